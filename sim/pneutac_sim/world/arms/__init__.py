"""Arms other than the paper's: those of the library, and what says which one carries the finger.

An arm from its URDF or MJCF: the chain of hinges from its base to its flange, by MuJoCo.

Of the file only the chain counts: frames, axes, limits. Its shapes are left out, so that meshes that are
missing, or in a format that MuJoCo does not read, are no hindrance; capsules are drawn between the joints.
With stiff joint control a link's mass matters for little, so every link has the same.
"""

import dataclasses
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from pneutac_sim.errors import InputError, as_numbers, shown, unknown_names
from pneutac_sim.features import PANDA_JOINTS, joint_names
from pneutac_sim.files import refuse_pointer
from pneutac_sim.world import panda
from pneutac_sim.world.panda import Panda

LEAST_JOINTS = 5  # to hold the flange's direction while it goes anywhere
TILT = np.cos(np.radians(5))  # of the flange's axis from straight down at home, at most
LINK_KG = 1.0
THICKNESS = 0.045  # radius of the capsules as a share of the longest link
_NAME = r"""\bname\s*=\s*(["'])(.*?)\1"""
_MIMIC = r"""<mimic\b[^>]*\bjoint\s*=\s*(["'])(.*?)\1"""  # inside of a URDF's joint
MOST_REACH_M = 5.0  # of an arm that carries a finger over a table
MOST_TURN_RAD = 2 * np.pi  # of a joint without limits
LEFT_OUT = (  # of a file: all that the chain does not need
    "geoms meshes hfields skins textures materials actuators sensors equalities tendons keys excludes pairs"
).split()


@dataclass(frozen=True)
class Link:
    """One body of the chain in the frame of the one before."""

    # pos, quat: its frame, m
    pos: np.ndarray
    quat: np.ndarray
    # joints (origin (3,), axis (3,), lowest, highest angle in rad), mostly one or none
    hinges: tuple[tuple[np.ndarray, np.ndarray, float, float], ...]


DAMPING, TURN_DAMPING = 0.005, 0.05  # m and rad a joint's rad, below which a direction counts as out of reach
ITERATIONS = 3


class ChainIK:
    """Joint targets that bring the flange to a position, its orientation held as at home as far as it can.

    `dq = J_p+ e_p + (J_r N)+ (e_r - J_r J_p+ e_p)` with damped pseudo-inverses, the position's null space
    `N = I - J_p+ J_p`, position error e_p and rotation vector e_r to the held orientation (Siciliano and
    Slotine, ICAR 1991). Joint limits are enforced by clipping. Position comes first, unlike in
    `panda.CartesianIK`, as an arm of five joints cannot meet both.

    Attributes:
        q: the present joint targets, as they were `reset`, rad; each `solve` starts from them.
        missing_m: by how much the last `solve` fell short, of the last of several arms.
    """

    def __init__(self, model: mujoco.MjModel, base_m: np.ndarray, home_rad: np.ndarray):
        """Of the arm alone in a model, with the site `flange`; its base at `base_m` (3,)."""
        self._model, self._data, self._base_m = model, mujoco.MjData(model), base_m
        self._site = model.site("flange").id
        self._home = home_rad
        self._held, _ = self.pose(home_rad)
        self.reset(home_rad)

    def pose(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotation (3, 3) and position (3,), m, of the flange in the base's frame at joint angles (N,)."""
        self._data.qpos[:] = q
        mujoco.mj_kinematics(self._model, self._data)
        rotation = self._data.site_xmat[self._site].reshape(3, 3).copy()
        return rotation, self._data.site_xpos[self._site] - self._base_m

    def jacobian(self) -> tuple[np.ndarray, np.ndarray]:
        """Of position (3, N) and rotation (3, N), where `pose` was asked last."""
        position, rotation = np.zeros((2, 3, self._model.nv))
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_jacSite(self._model, self._data, position, rotation, self._site)
        return position, rotation

    def reset(self, q: np.ndarray | None = None) -> None:
        """Starts again from the joint angles `q` (N,), or (M, N) of M arms, rad; from home without."""
        self.q, self.missing_m = np.array(self._home if q is None else q, float), 0.0

    def hold(self, q: np.ndarray) -> None:
        """Starts from the joint angles `q` (N,), rad, and holds the orientation that the flange has there."""
        self.reset(q)
        self._held, _ = self.pose(q)

    def solve(self, position: np.ndarray) -> np.ndarray:
        """Joint targets (N,), rad, for the flange at `position` (3,), metres in the base frame.

        After `reset` with angles (M, N) those (M, N) of M arms at positions (M, 3).
        """
        for q, at in zip(np.atleast_2d(self.q), np.atleast_2d(position), strict=True):
            q[:] = self._approach(q, at)
        return self.q.copy()

    def _approach(self, q: np.ndarray, position: np.ndarray) -> np.ndarray:
        """`solve` of one arm, from joint angles (N,)."""
        low, high = self._model.jnt_range.T
        for _ in range(ITERATIONS):
            rotation, at = self.pose(q)
            J_p, J_r = self.jacobian()
            away = np.zeros(4)
            mujoco.mju_mat2Quat(away, np.ascontiguousarray(self._held @ rotation.T).ravel())
            turn = np.zeros(3)
            mujoco.mju_quat2Vel(turn, away, 1.0)
            inverse = _inverse(J_p, DAMPING)
            step = inverse @ (position - at)
            free = J_r @ (np.eye(len(q)) - inverse @ J_p)
            step += _inverse(free, TURN_DAMPING) @ (turn - J_r @ step)
            q = np.clip(q + step, low, high)
        self.missing_m = float(np.linalg.norm(position - self.pose(q)[1]))
        return q


def _inverse(J: np.ndarray, damping: float) -> np.ndarray:
    """Damped pseudo-inverse `J^T (J J^T + damping^2 I)^-1`."""
    return J.T @ np.linalg.inv(J @ J.T + damping**2 * np.eye(len(J)))


class Chain:
    """An arm of N hinges; the finger hangs from its flange as it does from the Panda's.

    Attributes:
        joints: N.
        root: name of its outermost body.
        base_m: where its base stands (3,).
        low_rad, high_rad, speed_rad_s: limits (N,) of the joints.
        home_rad: (N,) where every inverse kinematics starts.
    """

    root = "arm"

    def __init__(self, file: str, flange: str, home_rad: Sequence[float], base_m: Sequence[float]):
        """An arm from a URDF or MJCF whose link (body, site) `flange` points down at home.

        Raises InputError: one sentence with file and fault.
        """
        self.base_m, self.home_rad = np.array(base_m, float), np.array(home_rad, float)
        self._links = read_chain(Path(file), flange)
        limits = [(low, high) for link in self._links for *_, low, high in link.hinges]
        self.joints = len(limits)
        self._check(file, flange, limits)
        self.low_rad, self.high_rad = np.array(limits).T
        self.speed_rad_s = np.full(self.joints, np.pi)  # no motion here comes near a joint's own limit
        self._turn = np.array([1.0, 0.0, 0.0, 0.0])
        home, _ = self.solver().pose(self.home_rad)
        down = panda.forward_kinematics(panda.HOME_JOINTS)[:3, :3]
        if home[:, 2] @ down[:, 2] < TILT:
            raise InputError(
                f"{file}: at home_rad {self.home_rad.tolist()} the z axis of '{flange}' points along"
                f" {np.round(home[:, 2], 2).tolist()}; give joint angles at which it points down, (0, 0, -1)."
            )
        # However the flange is turned about its axis, the finger is mounted to bend forwards at home.
        mujoco.mju_mat2Quat(self._turn, np.ascontiguousarray(home.T @ down).ravel())
        self._gains = self._servo_gains()

    def _check(self, file, flange: str, limits: list) -> None:
        reach = sum(float(np.linalg.norm(link.pos)) for link in self._links)
        if reach > MOST_REACH_M:
            raise InputError(
                f"{file}: the links to '{flange}' are {reach:.4g} m long together, which can only be"
                " millimetres; give the file's lengths in metres."
            )
        if self.joints < LEAST_JOINTS:
            raise InputError(
                f"{file}: {self.joints} joints lead to '{flange}'; it takes {LEAST_JOINTS} or more to hold"
                " the finger's direction."
            )
        if len(self.home_rad) != self.joints:
            raise InputError(
                f"{file}: {self.joints} joints lead to '{flange}', and home_rad has {len(self.home_rad)}"
                " angles; give one a joint, from the base on."
            )
        for name, q, (low, high) in zip(joint_names(self.joints), self.home_rad, limits, strict=True):
            if not low <= q <= high:
                raise InputError(
                    f"{file}: home_rad has {q:g} for {name}, whose limits are {low:.4g} and {high:.4g} rad."
                )

    def body(self, payload: str = "") -> str:
        """MJCF body of the arm; `payload` is MJCF placed in the frame `flange`."""
        site = '<site name="flange" size=".001" group="5"/>'
        xml = f'<body name="flange" quat="{_text(self._turn)}">{site}{payload}</body>'
        thick = THICKNESS * max(np.linalg.norm(link.pos) for link in self._links)
        number, names = self.joints, joint_names(self.joints)
        for k in reversed(range(len(self._links))):
            link, ahead = self._links[k], [n.pos for n in self._links[k + 1 : k + 2]]
            hinges = ""
            for at, axis, low, high in reversed(link.hinges):
                number -= 1
                hinges = (
                    f'<joint name="{names[number]}" pos="{_text(at)}" axis="{_text(axis)}" limited="true"'
                    f' range="{float(low)!r} {float(high)!r}" armature="{panda.ARMATURE}"/>{hinges}'
                )
            shape = f'type="sphere" size="{1.2 * thick}" mass="{LINK_KG / 2}" material="arm_dark"'
            geoms = f'<geom class="arm" {shape}/>' if hinges or k == 0 else ""
            if ahead and np.linalg.norm(ahead[0]) > thick:
                shape = f'type="capsule" fromto="0 0 0 {_text(ahead[0])}" size="{thick}"'
                geoms += f'<geom class="arm" {shape} mass="{LINK_KG / 2}" material="arm"/>'
            xml = (
                f'<body name="link{k + 1}" pos="{_text(link.pos)}" quat="{_text(link.quat)}" gravcomp="1">'
                f"{hinges}{geoms}{xml}</body>"
            )
        shape = f'type="cylinder" fromto="0 0 {-self.base_m[2] - 0.001} 0 0 0.001" size="{1.5 * thick}"'
        stand = f'<geom class="arm" {shape} material="arm_dark"/>'
        return f'<body name="{self.root}" pos="{_text(self.base_m)}">{stand}{xml}</body>'

    def servos(self) -> str:
        """MJCF position servos of the joints, with the same lag as the Panda's in every one."""
        return "".join(
            f'<position name="servo_{j}" joint="{j}" kp="{kp!r}" kv="{panda.SERVO_LAG_S * kp!r}"/>'
            for j, kp in zip(joint_names(self.joints), self._gains, strict=True)
        )

    def solver(self) -> ChainIK:
        """Inverse kinematics of the flange in the base's frame, with its orientation held as at home."""
        return ChainIK(self._model(), self.base_m, self.home_rad)

    def _model(self) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string(
            f"<mujoco><compiler angle='radian'/><default>{panda.DEFAULTS}</default>"
            f"<asset>{panda.MATERIALS}</asset><worldbody>{self.body()}</worldbody></mujoco>"
        )

    def _servo_gains(self) -> list[float]:
        """Stiffness (N,) in N m/rad: with the lag, damping is critical for the inertia that turns at home."""
        model = self._model()
        data, mass = mujoco.MjData(model), np.empty((model.nv, model.nv))
        data.qpos[:] = self.home_rad
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass)
        return (4 * mass.diagonal() / panda.SERVO_LAG_S**2).tolist()


def read_chain(file: Path, flange: str) -> list[Link]:
    """The bodies from an arm's base to its flange, a body or site of a URDF or MJCF.

    Raises InputError: one sentence with file and fault.
    """
    if not file.is_file():
        raise InputError(f"There is no file '{file}'; give the arm's URDF or MJCF.")
    refuse_pointer(file)
    try:
        spec = mujoco.MjSpec.from_file(str(file))
        copies = _copied_joints(file, spec)
        for kind in LEFT_OUT:
            for each in list(getattr(spec, kind)):
                spec.delete(each)
        spec.compiler.fusestatic, spec.compiler.discardvisual = False, False
        spec.compiler.boundmass, spec.compiler.boundinertia = 1e-3, 1e-6
        model = spec.compile()
    except (ValueError, RuntimeError) as e:
        raise InputError(f"{file} is no URDF or MJCF that MuJoCo reads ({' '.join(str(e).split())}).") from e
    bodies = [model.body(i).name for i in range(model.nbody)]
    sites = [model.site(i).name for i in range(model.nsite)]
    links = []
    if flange in bodies:
        b = bodies.index(flange)
    elif flange in sites:
        site = model.site(flange)
        b = int(model.site_bodyid[site.id])
        links.append(Link(site.pos.copy(), site.quat.copy(), ()))
    else:
        raise InputError(f"{file} has no link '{flange}'; it has {', '.join([*bodies[1:], *sites])}.")
    while b > 0:
        first, count = model.body_jntadr[b], model.body_jntnum[b]
        hinges = []
        for j in range(first, first + count):
            if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_HINGE:
                raise InputError(
                    f"{file}: joint '{model.joint(j).name}' on the way to '{flange}' is no hinge; an arm of"
                    " hinges alone can be used."
                )
            if model.joint(j).name in copies:
                raise InputError(
                    f"{file}: joint '{model.joint(j).name}' copies '{copies[model.joint(j).name]}' (mimic),"
                    " so it has no motor of its own; give an arm without such joints."
                )
            limits = model.jnt_range[j] if model.jnt_limited[j] else (-MOST_TURN_RAD, MOST_TURN_RAD)
            hinges.append((model.jnt_pos[j].copy(), model.jnt_axis[j].copy(), *limits))
        links.append(Link(model.body_pos[b].copy(), model.body_quat[b].copy(), tuple(hinges)))
        b = int(model.body_parentid[b])
    return links[::-1]


def _copied_joints(file: Path, spec: mujoco.MjSpec) -> dict[str, str]:
    """Joint to the one whose angle it copies, by a URDF's `mimic` or an MJCF's equality of joints."""
    found = {e.name1: e.name2 for e in spec.equalities if e.type == mujoco.mjtEq.mjEQ_JOINT and e.name2}
    text = re.sub(r"<!--.*?-->", "", file.read_text(errors="replace"), flags=re.S)
    for joint, inside in re.findall(r"<joint\b([^>]*[^/])>(.*?)</joint>", text, flags=re.S):
        name, copied = (re.search(p, t) for p, t in ((_NAME, joint), (_MIMIC, inside)))
        if name and copied:
            found[name[2]] = copied[2]
    return found


def _text(numbers: np.ndarray) -> str:
    return " ".join(repr(float(x)) for x in numbers)


_HERE = Path(__file__).parent


@dataclass(frozen=True)
class ArmFile:
    """An arm described by a URDF or an MJCF."""

    urdf: str  # that file; only its joints count, so its meshes may be missing
    flange: str  # link of the URDF, or body or site of the MJCF, that carries the finger, z outwards
    home_rad: tuple[float, ...]  # joint angles (N,) from the base to there at which the flange points down

    def __post_init__(self):
        for name in ("urdf", "flange"):
            if not isinstance(getattr(self, name), str):
                raise InputError(f"arm.{name} is {shown(getattr(self, name))}; give a text.")
        try:
            angles = tuple(as_numbers(self.home_rad))
        except (TypeError, ValueError):
            angles = (math.nan,)
        if not all(map(math.isfinite, angles)):
            raise InputError(f"arm.home_rad is {shown(self.home_rad)}; give a finite angle in rad a joint.")
        object.__setattr__(self, "home_rad", angles)

    @property
    def joints(self) -> int:
        return len(self.home_rad)


# The library's arms, and where their bases stand so that they reach what the tasks lay out.
ARMS: dict[str, tuple[ArmFile | None, tuple[float, float, float]]] = {
    "panda": (None, (0.0, 0.0, 0.0)),
    "ur5": (
        ArmFile(str(_HERE / "ur5.urdf"), "tool0", (0.2397, -1.5299, -1.9536, -1.2284, 1.5708, 0.0)),
        (0.0, 0.0, 0.0),
    ),
    "so101": (ArmFile(str(_HERE / "so101.urdf"), "flange", (0.0, 0.48, 0.55, 0.54, 0.0)), (0.29, 0.0, 0.23)),
}


def read_arm(value: Any, folder: Path) -> ArmFile | str:
    """An arm as a `station.yaml` in `folder` gives it: one of `ARMS`, or the fields of `ArmFile`.

    Raises InputError where it is neither; one sentence.
    """
    if isinstance(value, str) and value in ARMS:
        return value
    names = [f.name for f in dataclasses.fields(ArmFile)]
    for fault in unknown_names(value, names) if isinstance(value, dict) else ():
        raise InputError(f"arm: {fault}")
    if not isinstance(value, dict) or set(value) != set(names):
        raise InputError(
            f"arm is {shown(value)}; give {', '.join(ARMS)}, or a mapping with exactly {', '.join(names)}."
        )
    arm = ArmFile(**value)
    return dataclasses.replace(arm, urdf=str(folder / arm.urdf))


def joints_of(arm: ArmFile | str) -> int:
    """How many joints an arm has, without its file being read."""
    described = ARMS[arm][0] if isinstance(arm, str) else arm
    return PANDA_JOINTS if described is None else described.joints


def make_arm(arm: ArmFile | str, base_m: tuple[float, float, float]) -> Chain | Panda:
    """The arm, its base at `base_m` (3,) of the station.

    Raises InputError where its file is missing or damaged, or it cannot carry a finger; one sentence.
    """
    described = ARMS[arm][0] if isinstance(arm, str) else arm
    if described is None:
        return Panda(base_m)
    return Chain(described.urdf, described.flange, described.home_rad, base_m)
