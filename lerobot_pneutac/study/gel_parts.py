"""Deals photographs of a gel into those that fit and choose, and those that the report alone looks at.

The calibration pair always trains and is never judged: every twin of the gel has seen it. Choices rest on
cross-validation over the other photographs. Where these are few they are tested by it as well.
"""

from collections.abc import Sequence

import numpy as np

from lerobot_pneutac.diagnosis.candidates import Untested
from lerobot_pneutac.diagnosis.parts import Parts
from lerobot_pneutac.diagnosis.votes import deal_folds
from pneutac_datasets.recording import blocks
from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import sensor_effects
from pneutac_sim.errors import InputError

NEEDED = 10  # photographs for a verdict, the calibration pair's among them
APART = 24  # photographs from which a third is put aside for the report
FOLDS = 5
UNHELD = "cannot be tested, record column hold_s and a time_s that runs on"


def sort_candidates(data: GelRecording, own: Sequence[str]) -> tuple[list[str], list[Untested]]:
    """Effects to try that a twin has not got, and those that these photographs cannot test."""
    others = {n: e for n, e in sensor_effects().items() if n not in own}
    told = any(s.earlier for s in data.samples)
    untested = [Untested(n, UNHELD) for n, e in others.items() if e.late and not told]
    return [n for n, e in others.items() if told or not e.late], untested


def deal_photographs(recording: Recording, seed: int) -> Parts:
    """Photographs to fit, to choose by and to test on; the last two are one where there are fewer than 24.

    Raises:
        InputError: there is no photograph beside the calibration pair.
    """
    n = len(recording)
    roles = recording.samples["role"].astype(str) if recording.has("role") else np.full(n, "")
    judged = np.asarray(roles != "calibration")
    if not judged.any():
        raise InputError("The recording has no image beside the calibration pair, so nothing can be judged.")
    train, test = np.ones(n, bool), judged
    if n >= APART:
        others = np.flatnonzero(judged)
        part = blocks.assign(recording.samples.iloc[others], np.arange(len(others)), seed, (2 / 3, 1 / 3))
        test = np.isin(np.arange(n), others[part == 1])
        train = ~test
    stratum = np.unique(np.asarray(roles), return_inverse=True)[1]
    return Parts(train, judged & train, test, np.arange(n), stratum)


def photograph_folds(parts: Parts, seed: int) -> np.ndarray:
    """(n,) fold of each photograph that is judged by cross-validation; -1 for all others."""
    fold = np.full(len(parts.unit), -1)
    fold[parts.validation] = deal_folds(parts.unit[parts.validation], FOLDS, seed)
    return fold
