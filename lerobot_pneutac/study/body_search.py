"""The search for what a finger or an arm lacks: air from the measured pressure, body from the pose."""

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from lerobot_pneutac.diagnosis import pneumatics
from lerobot_pneutac.diagnosis.adequacy import noise_limit
from lerobot_pneutac.diagnosis.engine import Engine, StageFitter
from lerobot_pneutac.diagnosis.fingerprints import fingerprints
from lerobot_pneutac.diagnosis.fits import FittedModel
from lerobot_pneutac.diagnosis.profile import Profile, profile
from lerobot_pneutac.diagnosis.result import Outcome, Tested
from lerobot_pneutac.diagnosis.rivals import Rival, find_rivals
from lerobot_pneutac.diagnosis.selection import Selection, select
from lerobot_pneutac.diagnosis.steps import Steps
from lerobot_pneutac.diagnosis.verdict import Evidence, decide
from pneutac_datasets.recording.noise import headline
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.finger.quantities import squared_distance
from pneutac_sim.twin import Twin

if TYPE_CHECKING:
    from lerobot_pneutac.study.body import BodyStudy

ON_PRESSURE = "measured pressure"


@dataclass
class Searched:
    """What the two stages found.

    Attributes:
        base: the twin as it is, fitted to the pose from the command.
        air: effects between command and measured pressure; None where it was not measured.
        body: all other effects.
        driven: the recording with the pressure that drives the body.
        profiles: of the parameters of selected effects.
        rivals: of selected effects.
        correlated: pairs of effects that the data can hardly tell apart.
    """

    base: FittedModel
    air: Selection | None
    body: Selection
    driven: Recording
    profiles: list[Profile]
    rivals: list[Rival]
    correlated: list[tuple[str, str, float]]

    def twin(self, body: FittedModel, air: FittedModel | None = None) -> Twin:
        """One body and one air, the final one where None, as a twin."""
        if self.air is None:
            return body.twin
        return pneumatics.joined(body.twin, (air or self.air.final).twin)


def search_body(study: "BodyStudy", jobs: int, steps: Steps) -> Outcome:
    """Finds what a twin lacks.

    Args:
        study: of a finger or an arm.
        jobs: processes.
        steps: counts the fits.
    """
    began = time.perf_counter()
    found = _stages(study, jobs, steps)
    air, body = found.air, found.body

    def model(twin: Twin) -> FittedModel:
        return FittedModel(tuple(twin.effects), study.residual(twin), 0, twin)

    before, last = found.base, found.twin(body.final)
    if air and (air.selected or body.selected):
        after = model(last)
    else:
        after = body.final if body.selected else before
    importance = {}
    for chosen in [s for s in (air, body) if s]:
        for e in chosen.selected:
            without = chosen.without[e]
            pair = (body.final, without) if chosen is air else (without,)
            squared = squared_distance(study.residual(found.twin(*pair)))
            importance[e] = study.judge.value(squared) - study.judge.value(after.squared)
    selected = sorted(importance, key=lambda e: -importance[e])
    evidence = _evidence(study, found, before, after, selected)
    pressure_error = None
    if air:
        base, final = (float(np.sqrt(study.test.value(f.squared))) for f in (air.base, air.final))
        pressure_error = (base, final, study.air_noise)
    drive = found.driven.samples[study.measured or study.recording.pressure_columns].to_numpy(float)
    return Outcome(
        before=before,
        after=replace(after, twin=last if selected else before.twin),
        ladder=_ladder(found, model),
        selected=selected,
        tested=_tested(study, found),
        rivals=found.rivals,
        correlated=found.correlated,
        evidence=evidence,
        verdict=decide(evidence),
        twin=last if selected else before.twin,
        seconds=time.perf_counter() - began,
        fingerprints=fingerprints(study.recording, before.residual, drive, study.seed),
        profiles=found.profiles,
        pressure_error=pressure_error,
    )


def _stages(study: "BodyStudy", jobs: int, steps: Steps) -> Searched:
    """Selects effects of the air, then those of the body, and looks for rivals of both."""
    names, own = list(study.candidates), tuple(sorted(study.own))
    parts, seed, floor = study.parts, study.seed, study.noise.value
    air, driven, source, profiles = None, study.recording, "command", []
    with Engine(study.recording, parts.train, jobs, steps.done) as engine:
        steps.expect("the twin as it is", 1)
        base = StageFitter(engine, study.twin, "pose", "command").fit_all([own])[0]
        if study.measured:
            fitter = StageFitter(engine, base.twin, "pressure", "command")
            start, tried = (_pneumatic(own), list(_pneumatic(names)))
            air = select(fitter, start, tried, parts, study.air_noise, seed, steps)
            profiles = profile(fitter, air.final, air.selected, parts, steps)
    if air:
        driven, source = study.driven(air.final.residual), "measured"
        names, own = ([e for e in es if e not in _pneumatic(es)] for es in (names, own))
    with Engine(driven, parts.train, jobs, steps.done) as engine:
        fitter = StageFitter(engine, base.twin, "pose", source)
        body = select(fitter, tuple(own), names, parts, floor, seed, steps)
        rivals, correlated = find_rivals(fitter, body, names, parts, floor, seed, steps)
        profiles = profiles + profile(fitter, body.final, body.selected, parts, steps)
    if air:
        of_air, pairs = find_rivals(None, air, [], parts, study.air_noise, seed, steps)
        rivals, correlated = of_air + rivals, pairs + correlated
    return Searched(base, air, body, driven, profiles, rivals, correlated)


def _pneumatic(effects) -> tuple[str, ...]:
    return tuple(e for e in effects if pneumatics.is_pneumatic(e))


def _evidence(
    study: "BodyStudy", found: Searched, before: FittedModel, after: FittedModel, selected: list[str]
) -> Evidence:
    """What the verdict rests on: errors of test blocks, which nothing was fitted or chosen on."""
    recording, test, floor = study.recording, study.test, study.noise.value
    finals = [found.body.final, *([found.air.final] if found.air else [])]
    columns, _ = headline(recording)
    sigma = np.array([study.noise.by_column.get(c, 0.0) for c in columns])
    command = recording.samples[recording.pressure_columns].to_numpy(float)
    count = sum(f.count for f in finals)
    return Evidence(
        samples=int(study.parts.train.sum()),
        units=test.units,
        moves=bool(np.ptp(command, axis=0).max() > 1e-3),
        before=float(np.sqrt(test.value(before.squared))) / max(floor, 1e-12),
        after=float(np.sqrt(test.value(after.squared))) / max(floor, 1e-12),
        limit=noise_limit(recording, after.residual, study.parts.test, sigma, count, study.seed),
        selected=selected,
        removed=test.reduction(before.squared, after.squared, floor)[0] if selected else 0.0,
        at_bound=[name for f in finals for name in f.at_bound if "." in name],
        near_miss=found.body.near_miss,
    )


def _ladder(found: Searched, model) -> list[tuple[str, FittedModel]]:
    """Labels and models from the twin as it is to the final one, all from the commanded pressure."""
    air, body = found.air, found.body
    rungs = [("as it is", found.base)]
    if air is None:
        return rungs + [(f"+ {e}", f) for e, f in zip(body.added, body.path[1:], strict=True)]
    for e, f in zip(air.added, air.path[1:], strict=True):
        rungs.append((f"+ {e}", model(found.twin(body.base, f))))
    for e, f in zip(body.added, body.path[1:], strict=True):
        rungs.append((f"+ {e}", model(found.twin(f))))
    return rungs


def _tested(study: "BodyStudy", found: Searched) -> list[Tested]:
    """Each candidate alone, the one that removes most first."""
    out = []
    for name, fit in (found.air.first if found.air else {}).items():
        after = squared_distance(study.residual(found.twin(found.body.base, fit)))
        out.append(_tried(study, name, fit, found.base.squared, after, ON_PRESSURE))
    how = "pose, driven by the measured pressure" if found.air else "pose, driven by the command"
    for name, fit in found.body.first.items():
        out.append(_tried(study, name, fit, found.body.base.squared, fit.squared, how))
    return sorted(out, key=lambda t: t.reduction or 0.0, reverse=True)


def _tried(
    study: "BodyStudy", name: str, fit: FittedModel, before: np.ndarray, after: np.ndarray, how: str
) -> Tested:
    share, interval = study.test.reduction(before, after, study.noise.value)
    errors = {"heldout": float(np.sqrt(study.test.value(after)))}
    return Tested(name, errors, share, interval, study.parameters(fit, name), how)
