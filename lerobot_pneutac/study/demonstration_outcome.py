"""From a search on demonstrations to the outcome of its diagnosis: how hard it presses, rivals, evidence."""

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from lerobot_pneutac.diagnosis.black_box import share_left
from lerobot_pneutac.diagnosis.model import FittedModel
from lerobot_pneutac.diagnosis.result import Outcome, Rival, Tested
from lerobot_pneutac.diagnosis.search import Found
from lerobot_pneutac.diagnosis.verdict import Evidence, decide
from lerobot_pneutac.diagnosis.votes import chosen_in, rivals
from lerobot_pneutac.study.demonstration_data import command_signals
from lerobot_pneutac.study.demonstration_fit import AIR, LATE, TOUCH, Fitter
from lerobot_pneutac.study.demonstration_model import DemonstrationModel
from lerobot_pneutac.study.demonstration_strength import COMPLIANCE
from lerobot_pneutac.study.demonstration_words import CREEP
from pneutac_sim.effects.laws import family

if TYPE_CHECKING:
    from lerobot_pneutac.study.demonstrations import DemonstrationStudy


def demonstration_outcome(
    study: "DemonstrationStudy", air: Found, touch: Found, fitter: Fitter, tested: list[Tested], began: float
) -> Outcome:
    """What a search ended with, judged on held-out episodes.

    Args:
        study: of the episodes.
        air: what arm and gauge told.
        touch: what touch told, of a body behind that air.
        fitter: of the replays with that air.
        tested: candidates alone.
        began: by `time.perf_counter`.
    """
    before = study.bare
    models, base = [air.final.model, touch.final.model], touch.base.model
    after = study.fitted(models[0], models[1], fitter)
    lower = study.test.value(after.squared) < study.test.value(before.squared)
    if not (lower or study.by_level):
        models, after, fitter = [study.bare_air, study.bare_touch], before, study.fitter
    selected = [e for m in models for e in m.form.effects]
    ladder = [("as it is", before)]
    if models[0].form.effects:
        ladder.append((" + ".join(models[0].form.effects), study.fitted(models[0], base, fitter)))
    if models[1].form.effects:
        ladder.append((" + ".join(selected), after))
    pressing = pressing_as(study, after, models[1], fitter, selected)
    if pressing is not None:
        selected, after = [*selected, COMPLIANCE], pressing
        study.prepare(selected, ())
        before = study.fitted(study.bare_air, study.bare_touch, study.fitter)
        ladder = [("as it is", before), *ladder[1:], (" + ".join(selected), after)]
    others = rivals(
        touch,
        study.noise.by_column["imprint"],
        selected,
        family,
        lambda s: study.fitted(air.final.model, s.model, fitter),
    )
    if study.by_level:
        others.insert(0, _stiffer(study, study.fitted(models[0], base, fitter), after))
    votes = {}
    for found in (air, touch):
        votes |= chosen_in(found, study.owner[study.parts.train], study.noise.floor, family)
    chosen = {t: votes.get(t, 1.0) for t in selected}
    evidence = _evidence(study, before, after, selected, chosen)
    return Outcome(
        before=before,
        after=after,
        ladder=ladder,
        selected=selected,
        tested=tested,
        rivals=others,
        evidence=evidence,
        verdict=decide(evidence),
        twin=after.twin,
        seconds=time.perf_counter() - began,
        chosen_in=chosen,
    )


def pressing_as(
    study: "DemonstrationStudy",
    found: FittedModel,
    touch: DemonstrationModel,
    fitter: Fitter,
    selected: Sequence[str],
) -> FittedModel | None:
    """The same with a finger that presses as hard as its imprints are strong; None where it does.

    Imprints that are stronger where a slow valve or more of the body was found may tell of that.
    """
    apart, strength = study.stronger_by(found.twin), study.strengths[id(found.twin)]
    if study.known is None or not apart or (apart > 0 and set(selected) - {LATE}):
        return None
    twin = strength.pressing(found.twin, study.known)
    study.strengths[id(twin)] = strength
    uncharged = fitter.predict(touch.form, touch.values)[0]
    return replace(found, twin=twin, residual=uncharged, count=found.count + 1)


def _stiffer(study: "DemonstrationStudy", plain: FittedModel, found: FittedModel) -> Rival:
    """A stiffer finger in place of creep that was named by the imprints' level too."""
    assert study.known is not None
    twin = study.strengths[id(plain.twin)].pressing(plain.twin, study.known)
    worse = study.test.value(plain.squared) / study.test.value(found.squared) - 1
    return Rival(CREEP, COMPLIANCE, worse, replace(plain, twin=twin), found)


def _evidence(study: "DemonstrationStudy", before, after, selected, chosen) -> Evidence:
    floor = max(study.noise.floor, 1e-12)
    worst, left = study.test.value(before.squared), study.test.value(after.squared)
    room = worst - floor**2
    removed = 1 - max(left - floor**2, 0.0) / room if selected and room > 0 else float(bool(selected))
    signals, train, test = command_signals(study.fitter.episodes), study.parts.train, study.parts.test
    return Evidence(
        poor=bool(study.too_little()),
        before=float(np.sqrt(worst)) / floor,
        after=float(np.sqrt(left)) / floor,
        selected=selected,
        removed=float(np.clip(removed, -1, 1)),
        at_bound=[n for n in after.at_bound if n.rpartition(".")[0] in selected],
        left_to_black_box=share_left(after.residual, signals, train, test, floor),
        agreed=min([chosen[t] for t in selected[:1]], default=1.0),
        noise_known=study.noise.known,
    )


def tested_alone(
    study: "DemonstrationStudy", found: Found, behind: tuple[DemonstrationModel, Fitter] | None
) -> list[Tested]:
    """Each candidate alone, of arm and gauge, or of touch behind a model of the air on its replays."""
    before = study.bare
    out, first = [], [*found.path[1:2], *(found.rivals[0] if found.rivals else [])]
    for s in sorted(first, key=lambda s: s.value):
        if len(s.model.form.effects) != 1:
            continue
        name = s.model.form.effects[0]
        if behind is None:
            model = study.fitted(s.model, study.bare_touch, study.fitter)
            how, ground = "arm and gauge", study.fitter.predict(s.model.form, s.model.values, AIR)[0]
            model.residual = np.concatenate([ground[:, AIR], before.residual[:, TOUCH]], 1)
        else:
            model, how = study.fitted(behind[0], s.model, behind[1]), "touch"
        share, interval = study.reduction(before, model)
        errors = {"heldout": float(np.sqrt(study.test.value(model.squared)))}
        out.append(Tested(name, errors, share, interval, study.parameters(model, name), how))
    return out
