"""How stable a finding is: other splits of the same blocks, and other terms that would have done as well."""

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from lerobot_pneutac.diagnosis.model import FittedModel
from lerobot_pneutac.diagnosis.result import Rival
from lerobot_pneutac.diagnosis.search import Found, Scored, chosen

VOTES = 7
KEPT = 0.75  # of the blocks, in each vote
AS_GOOD = 0.02  # of the avoidable mean square error: models that differ by less are rivals
MOST_RIVALS = 3


def deal_folds(unit: np.ndarray, folds: int, seed: int) -> np.ndarray:
    """(N,) fold of each row: whole units, dealt at random."""
    index = np.unique(unit, return_inverse=True)[1]
    order = np.random.default_rng([seed, 5]).permutation(index.max() + 1)
    return (order % folds)[index]


def chosen_in(found: Found, unit: np.ndarray, floor: float, kind: Callable[[str], str]) -> dict[str, float]:
    """Share of the votes in which each term of the final model, or another of its kind, came.

    Each vote leaves out a quarter of the blocks and deals the others anew into five folds; at each acceptance
    it chooses among the models that were fitted well there.

    Args:
        found: by a search.
        unit: (N,) block of each row.
        floor: noise.
        kind: of a term.
    """
    count: Counter[str] = Counter()
    index = np.unique(unit, return_inverse=True)[1]
    for seed in range(VOTES):
        rng = np.random.default_rng([seed, 9])
        keep = rng.permutation(index.max() + 1) < KEPT * (index.max() + 1)
        fold = np.where(keep[index], deal_folds(unit, 5, seed), -1)
        terms = set(found.final.model.form.effects)
        for taken, rivals in zip(found.path[1:], found.rivals, strict=True):
            winner = _winner([taken, *rivals], fold, floor)
            if winner is not taken:
                kinds = {kind(e) for e in winner.model.form.effects}
                terms = {t for t in terms if kind(t) in kinds}
                break
        count.update(terms)
    return {t: count[t] / VOTES for t in found.final.model.form.effects}


def rivals(
    found: Found,
    floor: float,
    terms: Sequence[str],
    kind: Callable[[str], str],
    fitted: Callable[[Scored], FittedModel],
) -> list[Rival]:
    """Models as good where a term was accepted, with one of another kind in its place; the first few.

    Args:
        found: by a search.
        floor: noise.
        terms: that count as found.
        kind: of a term.
        fitted: a model of the search on all samples.
    """
    out = []
    for taken, others, before in zip(found.path[1:], found.rivals, found.path, strict=False):
        room = max(before.value - floor**2, 0.0)
        new = [e for e in taken.model.form.effects if e not in before.model.form.effects]
        for s in others:
            instead = [e for e in s.model.form.effects if e not in taken.model.form.effects]
            as_good = s.value - taken.value < AS_GOOD * room and len(new) == len(instead) == 1
            if as_good and new[0] in terms and kind(instead[0]) != kind(new[0]) and len(out) < MOST_RIVALS:
                share = s.value / max(taken.value, 1e-30) - 1
                out.append(Rival(new[0], instead[0], share, fitted(s), fitted(taken)))
    return out


def _winner(scored: Sequence, fold: np.ndarray, floor: float):
    rows = fold >= 0
    value = {id(s): float(s.model.crossed(fold)[rows].mean()) for s in scored}
    return chosen(scored, lambda s: value[id(s)], floor**2)
