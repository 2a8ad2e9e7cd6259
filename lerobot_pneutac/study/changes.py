"""A device that changed once for good: what stands before a moment and after it agrees with no one model.

A mount that is knocked, a layer that peels off, a marker that slips: each makes two devices of one, and laws
are then found that stand in for the moment. So all parameters of a fitted model may differ from a row on, to
first order, at every row; where that explains most of what is left, and much less at moments farther away,
something changed there. What goes on for a while, as fatigue does, has no such moment.
"""

import numpy as np

from lerobot_pneutac.study.body_model import BodyModel

STEP = 10  # rows between the moments that are tried
ENDS = 0.08  # of the rows, at both ends, in which too little stands before or after
AWAY = 0.06  # of the rows: moments farther away must explain less
LESS = 0.9  # of what the moment explains


def find_change(model: BodyModel, least: float) -> int | None:
    """The row from which on a device is another one, None where there is none.

    Args:
        model: of a search, whose rows are in the order of time.
        least: fall of the mean square error that would say so.
    """
    n = len(model.residual)
    moments = np.arange(int(ENDS * n), n - int(ENDS * n), STEP)
    falls = _falls(model, moments) / n
    best = int(falls.argmax())
    far = np.abs(moments - moments[best]) > AWAY * n
    if falls[best] < least or falls[far].max(initial=0.0) > LESS * falls[best]:
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
