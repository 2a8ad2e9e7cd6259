"""How stable a finding is, on models whose errors in each block are written down."""

from types import SimpleNamespace

import numpy as np

from lerobot_pneutac.diagnosis.search import Found, Scored, chosen_in, deal_folds
from lerobot_pneutac.diagnosis.thresholds import VOTES

UNITS, SIZE = 40, 10
UNIT = np.repeat(np.arange(UNITS), SIZE) + 100
N = UNITS * SIZE
FLOOR = 0.1


def scored(effects, errors, cost=None):
    """A model with these squared errors, one for all or (units,)."""
    cv_squared = np.repeat(np.broadcast_to(np.asarray(errors, float), UNITS), SIZE)
    model = SimpleNamespace(
        structure=SimpleNamespace(effects=effects),
        cost=len(effects) if cost is None else cost,
        cv_squared=lambda fold: np.where(fold >= 0, cv_squared, 0.0),
    )
    return Scored(model, cv_squared, float(cv_squared.mean()))


def found(taken, *rivals):
    base = scored((), 4.0)
    return Found(base, [base, taken], taken, [list(rivals)])


def votes(of, kind=lambda e: e):
    return chosen_in(of, UNIT, FLOOR, kind)


def test_folds_are_whole_units_dealt_evenly_and_anew_with_each_seed():
    fold = deal_folds(UNIT, 5, 3)
    assert all(len(set(fold[u == UNIT])) == 1 for u in np.unique(UNIT))
    assert np.bincount(fold).tolist() == [N // 5] * 5
    np.testing.assert_array_equal(fold, deal_folds(UNIT, 5, 3))
    assert not np.array_equal(fold, deal_folds(UNIT, 5, 4))


def test_what_is_best_everywhere_is_chosen_always():
    assert votes(found(scored(("A",), 1.0), scored(("B",), 2.0))) == {"A": 1.0}


def test_what_rests_on_a_few_blocks_is_chosen_where_these_are_drawn():
    lucky = np.full(UNITS, 1.5)
    lucky[7] = 0.0
    rival = np.full(UNITS, 1.5)
    rival[8] = 0.0
    share = votes(found(scored(("A",), lucky), scored(("B",), rival)))["A"]
    assert 0 < share < 1 and share * VOTES == round(share * VOTES)


def test_another_of_the_same_kind_is_a_vote_for_it():
    of = found(scored(("lag",), 2.0), scored(("springpot",), 1.0))
    assert votes(of) == {"lag": 0.0}
    assert votes(of, lambda e: "creep") == {"lag": 1.0}


def test_after_another_choice_only_what_both_have_stays():
    base, first = scored((), 4.0), scored(("A",), 2.0)
    second = scored(("A", "B"), 1.0)
    rival = scored(("A", "C"), 0.5)
    of = Found(base, [base, first, second], second, [[], [rival]])
    assert votes(of) == {"A": 1.0, "B": 0.0}
    of.rivals = [[scored(("C",), 1.0)], []]
    assert votes(of) == {"A": 0.0, "B": 0.0}


def test_the_simpler_of_equals_is_chosen():
    assert votes(found(scored(("A",), 1.0), scored(("B",), 0.999, cost=4))) == {"A": 1.0}
    assert votes(found(scored(("A",), 1.0, cost=4), scored(("B",), 1.001))) == {"A": 0.0}
