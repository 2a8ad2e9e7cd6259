"""The search over models: lines first, then terms, alone and in pairs, by a beam, then backward.

It knows nothing of the device. A space offers forms and fits them; a model's worth is its error on blocks of
time that its fit did not see (`crossed`), pooled over all blocks but those of the report.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Protocol

import numpy as np

from lerobot_pneutac.diagnosis.bootstrap import Resampler
from lerobot_pneutac.diagnosis.parts import out_of_time

MOST_TERMS = 6
BEAM = 3
OTHER_LINES = 4  # fitted well, where the line is chosen anew
ADEQUATE = 1.1  # times the noise: what is nearer needs no other line
COARSE, FINE = 12, 6  # additions fitted roughly, and then well, in a round
WORTH_OF_ROOM = 0.04  # of the avoidable mean square error that is left: least fall worth a term
WORTH_OF_FLOOR = 0.03  # of the noise's mean square
WORTH_OF_START = 0.005  # of the avoidable mean square error of the start
LINE_AGAIN = 0.5  # of the avoidable mean square error at which a line was chosen; below, it is chosen anew
ALIKE = 0.01  # of the avoidable mean square error: models that differ by less are equal; the simpler wins
AHEAD = (0.4, 0.6, 0.8, 1.0)  # of the rows: stretches that an addition must foretell from all before them


class Space(Protocol):
    """What a search may try, see `BodySpace`."""

    def bases(self) -> Sequence[Any]:
        """What to begin with."""
        ...

    def with_lines(self, model) -> Sequence[Any]:
        """A model with each line, as trials."""
        ...

    def settle_line(self, model) -> Any:
        """A model with a line, fitted well."""
        ...

    def grow(self, model, most: int, pairs: int) -> Sequence[Any]:
        """The most promising additions to a model, as trials."""
        ...

    def fit(self, trial, steps: int, every: int) -> Any:
        """A model, or None where a trial cannot be fitted."""
        ...

    def again(self, model) -> Any:
        """A model as a trial."""
        ...

    def settle(self, model) -> Any:
        """An accepted model, with how it was recorded."""
        ...

    def removable(self, model) -> Sequence[str]:
        """Terms that a model may do without."""
        ...

    def without(self, model, term: str) -> Any:
        """A model re-fitted without a term."""
        ...


@dataclass(frozen=True)
class Trial:
    """A form of a model to be fitted, with where to start.

    Attributes:
        form: structure; its `effects` are names.
        values: starting values by name.
    """

    form: Any
    values: dict[str, float]


@dataclass
class Scored:
    """A fitted model with its worth.

    Attributes:
        model: as fitted.
        crossed: (N,) squared errors on rows that the fit did not see.
        value: their mean.
    """

    model: Any
    crossed: np.ndarray
    value: float


@dataclass
class Found:
    """What a search ended with.

    Attributes:
        base: the best model without any term.
        path: from the base to the end, one acceptance each.
        final: after the backward check.
        rivals: of each acceptance, the other models that were fitted well.
        without: of the final model, term to the model without it.
    """

    base: Scored
    path: list[Scored]
    final: Scored
    rivals: list[list[Scored]] = field(default_factory=list)
    without: dict[str, Scored] = field(default_factory=dict)


class Search:
    """One search.

    Args:
        space: what may be tried.
        judge: draws blocks of the search's rows.
        fold: (N,) number of each row's fold; rows are in the order of time.
        floor: noise, in the unit of the error.
        run: like `map`, perhaps in parallel.
        tell: called with a line of progress.
        condition: (N,) number of each row's physical condition, see `parts.conditions`; None for one alone.
    """

    def __init__(
        self,
        space,
        judge: Resampler,
        fold,
        floor: float,
        run: Callable = map,
        tell=lambda text: None,
        condition: np.ndarray | None = None,
    ):
        self.space, self.judge, self.fold, self.floor2 = space, judge, fold, floor**2
        self.run, self.tell = run, tell
        self.condition = np.zeros(len(fold), int) if condition is None else condition

    def score(self, model) -> Scored:
        """A model with its worth."""
        crossed = model.crossed(self.fold)
        return Scored(model, crossed, self.judge.value(crossed))

    def fits(self, trials, steps: int, every: int = 1) -> list[Scored]:
        """Fits trials, the best first."""
        out = [self.score(m) for m in self.run(lambda t: self.space.fit(t, steps, every), list(trials)) if m]
        return sorted((s for s in out if np.isfinite(s.value)), key=lambda s: s.value)

    def find(self) -> Found:
        """Runs the search."""
        beam = self._begin()
        base = best = beam[0]
        found = Found(base, [base], base)
        start = lined = base.value - self.floor2
        for _ in range(MOST_TERMS):
            room = best.value - self.floor2
            if room < 0.06 * self.floor2:
                break
            done = [d for d in self._round(beam) if self._improves_out_of_time(best, d)]
            if not done:
                break
            taken = self._accepted(best, done, room, start)
            if taken is None:
                break
            settled = self.score(self.space.settle(taken.model))
            best = settled if settled.value < taken.value else taken
            self.tell(f"found {' + '.join(best.model.form.effects)}: error {best.value**0.5:.3g}")
            found.path.append(best)
            found.rivals.append([d for d in done if d is not taken])
            beam = [best, *(d for d in done if d is not taken)][:BEAM]
            if best.value - self.floor2 < LINE_AGAIN * lined:
                lined = best.value - self.floor2
                best = self._line_again(best, found)
                beam = [best, *(s for s in beam if s is not best)][:BEAM]
        found.final = self.pruned(best, found)
        return found

    def _begin(self) -> list[Scored]:
        """The best bases and lines, the chosen one first."""
        bare = self.fits(self.space.bases(), 12)
        cheap = min(bare, key=lambda s: (s.model.cost, s.value))
        chosen = bare[0] if self._surely(cheap, bare[0], 0.05 * max(cheap.value - self.floor2, 0)) else cheap
        quick = self.fits(self.space.with_lines(chosen.model), 2, 4)
        front = list(self.run(lambda s: self.space.settle_line(s.model), best_of_each(quick, 2)))
        done = best_of_each(sorted([chosen, *map(self.score, front)], key=lambda s: s.value), 1)
        for s in done:
            self.tell(f"trying {' + '.join(s.model.form.effects) or 'the base'}: error {s.value**0.5:.3g}")
        near = done[0].value + 0.02 * max(done[0].value, self.floor2)
        first = min((s for s in done if s.value <= near), key=lambda s: s.model.cost)
        least = set(first.model.form.effects)  # with more, and no better, all would be tried twice
        done = [s for s in done if s.value > near or not least < set(s.model.form.effects)]
        return [first, *(s for s in done if s is not first)][: BEAM - 1] + (
            [chosen] if chosen is not first and chosen not in done[: BEAM - 1] else []
        )

    def _line_again(self, best: Scored, found: Found) -> Scored:
        """The model with another line where that is surely better.

        The line was chosen while most of the error was of what has been found since, and may have stood in
        for it.
        """
        others = self.other_lines(best)
        if not others or not self._surely(best, others[0], WORTH_OF_ROOM * (best.value - self.floor2)):
            return best
        self.tell(f"line {' + '.join(others[0].model.form.effects)}: error {others[0].value ** 0.5:.3g}")
        found.path.append(others[0])
        found.rivals.append([best])
        return others[0]

    def other_lines(self, model: Scored) -> list[Scored]:
        """The most promising models with another line, fitted well, the best first; none at the noise."""
        if model.value < ADEQUATE**2 * self.floor2:
            return []
        quick, now = self.fits(self.space.with_lines(model.model), 2, 4), set(model.model.form.effects)
        others = [s for s in best_of_each(quick, 1) if set(s.model.form.effects) != now]
        front = self.run(lambda s: self.space.settle_line(s.model), others[:OTHER_LINES])
        return sorted(map(self.score, front), key=lambda s: s.value)

    def _round(self, beam: list[Scored]) -> list[Scored]:
        """The best models with one or two terms more, fitted well."""
        trials = []
        for k, s in enumerate(beam):
            trials += self.space.grow(s.model, COARSE if k == 0 else 4, 4 if k == 0 else 2)
        done, seen, fine = self.fits(trials, 5, 2), set(), []
        for s in done:
            key = tuple(sorted(s.model.form.effects))
            if key not in seen and len(fine) < FINE:
                seen.add(key)
                fine.append(s.model)
        done = self.fits([self.space.again(m) for m in fine], 8)
        for s in best_of_each(done, 1):
            self.tell(f"tried {' + '.join(s.model.form.effects)}: error {s.value**0.5:.3g}")
        return done

    def _accepted(self, now: Scored, done: list[Scored], room: float, start: float) -> Scored | None:
        """The simplest of the best, if the error falls for sure and worthwhile."""
        least = max(WORTH_OF_ROOM * room, WORTH_OF_FLOOR * self.floor2, WORTH_OF_START * start)
        alike = [d for d in done if d.value < done[0].value + ALIKE * max(room, 0)]
        alike.sort(key=lambda d: (d.model.cost, d.value))
        rest = [d for d in done if d not in alike]
        for d in (*alike[:3], *rest[:2]):
            if self._surely(now, d, least):
                return d
        return None

    def _improves_out_of_time(self, now: Scored, after: Scored) -> bool:
        """Whether a model errs less than the one it replaces in the last of `AHEAD`, and in all together.

        Blocks dealt at random lie between others that were fitted: there any slow course does well, one of
        time or one of a long memory.
        """
        n, drops = len(self.fold), []
        for begin, end in pairwise((np.array(AHEAD) * n).astype(int)):
            fold = out_of_time(self.condition, begin)
            if (fold[:end] == 0).any():
                drops.append(float((now.model.crossed(fold) - after.model.crossed(fold))[:end].sum()))
        return not drops or min(drops[-1], sum(drops)) > 0

    def is_worth(self, now: Scored, after: Scored) -> bool:
        """Whether a step between models is significant, large enough and improves out of time."""
        least = max(WORTH_OF_ROOM * (now.value - self.floor2), WORTH_OF_FLOOR * self.floor2)
        return self._surely(now, after, least) and self._improves_out_of_time(now, after)

    def _surely(self, before: Scored, after: Scored, least: float) -> bool:
        return before.value - after.value > least and self.judge.surely(before.crossed, after.crossed)

    def pruned(self, best: Scored, found: Found) -> Scored:
        """Takes away what is not needed, one after the other."""
        while True:
            terms = self.space.removable(best.model)
            if not terms:
                return best
            models = self.run(self.space.without, [best.model] * len(terms), terms)
            without = {t: self.score(m) for t, m in zip(terms, models, strict=True)}
            found.without = without
            weakest = min(without, key=lambda t: without[t].value)
            room = without[weakest].value - self.floor2
            if self._surely(without[weakest], best, max(0.02 * room, WORTH_OF_FLOOR * self.floor2)):
                return best
            best = without[weakest]


def best_of_each(scored: list[Scored], most: int) -> list[Scored]:
    """The best few of each structure, in order."""
    count: dict[tuple, int] = {}
    out = []
    for s in scored:
        count[s.model.form.effects] = count.get(s.model.form.effects, 0) + 1
        if count[s.model.form.effects] <= most:
            out.append(s)
    return out


def chosen(scored: Sequence[Scored], value: Callable[[Scored], float], floor2: float) -> Scored:
    """The simplest of those that are as good as the best, by some measure of worth."""
    best = min(map(value, scored))
    alike = [s for s in scored if value(s) <= best + max(2 * ALIKE * (best - floor2), 0.01 * floor2)]
    return min(alike, key=lambda s: (s.model.cost, value(s)))
