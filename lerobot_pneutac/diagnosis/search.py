"""The search over models: actuation first, then terms, alone and in pairs, by a beam, then backward.

It knows nothing of the device. A space offers structures and fits them; a model's worth is its
cross-validated error (`cv_squared`), pooled over all blocks of time but those of the report.
"""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, Self

import numpy as np

from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.diagnosis.bootstrap import BlockBootstrap, out_of_time
from lerobot_pneutac.diagnosis.result import Candidate, FittedModel, Rival
from pneutac_sim.twin import Twin


@dataclass(frozen=True)
class Structure:
    """Which effects a model has, in the order in which they came."""

    effects: tuple[str, ...] = ()

    def plus(self, *effects: str) -> Self:
        """With further effects; a law that is there already comes in a second instance."""
        now = list(self.effects)
        for e in effects:
            number, name = 2, e
            while name in now:
                name, number = f"{e} #{number}", number + 1
            now.append(name)
        return replace(self, effects=tuple(now))

    def without(self, *effects: str) -> Self:
        return replace(self, effects=tuple(e for e in self.effects if e not in effects))


type Start = tuple[Any, Any]  # a structure, and where its fit begins: values by name, or a fitted gel


class Space(ABC):
    """What a search may try on one kind of recording. By default there is nothing to choose but effects."""

    candidates: Sequence[str]

    @abstractmethod
    def bases(self) -> Sequence[Start]:
        """What to begin with."""

    @abstractmethod
    def grow(self, model: Any, most: int, pairs: int) -> Sequence[Start]:
        """The most promising additions to a model, single and in pairs."""

    @abstractmethod
    def fit(self, start: Start, steps: int, every: int = 1) -> Any:
        """A model, by so many steps and one row in so many; None where it cannot be fitted."""

    @abstractmethod
    def without(self, model: Any, term: str) -> Any:
        """The model re-fitted without a term."""

    def with_actuations(self, model: Any, starts: bool) -> Sequence[Start]:
        """The model with each actuation model in place of its own; with `starts` however trials may begin."""
        return []

    def refine_actuation(self, model: Any) -> Any:
        """A model with its actuation refined."""
        return model

    def begun(self, model: Any) -> Any:
        """A model with how its recording's runs begin, where that is quickly found."""
        return model

    def refine(self, model: Any) -> Any:
        """An accepted model, with how it was recorded."""
        return model

    def bare_starts(self, model: Any) -> Sequence[Start]:
        """The model without those parts of its base that may stand in for a term."""
        return []

    def again(self, model: Any) -> Start:
        """The model's structure, started where it is."""
        return (model.structure, model.values)

    def removable(self, model: Any) -> Sequence[str]:
        """Terms that the model might do without."""
        return model.structure.effects


@dataclass
class Scored:
    """A fitted model with its worth."""

    model: Any  # as fitted
    cv_squared: np.ndarray  # (N,) squared errors on rows that the fit did not see
    value: float  # their mean


@dataclass
class Found:
    """What a search ended with."""

    base: Scored  # the best model without any term
    path: list[Scored]  # from the base to the end, one acceptance each
    final: Scored  # after the backward check
    # of each acceptance, the other models that were fitted well
    rivals: list[list[Scored]] = field(default_factory=list)
    # of the final model, term to the model without it
    without: dict[str, Scored] = field(default_factory=dict)
    # the model when its actuation was last chosen again; None where it was not
    actuated: Scored | None = None
    # those with another actuation at that time, the best first
    others: list[Scored] = field(default_factory=list)


class Search:
    """One search.

    Args:
        space: what may be tried.
        bootstrap: draws blocks of the search's rows.
        fold: (N,) number of each row's fold; rows are in the order of time.
        floor: noise, in the unit of the error.
        run: like `map`, perhaps in parallel.
        report: called with a line of progress.
        condition: (N,) number of each row's physical condition, see `bootstrap.conditions`; None for
            one alone.
    """

    def __init__(
        self,
        space,
        bootstrap: BlockBootstrap,
        fold,
        floor: float,
        run: Callable = map,
        report=lambda text: None,
        condition: np.ndarray | None = None,
    ):
        self.space, self.bootstrap, self.fold, self.noise_mse = space, bootstrap, fold, floor**2
        self.run, self.report = run, report
        self.condition = np.zeros(len(fold), int) if condition is None else condition

    def score(self, model) -> Scored:
        cv_squared = model.cv_squared(self.fold)
        return Scored(model, cv_squared, self.bootstrap.value(cv_squared))

    def fits(self, trials, steps: int, every: int = 1) -> list[Scored]:
        """Fits trials, the best first."""

        def fitted(trial: Start) -> Scored | None:
            model = self.space.fit(trial, steps, every)
            return model and self.score(model)

        out = self.run(fitted, list(trials))
        return sorted((s for s in out if s and np.isfinite(s.value)), key=lambda s: s.value)

    def _roughly(self, trials: Sequence[Start]) -> list[Scored]:
        """Fits trials by two steps and a quarter of the rows; the best by their own errors come first."""

        def fitted(trial: Start) -> Scored | None:
            model = self.space.fit(trial, 2, 4)
            return model and Scored(model, model.squared, self.bootstrap.value(model.squared))

        return sorted((s for s in self.run(fitted, trials) if s), key=lambda s: s.value)

    def find(self) -> Found:
        beam = self._begin()
        base = best = beam[0]
        found = Found(base, [base], base)
        start = lined = base.value - self.noise_mse
        for _ in range(T.MOST_TERMS):
            excess = best.value - self.noise_mse
            if excess < T.STOP_EXCESS * self.noise_mse:
                break
            done = [d for d in self._round(beam) if self._improves_out_of_time(best, d)]
            if not done:
                break
            taken = self._accepted(best, done, excess, start)
            if taken is None:
                break
            refined = self.score(self.space.refine(taken.model))
            best = refined if refined.value < taken.value else taken
            self.report(f"found {' + '.join(best.model.structure.effects)}: error {best.value**0.5:.3g}")
            found.path.append(best)
            found.rivals.append([d for d in done if d is not taken])
            beam = [best, *(d for d in done if d is not taken)][: T.BEAM]
            if best.value - self.noise_mse < T.ACTUATION_AGAIN * lined:
                lined = best.value - self.noise_mse
                best = self._actuation_again(best, found)
                beam = [best, *(s for s in beam if s is not best)][: T.BEAM]
        found.final = self.pruned(best, found)
        return found

    def _begin(self) -> list[Scored]:
        """The best bases and lines, the chosen one first."""
        bare = self.fits(self.space.bases(), 12)
        cheap = min(bare, key=lambda s: (s.model.cost, s.value))
        chosen = (
            bare[0]
            if self._significant(cheap, bare[0], T.WORTH_OF_BASE * max(cheap.value - self.noise_mse, 0))
            else cheap
        )
        quick = self._roughly(self.space.with_actuations(chosen.model, starts=True))
        front = self.run(self._with_refined_actuation, best_of_each(quick, 2))
        done = best_of_each(sorted([chosen, *front], key=lambda s: s.value), 1)
        for s in done:
            self.report(
                f"trying {' + '.join(s.model.structure.effects) or 'the base'}: error {s.value**0.5:.3g}"
            )
        near = done[0].value + T.SAME_ACTUATION * max(done[0].value, self.noise_mse)
        first = min((s for s in done if s.value <= near), key=lambda s: s.model.cost)
        least = set(first.model.structure.effects)  # with more, and no better, all would be tried twice
        done = [s for s in done if s.value > near or not least < set(s.model.structure.effects)]
        return (
            [first, *(s for s in done if s is not first)][: T.BEAM - 1]
            + ([chosen] if chosen is not first and chosen not in done[: T.BEAM - 1] else [])
            + self.fits(self.space.bare_starts(first.model), 12)[:1]
        )

    def _actuation_again(self, best: Scored, found: Found) -> Scored:
        """The model with another actuation model where that is significantly better.

        The line was chosen while most of the error was of what has been found since, and may have stood in
        for it.
        """
        found.actuated, found.others = best, self.other_actuations(best)
        if not found.others or not self._significant(
            best, found.others[0], T.WORTH_OF_EXCESS * (best.value - self.noise_mse)
        ):
            return best
        others, found.actuated, found.others = found.others, found.others[0], [best, *found.others[1:]]
        effects = " + ".join(others[0].model.structure.effects)
        self.report(f"actuation {effects}: error {others[0].value ** 0.5:.3g}")
        found.path.append(others[0])
        found.rivals.append([best])
        return others[0]

    def other_actuations(self, model: Scored) -> list[Scored]:
        """The most promising models with another line, fitted well, the best first; none at the noise."""
        if model.value < T.AS_IS_NOISE**2 * self.noise_mse:
            return []
        quick = self._roughly(self.space.with_actuations(model.model, starts=False))
        now = set(model.model.structure.effects)
        others = [s for s in best_of_each(quick, 1) if set(s.model.structure.effects) != now]
        front = self.run(self._with_refined_actuation, others[: T.OTHER_ACTUATIONS])
        return sorted(front, key=lambda s: s.value)

    def _with_refined_actuation(self, scored: Scored) -> Scored:
        return self.score(self.space.refine_actuation(scored.model))

    def _round(self, beam: list[Scored]) -> list[Scored]:
        """The best models with one or two terms more, fitted well."""

        def grown(k: int) -> Sequence[Start]:
            return self.space.grow(beam[k].model, *((T.COARSE, 4) if k == 0 else (4, 2)))

        trials = [trial for new in self.run(grown, range(len(beam))) for trial in new]
        done, seen, fine = self.fits(trials, 5, 2), set(), []
        for s in done:
            key = tuple(sorted(s.model.structure.effects))
            if key not in seen and len(fine) < T.FINE:
                seen.add(key)
                fine.append(s.model)
        done = [s.model for s in self.fits([self.space.again(m) for m in fine], 8)]
        done = sorted(self.run(lambda m: self.score(self.space.begun(m)), done), key=lambda s: s.value)
        for s in best_of_each(done, 1):
            self.report(f"tried {' + '.join(s.model.structure.effects)}: error {s.value**0.5:.3g}")
        return done

    def _accepted(self, now: Scored, done: list[Scored], excess: float, start: float) -> Scored | None:
        """The simplest of the best, if the error falls significantly and worthwhile."""
        least = max(T.WORTH_OF_EXCESS * excess, T.WORTH_OF_NOISE * self.noise_mse, T.WORTH_OF_START * start)
        equal = [d for d in done if d.value < done[0].value + T.EQUAL * max(excess, 0)]
        equal.sort(key=lambda d: (d.model.cost, d.value))
        rest = [d for d in done if d not in equal]
        for d in (*equal[:3], *rest[:2]):
            if self._significant(now, d, least):
                return d
        return None

    def _improves_out_of_time(self, now: Scored, after: Scored) -> bool:
        """Whether a model errs less than the one it replaces in all of `AHEAD`, and hardly more in the last.

        Blocks dealt at random lie between others that were fitted: there any slow course does well, one of
        time or one of a long memory. A wrong model may be right by chance in the last stretch alone.
        """
        n, drops = len(self.fold), []
        for begin, end in pairwise((np.array(T.AHEAD) * n).astype(int)):
            fold = out_of_time(self.condition, begin)
            if (fold[:end] == 0).any():
                drops.append(float((now.model.cv_squared(fold) - after.model.cv_squared(fold))[:end].sum()))
        return not drops or sum(drops) > max(0.0, -drops[-1] / T.LOST_LAST)

    def is_worth(self, now: Scored, after: Scored) -> bool:
        """Whether a step between models is significant, large enough and improves out of time."""
        least = max(T.WORTH_OF_EXCESS * (now.value - self.noise_mse), T.NEEDED_OF_NOISE * self.noise_mse)
        return self._significant(now, after, least) and self._improves_out_of_time(now, after)

    def is_needed(self, without: Scored, model: Scored, share: float = T.WORTH_KEEPING) -> bool:
        """Whether a model is so much better than the one re-fitted without a term that the term stays."""
        least = max(share * (without.value - self.noise_mse), T.NEEDED_OF_NOISE * self.noise_mse)
        return self._significant(without, model, least)

    def is_significant(self, before: Scored, after: Scored) -> bool:
        return self.bootstrap.significant_drop(before.cv_squared, after.cv_squared, self.noise_mse)

    def _significant(self, before: Scored, after: Scored, least: float) -> bool:
        return before.value - after.value > least and self.is_significant(before, after)

    def pruned(self, best: Scored, found: Found, share: float = T.WORTH_KEEPING) -> Scored:
        """Takes away what is not needed, one after the other, see `is_needed`."""
        while True:
            terms = self.space.removable(best.model)
            left = self.run(lambda t, model=best.model: self.score(self.space.without(model, t)), terms)
            found.without = without = dict(zip(terms, left, strict=True))
            if not terms:
                return best
            weakest = min(without, key=lambda t: without[t].value)
            if self.is_needed(without[weakest], best, share):
                return best
            best = without[weakest]


def best_of_each(scored: list[Scored], most: int) -> list[Scored]:
    """The best few of each structure, in order."""
    count: dict[tuple, int] = {}
    out = []
    for s in scored:
        count[s.model.structure.effects] = count.get(s.model.structure.effects, 0) + 1
        if count[s.model.structure.effects] <= most:
            out.append(s)
    return out


def chosen(scored: Sequence[Scored], value: Callable[[Scored], float], noise_mse: float) -> Scored:
    """The simplest of those that are as good as the best, by some measure of worth."""
    best = min(map(value, scored))
    equal = [
        s for s in scored if value(s) <= best + max(2 * T.EQUAL * (best - noise_mse), T.EQUAL * noise_mse)
    ]
    return min(equal, key=lambda s: (s.model.cost, value(s)))


def deal_folds(unit: np.ndarray, folds: int, seed: int) -> np.ndarray:
    """(N,) fold of each row: whole units, dealt at random."""
    index = np.unique(unit, return_inverse=True)[1]
    order = np.random.default_rng([seed, 5]).permutation(index.max() + 1)
    return (order % folds)[index]


def chosen_in(found: Found, unit: np.ndarray, floor: float, kind: Callable[[str], str]) -> dict[str, float]:
    """Share of the votes in which each term of the final model, or another of its `kind`, came.

    Each vote leaves out a quarter of the blocks `unit` (N,) and deals the others again into five folds; at
    each acceptance it chooses among the models that were fitted well there.
    """
    count: Counter[str] = Counter()
    index = np.unique(unit, return_inverse=True)[1]
    for seed in range(T.VOTES):
        rng = np.random.default_rng([seed, 9])
        keep = rng.permutation(index.max() + 1) < T.VOTE_BLOCKS * (index.max() + 1)
        fold = np.where(keep[index], deal_folds(unit, 5, seed), -1)
        terms = set(found.final.model.structure.effects)
        for taken, rivals in zip(found.path[1:], found.rivals, strict=True):
            value = {id(s): float(s.model.cv_squared(fold)[fold >= 0].mean()) for s in (taken, *rivals)}
            winner = chosen([taken, *rivals], lambda s, value=value: value[id(s)], floor**2)
            if winner is not taken:
                kinds = {kind(e) for e in winner.model.structure.effects}
                terms = {t for t in terms if kind(t) in kinds}
                break
        count.update(terms)
    return {t: count[t] / T.VOTES for t in found.final.model.structure.effects}


def rivals(
    found: Found,
    floor: float,
    terms: Sequence[str],
    kind: Callable[[str], str],
    fitted: Callable[[Scored], FittedModel],
    as_good: Callable[[Scored, Scored, Scored], bool] | None = None,
    most: int = T.MOST_RIVALS,
) -> list[Rival]:
    """Models as good where a term was accepted, with one of another kind in its place; the first `most`.

    Args:
        found: by a search.
        floor: noise.
        terms: that count as found.
        kind: of a term.
        fitted: a model of the search on all samples.
        as_good: of the model before a term, the one with it and another; by their errors where None.
        most: that are returned.
    """
    out = []
    for taken, others, before in zip(found.path[1:], found.rivals, found.path, strict=False):
        least = T.AS_GOOD * max(before.value - floor**2, 0.0)
        new = [e for e in taken.model.structure.effects if e not in before.model.structure.effects]
        for s in others if len(new) == 1 and new[0] in terms else ():
            instead = [e for e in s.model.structure.effects if e not in taken.model.structure.effects]
            if len(instead) != 1 or kind(instead[0]) == kind(new[0]) or len(out) == most:
                continue
            if as_good(before, taken, s) if as_good else s.value - taken.value < least:
                share = s.value / max(taken.value, 1e-30) - 1
                out.append(Rival(new[0], instead[0], share, fitted(s), fitted(taken)))
    return out


def contenders(
    scored: Sequence[Scored],
    bootstrap: BlockBootstrap,
    known: Container[str],
    twin_of: Callable[[Scored], Twin],
) -> list[Candidate]:
    """Models with how likely each is the best, and their terms besides those that are known."""
    share = bootstrap.shares([s.cv_squared for s in scored])
    terms = [tuple(e for e in s.model.structure.effects if e not in known) for s in scored]
    return [Candidate(twin_of(s), e, float(p)) for s, e, p in zip(scored, terms, share, strict=True)]


class Steps:
    """Calls `progress(text, done, total)` as work is done."""

    def __init__(self, progress: Callable[[str, int, int], None] | None = None):
        self._progress = progress
        self._text, self._done, self._total = "", 0, 0

    def expect(self, text: str, count: int) -> None:
        """So many more steps, of this kind."""
        self._text, self._total = text, self._total + count
        self._report()

    def done(self) -> None:
        self._done += 1
        self._report()

    def _report(self) -> None:
        if self._progress is not None:
            self._progress(self._text, self._done, self._total)
