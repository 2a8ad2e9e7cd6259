"""Rivals: effects that explain the recording as well as the one that was chosen, as far as can be told."""

from dataclasses import dataclass

import numpy as np

from lerobot_pneutac.diagnosis.bootstrap import Resampler
from lerobot_pneutac.diagnosis.fits import FittedModel
from lerobot_pneutac.diagnosis.parts import Parts
from lerobot_pneutac.diagnosis.selection import ALIKE, Selection, accepted, rank
from lerobot_pneutac.diagnosis.steps import Steps

MOST_TRIED = 5
CORRELATED = 0.95


@dataclass
class Rival:
    """An effect that could stand in the place of a selected one.

    Attributes:
        effect: the selected one.
        rival: the other.
        difference: held-out mean square error of the rival minus that of the choice, over the choice's.
        fit: the model with the rival instead.
        winner: the model that was chosen.
    """

    effect: str
    rival: str
    difference: float
    fit: FittedModel
    winner: FittedModel


def find_rivals(
    fitter, found: Selection, candidates: list[str], parts: Parts, floor: float, seed: int,
    steps: Steps,
) -> tuple[list[Rival], list[tuple[str, str, float]]]:  # fmt: skip
    """Names every candidate whose held-out difference from the winner includes zero or does not matter.

    Args:
        fitter: for more than one selected effect, fits the exchanged sets; None where that is not needed.
        found: what selection found.
        candidates: effects that were tried.
        parts: training, validation, test.
        floor: noise floor.
        seed: of the bootstrap.
        steps: counts the fits.

    Returns:
        Rivals, the closest first, and pairs of effects with correlated parameters (the second look).
    """
    judge = Resampler(parts.heldout, parts.unit, parts.stratum, seed + 2)
    rivals, pairs = [], []
    for effect, without in found.without.items():
        room = judge.value(without.squared) - floor**2
        fits = found.first if len(found.without) == 1 else {}
        if not fits and fitter is not None:
            others = [c for c in rank(found.first, parts, floor) if c not in found.final.effects][:MOST_TRIED]
            steps.expect(f"rivals of {effect}", len(others))
            sets = [tuple(sorted({*without.effects, c})) for c in others]
            fits = dict(zip(others, fitter.fit_all(sets, found.final), strict=True))
        for name, fit in fits.items():
            if name in found.final.effects:
                continue
            difference = judge.mse(fit.squared) - judge.mse(found.final.squared)
            as_good = np.quantile(difference, 0.025) <= 0 or difference.mean() < ALIKE * room
            if as_good and accepted(without, fit, found.base, floor, judge)[0]:
                share = judge.value(fit.squared) / max(judge.value(found.final.squared), 1e-30) - 1
                rivals.append(Rival(effect, name, share, fit, found.final))
    for name, fit in found.beside.items():
        pairs += _correlated(fit, name)
    return sorted(rivals, key=lambda r: r.difference), pairs


def _correlated(fit: FittedModel, name: str) -> list[tuple[str, str, float]]:
    """Selected effects whose parameters correlate with those of `name` when both are on."""
    effect = [n.rpartition(".")[0] for n in fit.names]
    out = []
    for other in dict.fromkeys(e for e in effect if e and e != name):
        a = [i for i, e in enumerate(effect) if e == name]
        b = [i for i, e in enumerate(effect) if e == other]
        if a and b and fit.correlation is not None:
            r = float(np.abs(fit.correlation[np.ix_(a, b)]).max())
            if r > CORRELATED:
                out.append((other, name, r))
    return out
