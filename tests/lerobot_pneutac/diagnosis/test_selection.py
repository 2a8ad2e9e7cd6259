"""Every rule of the selection, on fits whose errors are written down: one error for all samples of a part."""

import numpy as np
import pytest

from lerobot_pneutac.diagnosis import selection
from lerobot_pneutac.diagnosis.bootstrap import Resampler
from lerobot_pneutac.diagnosis.fits import FittedModel
from lerobot_pneutac.diagnosis.parts import Parts
from lerobot_pneutac.diagnosis.selection import accepted, rank, select, worth
from lerobot_pneutac.diagnosis.steps import Steps
from pneutac_sim.twin import Twin

TWIN = Twin("finger", 110.0)  # stands there; nothing asks for it
FLOOR = 0.5  # its square is a quarter
UNITS, SIZE = 40, 10
N = UNITS * SIZE
UNIT = np.repeat(np.arange(UNITS), SIZE)
TRAIN = UNIT < UNITS // 2
PARTS = Parts(TRAIN, ~TRAIN, ~TRAIN, UNIT, np.zeros(UNITS, int))
JUDGE = Resampler(PARTS.validation, UNIT, PARTS.stratum, 0)


def model(effects, validation, train=None, count=2, patchy=False):
    """A fit with these mean square errors. `patchy`: validation's is all in two of its twenty blocks."""
    squared = np.where(TRAIN, validation if train is None else train, validation).astype(float)
    if patchy:
        squared[~TRAIN] = np.where(UNIT >= UNITS - 2, 10 * validation, 0.0)[~TRAIN]
    sign = np.where(np.arange(N) % 2, 1.0, -1.0)  # neighbours do not go together: as many samples as rows
    residual = np.sqrt(squared) * sign
    return FittedModel(tuple(sorted(effects)), residual[:, None], count, TWIN)


class Table:
    """Fits as written down.

    Attributes:
        calls: (sets, effects of the start) of each call.
        asked: arguments of `promising`.
    """

    def __init__(self, rows):
        self.rows = {frozenset(k): v for k, v in rows.items()}
        self.calls, self.asked, self.lost = [], [], ()

    def fit_all(self, effects, start=None):
        effects = list(effects)
        self.calls.append((effects, start and start.effects))
        found = []
        for names in effects:
            row = self.rows[frozenset(names)]
            row = row(start) if callable(row) else row
            found.append(model(names, **(row if isinstance(row, dict) else {"validation": row})))
        return found[: len(found) - (len(self.calls) in self.lost)]

    def promising(self, fit, candidates, least):
        self.asked.append((fit.effects, list(candidates), least))
        return candidates


def run(rows, candidates="ABC", start=(), steps=None, floor=FLOOR):
    table = Table(rows)
    return table, select(table, start, list(candidates), PARTS, floor, 0, steps)


def alone(**others):
    """Fits of A, B and C alone; those not given bring nothing."""
    return {"": 4.25} | {c: others.get(c, 4.25) for c in "ABC"}


# ---------------------------------------------------------------- what is worth it


def test_the_thresholds_are_those_of_the_manual():
    assert (selection.MAX_EFFECTS, selection.TRIES) == (5, 4)
    assert (selection.WORTH_OF_ROOM, selection.WORTH_OF_BASE) == (0.04, 0.03)
    assert (selection.WORTH_OF_FLOOR, selection.ALIKE) == (0.02, 0.02)


@pytest.mark.parametrize(
    ("base", "floor", "least"), [(4.25, 0.5, 0.12), (0.26, 0.5, 0.005), (4.0, 0.0, 0.12), (0.1, 0.5, 0.005)]
)
def test_worth_is_a_share_of_what_can_be_avoided_or_of_the_noise(base, floor, least):
    assert worth(model("", base), floor, JUDGE) == pytest.approx(least)


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        (4.25, 4.0, (True, True)),
        (4.25, 4.0875, (True, True)),  # 0.1625; 0.16 is needed of a room of 4
        (4.25, 4.095, (False, False)),
        (2.25, 2.12, (True, True)),  # 0.13; 0.12 is needed of the start's room
        (2.25, 2.15, (False, False)),
        (4.25, 5.0, (False, False)),
    ],
)
def test_a_fall_is_accepted_where_it_is_worth_it(before, after, expected):
    assert accepted(model("", before), model("A", after), model("", 4.25), FLOOR, JUDGE) == expected


def test_a_fall_that_two_blocks_undo_is_not_sure():
    base = model("", 4.25)
    assert accepted(base, model("A", 4.05, patchy=True), base, FLOOR, JUDGE) == (False, True)


# ---------------------------------------------------------------- forward


@pytest.mark.parametrize(("base", "tried"), [(0.2549, False), (0.2551, True)])
def test_nothing_is_tried_where_nothing_could_be_worth_it(base, tried):
    table, found = run({"": base, "A": base, "B": base, "C": base})
    assert (len(table.calls) > 1) == tried and found.selected == [] and bool(found.first) == tried


def test_the_ladder_its_fits_and_what_is_told():
    rows = alone(A=2.25, B=3.25) | {"AB": 1.25, "AC": 2.25, "ABC": 1.25, "BC": 3.25}
    told = []
    table, found = run(rows, steps=Steps(lambda text, done, total: told.append((text, total))))
    assert found.added == ["A", "B"] and found.selected == ["A", "B"]
    assert [f.effects for f in found.path] == [(), ("A",), ("A", "B")] and found.final is found.path[-1]
    assert sorted(found.first) == ["A", "B", "C"] and found.first["A"].effects == ("A",)
    assert list(found.beside) == ["C"] and found.beside["C"].effects == ("A", "B", "C")
    assert table.calls == [
        ([()], None),
        ([("A",), ("B",), ("C",)], ()),
        ([("A", "B"), ("A", "C")], ("A",)),
        ([("A", "B", "C")], ("A", "B")),
        ([("B",), ("A",)], ("A", "B")),
    ]
    assert table.asked == [(("A",), ["B", "C"], 0.01), (("A", "B"), ["C"], 0.01)]
    assert told == [
        ("the start", 1),
        ("each candidate alone", 4),
        ("each candidate beside A", 6),
        ("each candidate beside A, B", 7),
        ("each selected effect taken out again", 9),
    ]
    assert found.importance == pytest.approx({"A": 2.0, "B": 1.0}) and found.without["A"].effects == ("B",)


def test_no_more_than_five():
    names = "ABCDEFG"
    rows = {}
    for k in range(2 ** len(names)):
        chosen = frozenset(c for i, c in enumerate(names) if k >> i & 1)
        rows[chosen] = 8.25 - len(chosen)
    _, found = run(rows, names)
    assert len(found.added) == len(found.selected) == 5


def test_effects_of_the_start_stay_and_are_no_finding():
    rows = {"S": 4.25, "SA": 2.25, "SB": 4.25, "SAB": 2.25}
    table, found = run(rows, "AB", ("S",))
    assert found.selected == ["A"] and found.final.effects == ("A", "S")
    assert [f.effects for f in found.path] == [("S",), ("A", "S")]
    assert len(table.calls) == 4, "the ladder is fitted once"


def test_a_fitter_that_loses_a_fit_is_an_error():
    for lost in (2, 4):
        table = Table(alone(A=2.25) | {"AB": 2.25, "AC": 2.25})
        table.lost = (lost,)
        with pytest.raises(ValueError, match="zip"):
            select(table, (), list("ABC"), PARTS, FLOOR, 0)


# ---------------------------------------------------------------- which of them


def test_the_fourth_by_bic_is_tried_and_the_fifth_is_not():
    for place, expected in ((4, ["E"]), (5, [])):
        rows = {"": 4.25} | {c: {"validation": 4.25, "train": 1.0 + 0.1 * i} for i, c in enumerate("ABCD")}
        rows["E"] = {"validation": 1.25, "train": 1.0 + 0.1 * place - 0.15}
        rows |= {f"E{c}": 1.25 for c in "ABCD"}
        assert run(rows, "ABCDE")[1].selected == expected


def test_what_ranks_higher_and_does_as_well_explains_better_than_what_is_sure():
    rows = alone(
        A={"validation": 2.2, "train": 1.0, "patchy": True},
        B={"validation": 2.25, "train": 2.0},
        C={"validation": 3.0, "train": 0.9, "patchy": True},
    )
    rows |= {"AB": 2.2, "AC": 2.2, "BC": 2.2}
    assert run(rows)[1].added == ["A"]
    assert run(rows | {"A": {"validation": 2.35, "train": 1.0, "patchy": True}})[1].added == ["B"]


@pytest.mark.parametrize(("validation", "chosen"), [(1.329, "B"), (1.331, "A")])
def test_of_those_that_are_alike_the_simplest_is_taken(validation, chosen):
    """Alike within 0.02 of a room of 4."""
    rows = alone(
        A={"validation": 1.25, "train": 1.0, "count": 5},
        B={"validation": validation, "train": 1.2, "count": 3},
    )
    rows |= {"AB": 1.25, "AC": 1.25, "BC": 1.25}
    assert run(rows)[1].added == [chosen]


@pytest.mark.parametrize(("validation", "near"), [(2.22, ["A"]), (2.27, [])])
def test_a_near_miss_would_explain_most_but_not_for_sure(validation, near):
    table, found = run(alone(A={"validation": validation, "patchy": True}))
    assert found.near_miss == near and found.selected == []
    assert sorted(found.beside) == ["A", "B", "C"]


def test_a_near_miss_is_one_of_the_start_alone():
    rows = alone(B=2.25) | {"AB": {"validation": 1.1, "patchy": True}, "BC": 2.25}
    assert accepted(model("B", 2.25), model("AB", **rows["AB"]), model("", 4.25), FLOOR, JUDGE) == (
        False,
        True,
    )
    _, found = run(rows | {"ABC": 1.1})
    assert found.added == ["B"] and found.near_miss == []


def test_a_fall_that_is_worth_nothing_is_no_near_miss():
    """More than half of a room that is next to nothing."""
    assert run({"": 0.2575, "A": 0.253, "B": 0.2575, "C": 0.2575})[1].near_miss == []


# ---------------------------------------------------------------- backward


def test_what_the_others_made_needless_goes_and_the_ladder_is_built_anew():
    """A stood for B and C, which came after it."""
    rows = {"": 4.25, "A": 2.25, "B": 3.25, "C": 3.25, "AB": 1.25, "AC": 2.0, "BC": 0.45, "ABC": 0.45}
    table, found = run(rows)
    assert found.selected in (["B", "C"], ["C", "B"]) and found.added == ["B", "C"]
    assert [f.effects for f in found.path] == [(), ("B",), ("B", "C")]
    assert found.importance == pytest.approx({"B": 2.8, "C": 2.8}) and found.final.effects == ("B", "C")
    assert table.calls[-1] == ([(), ("B",), ("B", "C")], ("B", "C"))


def test_with_effects_of_the_start_the_ladder_begins_with_them():
    rows = {"": 4.25, "A": 2.25, "B": 3.25, "C": 3.25, "AB": 1.25, "AC": 2.0, "BC": 0.45, "ABC": 0.45}
    table, found = run({f"S{k}": v for k, v in rows.items()}, "ABC", ("S",))
    assert [f.effects for f in found.path] == [("S",), ("B", "S"), ("B", "C", "S")]
    assert found.added == ["B", "C"]


def test_of_two_that_are_needless_the_less_important_goes():
    """Each of A and B does without the other beside C; taking A out costs less."""
    rows = {"": 8.25, "A": 3.25, "B": 6.25, "C": 6.25, "AB": 2.25, "AC": 2.5, "ABC": 0.48}
    rows["BC"] = lambda start: {"validation": 0.49 if start and len(start.effects) == 3 else 2.5}
    rows["AC"] = lambda start: {"validation": 0.52 if start and len(start.effects) == 3 else 2.5}
    _, found = run(rows)
    assert found.added == ["B", "C"] and found.final.effects == ("B", "C")


def test_of_two_one_goes():
    rows = {"": 4.25, "A": 2.25, "B": 0.5, "C": 4.25, "AB": 0.5, "AC": 2.25, "BC": 0.5}
    rows["B"] = lambda start: {"validation": 0.5 if start and "A" in start.effects else 4.25}
    _, found = run(rows | {"AB": 0.45, "ABC": 0.45})
    assert found.selected == ["B"] and found.importance.keys() == {"B"}


def test_the_last_one_stays():
    """Also where its absence, fitted from another start, turns out as good."""
    rows = alone(A=2.25) | {"AB": 2.25, "AC": 2.25}
    rows[""] = lambda start: {"validation": 2.26 if start else 4.25}
    _, found = run(rows)
    assert found.selected == ["A"] and found.importance["A"] == pytest.approx(0.01)


# ---------------------------------------------------------------- ranking


def test_the_rank_counts_independent_samples_by_the_best_fit():
    """With few of them a parameter weighs more: the worst fit, whose errors go together, would say so."""
    worst = model("W", 9.0)
    worst.residual = np.abs(worst.residual) * np.where(UNIT % 4 < 2, 1.0, -1.0)[:, None]
    fits = {"W": worst, "Y": model("Y", 1.3, count=2), "X": model("X", 1.0, count=10)}
    assert worst.independent(TRAIN) < 20 < 150 < fits["X"].independent(TRAIN)
    assert rank(fits, PARTS, FLOOR) == ["X", "Y", "W"]
    assert rank({}, PARTS, FLOOR) == []
