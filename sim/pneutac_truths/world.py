"""What the effects act on: one device on one day, as series on the fine time grid.

What the camera tracker is shown and what it makes of it.
"""

import zlib
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from pneutac_truths.programs import DT_S, Plan, plan
from pneutac_truths.rod import BASE_TURN, BEND_Y, BEND_Z, COLUMNS, SET_Y, SET_Z, SOFT, STRETCH, TWIST, Rod

CHAMBERS = {"rod": 1, "cosserat": 1, "arm": 3}


@dataclass(frozen=True)
class Body:
    """One device as drawn from its seed: everything that no effect changes."""

    top_kpa: float  # highest commanded pressure
    bend_rad: np.ndarray  # of each chamber alone at the top pressure (chambers,)
    # of each chamber's bend about the axis (chambers,); 0 bends towards z, pi/2 towards y
    direction_rad: np.ndarray
    length_mm: float  # from base to marker
    rod: Rod  # its elastic line
    weight: float  # weight of the flexible part times length squared over bending stiffness
    tip_share: float  # weight of the tip piece over that of the flexible part
    mass_g: float  # of the flexible part
    noise_mm: float  # standard deviation of the marker per axis
    gauge_noise_kpa: float  # of a pressure gauge
    curvatures: bool  # an arm that is measured by curvatures instead of a marker
    period_s: float  # of the lowest mode where the body moves
    damping: float  # ratio of that mode

    @classmethod
    def draw(cls, device: str, seed: int) -> "Body":
        """The device of this seed, within the ranges of silicone bending actuators in the literature.

        Sources: Polygerinos et al., IEEE T. Robotics 31 (2015) 778; Mosadegh et al., Adv. Funct. Mater. 24
        (2014) 2163; Xavier et al., IEEE Access 10 (2022) 59442 (survey).
        """
        rng = stream(seed, "body", device)
        c = CHAMBERS[device]
        length = rng.uniform(80, 200)
        tip = rng.uniform(4, 14)
        radius = length * rng.uniform(0.06, 0.1)
        ends = rng.uniform(0.02, 0.12), rng.uniform(0.68, 0.95), rng.uniform(-0.5, 0.5)
        rod = Rod.of(length - tip, tip, *ends, radius)
        return cls(
            top_kpa=round(rng.uniform(15, 90), 1),
            bend_rad=np.full(c, rng.uniform(0.8, 1.8)),
            direction_rad=2 * np.pi * np.arange(c) / c,
            length_mm=length,
            rod=rod,
            weight=rng.uniform(0.1, 0.5),
            tip_share=rng.uniform(0.1, 0.4),
            mass_g=1.05e-3 * np.pi * radius**2 * length * 0.7,
            noise_mm=rng.uniform(0.15, 0.4),
            gauge_noise_kpa=rng.uniform(0.05, 0.2),
            curvatures=device == "arm" and rng.random() < 0.5,
            period_s=rng.uniform(0.18, 0.24),
            damping=rng.uniform(0.6, 0.8),
        )


def stream(*keys: int | str) -> np.random.Generator:
    """Random numbers of their own for these keys, so that one draw never shifts another."""
    return np.random.default_rng([k if isinstance(k, int) else zlib.crc32(k.encode()) for k in keys])


@dataclass
class World:
    """One recording while it is made; effects change the series below, stage by stage."""

    body: Body  # the device
    plan: Plan  # what is commanded; c chambers, n rows of the fine grid
    seed: int  # of the device
    day: int  # of the recording
    sent: np.ndarray = field(init=False)  # (n, c) what reaches the regulator, share of the top pressure
    air: np.ndarray | None = None  # (n, c) pressure in the chamber
    at_gauge: np.ndarray | None = None  # (n, c) pressure where the gauge sits; None: in the chamber
    drive: np.ndarray | None = None  # (n, c) bend that this pressure drives, rad
    memory: np.ndarray | None = None  # (n, c) bend that the material adds by what it remembers, rad
    softer: np.ndarray = field(init=False)  # (n,) compliance of the material over that of the plain one
    aside: np.ndarray = field(init=False)  # (n,) bend out of the plane, rad
    twist: np.ndarray = field(init=False)  # (n,) twist over the length, rad
    stretch: np.ndarray = field(init=False)  # (n,) axial strain of the chamber
    base_turn: np.ndarray = field(init=False)  # (n, 3) rotation vector of the mount, rad
    in_plane: bool = False  # whether the base is turned in the plane of bending alone
    gravity: np.ndarray | None = None  # (trials, 3) unit vectors where weight acts, else None
    weighs: bool = False  # whether the rod's own weight acts
    payload_g: np.ndarray | None = None  # (trials,) at the tip, or None
    temperature_c: np.ndarray | None = None  # (n,) where it is logged, else None
    contact: dict | None = None  # a wall (see `contact`), or None
    # period, damping and more of a body that moves; empty for one in equilibrium
    dynamics: dict = field(default_factory=dict)

    def __post_init__(self):
        n = len(self.plan.time_s)
        self.sent = self.plan.command.copy()
        self.softer = np.ones(n)
        self.aside, self.twist, self.stretch = np.zeros(n), np.zeros(n), np.zeros(n)
        self.base_turn = np.zeros((n, 3))

    @classmethod
    def start(cls, device: str, seed: int, day: int, minutes: float, plan: Plan | None = None) -> "World":
        """A device before its first trial of the day; None draws what is commanded."""
        body = Body.draw(device, seed)
        w = cls(body, plan or _planned(device, seed, day, minutes), seed, day)
        if device == "cosserat":
            w.dynamics = {"period_s": body.period_s, "damping": body.damping}
        return w

    @property
    def time_s(self) -> np.ndarray:
        """(n,) of the fine grid, from the start of the first trial."""
        return self.plan.time_s

    def draws(self, name: str) -> np.random.Generator:
        """Random numbers of a name, other ones each day."""
        return stream(self.seed, name, self.day)

    def rod_inputs(self, rows: np.ndarray) -> np.ndarray:
        """Inputs of the rod (k, COLUMNS) in these rows of the fine grid."""
        u = np.zeros((len(rows), COLUMNS))
        way = self.body.direction_rad
        u[:, BEND_Z] = self.drive[rows] @ np.cos(way)
        u[:, BEND_Y] = self.drive[rows] @ np.sin(way) + self.aside[rows]
        u[:, SET_Z] = self.memory[rows] @ np.cos(way)
        u[:, SET_Y] = self.memory[rows] @ np.sin(way)
        u[:, TWIST], u[:, STRETCH], u[:, SOFT] = self.twist[rows], self.stretch[rows], self.softer[rows]
        u[:, BASE_TURN] = self.base_turn[rows]
        if self.gravity is None:
            return u
        trial = np.maximum(self.plan.trial, 0)[rows]
        down, length = self.gravity[trial], self.body.rod.length_mm
        unit = self.body.weight / length**2  # the flexible part's weight over its bending stiffness, 1/mm^2
        tip = np.zeros(len(rows))
        if self.weighs:
            u[:, 7:10] = down * unit / length
            tip = tip + self.body.tip_share * unit
        if self.payload_g is not None:
            tip = tip + self.payload_g[trial] / self.body.mass_g * unit
        u[:, 10:13] = down * tip[:, None]
        return u


@lru_cache(maxsize=4)
def _planned(device: str, seed: int, day: int, minutes: float) -> Plan:
    return plan(stream(seed, device, day), CHAMBERS[device], minutes, quiet=device == "cosserat")


def seconds(duration_s: float) -> int:
    """Rows of the fine grid in a duration, at least one."""
    return max(1, round(duration_s / DT_S))


TIP = ["tip_x_mm", "tip_y_mm", "tip_z_mm"]
CURVATURES = ["curvature_x_1_per_m", "curvature_y_1_per_m"]
UNSEEN = {"stretch", "camera_warm_up"}  # no curvature shows them, so such a device is logged by its marker


def logged(body: Body, names) -> tuple[list[str], float]:
    """Columns of the pose in this device's log, and the standard deviation of their noise."""
    if body.curvatures and not UNSEEN & set(names):
        return CURVATURES, 2e3 * body.noise_mm / body.length_mm**2
    return TIP, body.noise_mm


def in_columns(body: Body, columns: list[str], tips: np.ndarray) -> np.ndarray:
    """Marker (rows, 3) in mm as the values of these columns (rows, columns)."""
    return curvatures(tips, body.length_mm) if columns == CURVATURES else tips


def curvatures(tips: np.ndarray, length_mm: float) -> np.ndarray:
    """Constant-curvature reading (rows, 2) in 1/m of marker positions: bend towards z and towards y.

    Source: Webster and Jones, IJRR 29 (2010) 1661: the chord lies at half the bend angle.
    """
    aside = np.hypot(tips[:, 1], tips[:, 2])
    bend = 2 * np.arctan2(aside, tips[:, 0])
    return (bend / np.maximum(aside, 1e-12) / length_mm * 1e3)[:, None] * tips[:, [2, 1]]


@dataclass
class Seen:
    """The marker on its way into the log."""

    world: World  # whose marker it is
    path: np.ndarray  # (m, 3) mm on the fine grid of all trials without pauses, or on the recorded rows alone
    fine: bool  # whether `path` is on the fine grid
    late_s: np.ndarray  # (rows,) by how much each sample is taken after its stamp
    frozen: np.ndarray  # (rows,) that repeat the row before, noise and all
    tips: np.ndarray | None = None  # (rows, 3) mm as logged, before noise; None until `sample`

    def trials(self, x: np.ndarray) -> list[np.ndarray]:
        """The pieces of x (m, ...) that belong to each trial on the fine grid."""
        p = self.world.plan
        lengths = [b - a for a, b in zip(p.starts, p.ends, strict=True)]
        return np.split(x, np.cumsum(lengths)[:-1])

    def sample(self) -> None:
        """Takes `tips` from `path` at the stamps plus `late_s`."""
        if not self.fine:
            self.tips = self.path.copy()
            return
        p = self.world.plan
        late = np.split(self.late_s, np.flatnonzero(np.diff(p.trial[p.rows])) + 1)
        out = []
        for piece, a, b, by in zip(self.trials(self.path), p.starts, p.ends, late, strict=True):
            t = p.time_s[a:b]
            at = p.time_s[p.rows[(p.rows >= a) & (p.rows < b)]] + by
            out.append(np.stack([np.interp(at, t, piece[:, k]) for k in range(3)], 1))
        self.tips = np.concatenate(out)
