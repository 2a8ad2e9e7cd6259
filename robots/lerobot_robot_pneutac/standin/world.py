"""The stand-in in front of a task: arm and objects as in the twin's world, finger and touch its own.

Joints, gauge and camera are noisy; commands act a control step late and tactile images come a control step
late. Augmentation and training see its recordings alone: `docs/concepts/standin.md` lists what differs.

Its finger is a rod with weight behind an orifice, whose material creeps and is hysteretic. What bends it, and
when, is `pneutac_truths.online.OnlineRod`. Here are its sizes, and its body in MuJoCo: the rod cut into
`PARTS` lengths h, each a hinge in the plane of the bend and one across it, of stiffness EI / h, whose rest
angles are those of the unloaded rod. Weight, inertia and contact act on that body, in the world and on the
bench. Its gel has contact by theory and light by rays.
"""

from collections import deque
from dataclasses import dataclass, replace
from typing import override

import cv2
import mujoco
import numpy as np

from pneutac_sim.errors import InputError, check_choice
from pneutac_sim.features import CONTROL_HZ, IMAGE_SHAPE, MAX_PRESSURE_KPA, PAPER_RANGE_KPA, state_limits
from pneutac_sim.world import scene
from pneutac_sim.world.base import BaseWorld, Observation, imprint_m
from pneutac_sim.world.scene import OBJECT_GROUP, PHYSICS_HZ, Finger
from pneutac_sim.world.station import Station
from pneutac_sim.world.task_env import TaskEnv
from pneutac_sim.world.view import View
from pneutac_truths.light import Gel, Lamps
from pneutac_truths.online import OnlineRod
from pneutac_truths.rod import Rod

MODES = ("image", "area", "none")
LATE_IMAGES = 1  # control steps
NOISE_LEVELS = 1.5  # standard deviation of a pixel's channel
DRIFT_SHARE, DRIFT_S = 0.012, 20.0  # of the brightness of a channel, and over how long it wanders
WINDOW_MM = (12.0, 16.0)  # of a DIGIT
# LEDs such that the rest image is like photographs of two DIGITs (correlation 0.8).
LAMPS = Lamps(
    places=np.array([[-7.0, -1.7, -6.0], [10.0, -4.9, -6.0], [0.2, 13.0, -3.5]]),
    colours=np.array([[100.0, 11.0, 11.0], [8.0, 77.0, 12.0], [4.5, 14.0, 83.0]]),
    scattered=np.array([0.05, 0.12, 0.2]),
    camera_mm=14.0,
)


def new_gel(
    image_shape: tuple[int, int, int] = IMAGE_SHAPE, window_mm: tuple[float, float] = WINDOW_MM
) -> Gel:
    """The gel under its light, for images of a shape (H, W, 3).

    Lights stand as far apart as the window of the camera is wide and high, mm.
    """
    scale = np.append(np.divide(window_mm, WINDOW_MM), 1.0)
    lamps = replace(LAMPS, places=LAMPS.places * scale)
    return Gel(image_shape, window_mm, GEL_KPA, DOME_MM, lamps)


class GelTouch:
    """The stand-in's touch: `image`, `pixels`, `area` are late and noisy.

    Attributes:
        displacement_mm: (rows, columns) of the gel's face now.
        image: last tactile image uint8 (H, W, 3), or None where the mode has none.
        pixels: last count s of pixels in contact.
        area: s / N.
        rest_image: without contact, noise and drift.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        mode: str,
        threshold_levels: float,
        brightness: tuple[float, float, float] = (1.0, 1.0, 1.0),
        image_shape: tuple[int, int, int] = IMAGE_SHAPE,
        window_mm: tuple[float, float] = WINDOW_MM,
        dt_s: float = 1 / CONTROL_HZ,
    ):
        """The touch of a world; see `StandinWorld`."""
        check_choice("touch", mode, MODES)
        self.gel, self._mode, self._threshold = new_gel(image_shape, window_mm), mode, threshold_levels
        self.rest_image = self.gel.rest_image
        self._camera = CameraNoise(self.rest_image.shape, brightness, dt_s)
        self._site = model.site("gel").id
        shaped = model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE
        self._felt = np.flatnonzero((model.geom_group == OBJECT_GROUP) & shaped)
        if (model.geom_type[self._felt] == mujoco.mjtGeom.mjGEOM_MESH).any():
            raise InputError(
                "The stand-in's gel feels no meshes; build the task's objects of boxes, cylinders, capsules, "
                "spheres and ellipsoids to play it there."
            )
        self._kinds, self._sizes_mm = model.geom_type[self._felt], 1e3 * model.geom_size[self._felt]
        self._reach = model.geom_rbound[self._felt] + 1e-3 * np.hypot(*window_mm) / 2
        self.begin(np.random.default_rng(0))

    def begin(self, rng: np.random.Generator) -> None:
        """Starts an episode, whose noise `rng` draws."""
        self._camera.begin(rng)
        self._waiting: deque[tuple] = deque()
        self.displacement_mm = np.zeros(self.gel.shape)

    def prepare(self) -> None:
        """Presses a ball that nobody feels: what is compiled at the first touch is so before a clock runs."""
        kinds, sizes_mm, places_mm = [mujoco.mjtGeom.mjGEOM_SPHERE], np.full((1, 3), 4.0), [[0.0, 0.0, 3.5]]
        self.gel.image(self.gel.press(kinds, sizes_mm, np.array(places_mm), np.eye(3)[None])[0])

    def sense(self, data: mujoco.MjData) -> None:
        """Senses the present state; `data` must have its kinematics up to date."""
        self.image, self.pixels, self.area = None, 0, 0.0
        if self._mode == "none":
            return
        self.displacement_mm = self._press(data)
        touched = self.displacement_mm.any()
        clean = self.gel.image(self.displacement_mm) if touched else self.rest_image
        while len(self._waiting) <= LATE_IMAGES:
            image = self._camera.photograph(clean)
            pixels = contact_pixels(image, self.rest_image, self._threshold)
            self._waiting.append((image if self._mode == "image" else None, pixels))
        self.image, self.pixels = self._waiting.popleft()
        self.area = self.pixels / (self.rest_image.shape[0] * self.rest_image.shape[1])

    def _press(self, data: mujoco.MjData) -> np.ndarray:
        away = data.geom_xpos[self._felt] - data.site_xpos[self._site]
        near = np.square(away).sum(1) < self._reach**2
        if not near.any():
            return np.zeros(self.gel.shape)
        R = data.site_xmat[self._site].reshape(3, 3)
        turns = R.T @ data.geom_xmat[self._felt][near].reshape(-1, 3, 3)
        return self.gel.press(self._kinds[near], self._sizes_mm[near], 1e3 * away[near] @ R, turns)[0]


def contact_pixels(image: np.ndarray, rest_image: np.ndarray, threshold_levels: float) -> int:
    """How many pixels of an image uint8 (H, W, 3) differ from the rest image by more, mean over R, G, B.

    The median of 3 x 3 pixels counts, as on the robot: single pixels of noise are no touch.
    """
    change = cv2.absdiff(cv2.medianBlur(image, 3), cv2.medianBlur(rest_image, 3)).reshape(-1, 3)
    return int(np.count_nonzero(change @ np.ones(3, np.uint16) > 3 * threshold_levels))


class CameraNoise:
    """Noise of every pixel, and a slow drift of each channel's brightness about that of the rest image."""

    def __init__(
        self,
        shape: tuple[int, int, int],
        brightness: tuple[float, float, float] = (1.0, 1.0, 1.0),
        dt_s: float = 1 / CONTROL_HZ,
    ):
        """For images of a shape (H, W, 3), `dt_s` apart, whose colours are brighter by these factors."""
        self._brightness, self._keep = np.array(brightness), np.exp(-dt_s / DRIFT_S)
        self._shape, self._size = shape, int(np.prod(shape))
        # Drawing new noise takes longer than a whole control step; stretches of a longer one are as good.
        noise = NOISE_LEVELS * np.random.default_rng(0).standard_normal(3 * self._size, np.float32)
        self._pool = noise.round().astype(np.int8)
        self.begin(np.random.default_rng(0))

    def begin(self, rng: np.random.Generator) -> None:
        """A new episode, whose drift and noise `rng` draws."""
        self._rng, self._drift = rng, DRIFT_SHARE * rng.standard_normal(3)

    def photograph(self, image: np.ndarray) -> np.ndarray:
        """The image (H, W, 3) uint8 as the camera gives it one control step later than the last."""
        keep = self._keep
        self._drift = keep * self._drift + DRIFT_SHARE * np.sqrt(1 - keep**2) * self._rng.standard_normal(3)
        table = np.arange(256)[:, None] * (1 + self._drift) * self._brightness
        bright = cv2.LUT(image, table.clip(0, 255).round().astype(np.uint8)[None])
        start = int(self._rng.integers(len(self._pool) - self._size))
        noise = self._pool[start : start + self._size].reshape(self._shape)
        return cv2.add(bright, noise, dtype=cv2.CV_8U)


# Sizes of the drawing: flexible part, rigid end that carries the DIGIT, adapter to the flange, section.
LENGTH_MM, TIP_MM = 100.0, 10.0
MOUNT_M, SECTION_M = 0.020, 0.020
PARTS = 10

# Material. EI such that weight x length^2 / EI = 0.3, in the middle of silicone actuators (the range that
# `pneutac_truths.world.Body` draws from, with its sources); across the plane the strain-limiting layer
# stands on edge. The loss factor of silicone rubber, 0.1 to 0.3, is that of ETA_S between 2 and 5 Hz.
DENSITY = 1145.0  # kg/m3
STIFFNESS_NM2, ACROSS = 0.0145, 1.8
ETA_S = 0.010  # damping over stiffness (Kelvin and Voigt)

# Drive, air and memory, all inside the ranges from which `pneutac_truths.effects` draws with their sources.
# The bends bring the tip about as far as a finger of this length goes in the paper.
BEND_RAD, MOULDED_RAD = 0.60, 0.40
CHAMBER = {"start": 0.06, "end": 0.86, "taper": -0.35, "radius_mm": 10.0}
ORIFICE = {"critical": 0.3, "supply": 2.0, "growth": 0.8, "size": 0.45}
CREEP = {"order": 0.22, "size": 0.14}
HYSTERESIS = {"width": 0.2, "size": 0.22}

# DIGIT (Lambeta et al., IEEE RA-L 5 (2020) 3838): 27 x 20 x 18 mm, 20 g, of which the gel 5.
DIGIT_M, DIGIT_KG, PAD_KG = (0.027, 0.020, 0.018), 0.015, 0.005
GEL_ALONG_M, GEL_ABOVE_M = 0.017, 0.012  # gel's middle beyond the marker, and above the axis
PROUD_M = 0.0045  # by which it stands out of the housing
GEL_KPA, DOME_MM = 140.0, 40.0  # reduced modulus of soft silicone; radius of the face
FRICTION = 0.9
PAD_M = (0.0080, 0.0100)  # half width and half length of the face
PAD_DAMPING = 4.0  # N s/m
PAD_TRAVEL_M = 0.0025

_DEFAULTS = (
    '<default class="finger"><geom contype="1" conaffinity="2" group="3" friction=".5" solref=".004 1"'
    ' solimp=".95 .99 .0005"/></default>'
    '<default class="skin"><geom contype="0" conaffinity="0" group="1" mass="0"/></default>'
)
_MATERIALS = (
    '<material name="rod" rgba=".55 .30 .58 1" specular=".4" shininess=".5"/>'
    '<material name="digit" rgba=".30 .32 .36 1" specular=".4" shininess=".5"/>'
    '<material name="gel" rgba=".88 .86 .95 1" specular="1" shininess=".9"/>'
)


def new_rod(creep_size: float = CREEP["size"], orifice_size: float = ORIFICE["size"]) -> OnlineRod:
    """The rod with its air and memory, long without pressure; sizes as of `CREEP` and `ORIFICE`."""
    rod = Rod.of(LENGTH_MM, TIP_MM, **CHAMBER)
    orifice, creep = ORIFICE | {"size": orifice_size}, CREEP | {"size": creep_size}
    return OnlineRod(rod, MAX_PRESSURE_KPA, BEND_RAD, MOULDED_RAD, orifice, creep, HYSTERESIS)


def gel_force_n(depth_mm: float) -> float:
    """What the domed gel answers to a depth, by Hertz; see `pneutac_truths.light.Gel.force_n`."""
    return 4 / 3 * 1e-3 * GEL_KPA * np.sqrt(DOME_MM * max(depth_mm, 0.0) ** 3)


def body(axes: str, place: str) -> str:
    """MJCF of the finger with its DIGIT, in its base frame: x along it, z towards where it bends.

    `axes` (`xyaxes` of MJCF) and `place`, m, are those of that frame in its parent's.
    """
    h, end = 1e-3 * LENGTH_MM / PARTS, 1e-3 * TIP_MM
    tip = f'fromto="{h / 2} 0 0 {h / 2 + end} 0 0" size=".0095" mass="0"'
    xml = f'<geom class="finger" type="capsule" {tip}/>'
    xml += f'<site name="tip" pos="{h / 2 + end} 0 0" size=".001" group="5"/>{_digit(h / 2 + end)}'
    for n in reversed(range(PARTS)):
        m = DENSITY * SECTION_M**2 * h
        across = m * SECTION_M**2 / 6, m * (SECTION_M**2 + h**2) / 12
        xml = (
            f'<body name="part_{n}" pos="{h / 2 if n == 0 else h} 0 0">'
            f'<joint name="bend_{n}" axis="0 -1 0" {_spring(h)}/>'
            f'<joint name="across_{n}" axis="0 0 1" {_spring(h, ACROSS)}/>'
            f'<inertial mass="{m}" pos="0 0 0" diaginertia="{across[0]} {across[1]} {across[1]}"/>'
            f'<geom class="finger" type="capsule" fromto="{-h / 2} 0 0 {h / 2} 0 0" size=".0095" mass="0"/>'
            f'<geom class="skin" type="ellipsoid" size="{0.62 * h} .0115 .0105" material="rod"/>{xml}</body>'
        )
    return f'<body name="finger" pos="{place}" xyaxes="{axes}">{xml}</body>'


def mjcf(mount_m: float = MOUNT_M) -> Finger:
    """The finger for the frame `flange`, turned about it by 45 degrees as Franka's hand is."""
    c = float(np.sqrt(0.5))
    mount = f'<geom class="skin" type="cylinder" fromto="0 0 0 0 0 {mount_m}" size=".026" material="digit"/>'
    return Finger(mount + body(f"0 0 1 {-c} {-c} 0", f"0 0 {mount_m}"), _DEFAULTS, _MATERIALS)


def clamped() -> mujoco.MjModel:
    """The finger alone, hanging from a clamp on the bench."""
    timestep = 1 / PHYSICS_HZ
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option timestep="{timestep!r}" integrator="implicitfast"/>'
        f"<default>{_DEFAULTS}</default><asset>{_MATERIALS}</asset>"
        f"<worldbody>{body('0 0 -1 0 1 0', '0 0 0')}</worldbody></mujoco>"
    )


def _spring(h: float, factor: float = 1.0) -> str:
    """Of a hinge, EI / h, with damping eta EI / h; MuJoCo's step dt is stable as eta > dt / 2."""
    k = factor * STIFFNESS_NM2 / h
    return f'stiffness="{k}" damping="{ETA_S * k}"'


def _digit(start: float) -> str:
    """DIGIT behind x = `start` of the last part; the site `gel` has y along the finger, z out of the gel."""
    a, b, c = (x / 2 for x in DIGIT_M)
    x, z, axes = start + GEL_ALONG_M, GEL_ABOVE_M - PROUD_M - c, 'xyaxes="0 -1 0 1 0 0"'
    (px, py), rise = PAD_M, PAD_M[0] * PAD_M[1] / (1e-3 * DOME_MM)  # an ellipsoid's radius is a^2 / c
    return (
        f'<geom class="finger" type="box" pos="{start + a} 0 {z}" size="{a} {b} {c}" mass="{DIGIT_KG}"/>'
        f'<geom class="skin" type="box" pos="{start + a} 0 {z}" size="{a} {b} {c}" material="digit"/>'
        f'<site name="gel" pos="{x} 0 {GEL_ABOVE_M}" {axes} size=".001" group="5"/>'
        f'<body name="pad" pos="{x} 0 {GEL_ABOVE_M}" {axes} gravcomp="1">'
        f'<joint name="pad" type="slide" axis="0 0 1" damping="{PAD_DAMPING}" limited="true"'
        f' range="{-PAD_TRAVEL_M} 0"/>'
        f'<geom name="pad" class="finger" type="ellipsoid" pos="0 0 {-rise}" size="{px} {py} {rise}"'
        f' mass="{PAD_KG}" friction="{FRICTION}" priority="1" solref=".004 1" solimp=".99 .998 .001"/>'
        f'<geom class="skin" type="ellipsoid" pos="0 0 {-rise}" size="{px} {py} {rise}" material="gel"/>'
        "</body>"
    )


class RodBody:
    """The rod's body in a model, bent by its air."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, rod: OnlineRod | None = None):
        self._model, self._data, self.rod = model, data, rod or new_rod()
        names = [f"bend_{n}" for n in range(PARTS)]
        self._springs = [model.joint(n).qposadr[0] for n in names]
        self._pad, self._force = model.joint("pad").qposadr[0], model.joint("pad").dofadr[0]
        self.rest()

    def rest(self) -> None:
        """A finger that has long been without pressure, unloaded."""
        self.rod.rest()
        self._bends = self.rod.bends_rad(PARTS)
        self._data.qpos[self._springs] = self._model.qpos_spring[self._springs] = self._bends

    def advance(self, command_kpa: float, dt_s: float, each=lambda share: None) -> None:
        """Integrates `dt_s` under a command; `each(share)` is called before every substep.

        The rod's bends go from where they were to where they are at the end of it, and the gel answers by
        its force at every substep.
        """
        before = self._bends
        self.rod.step(command_kpa, dt_s)
        self._bends = self.rod.bends_rad(PARTS)
        steps = round(dt_s / self._model.opt.timestep)
        for share in np.arange(1, steps + 1) / steps:
            self._model.qpos_spring[self._springs] = before + share * (self._bends - before)
            self._data.qfrc_applied[self._force] = gel_force_n(-1e3 * self._data.qpos[self._pad])
            each(share)
            mujoco.mj_step(self._model, self._data)


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
        another shape or is not finite, DivergedError where the physics has diverged.
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


OF_WORLD = "contact_threshold", "image_shape", "window_mm", "station"


def standin_env(task: str = "switch", touch: str = "image", **options) -> TaskEnv:
    """A task on the stand-in; `options` are `OF_WORLD`, of `StandinWorld`, and those of `TaskEnv`."""
    own = {name: options.pop(name) for name in OF_WORLD if name in options}
    return TaskEnv(StandinWorld(task, touch, **own), touch, **options)
