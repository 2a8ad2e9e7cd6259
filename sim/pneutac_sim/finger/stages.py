"""The links of the pipeline's chain: each changes one signal and keeps its own state.

pressure (m, chambers) -> Drive -> joints (m, N) or (m, 2 N) -> loads -> joints -> Markers -> markers (m, 5).
Effects sit between them. Every link reads its parameters from one vector `theta` by index.

Spine kinematics: from pressure to joint command, from joint angles to tip and bend.

Frame: x along the straight finger, z the bending direction at positive pressure, y completes the right hand.
Link 0 runs from the base to the first joint and is fixed; a positive angle bends towards +z. Lengths may be
in any one unit; the tip comes out in the same unit.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from pneutac_sim.effects.body_effect import BodyEffect, kernel
from pneutac_sim.effects.effect import Parameter
from pneutac_sim.errors import InputError
from pneutac_sim.features import CHAMBERS
from pneutac_sim.finger import equilibrium
from pneutac_sim.finger.equilibrium import SoftBody, controller_stiffness, loaded
from pneutac_sim.twin import PAPER_FINGER


def gain_profile(n_joints: int, alpha: float, beta: float) -> np.ndarray:
    """How N joints share the bending: (N,) r_n(alpha, beta), positive, of mean 1 (the paper's profile).

    r_n ∝ exp(alpha (n - nbar)) (1 + beta (n - nbar)^2), n = 1 at the base, nbar = (N + 1) / 2: alpha skews it
    towards the tip, or negative the base; with a positive beta the ends bend more than the middle.

    Raises InputError where it would not be positive everywhere.
    """
    m = np.arange(n_joints) - (n_joints - 1) / 2
    with np.errstate(over="ignore", invalid="ignore"):
        r = np.exp(alpha * m) * (1 + beta * m * m)
    if not (np.isfinite(r).all() and r.min() > 0):
        limit = f"above {-1 / m[-1] ** 2:.3g}" if n_joints > 1 else "finite"
        raise InputError(
            f"gain_beta is {beta} and gain_alpha {alpha}; with {n_joints} joints gain_beta must be {limit} "
            "and gain_alpha of moderate size, so that every joint bends in the same direction."
        )
    return r / r.mean()


def joint_command(
    pressure_kpa: np.ndarray | float, gain: float, alpha: float, beta: float, rest_pressure: float, n: int
) -> np.ndarray:
    """Target angles (..., N) in rad of a finger's N joints, q_n = G r_n(alpha, beta) (p + p0).

    At gauge pressures (...) in kPa, with the gain G in rad/kPa, `gain_profile` r_n, and p0, the pressure in
    kPa that would make the bend already present at rest.
    """
    drive = gain * (np.asarray(pressure_kpa, dtype=float) + rest_pressure)
    return drive[..., None] * gain_profile(n, alpha, beta)


def forward_kinematics(
    q: np.ndarray, joint_positions: np.ndarray, length: float
) -> tuple[np.ndarray, np.ndarray]:
    """Tip (..., 2), x and z, and its bend (...), rad, of a finger that bends in the xz plane.

    Of joint angles (..., N) rad, with the arc lengths of each joint, (N,), and of the tip from the base, in
    one unit, which the tip has too.
    """
    q = np.asarray(q, dtype=float)
    heading = q @ np.triu(np.ones((q.shape[-1], q.shape[-1])))  # cumulative sum, faster than np.cumsum here
    links = _links(joint_positions, length)
    x = joint_positions[0] + np.cos(heading) @ links
    z = np.sin(heading) @ links
    tip = np.empty((*x.shape, 2))
    tip[..., 0], tip[..., 1] = x, z
    return tip, heading[..., -1]


def forward_kinematics_spatial(
    q: np.ndarray, joint_positions: np.ndarray, length: float
) -> tuple[np.ndarray, np.ndarray]:
    """Tip (..., 3) and bend (..., 2) = sum of q_n, rad, of an arm whose joints bend towards +z and +y.

    Of joint angles (..., N, 2) rad; lengths as of `forward_kinematics`. Each joint turns the next link, in
    the frame of the link before it, by the angle |q_n| in the direction (0, q_n[1], q_n[0]) / |q_n|.
    """
    q = np.asarray(q, dtype=float)
    tip = np.empty((*q.shape[:-2], 3))
    links = _links(joint_positions, length)
    _chain(q.reshape(-1, len(links), 2), float(joint_positions[0]), links, tip.reshape(-1, 3))
    return tip, q.sum(axis=-2)


@kernel
def _chain(q, first, links, tip):
    """Tips (n, 3) of chains of joints (n, N, 2), by Rodrigues' formula joint by joint."""
    x, y, z = np.empty(3), np.empty(3), np.empty(3)  # the frame's columns
    for t in range(len(q)):
        x[:], y[:], z[:] = 0.0, 0.0, 0.0
        x[0] = y[1] = z[2] = 1.0
        tip[t, 0], tip[t, 1], tip[t, 2] = first, 0.0, 0.0
        for n in range(len(links)):
            to_z, to_y = q[t, n, 0], q[t, n, 1]
            square = to_z * to_z + to_y * to_y
            angle = math.sqrt(square)
            a = math.sin(angle) / angle if angle > 1e-6 else 1.0
            b = (1.0 - math.cos(angle)) / square if angle > 1e-4 else 0.5
            for i in range(3):
                old_x, old_y, old_z = x[i], y[i], z[i]
                x[i] = (1.0 - b * square) * old_x + a * (to_y * old_y + to_z * old_z)
                lost = a * old_x + b * (to_y * old_y + to_z * old_z)
                y[i] = old_y - to_y * lost
                z[i] = old_z - to_z * lost
                tip[t, i] += links[n] * x[i]


def _links(joint_positions: np.ndarray, length: float) -> np.ndarray:
    """(N,) length of the link after each joint; raises InputError where joints are not in order."""
    links = np.diff(np.append(np.asarray(joint_positions, dtype=float), length))
    if not ((links > 0).all() and joint_positions[0] >= 0):
        raise InputError(
            f"Joint positions {list(joint_positions)} with length {length}: they must rise from base to tip."
        )
    return links


Conditions = Callable[[tuple[str, ...]], np.ndarray]
BODY_SHARE = "body_share"  # of the joints' whole stiffness, that is the soft body's
FORCES = ("force_x_n", "force_y_n", "force_z_n")  # measured at the tip, in the frame of the finger's base


@dataclass(frozen=True)
class Geometry:
    """Shape of the device: `finger` (one bending plane) or `arm` (two), length and joints in mm."""

    device: str
    length_mm: float
    joint_positions_mm: tuple[float, ...]

    def __post_init__(self):
        if self.device not in CHAMBERS:
            raise InputError(
                f"A '{self.device}' has no pressure chambers; the pipeline models {' and '.join(CHAMBERS)}."
            )

    @property
    def n_joints(self) -> int:
        return len(self.joint_positions_mm)

    @property
    def axes(self) -> int:
        """Bending axes of a joint."""
        return 1 if self.device == "finger" else 2

    @property
    def chambers(self) -> int:
        """Independent pressures."""
        return CHAMBERS[self.device]

    @cached_property
    def links(self) -> np.ndarray:
        """(2 N,) length of the link after each joint, m, then their share of the weight."""
        lengths = 1e-3 * np.diff(np.append(self.joint_positions_mm, self.length_mm))
        return np.concatenate([lengths, lengths / (1e-3 * self.length_mm)])


def base_parameters(geometry: Geometry, of_stiffness: bool = False) -> tuple[Parameter, ...]:
    """Parameters that every twin of this device has.

    Bounds: a joint bends at most 2 rad at the largest pressure, and every joint in the same direction. With
    `of_stiffness` that of the joints is fitted, and at the end the soft body's share of it.
    """
    half = (geometry.n_joints - 1) / 2
    shape = (
        Parameter("gain_alpha", "", 0.0, -1.5, 1.5, fixed=geometry.n_joints < 2),
        Parameter("gain_beta", "", 0.0, -0.95 / max(half, 0.5) ** 2, 3.0, fixed=geometry.n_joints < 3),
    )
    name, unit = "joint_stiffness_nm_per_rad", "N m/rad"
    stiffness = Parameter(name, unit, PAPER_FINGER[name], 1e-4, 100.0, log=True, fixed=not of_stiffness)
    share = (Parameter(BODY_SHARE, "", 0.7, 0.02, 0.98),) * of_stiffness
    own = (
        *(Parameter(f"bend_{n + 1}", "", 0.0, -1.5, 3.0, fixed=True) for n in range(geometry.n_joints)),
        Parameter("curl_rad", "rad", 0.0, -3.0, 3.0, fixed=True),
    )
    if geometry.device == "finger":
        gain = Parameter("gain_rad_per_kpa", "rad/kPa", 0.15, -2.0, 2.0, range_power=-1)
        rest = Parameter("rest_pressure_kpa", "kPa", 0.0, -3.0, 3.0, range_power=1)
        return gain, *shape, rest, *own, stiffness, *share
    return (
        Parameter("gain_rad_per_kpa", "rad/kPa", 0.1, 0.0, 2.0, range_power=-1),
        *shape,
        Parameter("rest_pressure_z_kpa", "kPa", 0.0, -3.0, 3.0, range_power=1),
        Parameter("rest_pressure_y_kpa", "kPa", 0.0, -3.0, 3.0, range_power=1),
        Parameter("chamber_angle_rad", "rad", 0.0, -2 * np.pi, 2 * np.pi),
        Parameter("chamber_2_gain", "", 1.0, 0.2, 5.0, neutral=1.0, log=True),
        Parameter("chamber_3_gain", "", 1.0, 0.2, 5.0, neutral=1.0, log=True),
        Parameter("chamber_handedness", "", 1.0, -1.0, 1.0, fixed=True),
        Parameter("chamber_2_turn_rad", "rad", 0.0, -1.5, 1.5, fixed=True),
        Parameter("chamber_3_turn_rad", "rad", 0.0, -1.5, 1.5, fixed=True),
        *own,
        stiffness,
    )


class Link:
    """A link that remembers nothing."""

    remembers = False  # whether what it does depends on what was before

    def state_size(self, channels: int) -> int:
        return 0


@dataclass(frozen=True)
class EffectLink:
    """One effect in the chain."""

    effect: BodyEffect
    indices: tuple[int, ...]

    @cached_property
    def _index(self) -> np.ndarray:
        return np.array(self.indices, int)

    @property
    def remembers(self) -> bool:
        """Whether what it does depends on what was before."""
        return self.effect.state_size(1) > 0

    def state_size(self, channels: int) -> int:
        return self.effect.state_size(channels)

    def __call__(self, x, dt, theta, conditions: Conditions, state) -> np.ndarray:
        """Returns the changed signal (m, channels); `state` is updated."""
        out = np.array(x)
        values = theta[self._index]
        self.effect.run(out, dt, values, conditions(self.effect.columns), state)
        return out

    def side_by_side(self, x, dt, theta, conditions: Conditions) -> np.ndarray:
        """Returns several changed signals (m, K, channels), each from a new device's state."""
        m, k, channels = x.shape
        if self.effect.apart:
            state = np.zeros(self.state_size(k * channels))
            return self(x.reshape(m, -1), dt, theta, conditions, state).reshape(x.shape)
        new, each = self.state_size(channels), (np.ascontiguousarray(x[:, i]) for i in range(k))
        return np.stack([self(one, dt, theta, conditions, np.zeros(new)) for one in each], axis=1)


_profile = lru_cache(256)(gain_profile)  # a fit asks for the same again and again


def drive_line(values: np.ndarray, profile: np.ndarray, axes: int) -> tuple[np.ndarray, np.ndarray]:
    """Joints by pressure (chambers, N axes) in rad/kPa, and at zero pressure (N axes,) in rad, see `Drive`.

    By the base parameters before the stiffness, in their order, and `profile` (N,) of `gain_profile`.
    """
    n = len(profile)
    profile = profile * (1 + values[-1 - n : -1])
    if axes == 1:
        directions, rest = np.ones((1, 1)), values[3:4]
    else:
        ratios, turn = np.array([1.0, values[6], values[7]]), np.array([0.0, values[9], values[10]])
        phi = values[5] + np.sign(values[8]) * 2 * np.pi * np.arange(3) / 3 + turn
        directions = ratios[:, None] * np.stack([np.cos(phi), np.sin(phi)], axis=1)
        rest = values[3:5]
    bend = values[0] * profile[:, None]  # (N, 1)
    still = bend * rest
    still[:, 0] += values[-1] / n
    return (bend * directions[:, None, :]).reshape(len(directions), -1), still.ravel()


@dataclass(frozen=True)
class Drive(Link):
    """Pressure to free joint angles, q_n = G r_n(alpha, beta) (1 + d_n) (p + p0) + curl / N.

    d_n and curl are zero in the paper: they let a body bend where its own chamber makes it. In an arm
    chamber c pulls in the direction angle + handedness 2 pi (c - 1) / 3 + turn_c, counted from +z towards +y,
    and p is the vector sum of the three pressures times their relative gains.
    """

    geometry: Geometry
    indices: tuple[int, ...]
    held: tuple[np.ndarray, np.ndarray] | None = None  # its line, where the parameters stay as they are

    def __call__(self, x, dt, theta, conditions: Conditions, state) -> np.ndarray:
        """Returns joints (m, N axes)."""
        gain, still = self.line(theta)
        return x @ gain + still

    def line(self, theta) -> tuple[np.ndarray, np.ndarray]:
        """Joints by pressure (chambers, N axes), and at zero pressure (N axes,): a curl without stress."""
        if self.held is not None:
            return self.held
        values, g = theta[list(self.indices)], self.geometry
        return drive_line(values, _profile(g.n_joints, float(values[1]), float(values[2])), g.axes)


@dataclass(frozen=True)
class BodyLink(EffectLink):
    """An effect on the joints: it acts on what is strained, not on the curl that the device has at rest."""

    drive: Drive

    def __call__(self, x, dt, theta, conditions: Conditions, state) -> np.ndarray:
        """Returns the changed joints (m, N axes); `state` is updated."""
        strained = x - self.drive.line(theta)[1]
        return x + (super().__call__(strained, dt, theta, conditions, state) - strained)


@dataclass(frozen=True)
class LoadLink(Link):
    """Static equilibrium with the loads on the body: those of effects, and a force measured at the tip.

    Joints are springs of one stiffness; with a `body` of material points they are the chamber's controller
    and the body's own torque.
    """

    geometry: Geometry
    effects: tuple[EffectLink, ...]
    stiffness: int
    measured: bool = False
    body: SoftBody | None = None

    @property
    def indices(self) -> tuple[int, ...]:
        """Parameters that it depends on."""
        own = (self.stiffness,) if self.body is None else (self.stiffness, self.stiffness + 1)
        return (*own, *(i for e in self.effects for i in e.indices))

    def state_size(self, channels: int) -> int:
        """Deflection of the sample before, from which the next is solved; it changes nothing."""
        return channels

    def __call__(self, x, dt, theta, conditions: Conditions, state) -> np.ndarray:
        """Returns loaded joint angles (m, N axes)."""
        loads, links = self.loads(dt, theta, conditions), self.geometry.links
        if self.body is not None:
            whole, share = theta[self.stiffness : self.stiffness + 2]
            levers = 1e-3 * (self.geometry.length_mm - np.array(self.geometry.joint_positions_mm))
            modulus = share * whole / self.body.alone(levers)
            controller = controller_stiffness(whole, modulus * self.body.resting, levers)
            return loaded(x, loads, links, controller, modulus, self.body)
        if self.geometry.chambers == 1:
            out = equilibrium.along_a_line(x, loads, float(theta[self.stiffness]), links)
            if out is not None:
                return out
        out = np.array(x)
        equilibrium.solve(out, loads, theta[self.stiffness], links, state)
        return out

    def loads(self, dt, theta, conditions: Conditions) -> np.ndarray:
        """Loads (m, 6) N, see `equilibrium.solve`."""
        loads = np.zeros((len(dt), 6))
        if self.measured:
            loads[:, :3] = conditions(FORCES)
        for e in self.effects:
            loads = e(loads, dt, theta, conditions, np.zeros(e.state_size(6)))
        return loads


@dataclass(frozen=True)
class Markers(Link):
    """Joint angles to what a camera sees: tip x, y, z in mm, bend towards +z and +y in rad."""

    geometry: Geometry
    indices: tuple[int, ...] = ()

    def __call__(self, x, dt, theta, conditions: Conditions, state) -> np.ndarray:
        """Returns markers (m, 5)."""
        g = self.geometry
        out = np.zeros((len(x), 5))
        joints = np.array(g.joint_positions_mm)
        if g.axes == 1:
            tip, bend = forward_kinematics(x, joints, g.length_mm)
            out[:, 0], out[:, 2], out[:, 3] = tip[:, 0], tip[:, 1], bend
        else:
            out[:, :3], out[:, 3:] = forward_kinematics_spatial(x.reshape(len(x), -1, 2), joints, g.length_mm)
        return out
