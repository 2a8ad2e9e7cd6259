"""The stand-in's finger: a rod with weight behind an orifice, whose material creeps and is hysteretic.

What bends it, and when, is `pneutac_truths.online.OnlineRod`. Here are its sizes, and its body in MuJoCo: the
rod cut into `PARTS` lengths h, each a hinge in the plane of the bend and one across it, of stiffness EI / h,
whose rest angles are those of the unloaded rod. Weight, inertia and contact act on that body, in the world
and on the bench.
"""

import mujoco
import numpy as np

from pneutac_sim.features import MAX_PRESSURE_KPA
from pneutac_sim.world.scene import PHYSICS_HZ, Finger
from pneutac_truths.online import OnlineRod
from pneutac_truths.rod import Rod

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
    xml = (
        f'<geom class="finger" type="capsule" fromto="{h / 2} 0 0 {h / 2 + end} 0 0" size=".0095" mass="0"/>'
    )
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
