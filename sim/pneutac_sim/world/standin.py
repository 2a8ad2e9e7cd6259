"""The stand-in for reality: a second simulated robot that differs from the twin as a real one would.

Its finger bends by other numbers and has effects that the built-in twin lacks; its gel is a full elastic
layer under another light; its joints, gauge and camera are noisy; commands act a control step late and
tactile images come a control step late. Augmentation and training see its recordings alone:
`docs/concepts/standin.md` lists every difference.
"""

from collections import deque
from typing import override

import mujoco
import numpy as np

from pneutac_sim.effects.photometric_nonlinearity import QUADRATIC
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.effects.sensor_effect import CHANNELS
from pneutac_sim.errors import InputError
from pneutac_sim.features import IMAGE_SHAPE, JOINT_NAMES, STANDIN_GELS, STATE_HIGH, STATE_LOW, STATE_NAMES
from pneutac_sim.gel import builtin
from pneutac_sim.gel.model import GelModel
from pneutac_sim.twin import Twin, Value
from pneutac_sim.world.scene import OBJECT_GROUP
from pneutac_sim.world.standin_touch import StandinTouch
from pneutac_sim.world.world import Observation, World

LATE_COMMANDS = 1  # control steps

# Standard deviations of what is read once a control step, in the order of `features.STATE_NAMES`: encoders,
# flange (by kinematics from them), gauge. Contact comes from the noisy image.
GAUGE_NOISE_KPA = 0.1
NOISE = np.zeros(len(STATE_NAMES))
_N = len(JOINT_NAMES)
NOISE[:_N], NOISE[_N : 2 * _N], NOISE[2 * _N : 2 * _N + 3], NOISE[-1] = 2e-4, 2e-3, 1e-4, GAUGE_NOISE_KPA

FINGER = {
    "gain_rad_per_kpa": 0.01114 * 1.12,
    "gain_alpha": 0.09,
    "gain_beta": 0.22,
    "rest_pressure_kpa": 10.2,
    "joint_stiffness_nm_per_rad": 0.49,
    "joint_damping_nms_per_rad": 0.009,
}
# A quarter of the bend arrives late, over some seconds; the chamber fills and vents with a lag.
CREEP = {"weight_0_4s": 0.02, "weight_1_3s": 0.10, "weight_4s": 0.21}
VALVE_LAG = {"fill_time_s": 0.28, "vent_time_s": 0.38}
GEL_FRICTION, GEL_STIFFNESS, OBJECT_MASS = 0.95, 1.12, 1.15  # factors


def standin_twin() -> Twin:
    """The stand-in's own finger and gel: what a perfect calibration of it would find."""
    twin = Twin.builtin()
    twin.parameters |= {k: Value(v) for k, v in FINGER.items()}
    late = {p.name: CREEP.get(p.name, 0.0) for p in get_effect("creep").parameters}
    for name, values in (("valve_lag", VALVE_LAG), ("creep", late)):
        twin.effects[name] = {k: Value(v) for k, v in values.items()}
    standin_gel().into_twin(twin)
    return twin


def standin_gel() -> GelModel:
    """The stand-in's DIGIT: other colours, other light, near LEDs, Lambert's cosine and shadows."""
    image = builtin.rest_image(IMAGE_SHAPE).astype(float)
    across = np.linspace(-1, 1, IMAGE_SHAPE[1])[None, :, None]
    image = image * (1.12, 0.88, 1.05) * (1 + across * (0.06, -0.04, 0.0))
    turn = np.radians(7.0)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    def each(name: str, values: tuple[float, float, float]) -> dict[str, float]:
        return {name.format(c): v for c, v in zip(CHANNELS, values, strict=True)}

    quadratic = {k: v for name in QUADRATIC for k, v in each(name, (0.0, 0.0, 0.0)).items()}
    return GelModel(
        np.clip(image, 0, 255).round().astype(np.uint8),
        builtin.LIGHT @ rotation.T * np.array([[1.15], [0.9], [1.1]]),
        np.array([-5.0, -6.0, -7.0]),
        depth_scale=0.94,
        effects={
            "near_light": each("distance_{}_mm", (16.0, 18.0, 40.0)),
            "photometric_nonlinearity": each("direct_{}_levels", (70.0, 60.0, 65.0)) | quadratic,
            "shadow": each("shadow_{}_levels", (25.0, 20.0, 22.0))
            | each("elevation_{}", (0.25, 0.22, 0.3))
            | {"edge_mm": 0.15},
            "rest_colour": each("exponent_{}", (1.3, 1.1, 0.6)),
        },
    )


class StandinWorld(World):
    """A world as `World`, whose robot is the stand-in; deterministic under `reset(seed)`.

    `command` is the action that was sent; it acts `LATE_COMMANDS` control steps later. `touch.image`,
    `pixels` and `area` are what the camera delivers, a control step late; `touch.depth_mm` is the present.
    """

    def __init__(self, task: str = "switch", touch: str = "image", gel: str = "layer"):
        """The stand-in before a task.

        Args:
            task: `switch`, `egg` or `card`.
            touch: `image`, `area` or `none`, see `World`.
            gel: `layer`, an elastic layer in contact (milliseconds); `mpm`, material points (seconds a step).

        Raises:
            InputError: unknown task, touch mode or gel.
        """
        if gel not in STANDIN_GELS:
            raise InputError(f"The stand-in's gel is '{gel}'; it must be one of {', '.join(STANDIN_GELS)}.")
        self._noise = np.random.default_rng(0)
        self._waiting: deque[np.ndarray] = deque()
        super().__init__(task, standin_twin(), touch, fidelity="probe")
        self._build_otherwise()
        full = None
        if gel == "mpm" and touch != "none":
            from pneutac_sim.world.mpm_gel import MpmGel  # compilers take seconds to start

            full = MpmGel(self.twin)
        self.touch = StandinTouch(self.model, self.sensor, touch, full)
        self.reset(0)

    def _build_otherwise(self) -> None:
        """Other friction and stiffness of the gel, heavier objects."""
        model = self.model
        model.geom_friction[model.geom("pad").id, 0] *= GEL_FRICTION
        model.jnt_stiffness[model.joint("pad").id] *= GEL_STIFFNESS
        objects = np.unique(model.geom_bodyid[model.geom_group == OBJECT_GROUP])
        model.body_mass[objects] *= OBJECT_MASS
        model.body_inertia[objects] *= OBJECT_MASS
        mujoco.mj_setConst(model, self.data)

    @override
    def reset(self, seed: int | None = None) -> Observation:
        if seed is not None:
            self._noise = np.random.default_rng([seed, 1])
        self._waiting = deque([np.zeros(4)] * LATE_COMMANDS)
        self._pressed = 0.0, None
        if isinstance(self.touch, StandinTouch):  # not yet while the world is being built
            self.touch.begin(self._noise)
        return super().reset(seed)

    @override
    def step(self, action: np.ndarray) -> Observation:
        sent = self._clip(action)
        self._waiting.append(sent)
        self._pressed = super().press_mm, super().imprint_m
        observation = super().step(self._waiting.popleft())
        self.command = sent
        return observation

    @property
    @override
    def press_mm(self) -> float:
        """How far the gel's surface is pressed in as the camera shows it, a control step late, mm."""
        return self._pressed[0]

    @property
    @override
    def imprint_m(self) -> np.ndarray | None:
        """Where the gel is pressed as the camera shows it, see `World.imprint_m`."""
        return self._pressed[1]

    @override
    def _observe(self) -> Observation:
        o = super()._observe()
        state = o.state + NOISE * self._noise.standard_normal(len(NOISE))
        return Observation(np.clip(state, STATE_LOW, STATE_HIGH).astype(np.float32), o.tactile)
