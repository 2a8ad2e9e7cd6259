"""How well photographs identify each parameter."""

from dataclasses import dataclass

import numpy as np

from pneutac_sim.photo_fit.coarse import thin
from pneutac_sim.photo_fit.objective import Objective

BLUR_PX = 2.0
BLOCK = 32  # thinned pixels along an edge that count as one observation
MOVE = 0.5  # of a first step, for differences
LATTICE = 0.05  # of the particles' spacing, by which surfaces of one body on different lattices differ
TELLING = 0.1  # of the prior's standard deviation: where more is left, the parameter counts as not identified


@dataclass(frozen=True)
class Posterior:
    """Of P parameters.

    Attributes:
        sd: (P,) posterior standard deviation, coordinates.
        ci95: name to interval, physical values, inside the bounds.
        not_identified: names of those whose posterior is not ten times narrower than their bounds.
    """

    sd: np.ndarray
    ci95: dict[str, tuple[float, float]]
    not_identified: list[str]


def confidence(objective: Objective, x: np.ndarray) -> Posterior:
    """Posterior of the parameters at the optimum, from how silhouettes move with each.

    Linearised: residual r is blurred coverage less mask, J its derivative by central differences through all
    of material points and renderer. Pixels of a block err together, so information is Godambe's
    H M^-1 H with H = J^T J, M = sum over blocks of (J_b^T r_b)(J_b^T r_b)^T. What is wrong with the body's
    shape is so in all photographs: n of them have no more information on it than one, and M counts n times.
        So is what
    the lattice leaves open, by which the outline in a block is shifted along either axis: it adds to M. The
    uniform prior between the bounds adds the inverse of its variance.

    Args:
        objective: of the photographs that were fitted.
        x: (P,) coordinates of the optimum.
    """
    parameters = objective.equilibria.parameters
    n = len(parameters)
    step = MOVE * parameters.step
    ends = [np.clip(x + s * np.diag(step), parameters.lower, parameters.upper) for s in (1, -1)]
    bodies = objective.equilibria.solve(np.concatenate([x[None], *ends]))
    surfaces = [objective.surface(*body) for body in zip(bodies.positions, bodies.gradients, strict=True)]
    width = np.diag(ends[0] - ends[1])
    H, M = np.zeros((n, n)), np.zeros((n, n))
    for p in objective.photographs:
        mask = p.mask.astype(np.float32)
        pictures = np.stack(
            [thin(objective.outline.coverage(at[p.state], p.camera) - mask, BLUR_PX) for at in surfaces]
        ).astype(float)
        J = (pictures[1 : n + 1] - pictures[n + 1 :]) / width[:, None, None]
        H += np.einsum("ihw,jhw->ij", J, J)
        depth = p.camera.project(bodies.positions[0, p.state])[1].mean()
        open_px = LATTICE * objective.equilibria.body.spacing_m * p.camera.intrinsics[0, 0] / depth
        shifts = (open_px * thin(slope, BLUR_PX) for slope in np.gradient(mask))
        for residual in (pictures[0], *shifts):
            blocks = _blocks(J * residual)
            M += blocks @ blocks.T
    scale = parameters.prior_sd
    H, M = H * np.outer(scale, scale), M * np.outer(scale, scale)
    M *= len(objective.photographs)
    # No photograph is known better than to a thousandth of a pixel's coverage.
    M += 1e-6 * H + 1e-12 * np.trace(H) / n * np.eye(n)
    # Godambe: H M^-1 H, plus the prior's inverse variance, 1 in these units
    information = H @ np.linalg.solve(M, H)
    sd = scale * np.sqrt(np.diag(np.linalg.inv(information + np.eye(n))))
    low, high = (np.clip(x + s * 1.96 * sd, parameters.lower, parameters.upper) for s in (-1, 1))
    ends = zip(parameters.values(low), parameters.values(high), strict=True)
    ci95 = {name: (float(a), float(b)) for name, (a, b) in zip(parameters.names, ends, strict=True)}
    unclear = [name for name, a, b in zip(parameters.names, sd, scale, strict=True) if a > TELLING * b]
    return Posterior(sd, ci95, unclear)


def _blocks(pictures: np.ndarray) -> np.ndarray:
    """(n, blocks) sums over the blocks of (n, h, w) pictures."""
    n, h, w = pictures.shape
    whole = np.pad(pictures, ((0, 0), (0, -h % BLOCK), (0, -w % BLOCK)))
    return whole.reshape(n, -(-h // BLOCK), BLOCK, -(-w // BLOCK), BLOCK).sum((2, 4)).reshape(n, -1)
