"""The search, on linear models whose answer is known, and on models whose errors are written down."""

from dataclasses import dataclass, field
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from lerobot_pneutac.diagnosis import thresholds
from lerobot_pneutac.diagnosis.bootstrap import BlockBootstrap
from lerobot_pneutac.diagnosis.search import Scored, Search, chosen

UNITS, SIZE = 40, 25
N = UNITS * SIZE
UNIT = np.repeat(np.arange(UNITS), SIZE)
FOLD = UNIT % 5
JUDGE = BlockBootstrap(np.ones(N, bool), UNIT, np.zeros(UNITS, int), 0)
NOISE = 0.3


@dataclass(frozen=True)
class Linear:
    """Least squares on a constant and some columns."""

    effects: tuple
    X: np.ndarray
    y: np.ndarray
    cost: int

    @property
    def structure(self):
        return SimpleNamespace(effects=self.effects)

    def cv_squared(self, fold):
        out = np.zeros(N)
        for k in range(fold.max() + 1):
            w = np.linalg.lstsq(self.X[fold != k], self.y[fold != k], rcond=None)[0]
            out[fold == k] = (self.y - self.X @ w)[fold == k] ** 2
        return out


@dataclass
class LinearSpace:
    """Columns that may be added to a constant; `costs` of those that stand for several parameters."""

    columns: dict
    y: np.ndarray
    costs: dict = field(default_factory=dict)

    def bases(self):
        return [()]

    def begun(self, model):
        return model

    def with_actuations(self, model, starts=True):
        return []

    def bare_starts(self, model):
        return []

    def fit(self, trial, steps=0, every=1):
        X = np.stack([np.ones(N), *(self.columns[e] for e in trial)], 1)
        return Linear(trial, X, self.y, 1 + sum(self.costs.get(e, 1) for e in trial))

    def again(self, model):
        return model.effects

    def refine(self, model):
        return model

    def removable(self, model):
        return list(model.effects)

    def without(self, model, term):
        return self.fit(tuple(e for e in model.effects if e != term))

    def grow(self, model, most, pairs):
        rest = [e for e in self.columns if e not in model.effects]
        found = sorted(((e,) for e in rest), key=lambda new: self._left(model, new))[:most]
        both = sorted(combinations(rest, 2), key=lambda new: self._left(model, new))[:pairs]
        return [(*model.effects, *new) for new in (*found, *both)]

    def _left(self, model, new):
        fitted = self.fit((*model.effects, *new))
        return float((fitted.y - fitted.X @ np.linalg.lstsq(fitted.X, fitted.y, rcond=None)[0]).var())


def smooth(seed):
    rng = np.random.default_rng(seed)
    return np.interp(np.arange(N), np.linspace(0, N - 1, 120), rng.normal(size=120))


def toy(hidden, seed=0, columns=None, costs=None):
    columns = columns or {c: smooth([seed, i]) for i, c in enumerate("ABCDEFGH")}
    y = sum(size * columns[c] for c, size in hidden.items())
    y = y + NOISE * np.random.default_rng([seed, 99]).normal(size=N)
    return Search(LinearSpace(columns, y, costs or {}), JUDGE, FOLD, NOISE)


@pytest.mark.parametrize("hidden", [{"B": 1.0}, {"B": -0.4, "F": 1.5}, {"A": 1.0, "D": 0.7, "H": -0.5}])
def test_exactly_the_hidden_terms_are_found(hidden):
    found = toy(hidden).find()
    assert set(found.final.model.effects) == set(hidden)
    assert found.base.model.effects == () and found.path[0] is found.base
    assert found.final.value == pytest.approx(NOISE**2, rel=0.15)
    assert set(found.without) == set(hidden) and len(found.rivals) == len(found.path) - 1
    assert all(s.value > found.final.value for s in found.without.values())


def test_nothing_is_found_where_nothing_is_missing():
    for seed in range(10):
        assert toy({}, seed).find().final.model.effects == ()


def test_a_pair_is_found_of_which_each_alone_is_worth_nothing(monkeypatch):
    """Two columns that are nearly alike, and what is seen is their difference."""
    columns = {c: smooth([7, i]) for i, c in enumerate("ABCDEF")}
    columns["B"] = columns["A"] + 0.15 * columns["B"]
    columns["A"] = columns["A"] - 0.02 * columns["C"]
    hidden = {"A": -8.0, "B": 8.0}
    assert set(toy(hidden, columns=columns).find().final.model.effects) == {"A", "B"}
    grow = LinearSpace.grow
    monkeypatch.setattr(LinearSpace, "grow", lambda self, model, most, pairs: grow(self, model, most, 0))
    first = toy(hidden, columns=columns).find().path[1:2]
    assert not first or first[0].value > 0.5, "alone neither does"


def test_of_confounded_terms_the_simpler_is_taken():
    """R does as well as A, within noise, by three parameters."""
    columns = {c: smooth([3, i]) for i, c in enumerate("ABC")}
    columns["R"] = columns["A"] + 0.02 * columns["B"]
    found = toy({"R": 1.0}, columns=columns, costs={"R": 3}).find()
    assert found.final.model.effects == ("A",)
    assert ("R",) in {s.model.effects for s in found.rivals[0]}
    columns["R"] = columns["A"] + 0.5 * smooth(8)
    assert toy({"R": 1.0}, columns=columns, costs={"R": 3}).find().final.model.effects == ("R",)


# ---------------------------------------------------------------- errors that are written down

FLOOR = 0.5  # its square is a quarter


class Written:
    """A model with this mean square error.

    `patchy`: none of it in four of the forty blocks. `ahead`: of rows after all that were fitted.
    """

    def __init__(self, effects, value, cost=None, patchy=False, ahead=None):
        self.effects, self.cost = effects, len(effects) + 1 if cost is None else cost
        self.ahead = value if ahead is None else ahead
        self.structure = SimpleNamespace(effects=effects)
        self.squared = np.where(UNIT >= UNITS - 4, 0.0, value / 0.9) if patchy else np.full(N, float(value))

    def cv_squared(self, fold):
        return self.squared if np.min(fold) >= 0 else np.where(fold < 0, 0.0, float(self.ahead))


class Table:
    """A space whose fits are rows: value, or a dict of `Written`'s arguments. Terms are letters.

    A row's name may begin with "!", what settles to it, or "-", what is left of a model without a term.
    """

    def __init__(self, rows, bases=("",), lines=(), kept="", bare=()):
        self.rows, self.kept, self.begins, self.lines, self.bare = rows, kept, bases, lines, bare
        self.asked, self.fitted = [], []

    def begun(self, model):
        return model

    def fit(self, trial, steps=0, every=None):
        self.fitted.append((tuple(trial), steps, every))
        row = self.rows.get("".join(sorted(trial)))
        return None if row is None else written(tuple(trial), row)

    def bases(self):
        return [tuple(b) for b in self.begins]

    def bare_starts(self, model):
        return [tuple(b) for b in self.bare]

    def with_actuations(self, model, starts=True):
        rest = [e for e in model.effects if e not in "".join(self.lines)]
        return [(*line, *rest) for line in self.lines]

    def grow(self, model, most, pairs):
        self.asked.append((model.effects, most, pairs))
        terms = sorted(set("".join(self.rows)) - set(model.effects) - set("".join(self.lines) + "!-"))
        return [(*model.effects, *new) for k in (1, 2) for new in combinations(terms, k)]

    def again(self, model):
        return model.effects

    def refine(self, model):
        row = self.rows.get("!" + "".join(sorted(model.effects)))
        return model if row is None else written(model.effects, row)

    refine_actuation = refine

    def removable(self, model):
        return [e for e in model.effects if e not in self.kept]

    def without(self, model, term):
        left = tuple(e for e in model.effects if e != term)
        row = self.rows.get("-" + "".join(sorted(left)))
        return written(left, row) if row else self.fit(left) or Written(left, 99.0)


def written(effects, row):
    return Written(effects, **(row if isinstance(row, dict) else {"value": row}))


def find(rows, report=lambda text: None, **options):
    table = Table(rows, **options)
    return table, Search(table, JUDGE, FOLD, FLOOR, report=report).find()


def test_the_thresholds_are_those_of_the_manual():
    assert (thresholds.MOST_TERMS, thresholds.BEAM, thresholds.COARSE, thresholds.FINE) == (6, 3, 12, 6)
    assert (thresholds.WORTH_OF_EXCESS, thresholds.WORTH_OF_NOISE) == (0.04, 0.03)
    assert (thresholds.WORTH_OF_START, thresholds.EQUAL) == (0.005, 0.01)


@pytest.mark.parametrize(
    ("start", "after", "taken"),
    [(4.25, 4.085, True), (4.25, 4.095, False), (0.285, 0.259, True), (0.285, 0.261, False)],
)
def test_a_fall_must_be_worth_a_share_of_the_room_or_of_the_noise(start, after, taken):
    _, found = find({"": start, "A": after})
    assert (found.final.model.effects == ("A",)) == taken


def test_late_falls_must_be_worth_a_share_of_the_start():
    rows = {"": 8.25, "A": 0.75, "B": 8.25}  # 0.04 is needed of a start's excess of 8
    assert find(rows | {"AB": 0.711})[1].final.model.effects == ("A",)
    assert find(rows | {"AB": 0.709})[1].final.model.effects == ("A", "B")


def test_a_fall_that_is_all_in_a_few_blocks_is_not_sure():
    assert find({"": 1.25, "A": {"value": 1.13, "patchy": True}})[1].final.model.effects == ()
    assert find({"": 1.25, "A": 1.13})[1].final.model.effects == ("A",)


@pytest.mark.parametrize(("start", "asked"), [(0.2649, False), (0.2651, True)])
def test_nothing_is_tried_where_next_to_nothing_is_left(start, asked):
    table, _ = find({"": start, "A": start})
    assert bool(table.asked) == asked


def test_among_alike_the_simplest_is_accepted():
    """Alike within 0.01 of a excess of 4."""
    rows = {"": 4.25, "A": {"value": 1.0, "cost": 6}, "B": {"value": 1.03, "cost": 2}}
    assert find(rows)[1].final.model.effects == ("B",)
    assert find(rows | {"B": {"value": 1.05, "cost": 2}})[1].final.model.effects == ("A",)
    small = {
        "": 0.5,
        "A": {"value": 0.3, "cost": 6},
        "B": {"value": 0.305, "cost": 2},
    }  # of a excess of a quarter
    assert find(small)[1].final.model.effects == ("A",)


@pytest.mark.parametrize(
    ("final", "without", "kept"),
    [
        (0.26, 0.284, False),  # 0.1 of the noise's quarter
        (0.26, 0.286, True),
        (0.26, {"value": 0.29, "patchy": True}, False),  # worse, but not significantly
    ],
)
def test_what_others_made_needless_is_pruned_and_the_rest_weighed_anew(final, without, kept):
    """A stood for B and C, which no single step reaches."""
    rows = {"": 8.25, "A": 2.25, "B": 3.25, "C": 3.25, "AB": 1.25, "AC": 2.0, "ABC": final, "-BC": without}
    _, found = find(rows)
    assert found.path[-1].model.effects == ("A", "B", "C")
    assert set(found.final.model.effects) == set("ABC" if kept else "BC") == set(found.without)
    if not kept:
        assert found.without["B"].value == found.without["C"].value == 3.25


def test_what_must_be_kept_is_not_taken_away():
    rows = {"S": 4.25, "AS": 1.0}
    _, found = find(rows, bases=("S",), kept="S")
    assert found.base.model.effects == ("S",) and set(found.final.model.effects) == {"A", "S"}
    assert set(found.without) == {"A"}
    assert find(rows | {"A": 1.0}, bases=("S",))[1].final.model.effects == ("A",)


# ---------------------------------------------------------------- forward in time


def test_an_addition_must_foretell_what_comes_after():
    """Between blocks that were fitted any slow course does well; what comes after tells it apart."""
    t = np.arange(N) / N
    columns = {"T": np.exp(-t / 0.4), "A": smooth(5)}

    def found(course):
        y = course + NOISE * np.random.default_rng(9).normal(size=N)
        return Search(LinearSpace(columns, y), JUDGE, FOLD, NOISE).find().final.model.effects

    assert found(2 * columns["T"]) == ("T",)
    assert found(np.where(t < 0.85, 2 * columns["T"], 1.0)) == ()


def test_of_others_the_best_is_taken_where_an_addition_does_not_foretell():
    rows = {"": 4.25, "T": {"value": 1.0, "ahead": 9.0}, "A": 2.0, "AT": {"value": 0.9, "ahead": 9.0}}
    _, found = find(rows)
    assert found.final.model.effects == ("A",)
    assert not any("T" in s.model.effects for others in found.rivals for s in others)
    assert find(rows | {"T": 1.0})[1].final.model.effects == ("T",)


# ---------------------------------------------------------------- where it begins


def test_the_cheaper_base_stays_unless_the_other_is_surely_better():
    # 0.05 of a excess of 4 is 0.2, of a excess of 0.5 it is 0.025
    for start, value, first in ((4.25, 4.06, "S"), (4.25, 4.04, "T"), (0.75, 0.73, "S"), (0.75, 0.72, "T")):
        rows = {"S": {"value": start, "cost": 3}, "T": {"value": value, "cost": 9}}
        _, found = find(rows, bases=("S", "T"), kept="ST")
        assert found.base.model.effects == (first,)


@pytest.mark.parametrize(("value", "first"), [(2.03, "M"), (2.05, "L")])
def test_of_lines_within_two_hundredths_the_simplest_is_taken(value, first):
    rows = {"": 4.25, "L": {"value": 2.0, "cost": 5}, "M": {"value": value, "cost": 2}}
    _, found = find(rows, lines=("L", "M"))
    assert found.base.model.effects == (first,)


def test_what_does_not_fit_or_is_not_finite_is_left_out():
    space = Table({"A": 2.0, "B": np.nan, "C": 1.0})
    scored = Search(space, JUDGE, FOLD, FLOOR).fits([("A",), ("B",), ("C",), ("D",)], 1)
    assert [s.model.effects for s in scored] == [("C",), ("A",)]


def test_chosen_is_the_simplest_of_those_that_are_as_good():
    a, b, c = (Scored(SimpleNamespace(cost=k), np.zeros(1), v) for k, v in ((5, 4.25), (3, 4.32), (1, 4.335)))
    assert chosen([a, b, c], lambda s: s.value, 0.25) is b  # alike within 0.08
    assert chosen([a, c], lambda s: s.value, 0.25) is a
    a, b, c = (
        Scored(SimpleNamespace(cost=k), np.zeros(1), v) for k, v in ((5, 0.25), (3, 0.252), (1, 0.254))
    )
    assert chosen([a, b, c], lambda s: s.value, 0.25) is b  # of nothing avoidable, within 0.0025
