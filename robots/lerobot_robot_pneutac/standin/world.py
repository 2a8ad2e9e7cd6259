"""The stand-in in front of a task: arm and objects as in the twin's world, finger and touch its own.

Joints, gauge and camera are noisy; commands act a control step late and tactile images come a control step
late. Augmentation and training see its recordings alone: `docs/concepts/standin.md` lists what differs.
"""

from dataclasses import dataclass
from typing import override

import mujoco
import numpy as np

from lerobot_robot_pneutac.standin.finger import (
    CREEP,
    LENGTH_MM,
    ORIFICE,
    PARTS,
    TIP_MM,
    RodBody,
    gel_force_n,
    mjcf,
    new_rod,
)
from lerobot_robot_pneutac.standin.gel import WINDOW_MM, GelTouch
from pneutac_sim.features import IMAGE_SHAPE, PAPER_RANGE_KPA, state_limits
from pneutac_sim.world import scene
from pneutac_sim.world.base import BaseWorld, Observation, imprint_m
from pneutac_sim.world.station import Station
from pneutac_sim.world.task_env import TaskEnv
from pneutac_sim.world.view import View

LATE_COMMANDS = 1  # control steps
OBJECT_MASS = 1.15  # factor
CONTACT_THRESHOLD = 12.0  # levels, where no twin gives a calibrated one

# Standard deviations of what is read once a control step: encoders (rad, rad/s), flange (m, by kinematics
# from them), gauge. Contact comes from the noisy image.
ENCODER_NOISE, RATE_NOISE, FLANGE_NOISE, GAUGE_NOISE_KPA = 2e-4, 2e-3, 1e-4, 0.1


@dataclass(frozen=True)
class Physics:
    """What a lab's robot may do otherwise than when it was measured; the defaults are as on its bench."""

    late_commands: int = LATE_COMMANDS  # control steps by which commands act late
    creep: float = CREEP["size"]  # size of the power law, see `finger.CREEP`
    orifice: float = ORIFICE["size"]  # size of the valve, see `finger.ORIFICE`
    # factors on red, green and blue of the gel's light
    brightness: tuple[float, float, float] = (1.0, 1.0, 1.0)
    object_mass: float = OBJECT_MASS  # factor on the mass of moving objects
    friction: float = 1.0  # factor on the friction of the gel
    # factor on the bending stiffness of the finger, which its air bends as far as before
    stiffness: float = 1.0


class StandinWorld(BaseWorld):
    """The stand-in and a task; deterministic under `reset(seed)`. See `BaseWorld` for what is not here.

    It has the methods of `pneutac_sim.world.World`, for environment, robot and experts. Commands act some
    control steps late, see `Physics`; `out_of_range` stays 0, for it has no networks.

    Attributes:
        touch: last touch: `image`, `pixels`, `area`, a control step late.
    """

    chambers = 1
    pressure_range_kpa = PAPER_RANGE_KPA  # that of its own finger

    def __init__(
        self,
        task: str = "switch",
        touch: str = "image",
        contact_threshold: float = CONTACT_THRESHOLD,
        physics: Physics | None = None,
        image_shape: tuple[int, int, int] = IMAGE_SHAPE,
        window_mm: tuple[float, float] = WINDOW_MM,
        station: Station | None = None,
    ):
        """The stand-in before a task; `touch` is `image`, `area` (contact area without an image) or `none`.

        `contact_threshold` is the mean difference of R, G, B to the rest image, 8-bit levels, above which a
        pixel is in contact; that of a lab's twin, as on its real robot. Tactile images, where they are none
        of a DIGIT's, have a shape and show `window_mm` (width, height) of the gel. The latency of the
        station, by default the paper's, comes on top of its own. Raises InputError for an unknown task or
        touch mode, or an arm that does not reach.
        """
        super().__init__(task, station, LENGTH_MM + TIP_MM)
        self._physics = physics or Physics()
        objects = np.unique(self.model.geom_bodyid[self.model.geom_group == scene.OBJECT_GROUP])
        self.model.body_mass[objects] *= self._physics.object_mass
        self.model.body_inertia[objects] *= self._physics.object_mass
        self.model.geom_friction[self.model.geom("pad").id, 0] *= self._physics.friction
        springs = [self.model.joint(f"{way}_{n}") for way in ("bend", "across") for n in range(PARTS)]
        for joint in springs:
            joint.stiffness *= self._physics.stiffness
            joint.damping *= self._physics.stiffness
        mujoco.mj_setConst(self.model, self.data)
        self.touch = GelTouch(
            self.model, touch, contact_threshold, self._physics.brightness, image_shape, window_mm, self.dt_s
        )
        rows, columns, _ = self.tactile_shape
        joints = (self.arm.low_rad, self.arm.high_rad, self.arm.speed_rad_s)
        self._limits = state_limits(self.pressure_range_kpa, joints, rows * columns)
        n = self.arm.joints
        encoders, flange = [ENCODER_NOISE] * n + [RATE_NOISE] * n, [FLANGE_NOISE] * 3
        self._deviation = np.array([*encoders, *flange, 0.0, 0.0, GAUGE_NOISE_KPA])
        rod = new_rod(self._physics.creep, self._physics.orifice)
        self._finger = RodBody(self.model, self.data, rod)
        self.view, self._noise = View(self.model), np.random.default_rng(0)
        self.reset(0)

    def reset(self, seed: int | None = None) -> Observation:
        """Starts an episode, before which the finger has long rested.

        The seed decides everything; without one the next start of the same stream is drawn.
        """
        if seed is not None:
            self._rng, self._noise = np.random.default_rng(seed), np.random.default_rng([seed, 1])
        self._start()
        self._finger.rest()
        self._settle(0.0)
        self._shown = self._felt()
        self.touch.begin(self._noise)
        self.touch.sense(self.data)
        return self._observe()

    def step(self, action: np.ndarray) -> Observation:
        """Advances one control step, `dt_s`, by an action (4,) as `features.ACTION_NAMES`.

        What exceeds the limits is clipped and counted in `clipped`. Raises InputError where the action has
        another shape or is not finite, FloatingPointError where the physics has diverged.
        """
        joints, pressures_kpa = self._send(action)
        self._shown = self._felt()
        self._advance(joints, float(pressures_kpa[0]))
        scene.check_physics(self.data)
        self.task.update(self.model, self.data, self.dt_s)
        self.touch.sense(self.data)
        return self._observe()

    @override
    def _finger_mjcf(self) -> scene.Finger:
        return mjcf(1e-3 * self.station.mount_mm)

    @property
    @override
    def _late_commands(self) -> int:
        return super()._late_commands + self._physics.late_commands

    @override
    def _advance(self, joints: np.ndarray, drive: float) -> None:
        before = self._joints

        def servo(share: float) -> None:
            self.data.ctrl[self._arm] = before + share * (joints - before)

        self._finger.advance(drive, self.dt_s, servo)
        mujoco.mj_kinematics(self.model, self.data)
        self._joints = joints

    @property
    def tactile_shape(self) -> tuple[int, int, int]:
        """Height, width and channels of the tactile image."""
        return self.touch.rest_image.shape

    def _observe(self) -> Observation:
        d, s = self.data, self.touch.pixels
        contact = [self.touch.area, np.log1p(s), self.pressure_kpa]
        state = np.concatenate([d.qpos[self._arm], d.qvel[self._arm], self.flange_m - self._base_m, contact])
        state += self._deviation * self._noise.standard_normal(len(state))
        return Observation(np.clip(state, *self._limits).astype(np.float32), self.touch.image)

    def _felt(self) -> tuple[float, np.ndarray | None]:
        """How far the gel is pressed in, mm, and where: the centre of pressure (2,) in its frame, m."""
        return -1e3 * float(self.data.joint("pad").qpos[0]), imprint_m(self.model, self.data)

    @property
    def press_mm(self) -> float:
        """How far the gel's face is pressed in as the camera shows it, a control step late, mm."""
        return self._shown[0]

    @property
    def press_n(self) -> float:
        """Force on the gel, N, by that imprint."""
        return gel_force_n(self._shown[0])

    @property
    def imprint_m(self) -> np.ndarray | None:
        """Where it is pressed as the camera shows it: across and along the finger (2,), m; None where not."""
        return self._shown[1]

    @property
    def pressure_kpa(self) -> float:
        """Pressure in the finger's chamber, kPa."""
        return self._finger.rod.pressure_kpa


def standin_env(
    task: str = "switch",
    touch: str = "image",
    contact_threshold: float = CONTACT_THRESHOLD,
    image_shape: tuple[int, int, int] = IMAGE_SHAPE,
    window_mm: tuple[float, float] = WINDOW_MM,
    station: Station | None = None,
    **options,
) -> TaskEnv:
    """A task on the stand-in for reality; arguments of `StandinWorld`, `options` of `TaskEnv`."""
    return TaskEnv(
        StandinWorld(task, touch, contact_threshold, None, image_shape, window_mm, station), touch, **options
    )
