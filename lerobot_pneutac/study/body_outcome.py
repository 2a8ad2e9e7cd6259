"""From a body's search to the outcome of its diagnosis: models, rivals and the evidence of test blocks."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from lerobot_pneutac.diagnosis.belief import likely_right
from lerobot_pneutac.diagnosis.experiment import predict
from lerobot_pneutac.diagnosis.model import FittedModel
from lerobot_pneutac.diagnosis.result import PROFILE, Contender, Contribution, Outcome, Tested
from lerobot_pneutac.diagnosis.search import Scored
from lerobot_pneutac.diagnosis.verdict import Evidence, decide
from lerobot_pneutac.diagnosis.votes import rivals
from lerobot_pneutac.study.body_black_box import left_to_black_box
from lerobot_pneutac.study.body_model import BodyFitter, BodyModel
from lerobot_pneutac.study.body_search import BodySearch, Searched, base_effects
from lerobot_pneutac.study.reading import read
from pneutac_sim.effects.laws import family, is_law, starts
from pneutac_sim.finger.data import BodyData

if TYPE_CHECKING:
    from lerobot_pneutac.study.body import BodyStudy

MOST_OTHERS = 4  # contenders beside the final model and the bare device


def body_outcome(
    study: "BodyStudy", search: BodySearch, start: Scored, done: Searched, began: float
) -> Outcome:
    """What a search ended with, judged on test blocks; `began` by `time.perf_counter`."""
    before = study.fitted(start.model)
    after = _after(study, done, done.model.model)
    helps = search.judge.surely(start.crossed, done.model.crossed)
    helps = helps and study.test.value(after.squared) < study.test.value(before.squared)
    if not helps:
        after, done.terms = before, []
    runs, left = _run_terms(study, done.model.model) if helps else None, after.squared
    if runs is not None:
        left = (study.residual_with_runs(done.model.model) ** 2).sum(axis=1)
        runs["error"] = float(np.sqrt(study.test.value(left)))
    evidence = _evidence(study, before, after, done, left)
    if done.terms and evidence.at_noise:
        helps, after, near_miss, done.terms, runs = False, before, done.terms, [], None
        evidence = _evidence(study, before, after, done, after.squared)
        evidence.near_miss = near_miss if evidence.before is None else []
    done.black_box = evidence.left_to_black_box = left_to_black_box(study, after.residual)
    known = _known(study, start, done) if helps else []
    ladder = [("as it is", before)]
    if helps:
        ladder += _ladder(study, done, after)
    verdict, contenders = decide(evidence), _contenders(study, search, start, done if helps else None)
    return Outcome(
        before=before,
        after=after,
        ladder=ladder,
        selected=done.terms,
        tested=_tested(study, search, done, before),
        rivals=rivals(done.found, study.noise.floor, done.terms, family, lambda s: study.fitted(s.model)),
        evidence=evidence,
        verdict=verdict,
        twin=after.twin,
        seconds=time.perf_counter() - began,
        known=known,
        baseline=_baseline(study, search, start, done, known) if helps else None,
        contributions=_contributions(study, search, done, after, known) if helps else [],
        run_terms=runs,
        chosen_in=done.chosen_in,
        base_model=_base(done) if helps else {},
        contenders=contenders,
        likely_right=_belief(evidence, verdict, contenders[0]),
    )


def _known(study: "BodyStudy", start: Scored, done: Searched) -> list[str]:
    """Known causes among what the final model needed and the twin lacks."""
    causes = base_effects(study)
    own_profile = done.model.model.form.own and not start.model.form.own
    return [*(t for t in done.terms if t in causes), *([PROFILE] if own_profile else [])]


def _baseline(
    study: "BodyStudy", search: BodySearch, start: Scored, done: Searched, known: Sequence[str]
) -> FittedModel | None:
    """The twin with the known causes alone, re-fitted from the command; None where there are none."""
    if not known:
        return None
    form = replace(start.model.form, own=start.model.form.own or PROFILE in known)
    form = form.plus(*(k for k in known if k != PROFILE))
    values = start.model.values | {
        k: v for k, v in done.model.model.values.items() if k.rpartition(".")[0] in known
    }
    fitter = BodyFitter(study.recording, study.twin, search.rows)
    fits = [fitter.fit(form, v, 12) for v in (values, values | fitter.rough(form))]
    return study.fitted(min(map(search.score, fits), key=lambda s: s.value).model)


def _contributions(
    study: "BodyStudy", search: BodySearch, done: Searched, after: FittedModel, known: Sequence[str]
) -> list[Contribution]:
    """What each term is worth beside all others; of the air too where the gauge drove the body."""
    models = {t: _after(study, done, s.model) for t, s in done.without.items() if t in done.terms}
    if PROFILE in known and (plain := search.plain(done.space, done.model.model)) is not None:
        models[PROFILE] = _after(study, done, plain.model)
    if done.driven and done.air is not None:
        for term, air in done.air.without.items():
            if term in done.terms and term not in models:
                twin = study.with_air(done.model.model, air.model)
                models[term] = FittedModel(
                    effects=tuple(twin.effects), residual=study.residual(twin), count=0, twin=twin
                )
    return study.contributions(after, models, known)


def _run_terms(study: "BodyStudy", model: BodyModel) -> dict[str, float] | None:
    """Root mean squares over runs of what single runs have of their own; None where runs do not differ."""
    if not model.form.trials:
        return None
    data = BodyFitter(study.recording, study.twin, np.zeros(1, int)).data(model.form.reading)
    d, p = len(data.columns), data.inputs.pressure_range_kpa
    offset, gain, zero, clock = model.form.trials
    travel = float(np.ptp(data.measured * data.scale, axis=0).max())
    rms = np.sqrt((model.of_trials**2).mean(axis=0))
    return {
        "offset": offset * travel * float(np.linalg.norm(rms[: data.counted])),
        "gain": gain * float(rms[d]),
        "pressure_kpa": zero * p * float(rms[d + 1]),
        "clock_s": clock * float(rms[d + 2]),
    }


def _belief(evidence: Evidence, verdict: str, best: Contender) -> float | None:
    if not evidence.selected or not evidence.noise_known or evidence.poor or evidence.after is None:
        return None
    return likely_right(evidence.after, best.probability, verdict == "missing_effect")


def _after(study: "BodyStudy", done: Searched, model: BodyModel) -> FittedModel:
    """A model of the body, with the air that was found where the measured pressure drove it."""
    if not done.driven:
        return study.fitted(model)
    assert done.air is not None
    twin = study.with_air(model, done.air.final.model)
    return FittedModel(
        effects=tuple(twin.effects), residual=study.residual(twin), count=len(model.free), twin=twin
    )


def _ladder(study: "BodyStudy", done: Searched, after: FittedModel) -> list[tuple[str, FittedModel]]:
    out, had = [], set(study.own)
    for i, s in enumerate(done.found.path):
        new = [e for e in s.model.form.effects if e not in had and (i > 0 or e not in done.space.base)]
        out.append(
            (" + ".join(["how it bends", *new] if i == 0 else ["", *new]).strip(), study.fitted(s.model))
        )
        had |= set(s.model.form.effects)
    return [*out[:-1], ("all that was found", after)]


def _contenders(
    study: "BodyStudy", search: BodySearch, start: Scored, done: Searched | None
) -> list[Contender]:
    """The final model, others of other physics, and the twin as it is, re-fitted.

    Others are up to `MOST_OTHERS` that the search weighed where it accepted its last terms, and the final
    model re-fitted without each of its terms.
    """
    if done is None:
        return [Contender(study.fitted(start.model).twin, (), 1.0)]
    known = {*done.space.base, *study.own}
    others = [s for weighed in reversed(done.found.rivals) for s in sorted(weighed, key=lambda s: s.value)]
    scored = _differing([done.model], [*reversed(done.found.path), *others], known)[: 1 + MOST_OTHERS]
    scored = _differing(scored, done.without.values(), known)
    share = search.judge.shares([s.crossed for s in [*scored, start]])
    twins = [_after(study, done, s.model).twin for s in scored] + [study.fitted(start.model).twin]
    terms = [tuple(e for e in s.model.form.effects if e not in known) for s in scored] + [()]
    return [Contender(t, e, float(p)) for t, e, p in zip(twins, terms, share, strict=True)]


def _differing(first: list[Scored], more: Iterable[Scored], known: set[str]) -> list[Scored]:
    """The first, then of the others one of each kind of physics that none before it has."""
    out, kinds = list(first), {frozenset(), *(_kinds(s, known) for s in first)}
    for s in more:
        if _kinds(s, known) not in kinds:
            kinds.add(_kinds(s, known))
            out.append(s)
    return out


def _kinds(scored: Scored, known: set[str]) -> frozenset[str]:
    return frozenset(family(e) for e in scored.model.form.effects if e not in known)


def _base(done: Searched) -> dict:
    """How it bends, in numbers."""
    model = done.model.model
    values = {k: v for k, v in model.values.items() if "." not in k}
    parts = [e for e in model.form.effects if e in done.space.base and e not in done.terms]
    values |= {k: v for k, v in model.values.items() if k.rpartition(".")[0] in parts}
    switch = model.form.reading.switch
    return {
        "joints": model.form.joints,
        "profile": "its own" if model.form.own else "the paper's",
        "trials_begin": model.form.reading.start,
        "switch_share": None if switch is None else float(np.nanmedian(np.array(switch, dtype=float))),
        "driven_by": "measured pressure" if done.driven else "command",
        "parameters": values,
    }


def _tested(study: "BodyStudy", search: BodySearch, done: Searched, before: FittedModel) -> list[Tested]:
    """What each effect does alone: those found, then the best of the others, from the first round."""
    first: dict[str, FittedModel] = {}
    base = set(done.found.base.model.form.effects)
    rounds = [*done.found.path[1:2], *(done.found.rivals[0] if done.found.rivals else [])]
    for s in rounds:
        new = [e for e in s.model.form.effects if e not in base]
        if len(new) == 1:
            first.setdefault(new[0], study.fitted(s.model))
    ground = study.fitted(done.found.base.model)
    out = []
    how = "pose, driven by the measured pressure" if done.driven else "pose, driven by the command"
    for name in (*done.terms, *(e for e in first if e not in done.terms)):
        model = first.get(name)
        if model is None and name in done.importance and name in done.space.candidates:
            form = done.found.base.model.form.plus(name.partition(" #")[0])
            fits = search.engine(done.space).fits(
                [done.space.trial(form, done.found.base.model.values, name, s) for s in starts(name)], 8
            )
            model = study.fitted(fits[0].model) if fits else None
        if model is None:
            continue
        share, interval = study.reduction(ground, model)
        errors = {"heldout": float(np.sqrt(study.test.value(model.squared)))}
        out.append(Tested(name, errors, share, interval, study.parameters(model, model.effects[-1]), how))
    return out


def _evidence(
    study: "BodyStudy", before: FittedModel, after: FittedModel, done: Searched, left: np.ndarray
) -> Evidence:
    """What the verdict rests on: errors of test blocks, which nothing was fitted or chosen on.

    `left` (n,) are the squared errors of the final model, without what single runs have of their own.
    """
    test, floor, known = study.test, study.noise.floor, study.noise.value is not None
    data = BodyData.of(study.recording, study.twin, source="command")
    constant = data.measured[:, : data.counted] - data.measured[~study.parts.test, : data.counted].mean(
        axis=0
    )
    worst = min(test.value(before.squared), test.value((constant**2).sum(axis=1)))
    if done.model.model.form.trials:  # what zeros of trials take away, no law did
        worst = min(worst, test.value((study.residual_with_runs(done.found.base.model) ** 2).sum(axis=1)))
    excess = test.value(left) - floor**2
    removed = 1 - max(excess, 0.0) / (worst - floor**2) if worst > 1.02 * floor**2 else 0.0
    agreed = [done.chosen_in.get(t, 1.0) for t in done.terms[:1]]
    return Evidence(
        poor=bool(study.too_little()),
        before=float(np.sqrt(worst)) / floor if known else None,
        after=float(np.sqrt(test.value(left))) / floor if known else None,
        selected=done.terms,
        removed=float(np.clip(removed, -1, 1)) if done.terms else 0.0,
        at_bound=[n for n in after.at_bound if n.rpartition(".")[0] in done.terms],
        cancelling=_cancelling(study, after, done.terms),
        left_to_black_box=done.black_box,
        forward=done.forward,
        agreed=min(agreed, default=1.0),
        noise_known=study.noise.known,
    )


def _cancelling(study: "BodyStudy", model: FittedModel, terms: Sequence[str]) -> list[str]:
    """Laws each of which moves the device by more than it travels."""
    data = read(study.recording, model.twin)
    seen, out = predict(model.twin, data)[0], []
    travel = np.linalg.norm(np.ptp(data.measured[:, : data.counted], axis=0))
    for law in filter(is_law, terms):
        moved = seen - predict(model.twin.without(law), data)[0]
        if np.linalg.norm(moved, axis=1).max() > travel:
            out.append(law)
    return out
