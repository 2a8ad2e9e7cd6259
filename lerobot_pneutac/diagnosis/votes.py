"""How stable a finding is: the last choice of each round, made again on other splits of the same blocks."""

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from lerobot_pneutac.diagnosis.search import Found, chosen

VOTES = 7
KEPT = 0.75  # of the blocks, in each vote


def deal_folds(unit: np.ndarray, folds: int, seed: int) -> np.ndarray:
    """(N,) fold of each row: whole units, dealt at random."""
    index = np.unique(unit, return_inverse=True)[1]
    order = np.random.default_rng([seed, 5]).permutation(index.max() + 1)
    return (order % folds)[index]


def chosen_in(
    found: Found, unit: np.ndarray, floor: float, kind: Callable[[str], str], votes: int = VOTES
) -> dict[str, float]:
    """Share of the votes in which each term of the final model, or another of its kind, came.

    Each vote leaves out a quarter of the blocks and deals the others anew into five folds; at each acceptance
    it chooses among the models that were fitted well there.

    Args:
        found: by a search.
        unit: (N,) block of each row.
        floor: noise.
        kind: of a term.
        votes: number of splits.
    """
    count: Counter[str] = Counter()
    index = np.unique(unit, return_inverse=True)[1]
    for seed in range(votes):
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
    return {t: count[t] / votes for t in found.final.model.form.effects}


def _winner(scored: Sequence, fold: np.ndarray, floor: float):
    rows = fold >= 0
    value = {id(s): float(s.model.crossed(fold)[rows].mean()) for s in scored}
    return chosen(scored, lambda s: value[id(s)], floor**2)
