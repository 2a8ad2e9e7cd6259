"""Breaks in a recording: a marker that slips once, a device that changes once for good, runs mounted anew.

A slip shifts everything that is seen from a moment on by one distance. No device does that: what its pressure
history moves comes with the pressure or fades, and differs from pressure to pressure. So a slip is the moment
at which a residual jumps between two samples by just the distance by which, later and in every further trial,
the whole rest of the recording is shifted. Where the body itself moves farther between these samples, a
residual jumps by whatever the model does not know yet.

A change for good (a knocked mount, a layer that peels off) makes two devices of one, and laws are then found
that stand in for it. So all parameters of a fitted model may differ from a row on, to first order, at every
row; where that explains most of what is left, and much less at moments farther away, something changed there.
What goes on for a while, as fatigue does, has no such moment.

How sessions were mounted is first judged by a map of the pressure without any physics (`mounts`), which
places them to some millimetres. A fitted model in which each run has its own offset places them better.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import numpy as np

from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.diagnosis.bootstrap import BlockBootstrap, conditions
from lerobot_pneutac.diagnosis.search import Scored
from lerobot_pneutac.study.base import EffectStudy
from lerobot_pneutac.study.body_model import BodyFitter, BodyModel
from pneutac_datasets.recording.mounts import Motion, moved, remounted, trials_named
from pneutac_datasets.recording.noise import headline
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.sensors import where

NEAR, LEAST_NEAR = 4, 2  # samples on each side of a jump, in the same trial: most and least
SLIP_ENDS = 20  # samples at both ends of a recording where nothing lasts
STEP = 10  # rows between the moments that are tried for a change


@dataclass(frozen=True)
class Break:
    """A break that was found: its correction, see `without_break`, and a sentence on it."""

    correction: dict
    finding: str


def without_break(recording: Recording, correction: dict) -> Recording:
    """A recording that is of one device, seen by one marker.

    Args:
        recording: with the break.
        correction: `from_row` and `shift` (mm or rad by column) of a marker that slipped, or `first_row` and
            `last_row` of what is on one side of a change for good, or `motions` of runs mounted differently.
    """
    if "motions" in correction:
        motions = {
            m["trial"]: Motion(np.array(m["turn"]), np.array(m["shift"])) for m in correction["motions"]
        }
        return moved(recording, headline(recording)[0], motions)
    if "shift" not in correction:
        rows = np.arange(len(recording))
        return recording.keep((rows >= correction["first_row"]) & (rows <= correction["last_row"]))
    samples = recording.samples.copy()
    for name, shift in correction["shift"].items():
        samples.loc[samples.index[correction["from_row"] :], name] -= shift
    return replace(recording, samples=samples)


def find_slip(
    residual: np.ndarray,
    predicted: np.ndarray,
    trial: np.ndarray,
    rows: np.ndarray,
    jacobian: np.ndarray,
    noise: float,
) -> tuple[int, np.ndarray] | None:
    """Where the measured pose slips, and by how much.

    Args:
        residual: (n, k) measured - predicted, all samples.
        predicted: (n, k).
        trial: (n,) number of each sample's trial, each in one piece.
        rows: (m,) samples by which it may be judged.
        jacobian: (m k, F) of the prediction at these rows, by all that a refit could move.
        noise: of one sample over all k outputs, in the residual's unit.

    Returns:
        The first row after the slip and the shift (k,) in the residual's unit; None where there is none.
    """
    n, k = residual.shape
    begin = np.flatnonzero(np.r_[True, trial[1:] != trial[:-1]])
    piece = np.searchsorted(begin, np.arange(n), side="right") - 1
    at = np.arange(n)
    low, high = np.maximum(at - NEAR, begin[piece]), np.minimum(at + NEAR, np.r_[begin[1:], n][piece])
    ok = (np.minimum(at - low, high - at) >= LEAST_NEAR) & (at >= SLIP_ENDS) & (at < n - SLIP_ENDS)

    def change(x: np.ndarray) -> np.ndarray:
        """(n, k) mean of the samples from each one on less that of those before; 0 where these are few.

        Between trials a payload may change.
        """
        total = np.concatenate([np.zeros((1, k)), np.cumsum(x, axis=0)])
        out, i, a, b = np.zeros((n, k)), at[ok], low[ok], high[ok]
        out[ok] = (total[b] - total[i]) / (b - i)[:, None] - (total[i] - total[a]) / (i - a)[:, None]
        return out

    jump, move = change(residual), change(predicted)
    size = np.linalg.norm(jump, axis=1)
    size[np.linalg.norm(move, axis=1) > size] = 0.0
    best, gain = None, 0.0
    Q = np.linalg.qr(jacobian / (np.linalg.norm(jacobian, axis=0) + 1e-12))[0]
    r = residual[rows].ravel()
    r = r - Q @ (Q.T @ r)
    for i in np.argsort(-size)[:200]:
        if size[i] < T.SLIP_OVER_NOISE * noise or size[i] < size[max(i - NEAR, 0) : i + NEAR].max():
            continue
        if not _sudden(residual[low[i] : high[i]], i - low[i]):
            continue
        step = np.kron((rows >= i)[:, None], np.eye(k))
        step = step - Q @ (Q.T @ step)
        shift, *_ = np.linalg.lstsq(step, r, rcond=None)
        removed = float(r @ r - ((r - step @ shift) ** 2).sum())
        if removed > gain and np.linalg.norm(shift - jump[i]) < T.SLIP_DIFFERS * np.linalg.norm(shift):
            best, gain = (int(i), shift), removed
    return best


def _sudden(near: np.ndarray, at: int) -> bool:
    """Whether samples (m, k) jump at one of them rather than move there: a step fits better than a line."""
    left = []
    for shape in (np.arange(len(near)) >= at, np.arange(len(near))):
        design = np.stack([np.ones(len(near)), shape], axis=1).astype(float)
        left.append(((near - design @ np.linalg.lstsq(design, near, rcond=None)[0]) ** 2).sum())
    return bool(left[0] < left[1])


def find_change(model: BodyModel, least: float) -> int | None:
    """The row from which on a device is another one, None where there is none.

    The mean square error of the model, whose rows are in the order of time, must fall by `least` there.
    """
    n = len(model.residual)
    moments = np.arange(int(T.CHANGE_ENDS * n), n - int(T.CHANGE_ENDS * n), STEP)
    falls = _falls(model, moments) / n
    best = int(falls.argmax())
    far = np.abs(moments - moments[best]) > T.CHANGE_AWAY * n
    if falls[best] < least or falls[far].max(initial=0.0) > T.CHANGE_LESS * falls[best]:
        return None
    near = moments[best] + np.arange(1 - STEP, STEP)
    return int(near[_falls(model, near).argmax()])


def _falls(model: BodyModel, moments: np.ndarray) -> np.ndarray:
    """(k,) by how much the sum of squares falls where all parameters may differ from each moment on."""
    n, f = len(model.residual), len(model.v)
    J, weight = model.jacobian[:, :f].reshape(n, -1, f), model.weight[:f, :f]
    each, slope = np.einsum("ndf,ndg->nfg", J, J), np.einsum("ndf,nd->nf", J, model.residual)
    H, g = each.sum(axis=0) + weight, slope.sum(axis=0) + model.pull[:f]
    out = []
    each_after, slope_after = (np.cumsum(x[::-1], axis=0)[::-1][moments] for x in (each, slope))
    for H_after, g_after in zip(each_after, slope_after, strict=True):
        A = np.block([[H, H_after], [H_after, H_after + weight]])
        b = np.r_[g, g_after]
        A[np.diag_indices_from(A)] += 1e-9 * np.trace(A) / len(A)
        out.append(b @ np.linalg.solve(A, b))
    return np.array(out)


def slip_break(
    study: EffectStudy,
    rows: np.ndarray,
    bootstrap: BlockBootstrap,
    score: Callable[[BodyModel], Scored],
    found: Scored,
    residual: np.ndarray,
) -> Break | None:
    """A slip of the marker, if taking it back lowers the error significantly and leaves no change for good.

    The less a model leaves, the less can be mistaken for a slip. `rows` (m,) are the samples of the search
    that `found` the model, `residual` (n, k) is of all.
    """
    recording, model = study.recording, found.model
    columns, _ = headline(recording)
    J = model.jacobian.reshape(len(rows), -1, model.jacobian.shape[1])[:, : len(columns)]
    trial = np.asarray(recording.samples["trial"])
    predicted = recording.samples[columns].to_numpy(float) - residual
    J = J.reshape(-1, J.shape[2])
    slip = find_slip(residual, predicted, trial, rows, J, study.noise.floor)
    if slip is None:
        return None
    row, shift = slip
    correction = {"from_row": int(row), "shift": dict(zip(columns, map(float, shift), strict=True))}
    moved = ", ".join(f"{c} by {x:.3g}" for c, x in zip(columns, shift, strict=True))
    fitter = BodyFitter(without_break(recording, correction), study.twin, rows)
    without = score(fitter.fit(model.structure, model.values, 8))
    if (
        not bootstrap.significant_drop(found.cv_squared, without.cv_squared)
        or _change(study, without) is not None
    ):
        return None
    return Break(
        correction,
        f"The marker slipped in {where(recording, row)}: from there on everything is seen "
        f"elsewhere, {moved}; rows from {row + 1} on are moved back for this judgement.",
    )


def mount_break(
    study: EffectStudy, predicted: np.ndarray, own: np.ndarray, known: Collection[int]
) -> Break | None:
    """Runs that a model of all of them places elsewhere than they were seen, see `mounts.remounted`.

    Args:
        study: of the recording.
        predicted: (n, D) of all samples, the headline first, without what runs have of their own.
        own: the same with their gains, zeros and clocks, but without their offsets.
        known: trials that were moved onto another mount before.
    """
    recording, rows = study.recording, study.parts.learnt
    found = remounted(recording, predicted, own, rows, study.twin.length_mm, known)
    if not found:
        return None
    names, unit = trials_named(sorted(found)), study.unit
    far, angle = max(f.reach for f in found.values()), max(f.motion.angle_deg for f in found.values())
    turned = f" turned by up to {angle:.0f} degrees and" if unit == "mm" else ""
    motions = [
        {"trial": int(t), "turn": f.motion.turn.tolist(), "shift": f.motion.shift.tolist()}
        for t, f in sorted(found.items())
    ]
    return Break(
        {"motions": motions},
        f"By the fitted model {names} {'were' if len(found) > 1 else 'was'} mounted differently, early and "
        f"late in a trial: for this judgement they are{turned} shifted by up to {far:.3g} {unit} onto the "
        "mount of the others. Errors hold for a mount that is known; a new one may differ as much.",
    )


def change_break(study: EffectStudy, rows: np.ndarray, found: Scored) -> Break | None:
    """A lasting change, confirmed by the same structure fitted to both sides; the longer side is used."""
    at = _change(study, found)
    if at is None:
        return None
    # What differs between two loads may be what a load does: a change of the device shows within one.
    load = conditions(study.recording, ("payload_g",))[rows]
    both = np.isin(load, np.intersect1d(load[:at], load[at:]))
    if not both.any():
        return None
    model, sides = found.model, []
    for side in (rows[:at], rows[at:]):
        part = BodyFitter(study.recording, study.twin, side).fit(model.structure, model.values, 8)
        sides.append((part.residual[:, : part.counted] ** 2).sum(axis=1))
    before, left = (float(x[both].mean()) for x in (found.cv_squared, np.concatenate(sides)))
    if before - left < T.ONCE * (before - study.noise.floor**2):
        return None
    row, every = int(rows[at]), np.arange(len(study.recording))
    first, last = every <= rows[at - 1], every >= row
    which, longer = ("before", first) if first.sum() > last.sum() else ("after", last)
    first, last = np.flatnonzero(longer)[[0, -1]]
    return Break(
        {"first_row": int(first), "last_row": int(last)},
        f"Something changed permanently in {where(study.recording, row)}: the error of one model is "
        f"{before**0.5:.3g} {study.unit}, that of models fitted before and after it {left**0.5:.3g}. "
        f"Only the {longer.sum()} rows {which} it are used.",
    )


def _change(study: EffectStudy, found: Scored) -> int | None:
    """Row of the search from which on it is another device, where a model says so."""
    noise_mse = study.noise.floor**2
    near = found.value < T.CLOSE**2 * noise_mse
    return None if near else find_change(found.model, T.ONCE * (found.value - noise_mse))
