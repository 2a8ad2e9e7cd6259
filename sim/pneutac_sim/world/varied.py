"""Worlds laid out on purpose: object, start, gain or latency; and one whose finger bends sideways too."""

from collections import deque
from dataclasses import dataclass, field
from typing import override

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.world.scene import Finger
from pneutac_sim.world.soft_finger import mjcf
from pneutac_sim.world.tasks import Task
from pneutac_sim.world.tasks.base import HOME_JITTER_M, contact_force
from pneutac_sim.world.world import World


@dataclass(frozen=True)
class Variation:
    """What is different from the scene that the task itself draws.

    Attributes:
        start_m: flange position (3,) at the start, metres; None for the task's own.
        shift_m: displacement (3,) of the task's objects, metres.
        bend_gain: factor on the bend that the pressure makes.
        more_rad: bend in addition to that, shared by the joints.
        friction: factor on the friction of the gel.
        late_commands: control steps by which commands act later than the station says.
        at_once: whether commands act without any latency in place of that.
        late_touch: control steps by which touch is shown too late.
        conditions: in place of those that the world draws.
    """

    start_m: tuple[float, float, float] | None = None
    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bend_gain: float = 1.0
    friction: float = 1.0
    late_commands: int = 0
    late_touch: int = 0
    conditions: dict[str, float] = field(default_factory=dict)
    at_once: bool = False
    more_rad: float = 0.0


class VariedWorld(World):
    """A world with a `variation`, which acts from the next reset on."""

    variation = Variation()

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.task = _Staged(self.task, self.model)

    @override
    def reset(self, seed: int | None = None):
        if isinstance(self.task, _Staged):  # not yet while the world is being built
            self.task.variation = self.variation
        self._rest_rad = None
        observation = super().reset(seed)
        self._shown = deque([self._felt()] * self.variation.late_touch)
        return observation

    @property
    @override
    def home_m(self):
        start_m = self.variation.start_m
        return super().home_m if start_m is None else np.array(start_m)

    @property
    @override
    def _start_half_m(self):
        return super()._start_half_m if self.variation.start_m is None else np.full(3, HOME_JITTER_M)

    @property
    @override
    def _late_commands(self):
        return 0 if self.variation.at_once else super()._late_commands + self.variation.late_commands

    @override
    def _draw_conditions(self):
        return super()._draw_conditions() | self.variation.conditions

    @override
    def step(self, action: np.ndarray):
        super().step(action)
        self._shown.append(self._felt())
        self.touch.image, self.touch.pixels, self.touch.area = self._shown.popleft()
        return self._observe()

    @property
    def blocked(self) -> bool:
        """Whether the objects were laid where the hand starts: it touches them, or the task is over."""
        touches = contact_force(self.model, self.data, "") > 0
        return touches or self.success or self.failure is not None

    def _felt(self) -> tuple:
        return self.touch.image, self.touch.pixels, self.touch.area

    @override
    def _bend(self, q_cmd: np.ndarray) -> np.ndarray:
        if self._rest_rad is None:  # at the reset, where the pressure is off
            self._rest_rad = q_cmd
        bent = super()._bend(self._rest_rad + self.variation.bend_gain * (q_cmd - self._rest_rad))
        return bent + self.variation.more_rad / len(q_cmd)


class _Staged(Task):
    """A task as another one lays it out: after its own random start, its objects are moved."""

    def __init__(self, task: Task, model):
        self.inner, self.variation = task, Variation()
        self.name, self.description = task.name, task.description
        roots = (model.body(b) for b in range(1, model.nbody) if model.body_parentid[b] == 0)
        self._roots = [b.id for b in roots if b.name not in ("panda", "arm", "gantry")]
        self._pad = model.geom("pad").id
        self._grip = float(model.geom_friction[self._pad, 0])
        self._places = model.body_pos[self._roots].copy()

    @property
    def home_m(self):
        return self.inner.home_m  # that of the variation is the world's

    @property
    def starts_m(self):
        """Displacements from there along y, one of which is drawn."""
        return self.inner.starts_m if self.variation.start_m is None else (0.0,)

    @override
    def reset(self, model, data, rng):
        model.body_pos[self._roots] = self._places
        self.inner.reset(model, data, rng)
        model.body_pos[self._roots] += self.variation.shift_m
        for b in self._roots:
            joint = model.body_jntadr[b]
            if joint >= 0 and model.jnt_type[joint] == 0:  # a free object stands where its joint says
                at = model.jnt_qposadr[joint]
                data.qpos[at : at + 3] += self.variation.shift_m
        model.geom_friction[self._pad, 0] = self._grip * self.variation.friction

    @override
    def widen(self, width):
        self.inner.widen(width)

    @override
    def update(self, model, data, dt):
        self.inner.update(model, data, dt)

    @override
    def success(self):
        return self.inner.success()

    @override
    def failure(self):
        return self.inner.failure()


class SidewaysWorld(VariedWorld):
    """A world of a finger of one chamber whose joints are balls, as stiff across its plane as in it.

    That stiffness is an assumption: a bench measures the bend in the plane alone. Pressure bends it in its
    plane, as ever; only a load bends it across.

    Raises:
        InputError: the twin's body has several chambers, which any world bends to both sides.
    """

    @override
    def _finger_mjcf(self) -> Finger:
        if self.chambers > 1:
            raise InputError(
                f"The twin's {self.twin.device} has {self.chambers} chambers; a finger that a load bends"
                " sideways is made of one chamber alone."
            )
        return mjcf(self.twin, self.station.mount_mm, axes=2)

    @override
    def _bend(self, q_cmd: np.ndarray) -> np.ndarray:
        in_plane = super()._bend(q_cmd)
        return np.stack([in_plane, np.zeros_like(in_plane)], axis=1)

    @override
    def _in_plane(self, q: np.ndarray) -> np.ndarray:
        return q[:, 0]
