"""Forward selection of effects with a backward check.

Ranked by BIC on training blocks, kept only where a paired bootstrap on validation blocks says that the error
falls for sure and the fall is worth having. The test part is never looked at here.
"""

from dataclasses import dataclass, field

import numpy as np

from lerobot_pneutac.diagnosis.bootstrap import Resampler
from lerobot_pneutac.diagnosis.fits import FittedModel, Fitter, bic
from lerobot_pneutac.diagnosis.parts import Parts
from lerobot_pneutac.diagnosis.steps import Steps
from lerobot_pneutac.diagnosis.verdict import MOST

MAX_EFFECTS = 5
TRIES = 4  # candidates in BIC order that are put to the held-out test in each round
WORTH_OF_ROOM = 0.04  # of the avoidable mean square error that is left
WORTH_OF_BASE = 0.03  # of the avoidable mean square error of the start
WORTH_OF_FLOOR = 0.02  # of the noise's mean square
ALIKE = 0.02  # of the avoidable mean square error: candidates that differ by less are equal; the simpler wins


@dataclass
class Selection:
    """What forward selection found.

    Attributes:
        base: fit without further effects.
        path: fits from `base` to the last, one effect more each.
        added: the effect of each step.
        first: candidate to its fit alone on top of `base`.
        final: the fit kept after the backward check.
        importance: selected effect to the rise of the validation error when it is taken out.
        without: selected effect to the fit of the others.
        near_miss: candidates that alone would explain most, but not for sure.
        beside: refused candidate to its fit beside all that were selected.
    """

    base: FittedModel
    path: list[FittedModel]
    added: list[str]
    first: dict[str, FittedModel]
    final: FittedModel
    importance: dict[str, float] = field(default_factory=dict)
    without: dict[str, FittedModel] = field(default_factory=dict)
    near_miss: list[str] = field(default_factory=list)
    beside: dict[str, FittedModel] = field(default_factory=dict)

    @property
    def selected(self) -> list[str]:
        """Effects found, the most important first."""
        return sorted(self.importance, key=lambda e: -self.importance[e])


def select(
    fitter: Fitter,
    start: tuple[str, ...],
    candidates: list[str],
    parts: Parts,
    floor: float,
    seed: int,
    steps: Steps | None = None,
) -> Selection:
    """Finds the effects that the data asks for.

    Args:
        fitter: fits sets of effects.
        start: effects that the twin has already; they stay.
        candidates: effects to try, none of them in `start`.
        parts: training, validation, test.
        floor: noise floor, unit of the residuals.
        seed: of the bootstrap.
        steps: counts the fits.
    """
    judge, steps = Resampler(parts.validation, parts.unit, parts.stratum, seed), steps or Steps()
    steps.expect("the start", 1)
    base = fitter.fit_all([start])[0]
    result = Selection(base, [base], [], {}, base)
    now = base
    for turn in range(MAX_EFFECTS):
        if judge.value(now.squared) - floor**2 < worth(base, floor, judge):
            break  # nothing is left that could be worth having
        open_ = [c for c in candidates if c not in now.effects]
        if turn > 0:
            open_ = fitter.promising(now, open_, WORTH_OF_ROOM / 4)
        beside = (
            f"each candidate beside {', '.join(result.added)}" if result.added else "each candidate alone"
        )
        steps.expect(beside, len(open_))
        fits = dict(zip(open_, fitter.fit_all([_with(now, c) for c in open_], now), strict=True))
        if turn == 0:
            result.first = fits
        found = _best(now, fits, base, parts, floor, judge, result)
        if found is None:
            result.beside = fits
            break
        result.added.append(found)
        now = fits[found]
        result.path.append(now)
    result.final = now
    _check_backward(fitter, start, parts, floor, judge, result, steps)
    return result


def accepted(
    before: FittedModel, after: FittedModel, base: FittedModel, floor: float, judge: Resampler
) -> tuple[bool, bool]:
    """Whether the held-out error falls for sure and worthwhile; and whether it at least fell worthwhile."""
    drop, low, _ = judge.drop(before.squared, after.squared)
    least = max(WORTH_OF_ROOM * (judge.value(before.squared) - floor**2), worth(base, floor, judge))
    return bool(low > 0 and drop > least), bool(drop > least)


def worth(base: FittedModel, floor: float, judge: Resampler) -> float:
    """Least fall of the mean square error that is worth an effect."""
    return max(WORTH_OF_BASE * (judge.value(base.squared) - floor**2), WORTH_OF_FLOOR * floor**2)


def _best(now, fits, base, parts, floor, judge, result) -> str | None:
    n = now.independent(parts.train, len(np.unique(parts.unit[parts.train])))
    score = {c: bic(f, parts.train, n, floor) for c, f in fits.items()}
    order = sorted(fits, key=score.__getitem__)
    for i, name in enumerate(order[:TRIES]):
        sure, perhaps = accepted(now, fits[name], base, floor, judge)
        if sure:
            # something is missing for sure; what ranks higher and does no worse here explains it better
            reached = judge.value(fits[name].squared)
            better = [c for c in order[:i] if judge.value(fits[c].squared) <= reached]
            return _simplest(better[0] if better else name, order, now, fits, floor, judge)
        room = judge.value(now.squared) - floor**2
        if perhaps and now is base and judge.drop(now.squared, fits[name].squared)[0] > MOST * room:
            result.near_miss.append(name)
    return None


def _simplest(
    best: str,
    order: list[str],
    now: FittedModel,
    fits: dict[str, FittedModel],
    floor: float,
    judge: Resampler,
) -> str:
    """Among candidates as good as the best, for all that matters, the one with the fewest parameters."""
    room = judge.value(now.squared) - floor**2
    limit = judge.value(fits[best].squared) + ALIKE * room
    alike = [c for c in order if judge.value(fits[c].squared) <= limit]
    return min([best, *alike], key=lambda c: (fits[c].count, order.index(c)))


def _check_backward(fitter, start, parts, floor, judge, result, steps) -> None:
    """Takes out what the others have made needless, then measures what each of the rest is worth."""
    while True:
        chosen = [e for e in result.added if e in result.final.effects]
        if not chosen:
            break
        steps.expect("each selected effect taken out again", len(chosen))
        sets = [tuple(sorted(set(result.final.effects) - {e})) for e in chosen]
        result.without = dict(zip(chosen, fitter.fit_all(sets, result.final), strict=True))
        rise = {
            e: judge.value(f.squared) - judge.value(result.final.squared) for e, f in result.without.items()
        }
        needless = [
            e
            for e, f in result.without.items()
            if len(chosen) > 1 and not accepted(f, result.final, result.base, floor, judge)[1]
        ]
        if not needless:
            result.importance = rise
            break
        result.final = result.without[min(needless, key=rise.__getitem__)]
    kept = set(result.final.effects)
    result.path = (
        _replay(fitter, start, result, kept) if len(result.added) != len(kept) - len(start) else result.path
    )
    result.added = [e for e in result.added if e in kept]


def _replay(fitter, start, result, kept) -> list[FittedModel]:
    """The ladder over the effects that stayed."""
    names, rungs = list(start), [start]
    for e in result.added:
        if e in kept:
            names.append(e)
            rungs.append(tuple(sorted(names)))
    return fitter.fit_all(rungs, result.final)


def _with(fit: FittedModel, name: str) -> tuple[str, ...]:
    return tuple(sorted({*fit.effects, name}))


def rank(fits: dict[str, FittedModel], parts: Parts, floor: float) -> list[str]:
    """Candidates by BIC, the best first, with the effective count of the best residual."""
    if not fits:
        return []
    best = min(fits.values(), key=lambda f: float(f.squared[parts.train].mean()))
    n = best.independent(parts.train)
    return sorted(fits, key=lambda c: bic(fits[c], parts.train, n, floor))
