"""The bench that a hidden recording comes from: a random finger, its session, and the chain of stages."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from pneutac_datasets.generate.hidden.programs import session
from pneutac_sim.finger.kinematics import forward_kinematics, joint_command

FINE_HZ = 100.0  # the chain runs on this grid, between the logged samples too
JOINTS = 4


@dataclass
class HiddenBench:
    """Everything that is fixed before an effect acts.

    Attributes:
        base: length_mm, gain, alpha, beta, rest_pressure_kpa, joint_stiffness_nm_per_rad of the finger.
        top: largest pressure, kPa.
        dt: step of the fine grid, s.
        start: (n,) true where a trial begins on the fine grid.
        command: (n,) commanded pressure, kPa, straight between samples.
        temperature_c, payload_g: (n,).
        gravity: (n, 3) unit vectors in the base frame.
        logged: (m,) fine indices of the logged samples.
        trial, label, time_s: (m,) of the logged samples.
    """

    base: dict
    top: float
    dt: float
    start: np.ndarray
    command: np.ndarray
    temperature_c: np.ndarray
    payload_g: np.ndarray
    gravity: np.ndarray
    logged: np.ndarray
    trial: np.ndarray
    label: np.ndarray
    time_s: np.ndarray

    @property
    def joint_positions_m(self) -> np.ndarray:
        """(4,) arc length of each joint."""
        return self.base["length_mm"] / 1000 * (np.arange(JOINTS) + 0.5) / JOINTS

    def angles(self, drive: np.ndarray, parameters=None) -> np.ndarray:
        """Joint angles (m, 4) of the paper's gain law under a drive pressure (m,), kPa."""
        b = self.base
        gain, alpha, beta, rest = parameters or (b["gain"], b["alpha"], b["beta"], b["rest_pressure_kpa"])
        return joint_command(drive, gain, alpha, beta, rest, JOINTS)

    def tip(self, q: np.ndarray) -> np.ndarray:
        """Tip (m, 3) in mm of joint angles (m, 4)."""
        xz, _ = forward_kinematics(q, 1000 * self.joint_positions_m, self.base["length_mm"])
        return np.stack([xz[:, 0], np.zeros(len(q)), xz[:, 1]], 1)


def make_bench(seed: int, minutes: float, hz: float) -> HiddenBench:
    """A random finger (ranges around the paper's, Sec. IV-A) and a random session."""
    rng = np.random.default_rng([seed, 1])
    length = rng.uniform(80, 130)
    top = rng.uniform(30, 80)
    rest = rng.uniform(4, 12) * top / 50
    base = {
        "length_mm": round(float(length), 1),
        "gain": float(rng.uniform(1.2, 2.1) / (JOINTS * (top + rest))),  # 70 to 120 degrees at the top
        "alpha": float(rng.uniform(-0.1, 0.15)),
        "beta": float(rng.uniform(0.0, 0.35)),
        "rest_pressure_kpa": float(rest),
        "joint_stiffness_nm_per_rad": float(rng.uniform(0.3, 0.6)),
    }
    sub = max(1, round(FINE_HZ / hz))
    trials = session(top, 60 * minutes, hz, rng)
    sizes = [len(t.command) for t in trials]

    def fine(values):
        return np.repeat(np.concatenate(values), sub, axis=0)

    def command(trial):
        p = np.array(trial.command)
        rise = np.append(np.diff(p), 0.0)
        return (p[:, None] + rise[:, None] * np.arange(sub) / sub).ravel()

    start = np.zeros(sum(sizes) * sub, bool)
    start[np.r_[0, np.cumsum(sizes)[:-1]] * sub] = True
    wander = np.convolve(rng.normal(size=len(start) + 2000), np.ones(2001) / 2001, "valid")[: len(start)]
    return HiddenBench(
        base=base,
        top=float(top),
        dt=1 / (hz * sub),
        start=start,
        command=np.concatenate([command(t) for t in trials]),
        temperature_c=fine([np.full(n, t.temperature_c) for n, t in zip(sizes, trials, strict=True)])
        + 0.15 * wander / wander.std(),
        payload_g=fine([np.full(n, t.payload_g) for n, t in zip(sizes, trials, strict=True)]),
        gravity=fine([np.tile(t.gravity, (n, 1)) for n, t in zip(sizes, trials, strict=True)]),
        logged=np.arange(sum(sizes)) * sub,
        trial=np.repeat(np.arange(len(trials)), sizes),
        label=np.concatenate([t.label for t in trials]),
        time_s=np.concatenate([np.arange(n) / hz for n in sizes]),
    )


def fit_plain(bench: HiddenBench, tip: np.ndarray) -> np.ndarray:
    """Best tip (m, 3) of the plain gain law (gain, alpha, beta, rest pressure refitted) for a given tip.

    What stays is the misfit that a missing effect causes. The profile is bounded, since at extreme profiles a
    finger that bends in its two ends alone imitates a saturation.
    """
    command = bench.command[bench.logged]
    b = bench.base
    some = slice(None, None, 8)

    def model(x, rows=slice(None)):
        return bench.tip(bench.angles(command[rows], tuple(x)))

    found = least_squares(
        lambda x: (model(x, some) - tip[some])[:, ::2].ravel(),
        [b["gain"], b["alpha"], b["beta"], b["rest_pressure_kpa"]],
        bounds=([0.0, -1.5, -0.4, -3 * bench.top], [np.inf, 1.5, 3.0, 3 * bench.top]),
        x_scale=[0.1 * b["gain"], 0.1, 0.1, 0.1 * bench.top],
        xtol=1e-6,
        ftol=1e-6,
    )
    return model(found.x)


def rms_distance(a: np.ndarray, b: np.ndarray) -> float:
    """Root mean square Euclidean distance of two tracks (m, 3)."""
    return float(np.sqrt(np.mean(np.sum((a - b) ** 2, axis=1))))
