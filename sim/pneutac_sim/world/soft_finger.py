"""MJCF of the skeleton finger with a DIGIT at its tip: spine hinges, spring-loaded gel pad, gel frame.

The skeleton is `M q'' + D q' + K q = tau_s` with one hinge a spine joint; a positive angle bends towards the
finger's +z. Where several chambers bend it to two sides each joint is a ball, see `spine`. M is that of the
material points, each going with its nearest link, and of the DIGIT; D is the chamber's, from the
twin. K is set by `Springs`: joints and, between each two hinges, tendons have its entries. The world drives
each hinge with a motor, each ball with three.

No weight acts on the finger here: q_cmd holds the sag under the loads of the twin's effects, and in a twin
without such effects that of the pose in which it was calibrated (the paper's p0 absorbs it).

The plate that is the gel's face in MuJoCo, on a spring that has the force of the gel's own material.

Object and finger both feel that spring: it stands between the plate and the sensor's housing. Once a control
step it is taken from the law for what lies under or before the gel, as F = k1 x + k3 x^3, which holds force
and slope at the present depth and rises from zero at the resting face, whatever happens within the step.
"""

import mujoco
import numpy as np

from pneutac_sim.finger.stages import Geometry
from pneutac_sim.gel.force import GelForce
from pneutac_sim.gel.probe import NO_TRIANGLES, SPHERE
from pneutac_sim.gel.spring import GelSpring, Spring
from pneutac_sim.mpm.solid import WIDTH_MM, Links, bending_body, parameter
from pneutac_sim.twin import Twin
from pneutac_sim.world.scene import Finger
from pneutac_sim.world.spine import BALL

MASS_KG = 0.0015
AHEAD_M = 0.001  # depth that may be reached within the control step
BALL_M = 0.004  # radius of what the face expects where nothing is near


class Pad:
    """The gel's face in a model of a scene with a finger, by the slide joint `pad`.

    With steps h, a steepest slope k of the spring and a mass M = max(m, 2 h^2 k) the springs, which MuJoCo
    takes at the beginning of a step, are stable at any k, and a damping of M / 2h is small enough for the
    contact solver, which takes dampers there too. Where nothing is near the face has the spring of a ball, so
    that what it does follows from the present state alone. `triangles` are those of objects that are meshes.

    Attributes:
        spring: that acts.

    Raises InputError: the gel's material is out of range, see `GelForce`.
    """

    def __init__(self, model: mujoco.MjModel, twin: Twin, triangles: np.ndarray = NO_TRIANGLES):
        self._model, self._springs = model, GelSpring(GelForce.of(twin), triangles)
        self._joint = model.joint("pad").id
        self._dof = model.jnt_dofadr[self._joint]
        ball = [SPHERE], [(BALL_M, 0, 0)], [(0, 0, BALL_M)], [np.eye(3)]
        self._free = self._springs.of(*ball, np.zeros(3), np.eye(3))
        self.spring: Spring | None = None
        self.feel(None)

    def feel(self, objects: tuple | None) -> None:
        """Puts the spring for `objects`, arguments of `probe_grid`, into the model; None is nothing near."""
        spring = (objects and self._springs.of(*objects)) or self._free
        if spring is self.spring:
            return
        self.spring, m, h = spring, self._model, self._model.opt.timestep
        m.jnt_stiffness[self._joint] = self.spring.k1
        m.jnt_stiffnesspoly[self._joint] = 0.0, self.spring.k3
        mass = max(MASS_KG, 2 * h**2 * self.spring.slope(self.spring.depth_m + AHEAD_M))
        m.dof_armature[self._dof], m.dof_damping[self._dof] = mass - MASS_KG, mass / (2 * h)


# DIGIT: housing 27 x 20 x 18 mm, about 20 g with its gel (Lambeta et al. 2020); metres, kg.
DIGIT_SIZE = (0.027, 0.020, 0.018)
DIGIT_MASS = 0.020 - MASS_KG  # without the plate that is the face of its gel
GEL_ALONG_M = 0.015  # middle of the gel window beyond the finger's length
GEL_ABOVE_M = 0.011  # resting gel surface above the neutral axis of a finger, see `gel_above_m`

# Gel pad: the gel's contact surface as one rigid plate on the spring of `world.pad`.
PAD_HALF_M = (0.0065, 0.0085, 0.001)  # gel frame x, y, z; a little more than the window that the camera sees
GEL_FRICTION = 1.0
GEL_TRAVEL_M, GEL_SLACK_M = 0.0025, 0.0001  # in, and out: nothing pulls it

DEFAULTS = (
    '<default class="finger"><geom contype="1" conaffinity="2" group="3" friction=".5"'
    ' solref=".004 1" solimp=".95 .99 .0005"/></default>'
    '<default class="skin"><geom contype="0" conaffinity="0" group="1" material="soft" mass="0"/></default>'
)
MATERIALS = (
    '<material name="soft" rgba=".16 .18 .22 1" specular=".35" shininess=".3"/>'
    '<material name="bellow" rgba=".12 .55 .58 1" specular=".5" shininess=".6"/>'
    '<material name="digit" rgba=".95 .70 .25 1" specular=".4" shininess=".5"/>'
    '<material name="gel" rgba=".88 .86 .95 1" specular="1" shininess=".9"/>'
)


def mjcf(twin: Twin, mount_mm: float = 20.0, axes: int | None = None, motor_gear: float = 1.0) -> Finger:
    """All of the finger of a twin, on an adapter of that length between the flange and its base.

    `axes` of bending a joint has; None for those about which its chambers bend it. `motor_gear` is the torque
    in N m of a control of 1.
    """
    axes = axes or bending_axes(twin)
    joints = range(1, len(twin.spine_joint_positions_mm) + 1)
    turns = ("",) if axes == 1 else ("_x", "_y", "_z")  # of a joint's motors
    gears = ("{}",) if axes == 1 else ("{} 0 0 0 0 0", "0 {} 0 0 0 0", "0 0 {} 0 0 0")
    motors = "".join(
        f'<motor name="spine_{n}{turn}" joint="spine_{n}" gear="{gear.format(motor_gear)}"/>'
        for n in joints
        for turn, gear in zip(turns, gears, strict=True)
    )
    xml = body(twin, 1e-3 * mount_mm, axes)
    return Finger(xml, DEFAULTS, MATERIALS, motors, tendons(twin, axes))


def bending_axes(twin: Twin) -> int:
    """Bending axes of a joint: 1 with one chamber, 2 with several."""
    return Geometry(twin.device, twin.length_mm, tuple(twin.spine_joint_positions_mm)).axes


def half_width_m(twin: Twin) -> float:
    """Half the width of the body: of an arm its own, of a finger always that of the paper's."""
    width_mm = parameter(twin, "width_mm") if bending_axes(twin) > 1 else WIDTH_MM["finger"]
    return 0.5e-3 * width_mm


def gel_above_m(twin: Twin) -> float:
    """How far the resting gel's surface is above the neutral axis: a millimetre proud of the body."""
    return GEL_ABOVE_M + half_width_m(twin) - 0.5e-3 * WIDTH_MM["finger"]


def body(twin: Twin, mount_m: float, axes: int) -> str:
    """MJCF of mount, finger and DIGIT for the flange: finger x along flange z, hanging down at home.

    The finger is turned by 45 degrees about the flange's axis, as Franka's own hand is, so that at home it
    bends towards world +x.
    """
    s = np.asarray(twin.spine_joint_positions_mm) * 1e-3
    length = twin.length_mm * 1e-3
    ends, links = np.append(s, length), Links.of(bending_body(twin), s)
    half, flat = half_width_m(twin), bending_axes(twin) == 1
    kind = 'axis="0 -1 0"' if axes == 1 else 'type="ball"'

    tip = '<site name="tip" size=".001" group="5"/>'
    xml = f'<body name="sensor" pos="{length - s[-1]} 0 0">{tip}{_digit(gel_above_m(twin))}</body>'
    for n in reversed(range(len(s))):
        xml = (
            f'<body name="spine_{n + 1}" pos="{s[n] - (s[n - 1] if n else 0.0)} 0 0"'
            ' gravcomp="1">'
            f'<joint name="spine_{n + 1}" {kind}/>'
            f"{_inertial(links, n + 1, s[n], sensor(twin) if n == len(s) - 1 else None)}"
            f"{_segment(ends[n + 1] - ends[n], half, flat)}{xml}</body>"
        )
    c, thick = float(np.sqrt(0.5)), half + 0.002
    shape = f'type="cylinder" fromto="0 0 0 0 0 {mount_m}" size=".026"'
    mount = f'<geom class="skin" {shape} material="arm_dark"/>'
    base = f'<geom class="skin" type="box" pos="{s[0] / 2} 0 0" size="{s[0] / 2} {thick} {thick}"/>'
    base *= bool(s[0])  # none where the first joint is at the base
    return (
        f'{mount}<body name="finger" pos="0 0 {mount_m}" xyaxes="0 0 1 {-c} {-c} 0">'
        f"{_inertial(links, 0, 0.0)}{base}{xml}</body>"
    )


def sensor(twin: Twin) -> Links:
    """DIGIT and gel pad as two lumps in the frame of the straight finger, which the last link carries."""
    boxes = np.array([DIGIT_SIZE, 2 * np.array([PAD_HALF_M[1], PAD_HALF_M[0], PAD_HALF_M[2]])])
    mass, tip = np.array([DIGIT_MASS, MASS_KG]), 1e-3 * twin.length_mm
    above = gel_above_m(twin)
    digit, pad = (DIGIT_SIZE[0] / 2, 0.0, above - GEL_ABOVE_M), (GEL_ALONG_M, 0.0, above - PAD_HALF_M[2])
    squares = mass[:, None] / 12 * np.square(boxes)
    inertia = [np.diag(each.sum() - each) for each in squares]
    return Links(mass, np.array([digit, pad]) + [tip, 0.0, 0.0], np.array(inertia))


def tendons(twin: Twin, axes: int) -> str:
    """MJCF tendons of length q_i + q_j, one for each two hinges, whose stiffness couples them."""
    if axes > 1:
        return ""
    ties = "".join(
        f'<fixed name="spine_{i + 1}_{j + 1}"><joint joint="spine_{i + 1}" coef="1"/>'
        f'<joint joint="spine_{j + 1}" coef="1"/></fixed>'
        for i, j in _pairs(len(twin.spine_joint_positions_mm))
    )
    return f"<tendon>{ties}</tendon>" if ties else ""


class Springs:
    """The stiffness matrix K (N, N) of a finger in a model, whatever its size stable in the time step.

    (q_i + q_j)^2 = q_i^2 + q_j^2 + 2 q_i q_j, so a tendon of stiffness K_ij couples two joints and each joint
    keeps K_ii less those of its tendons. MuJoCo takes springs at the beginning of a step h and dampers at its
    end. A further damping of h K / 2 makes that stable at any K, where springs alone are up to w h = 2: (M +
    h D + h^2 K / 2) q'_1 = M q'_0 - h K q_0, with a growth of at most 1 for all eigenvalues of M^-1 K. What
    this takes of the slowest swing, which has about the whole stiffness, is left out of D, each joint's
    damping.

    Balls are not coupled: of their K the diagonal alone counts, the same about each axis.
    """

    def __init__(
        self, model: mujoco.MjModel, joints: int, damping_nms_per_rad: float, whole_nm_per_rad: float
    ):
        names = [f"spine_{n + 1}" for n in range(joints)]
        balls = model.joint(names[0]).type[0] == BALL
        pairs = [] if balls else _pairs(joints)
        self._model = model
        self._damping = max(damping_nms_per_rad - 0.5 * model.opt.timestep * whole_nm_per_rad, 0.0)
        self._joints = [model.joint(n).id for n in names]
        self._dofs = model.jnt_dofadr[self._joints][:, None] + np.arange(3 if balls else 1)
        self._pairs = tuple(np.array(pairs, int).reshape(-1, 2).T)
        self._tendons = [model.tendon(f"spine_{i + 1}_{j + 1}").id for i, j in pairs]

    def set(self, K: np.ndarray) -> np.ndarray:
        """Puts the symmetric K (N, N), N m/rad, into the model; returns all that damps it, N m s/rad."""
        m, half = self._model, 0.5 * self._model.opt.timestep
        tied = K[self._pairs]
        own = 2 * K.diagonal() - K.sum(1)
        m.tendon_stiffness[self._tendons], m.tendon_damping[self._tendons] = tied, half * tied
        m.jnt_stiffness[self._joints] = own
        m.dof_damping[self._dofs] = (self._damping + half * own)[:, None]
        return half * K + self._damping * np.eye(len(K))


def _pairs(joints: int) -> list[tuple[int, int]]:
    return [(i, j) for i in range(joints) for j in range(i + 1, joints)]


def _inertial(links: Links, k: int, joint_m: float, carried: Links | None = None) -> str:
    """MJCF inertial of link `k` in the frame of its joint; the first of what is carried goes with it."""
    parts = [(links.mass_kg[k], links.centre_m[k], links.inertia_kg_m2[k])]
    if carried is not None:
        parts.append((carried.mass_kg[0], carried.centre_m[0], carried.inertia_kg_m2[0]))
    mass = sum(m for m, _, _ in parts)
    if mass == 0:  # a base of no length
        return ""
    centre, inertia = sum(m * c for m, c, _ in parts) / mass, np.zeros((3, 3))
    for m, c, own in parts:
        r = c - centre
        inertia += own + m * (r @ r * np.eye(3) - np.outer(r, r))
    x, y, z = centre - [joint_m, 0.0, 0.0]
    full = [*inertia.diagonal(), inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    return f'<inertial pos="{x} {y} {z}" mass="{mass}" fullinertia="{" ".join(map(str, full))}"/>'


def _segment(length: float, half: float, flat: bool) -> str:
    """Bellows to look at and a capsule to touch, of the segment from x = 0 to `length`, half as wide."""
    rings = max(1, round(length / 0.0095))
    pitch = length / rings
    if flat:  # bellows above a spine
        above, across, deep = 0.0015, 0.0115, 0.0105
        spine = f'<geom class="skin" type="box" pos="{length / 2} 0 -.0075" size="{length / 2} .010 .003"/>'
    else:
        above, across, deep, spine = 0.0, half, half, ""
    skin = "".join(
        f'<geom class="skin" type="ellipsoid" pos="{(k + 0.5) * pitch} 0 {above}"'
        f' size="{0.62 * pitch} {across} {deep}" material="bellow"/>'
        for k in range(rings)
    )
    shape = f'type="capsule" fromto="0 0 0 {length} 0 0" size="{half - 0.0005}"'
    return f'{skin}{spine}<geom class="finger" {shape} mass="0"/>'


def _digit(above: float) -> str:
    """DIGIT housing and gel, from the finger's end on, its resting surface `above` the neutral axis.

    The site `gel` is the gel frame of `pneutac_sim.gel.probe`: y along the finger (image rows, towards the
    tip), z out of the gel, origin in the middle of the window on the resting surface.
    """
    a, b, c = (x / 2 for x in DIGIT_SIZE)
    z = above - 0.003 - c  # the gel stands 3 mm proud of the housing
    x = GEL_ALONG_M
    px, py, pz = PAD_HALF_M
    axes = 'xyaxes="0 -1 0 1 0 0"'
    return (
        f'<geom class="finger" type="box" pos="{a} 0 {z}" size="{a} {b} {c}" mass="0"/>'
        f'<geom class="skin" type="box" pos="{a} 0 {z}" size="{a} {b} {c}" material="digit"/>'
        f'<site name="gel" pos="{x} 0 {above}" {axes} size=".001" group="5"/>'
        f'<body name="pad" pos="{x} 0 {above}" {axes} gravcomp="1">'
        # Stops, hard after 2 mm: an edge that rubs along the gel's side would drag the face farther off,
        # where its spring is not stable.
        f'<joint name="pad" type="slide" axis="0 0 1" limited="true"'
        f' range="{-GEL_TRAVEL_M} {GEL_SLACK_M}" solimplimit=".9 .9999 .002"/>'
        f'<geom name="pad" class="finger" type="box" pos="0 0 {-pz}" size="{px} {py} {pz}" mass="{MASS_KG}"'
        f' friction="{GEL_FRICTION}" priority="1" solref=".004 1" solimp=".995 .998 .001"/>'
        f'<geom class="skin" type="box" pos="0 0 {-pz * 1.6}" size="{px} {py} {pz * 1.6}" material="gel"/>'
        f"</body>"
    )
