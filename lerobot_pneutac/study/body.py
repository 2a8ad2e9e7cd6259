"""The whole diagnosis: data check, noise floor, fingerprints, selection, rivals, verdict."""

import time
from collections.abc import Callable, Sequence

import numpy as np

from lerobot_pneutac.diagnosis import pneumatics
from lerobot_pneutac.diagnosis.adequacy import noise_limit
from lerobot_pneutac.diagnosis.bootstrap import Resampler
from lerobot_pneutac.diagnosis.candidates import sort_candidates
from lerobot_pneutac.diagnosis.engine import Engine, StageFitter
from lerobot_pneutac.diagnosis.experiment import predict
from lerobot_pneutac.diagnosis.fingerprints import fingerprints
from lerobot_pneutac.diagnosis.fits import FittedModel
from lerobot_pneutac.diagnosis.parts import deal
from lerobot_pneutac.diagnosis.profile import profile
from lerobot_pneutac.diagnosis.refit import Refit, refit
from lerobot_pneutac.diagnosis.result import BodyFindings, Tested
from lerobot_pneutac.diagnosis.rivals import find_rivals
from lerobot_pneutac.diagnosis.selection import Selection, select
from lerobot_pneutac.diagnosis.steps import Steps
from lerobot_pneutac.diagnosis.verdict import Evidence, decide
from lerobot_pneutac.study.base import Study
from lerobot_pneutac.study.pair import enough_rows
from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.mounts import on_one_mount
from pneutac_datasets.recording.noise import headline, noise_floor
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import get_effect, of_body
from pneutac_sim.finger.data import BodyData
from pneutac_sim.twin import Twin


def diagnose_body(
    twin: Twin,
    recording: Recording,
    seed: int = 0,
    jobs: int = 1,
    tell: Callable[[str, int], None] = lambda text, fits: None,
    done: Callable[[], None] = lambda: None,
) -> BodyFindings:
    """Finds what a twin lacks to explain a recording.

    Args:
        twin: of the recording's device.
        recording: of a finger or an arm.
        seed: of the split into parts and of every bootstrap.
        jobs: processes.
        tell: is told what is being done and how many fits it takes.
        done: is called after each fit.

    Raises:
        InputError: the recording has too few rows to fit the twin at all, or is of another device.
    """
    began = time.perf_counter()
    recording, findings = check(recording)
    parts = deal(recording, seed)
    names, untested = sort_candidates(recording, twin)
    own = tuple(sorted(of_body(twin.effects)))
    largest = max(names, key=lambda e: len(get_effect(e).parameters), default=None)
    enough_rows(twin, recording, [*own, *([largest] if largest else [])], parts.train)
    recording, said = on_one_mount(recording, twin, parts.train)
    findings = findings + said
    noise = noise_floor(recording)
    columns, _ = headline(recording)
    measured = pneumatics.measured_columns(recording)
    test = Resampler(parts.test, parts.unit, parts.stratum, seed + 1)

    with Engine(recording, parts.train, jobs, done) as engine:
        tell("the twin as it is", 1)
        base = StageFitter(engine, twin, "pose", "command").fit_all([own])[0]
        air, profiles = None, []
        if measured:
            air_noise = pneumatics.sensor_noise(recording, measured)
            fitter = StageFitter(engine, base.twin, "pressure", "command")
            air = select(
                fitter,
                tuple(e for e in own if pneumatics.is_pneumatic(e)),
                [c for c in names if pneumatics.is_pneumatic(c)],
                parts,
                air_noise,
                seed,
                tell,
            )
            profiles = profile(fitter, air.final, air.selected, parts, tell)
    if measured:
        driven = pneumatics.driven_by(recording, measured, air.final.residual, air_noise)
        names_body = [c for c in names if not pneumatics.is_pneumatic(c)]
        own_body = tuple(e for e in own if not pneumatics.is_pneumatic(e))
        source = "measured"
    else:
        driven, names_body, own_body, source = recording, names, own, "command"
    with Engine(driven, parts.train, jobs, done) as engine:
        fitter = StageFitter(engine, base.twin, "pose", source)
        body = select(fitter, own_body, names_body, parts, noise.value, seed, tell)
        rivals, correlated = find_rivals(fitter, body, names_body, parts, noise.value, seed, tell)
        profiles += profile(fitter, body.final, body.selected, parts, tell)
    if air is not None:
        more, also = find_rivals(None, air, [], parts, air_noise, seed, tell)
        rivals, correlated = more + rivals, also + correlated

    bench = BodyData.of(recording, twin, source="command")
    y = bench.measured[:, : bench.counted]

    def residual(model: Twin) -> np.ndarray:
        return y - predict(model, bench)[0]

    final = pneumatics.joined(body.final.twin, air.final.twin) if air else body.final.twin
    after = (
        residual(final)
        if air and (air.selected or body.selected)
        else (body.final if body.selected else base).residual
    )
    ladder = _ladder(base, air, body, residual)
    importance = {}
    judge = Resampler(parts.heldout, parts.unit, parts.stratum, seed)
    for chosen in (air, body):
        for e in chosen.selected if chosen else ():
            without = chosen.without[e].twin
            model = pneumatics.joined(body.final.twin, without) if chosen is air else (
                pneumatics.joined(without, air.final.twin) if air else without
            )  # fmt: skip
            importance[e] = judge.value((residual(model) ** 2).sum(1)) - judge.value((after**2).sum(1))
    selected = sorted(importance, key=lambda e: -importance[e])

    tested = _tested(air, body, base, residual, test, noise.value, source)
    floor = noise.value
    before2, after2 = (base.residual**2).sum(1), (after**2).sum(1)
    sigma = np.array([noise.by_column.get(c, 0.0) for c in columns])
    free = body.final.count + (air.final.count if air else 0)
    evidence = Evidence(
        samples=int(parts.train.sum()),
        units=test.units,
        moves=bool(
            np.ptp(recording.samples[recording.pressure_columns].to_numpy(float), axis=0).max() > 1e-3
        ),
        before=float(np.sqrt(judge.value(before2))) / max(floor, 1e-12),
        after=float(np.sqrt(judge.value(after2))) / max(floor, 1e-12),
        limit=noise_limit(recording, after, parts.heldout, sigma, free, seed),
        selected=selected,
        removed=judge.reduction(before2, after2, floor)[0] if selected else 0.0,
        at_bound=[b for b in {**body.final.at_bound, **(air.final.at_bound if air else {})} if "." in b],
        near_miss=body.near_miss,
    )
    pressure = None
    if air:
        pressure = tuple(np.sqrt(test.value(f.squared)) for f in (air.base, air.final)) + (air_noise,)
    drive = driven.samples[measured or recording.pressure_columns].to_numpy(float)
    return BodyFindings(
        recording=recording,
        findings=findings,
        noise=noise,
        parts=parts,
        twin=final if selected else base.twin,
        base=base,
        before=base.residual,
        after=after,
        prediction=y - after,
        ladder=ladder,
        selected=selected,
        tested=tested,
        untested=untested,
        prints=fingerprints(recording, base.residual, drive, seed),
        rivals=rivals,
        correlated=correlated,
        profiles=profiles,
        evidence=evidence,
        verdict=decide(evidence),
        measured_pressure=bool(measured),
        pressure_error=pressure,
        seconds=time.perf_counter() - began,
        judge=test,
    )


def _ladder(
    base: FittedModel, air: Selection | None, body: Selection, residual
) -> list[tuple[str, np.ndarray]]:
    """Labels and residuals from the twin as it is to the final one, all from the commanded pressure."""
    rungs = [("as it is", base.residual)]
    if air is None:
        return rungs + [(f"+ {e}", f.residual) for e, f in zip(body.added, body.path[1:], strict=True)]
    for e, f in zip(air.added, air.path[1:], strict=True):
        rungs.append((f"+ {e}", residual(pneumatics.joined(body.base.twin, f.twin))))
    for e, f in zip(body.added, body.path[1:], strict=True):
        rungs.append((f"+ {e}", residual(pneumatics.joined(f.twin, air.final.twin))))
    return rungs


def _tested(
    air, body, base: FittedModel, residual, test: Resampler, floor: float, source: str
) -> list[Tested]:
    out = []
    for name, fit in (air.first if air else {}).items():
        after = (residual(pneumatics.joined(body.base.twin, fit.twin)) ** 2).sum(1)
        share, ci = test.reduction(base.squared, after, floor)
        out.append(
            Tested(
                name, float(np.sqrt(test.value(after))), share, ci, parameters(fit, name), "measured pressure"
            )
        )
    how = "pose, driven by the measured pressure" if source == "measured" else "pose, driven by the command"
    for name, fit in body.first.items():
        share, ci = test.reduction(body.base.squared, fit.squared, floor)
        out.append(
            Tested(name, float(np.sqrt(test.value(fit.squared))), share, ci, parameters(fit, name), how)
        )
    return sorted(out, key=lambda t: -t.reduction)


def parameters(fit: FittedModel, effect: str) -> dict:
    """Parameters of one effect with interval and unit."""
    values = fit.twin.effects.get(effect, {})
    units = {p.name: p.unit for p in get_effect(effect).parameters}
    return {
        k: {"value": v.value, "ci95": list(v.ci95) if v.ci95 else None, "unit": units.get(k, "")}
        for k, v in values.items()
    }


class BodyStudy(Study):
    """A recording of a finger or an arm; a sample is a row."""

    def __init__(self, twin: Twin, recording: Recording, seed: int, adding: str | None = None):
        self.twin, self.seed = twin, seed
        recording, self.findings = check(recording)
        self.parts = deal(recording, seed, choose=adding is None)
        self.own = tuple(of_body(twin.effects))
        self.candidates, self.untested = sort_candidates(recording, twin)
        self.recording = recording
        if adding is not None and self.refusal(adding):
            return
        largest = max(self.candidates, key=lambda e: len(get_effect(e).parameters), default=None)
        tried = adding or largest
        enough_rows(twin, recording, [*self.own, *([tried] if tried else [])], self.parts.train)
        self.recording, moved = on_one_mount(recording, twin, self.parts.train)
        self.findings = self.findings + moved
        self.noise = noise_floor(self.recording)
        self.unit = self.noise.unit

    def refit(self, effects: Sequence[str], start: Refit | None, steps: Steps) -> Refit:
        """Air to the measured pressure, body to the pose."""
        near = start.twin if start is not None and not pneumatics.is_pneumatic(effects[-1]) else self.twin
        return refit(near, self.recording, list(effects), self.parts, steps.done)

    def refusal(self, effect: str) -> str:
        """Why an effect cannot be switched on."""
        reasons = (
            f"{self.recording.folder}: effect '{effect}' {u.reason}."
            for u in self.untested
            if u.name == effect
        )
        return self.already_on(effect) or next(reasons, "")

    def twin_of(self, model: Refit) -> Twin:
        """The fitted twin."""
        return model.twin

    def parameters(self, model: Refit, effect: str) -> dict[str, dict]:
        """Parameters of one effect with interval and unit."""
        return parameters(model, effect)

    def at_bound(self, model: Refit, effects: Sequence[str]) -> list[str]:
        """Parameters at a bound."""
        return list(model.at_bound)
