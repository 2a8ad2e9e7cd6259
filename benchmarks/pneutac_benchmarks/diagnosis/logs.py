"""Set `logs`: ordinary logs of fingers in which nothing is hidden, and of fingers with one plain effect.

Each log is drawn from its seed: rate, hold, program, trials, what is recorded, noise. A plain finger is the
twin's own law and white noise. In the others one effect leaves five times the noise after the best straight
line in the pressure; their equations are written here and share no code or form with the twin's effects.
"""

import traceback
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from pneutac_benchmarks.diagnosis.cases import BenchmarkDiagnosisConfig, Case, diagnosed
from pneutac_benchmarks.diagnosis.rules import counts
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin

# Effect to what counts as its physics; a lag of the pose may be of the valve or of the body without a gauge.
ACCEPTED = {
    "creep": ("creep", "valve_lag", "orifice_flow"),
    "hysteresis": ("hysteresis", "friction"),
    "valve": ("valve_lag", "orifice_flow", "valve_slew", "air_resonance", "ringing", "creep", "rate"),
}
EVERY = 5  # one seed in so many also makes a finger with an effect
TIMES_THE_NOISE = 5.0
RATES_HZ = (4, 5, 8, 10, 15, 20, 50, 100)
HOLDS_S = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0)
PROGRAMS = ("steps", "random_steps", "ramps", "sine")
FINE_HZ = 1000  # at which fingers with an effect run
MOST_ROWS, LEAST_S, LEAST_HOLDS = 4000, 60.0, 20


@dataclass(frozen=True)
class Log:
    """How a log was made.

    Attributes:
        hz: rows a second.
        hold_s: of steps; a quarter of the period of ramps and sines; mean hold of random steps.
        program: one of `PROGRAMS`.
        trials: of equal length.
        repeats: whether all trials run one program.
        gauge: whether the pressure was measured.
        sent: whether `time_sent_s` was logged.
        stated: whether recording.json declares the noise.
        tips: whether the tip was tracked, not the bend.
        jitter: standard deviation of a row's time, in rows.
        noise: standard deviation of the bend's noise, rad; of a finger with an effect it follows from that.
        top_kpa: highest pressure.
        gain: rad/kPa.
    """

    hz: int
    hold_s: float
    program: str
    trials: int
    repeats: bool
    gauge: bool
    sent: bool
    stated: bool
    tips: bool
    jitter: float
    noise: float
    top_kpa: float
    gain: float


def cases(cfg: BenchmarkDiagnosisConfig) -> list[Case]:
    """A plain finger for each seed and a finger with an effect for one seed in five."""
    known = ("plain", *ACCEPTED)
    for name in cfg.effects:
        if name not in known:
            raise InputError(f"--effects: '{name}' must be one of {', '.join(known)}.")
    made = []
    for seed in range(cfg.first_seed, cfg.first_seed + cfg.seeds):
        made.append(Case("logs", "plain", "plain", seed))
        if seed % EVERY == 0:
            made.append(Case("logs", "effect", list(ACCEPTED)[seed // EVERY % len(ACCEPTED)], seed))
    return [c for c in made if not cfg.effects or c.effects in cfg.effects]


def drawn(case: Case) -> Log:
    """The log of a case; those of one seed differ between plain and effect."""
    rng = np.random.default_rng([case.seed, case.kind == "effect"])
    effect = case.kind == "effect"
    repeats = bool(rng.random() < 0.35)
    hz = int(rng.choice(RATES_HZ))
    return Log(
        hz=hz,
        hold_s=float(rng.choice([h for h in HOLDS_S if h * hz >= 2])),
        program=str(rng.choice(PROGRAMS[:2] if effect else PROGRAMS)),
        trials=int(rng.choice((2, 3, 6) if repeats else (1, 3, 6))),
        repeats=repeats,
        gauge=bool(rng.random() < 0.4),
        sent=bool(rng.random() < 0.25),
        stated=bool(rng.random() < 0.3),
        tips=bool(rng.random() < 0.3),
        jitter=float(rng.choice((0.0, 0.0, 0.1))),
        noise=float(np.exp(rng.uniform(np.log(0.002), np.log(0.02)))),
        top_kpa=float(np.exp(rng.uniform(np.log(10), np.log(80)))),
        gain=float(rng.uniform(0.5, 1.2)),
    )


def command(log: Log, seconds: float, rng) -> np.ndarray:
    """Commanded pressure (m,) at 1 kHz; a loop that runs with the log changes it, save random steps."""
    time = np.arange(int(seconds * FINE_HZ) + 1) / FINE_HZ
    if log.program == "random_steps":
        edges = np.cumsum(rng.uniform(0.5, 1.5, int(2 * seconds / log.hold_s) + 3)) * log.hold_s
        return rng.uniform(0, log.top_kpa, len(edges))[np.searchsorted(edges, time)]
    tick = (time * log.hz + 1e-6).astype(int)  # number of the row whose command holds
    if log.program == "steps":
        hold = max(2, round(log.hold_s * log.hz))
        return rng.uniform(0, log.top_kpa, tick[-1] // hold + 1)[tick // hold]
    phase = tick / log.hz / (4 * log.hold_s) % 1
    if log.program == "ramps":
        return log.top_kpa * (1 - np.abs(2 * phase - 1))
    return log.top_kpa / 2 * (1 - np.cos(2 * np.pi * phase))


def creeping(bend: np.ndarray) -> np.ndarray:
    """Logarithmic creep: what a change of the bend has not done at once it does as log(1 + t)."""
    t = np.arange(len(bend)) / FINE_HZ
    slow = np.log1p(t / 0.5)
    at = np.r_[0, 1 + np.flatnonzero(np.diff(bend))]
    change = np.diff(bend[at], prepend=0.0)
    out = 0.85 * bend
    for i, d in zip(at, change, strict=True):
        out[i:] += 0.03 * d * slow[: len(bend) - i]
    return out


def dissipating(bend: np.ndarray) -> np.ndarray:
    """Bouc-Wen hysteresis: dz = (1 - |z|^n (0.5 + 0.5 sign(z dx))) dx, x the bend in its own range."""
    scale = 0.12 * max(float(np.ptp(bend)), 1e-9)
    z, out = 0.0, bend.copy()
    changes = np.flatnonzero(np.diff(bend, prepend=bend[0]))
    state = np.zeros(len(bend))
    last = 0
    for i in changes:
        state[last:i] = z
        parts = max(1, int(np.ceil(abs(bend[i] - bend[i - 1]) / scale * 20)))
        dx = (bend[i] - bend[i - 1]) / scale / parts
        for _ in range(parts):
            z += dx * (1 - abs(z) ** 1.5 * (0.5 + 0.5 * np.sign(z * dx)))
        last = i
    state[last:] = z
    return out + 0.8 * scale * state


def filling(p: np.ndarray, quick_s: float) -> np.ndarray:
    """A regulator whose flow saturates: dp/dt = top / quick_s tanh((command - p) / (0.3 top))."""
    top, out = max(float(p.max()), 1e-9), np.empty_like(p)
    state = p[0]
    for i, target in enumerate(p):
        state += top / quick_s * np.tanh((target - state) / (0.3 * top)) / FINE_HZ
        out[i] = state
    return out


def made(case: Case) -> tuple[Log, Recording, float]:
    """The log, the recording, and the root mean square of its noise in the unit of the error."""
    log, rng = drawn(case), np.random.default_rng([case.seed, 1, case.kind == "effect"])
    seconds = min(max(LEAST_S, LEAST_HOLDS * log.hold_s, 600 / log.hz), MOST_ROWS / log.hz) / log.trials
    rows, rest = int(seconds * log.hz), rng.uniform(0.05, 0.15) * log.top_kpa
    one = command(log, seconds + 1, np.random.default_rng([case.seed, 2]))
    parts = []
    for trial in range(log.trials):
        p = one if log.repeats else command(log, seconds + 1, rng)
        chamber = filling(p, max(0.3, 2.0 / log.hz)) if case.effects == "valve" else p
        bend = log.gain / log.top_kpa * (chamber + rest)
        bend = {"creep": creeping, "hysteresis": dissipating}.get(case.effects, np.copy)(bend)
        t = (np.arange(rows) + 0.5) / log.hz  # a loop sends half a row before it measures
        t += np.clip(rng.normal(0, log.jitter, rows), -0.25, 0.25) / log.hz
        i = np.round(t * FINE_HZ).astype(int)
        changed = np.maximum.accumulate(np.where(np.diff(p, prepend=np.nan) != 0, np.arange(len(p)), 0))[i]
        looped = np.floor(t * log.hz) / log.hz  # a loop sends in every row, also what is held
        sent = changed / FINE_HZ if log.program == "random_steps" else looped
        parts.append(
            pd.DataFrame(
                {
                    "trial": trial, "time_s": (t - t[0]).round(5), "time_sent_s": (sent - t[0]).round(5),
                    "pressure_cmd_kpa": p[i].round(3), "chamber": chamber[i], "bend": bend[i],
                }
            )
        )  # fmt: skip
    s = pd.concat(parts, ignore_index=True)
    noise = log.noise
    if case.kind == "effect":
        line = np.c_[s["pressure_cmd_kpa"], np.ones(len(s))]
        left = s["bend"] - line @ np.linalg.lstsq(line, s["bend"], rcond=None)[0]
        noise = float(left.std() / TIMES_THE_NOISE)
    chamber, bend = s.pop("chamber"), s.pop("bend")
    if not log.sent:
        s.pop("time_sent_s")
    if log.gauge:
        s["pressure_kpa"] = (chamber + rng.normal(0, 0.002 * log.top_kpa, len(s))).round(4)
    length, columns = 100.0, ["bend_angle_rad"]
    if log.tips:
        noise, columns, b = noise * length / 2, ["tip_x_mm", "tip_z_mm"], bend.clip(lower=1e-6)
        s["tip_x_mm"] = (length * np.sin(b) / b + rng.normal(0, noise, len(s))).round(4)
        s["tip_z_mm"] = (length * (1 - np.cos(b)) / b + rng.normal(0, noise, len(s))).round(4)
    else:
        s["bend_angle_rad"] = (bend + rng.normal(0, noise, len(s))).round(6)
    meta = {"device": "finger", "length_mm": length}
    if log.stated:
        meta["noise"] = dict.fromkeys(columns, noise)
    return log, Recording(Path(case.key), meta, s, "finger"), noise * len(columns) ** 0.5


def solve(case: Case) -> dict:
    """Diagnoses one log; an exception is an answer too."""
    log, recording, noise = made(case)
    answer = asdict(case) | {"log": asdict(log), "rows": len(recording), "noise": noise}
    try:
        d = diagnosed(Twin("finger", recording.length_mm or 100.0), recording, case.seed)
        text = [d.sentence, *d.remarks()]
    except Exception as e:
        return answer | {"crash": repr(e), "where": traceback.format_exc(limit=-3)}
    evidence, floor = d.outcome.evidence, d.study.noise
    right = [e for e in d.selected if case.kind == "effect" and counts(e, ACCEPTED[case.effects])]
    return answer | {
        "verdict": d.verdict, "selected": d.selected, "right": right, "floor": floor.value,
        "floor_how": floor.how, "error_over_noise": [evidence.before, evidence.after],
        "findings": list(d.findings), "sentences": text, "seconds": d.outcome.seconds,
        "parameters": {e: d.study.parameters(d.outcome.after, e) for e in d.selected},
    }  # fmt: skip
