"""A recording of one device, seen by one marker: slips are taken back, a change for good is cut off."""

from typing import TYPE_CHECKING

import numpy as np

from lerobot_pneutac.diagnosis.search import Scored
from lerobot_pneutac.diagnosis.verdict import CLOSE
from lerobot_pneutac.study.body_model import BodyFitter
from lerobot_pneutac.study.changes import find_change
from lerobot_pneutac.study.slips import find_slip
from pneutac_datasets.recording.noise import headline
from pneutac_datasets.recording.tracker import where

if TYPE_CHECKING:
    from lerobot_pneutac.study.body import BodyStudy
    from lerobot_pneutac.study.body_search import BodySearch

MOST_SLIPS = 3
ONCE = 0.5  # of the avoidable mean square error: what goes where a device is two, before and after a moment


def move_back(study: "BodyStudy", search: "BodySearch", found: Scored) -> bool:
    """Takes a slip of the marker back where what a model leaves surely shows one; whether it did.

    The less a model leaves, the less can be mistaken for a slip.
    """
    was, model = (study.recording, study.findings, study.breaks), found.model
    columns, _ = headline(study.recording)
    J = model.jacobian.reshape(len(search.rows), -1, model.jacobian.shape[1])[:, : len(columns)]
    residual, trial = study.fitted(model).residual, np.asarray(study.recording.samples["trial"])
    predicted = study.recording.samples[columns].to_numpy(float) - residual
    J = J.reshape(-1, J.shape[2])
    slip = find_slip(residual, predicted, trial, search.rows, J, study.noise.floor)
    if slip is None or len(was[1]) - study.checked >= MOST_SLIPS:
        return False
    row, shift = slip
    moved = ", ".join(f"{c} by {x:.3g}" for c, x in zip(columns, shift, strict=True))
    study.apply_break({"from_row": int(row), "shift": dict(zip(columns, map(float, shift), strict=True))})
    study.findings = [
        *was[1],
        f"The marker slipped in {where(study.recording, row)}: from there on everything is seen "
        f"elsewhere, {moved}; rows from {row + 1} on are moved back for this judgement.",
    ]
    fitter = BodyFitter(study.recording, study.twin, search.rows)
    without = search.score(fitter.fit(model.form, model.values, 8))
    if search.judge.surely(found.crossed, without.crossed) and _change(study, without) is None:
        return True
    study.recording, study.findings, study.breaks = was
    return False


def keep_one_device(study: "BodyStudy", search: "BodySearch", found: Scored) -> bool:
    """Keeps what stands before a change for good, or after it, whichever is longer; whether there is one.

    It must be borne out by the same form fitted to both apart.
    """
    at = _change(study, found)
    if at is None:
        return False
    model, left = found.model, 0.0
    for rows in (search.rows[:at], search.rows[at:]):
        part = BodyFitter(study.recording, study.twin, rows).fit(model.form, model.values, 8)
        left += (part.residual[:, : part.counted] ** 2).sum() / len(search.rows)
    if found.value - left < ONCE * (found.value - study.noise.floor**2):
        return False
    row, rows = int(search.rows[at]), np.arange(len(study.recording))
    before, after = rows <= search.rows[at - 1], rows >= row
    kept, longer = ("before", before) if before.sum() > after.sum() else ("after", after)
    study.findings = [
        *study.findings,
        f"Something changed for good in {where(study.recording, row)}: one model errs by "
        f"{found.value**0.5:.3g} {study.unit}, fitted before and after apart by {left**0.5:.3g}. This "
        f"judgement is of the {longer.sum()} rows {kept} it.",
    ]
    first, last = np.flatnonzero(longer)[[0, -1]]
    study.apply_break({"first_row": int(first), "last_row": int(last)})
    return True


def _change(study: "BodyStudy", found: Scored) -> int | None:
    """Row of the search from which on it is another device, where a model says so."""
    floor2 = study.noise.floor**2
    near = found.value < CLOSE**2 * floor2
    return None if near else find_change(found.model, ONCE * (found.value - floor2))
