"""Sets `truths`, `extrapolation`, `own_form_out`: day 1 of a foreign device is diagnosed, day 2 judges."""

import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from lerobot_pneutac.diagnosis.result import SET_UP, family_in
from pneutac_benchmarks.diagnosis.cases import BenchmarkDiagnosisConfig, Case, diagnosed
from pneutac_benchmarks.diagnosis.rules import BASE, COUNTS, counts, removed
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.laws import family
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin
from pneutac_truths import EFFECTS, PAIRS, Truth, generate, write

COSSERAT_MINUTES = 2.0
GENTLE = 0.6  # share of the top pressure below which `extrapolation` learns
LONG_HOLD_S = 4.0
FAST = ("plain", "creep_fractional", "hysteresis_preisach", "unfolding", "tracker_outliers")


def cases(cfg: BenchmarkDiagnosisConfig) -> list[Case]:
    """All devices of a set; a moving rod has only what no other can have, beside `plain` and `device`."""
    known = ("plain", "device", *EFFECTS, *PAIRS)
    for name in cfg.effects:
        if name not in known:
            raise InputError(f"--effects: there is no truth '{name}'; see `python -m pneutac_truths --list`.")
    wanted = cfg.effects or (FAST if cfg.fast else known)
    made = []
    for seed in range(cfg.first_seed, cfg.first_seed + cfg.seeds):
        for device in cfg.devices[: 1 if cfg.fast else None]:
            for name in wanted:
                parts = PAIRS.get(name, (name,) if name in EFFECTS else ())
                devices = [EFFECTS[p].devices for p in parts]
                if not all(device in d for d in devices):
                    continue
                if device == "cosserat" and not cfg.effects and any(len(d) > 1 for d in devices):
                    continue
                if cfg.set == "own_form_out" and not _can_be_taken_out(parts):
                    continue
                kind = name if name in ("plain", "device") else "pair" if name in PAIRS else "effect"
                minutes = COSSERAT_MINUTES if device == "cosserat" else cfg.minutes
                made.append(Case(cfg.set, kind, name, seed, minutes, device, cfg.pauses))
    return made


def _can_be_taken_out(truth: tuple[str, ...]) -> bool:
    """Whether a truth's physics has names, all of which the grammar can do without: not how a body bends."""
    if len(truth) != 1 or not EFFECTS[truth[0]].physics:
        return False
    return bool(COUNTS[truth[0]]) and BASE not in COUNTS[truth[0]]


@dataclass
class Days:
    """Two days of one device.

    Attributes:
        truth: of day 1.
        learn: recording of day 1.
        judge: of day 2, as checked.
        logged: the same with the times at which commands were sent where day 1 has them, and without where it
            has none.
        twin: as it is.
    """

    truth: Truth
    learn: Recording
    judge: Recording
    logged: Recording
    twin: Twin

    @property
    def floor(self) -> float:
        """Noise of the pose."""
        return self.truth.noise_floor

    @property
    def physics(self) -> list[str]:
        """Effects that are of the device."""
        return [e for e in self.truth.effects if EFFECTS[e].physics]

    def residual(self, twin: Twin, judge: Recording | None = None) -> np.ndarray:
        """(n, k) of day 2, or of it without some columns, predicted from its commands alone."""
        from lerobot_pneutac.diagnosis.design import predict, read

        data = read(judge or self.judge, twin)
        return data.measured[:, : data.counted] - predict(twin, data)[0]

    def recorded(self, twin: Twin) -> float:
        """Root mean square error of day 2 as day 1 was recorded.

        As it was logged, and in the directions of gravity of day 1.
        """
        residual, names = self.residual(twin, self.logged), [f"gravity_{a}" for a in "xyz"]
        if names[0] not in self.learn.samples:
            return rms(residual)
        first, second = (r.samples[names].to_numpy(float) for r in (self.learn, self.logged))
        return rms(residual[(second @ np.unique(first, axis=0).T).max(axis=1) > 0.99])

    def constant(self) -> float:
        """Root mean square error of day 2's own mean."""
        from lerobot_pneutac.diagnosis.design import read

        data = read(self.judge, self.twin)
        seen = data.measured[:, : data.counted]
        return rms(seen - seen.mean(axis=0))


@contextmanager
def two_days(case: Case) -> Iterator[Days]:
    """Generates both days of a device, and a twin that knows nothing but its kind and its length."""
    from pneutac_datasets.recording.checks import check

    with tempfile.TemporaryDirectory() as tmp:

        def recorded(day: int, log_sent: bool) -> tuple[Truth, Recording]:
            asked = {"day": day, "minutes": case.minutes, "log_sent": log_sent, "state_pauses": case.pauses}
            truth = generate(case.device, [case.effects], case.seed, **asked)
            return truth, Recording.load(write(truth, Path(tmp) / f"day{day}_{log_sent}"))

        (truth, first), (_, second) = (recorded(day, False) for day in (1, 2))
        judge, sent = check(second)[0], "time_sent_s"
        logged = replace(judge, samples=judge.samples.drop(columns=sent, errors="ignore"))
        if sent in first.samples:
            logged = judge if sent in judge.samples else check(recorded(2, True)[1])[0]
        yield Days(truth, first, judge, logged, Twin(first.device, first.length_mm or 110.0))


def solve(case: Case) -> dict:
    """Diagnoses day 1 and judges on day 2."""
    with two_days(case) as days:
        learn, wanted = days.learn, None
        if case.set == "extrapolation":
            learn = gentle(learn)
        if case.set == "own_form_out":
            out = [n for t in days.physics for n in COUNTS[t]]
            wanted = lambda name: not counts(name, out)  # noqa: E731
        began, processor = time.perf_counter(), time.process_time()
        d = diagnosed(days.twin, learn, case.seed, wanted)
        seconds, processor = time.perf_counter() - began, time.process_time() - processor
        return (
            asdict(case)
            | {"truth": list(days.truth.effects), "physics": days.physics, "processor_seconds": processor}
            | scored(days, d, seconds)
        )


def scored(days: Days, d, seconds: float) -> dict:
    """What a diagnosis found and how it did on day 2."""
    evidence, floor, constant = d.outcome.evidence, days.floor, days.constant()
    before, after = (rms(days.residual(m.twin)) for m in (d.outcome.before, d.outcome.after))
    kinds = {t: family_in(d.outcome.after.twin, t) for t in d.selected if t not in SET_UP}
    # A law whose constants make it another kind of physics than its name says counts as that kind.
    names = {t: t if family(t) == kind else kind for t, kind in kinds.items()}
    return {
        "verdict": d.verdict, "selected": [names[t] for t in d.outcome.named if t in names],
        "terms": list(d.selected), "unnamed": [n for t, n in names.items() if t not in d.outcome.named],
        "floor": floor, "constant": constant,
        "before": before, "after": after, "ratio": after / floor,
        "removed": removed(before, constant, after, floor),
        "test_before": d.before["heldout"], "test_after": d.after["heldout"],
        "black_box": evidence.left_to_black_box, "agreed": evidence.agreed, "forward": evidence.forward,
        "interval": evidence.interval, "later": evidence.later, "error": evidence.after,
        "program": evidence.program,
        "ratio_logged": rms(days.residual(d.outcome.after.twin, days.logged)) / floor,
        "ratio_recorded": days.recorded(d.outcome.after.twin) / floor,
        "explained": d.explained.value, "explained_where": evidence.where,
        "noise_known": evidence.noise_known,
        "causes": [
            {"cause": m.cause, "ranked": dict(m.ranked), "certain": m.certain, "features": m.features,
             "terms": [n for t, n in names.items() if kinds[t] == m.cause]}
            for m in d.outcome.mechanisms
        ],
        "chosen_in": d.outcome.chosen_in,
        "values": {t: {k: v["value"] for k, v in d.study.parameters(d.outcome.after, t).items()}
                   for t in names},
        "objections": evidence.objections, "gauge": bool(d.study.measured), "seconds": seconds,
    }  # fmt: skip


def gentle(recording: Recording) -> Recording:
    """Each trial up to where the command first passes 60 % of its top, or has been held for long."""
    command = recording.samples[recording.pressure_columns].abs().to_numpy(float)
    top, keep = command.max(), np.zeros(len(command), bool)
    for rows in recording.trials().values():
        p, t = command[rows], recording.samples["time_s"].to_numpy(float)[rows]
        moved = np.r_[True, np.abs(np.diff(p, axis=0)).max(axis=1) > 1e-6 * top]
        held = t - t[np.maximum.accumulate(np.where(moved, np.arange(len(t)), 0))]
        beyond = (p.max(axis=1) > GENTLE * top) | ((held > LONG_HOLD_S) & (p.max(axis=1) > 0))
        keep[rows.start : rows.start + (int(np.argmax(beyond)) if beyond.any() else len(t))] = True
    return recording.keep(keep)


def rms(residual: np.ndarray) -> float:
    """Root mean square length of the rows."""
    return float(np.sqrt((residual**2).sum(axis=1).mean()))
