"""Gaussians on the particles of a body, and how they follow them.

Colours of a body without looks of its own: its largest stretch, from calm to warm.

Carries points along with the particles of a body: vertices of meshes, samples of rays.
"""

import numpy as np
from scipy.ndimage import binary_erosion
from scipy.spatial import cKDTree

from pneutac_sim.errors import InputError
from pneutac_sim.mpm.body import Body
from pneutac_sim.splat.gaussians import Gaussians

SCALE = 0.4  # standard deviation over the distance of neighbours: these overlap without gaps
OPACITY = 0.8  # to start from; what a photograph does not show keeps it
MOST_DETAIL = 6


def blank_looks(body: Body, detail: int = 1) -> Gaussians:
    """Black Gaussians of a straight body.

    Along each edge of a particle at the surface there are `detail` of them; 1 for one a particle.

    Raises InputError where `detail` is no whole number from 1 to `MOST_DETAIL`.
    """
    if isinstance(detail, bool) or not isinstance(detail, int) or not 1 <= detail <= MOST_DETAIL:
        raise InputError(f"detail is {detail!r}; it must be a whole number from 1 to {MOST_DETAIL}.")
    h = body.spacing_m
    filled = np.zeros(body.cells.max(0) + 3, bool)
    at = tuple((body.cells + 1).T)
    filled[at] = True
    outer = ~binary_erosion(filled, np.ones((3, 3, 3)))[at]
    place = ((np.arange(detail) + 0.5) / detail - 0.5) * h
    offsets = np.stack(np.meshgrid(place, place, place, indexing="ij"), -1).reshape(-1, 3)
    fine = (body.positions[outer][:, None] + offsets).reshape(-1, 3)
    if detail == 1:  # in the particles' order
        points, scale = body.positions, np.full(len(body.positions), SCALE * h)
    else:
        points = np.concatenate([fine, body.positions[~outer]])
        scale = SCALE * h * np.where(np.arange(len(points)) < len(fine), 1 / detail, 1.0)
    n = len(points)
    return Gaussians(
        points,
        np.repeat(scale[:, None], 3, 1),
        np.broadcast_to(np.eye(3), (n, 3, 3)),
        np.zeros((n, 3)),
        np.full(n, OPACITY),
    )


def carried(looks: Gaussians, body: Body, positions: np.ndarray, gradients: np.ndarray) -> Gaussians:
    """Gaussians of a straight body in another state of it, each carried by the nearest particle.

    That state is positions (P, 3) in m and deformation gradients (P, 3, 3) of the body's particles, perhaps
    on another lattice than the one that `looks` were made for.

    Raises InputError where a Gaussian is far from all particles: the looks are those of another body.
    """
    distance, owner = cKDTree(body.positions).query(looks.means)
    if distance.max() > 3 * body.spacing_m:
        raise InputError(
            f"These looks reach {1e3 * distance.max():.3g} mm beyond the body's particles; they are those of "
            "another body, so calibrate with photographs again."
        )
    F = gradients[owner]
    means = positions[owner] + np.einsum("nij,nj->ni", F, looks.means - body.positions[owner])
    return looks.moved(means, F)


STOPS = np.array([[38.0, 150, 155], [238, 200, 110], [226, 74, 51]])  # RGB: calm, half way, most
MOST_STRAIN = 0.15  # of the warmest colour, in a finger or an arm


def strain(gradients: np.ndarray) -> np.ndarray:
    """(...,) largest principal stretch less one of deformation gradients (..., 3, 3)."""
    return np.linalg.svd(np.asarray(gradients, float), compute_uv=False)[..., 0] - 1


def stretch_colours(value: np.ndarray, top: float = MOST_STRAIN) -> np.ndarray:
    """(P, 3) RGB, 0 to 255, from calm to warm for values from 0 to `top`."""
    share = np.clip(value / top, 0, 1) * (len(STOPS) - 1)
    return np.stack([np.interp(share, range(len(STOPS)), stop) for stop in STOPS.T], -1)


NEAR = 12  # particles that a point follows


class Carrier:
    """Points (K, 3) m that follow a body of particles `rest` (P, 3) m.

    Each particle maps its surroundings by x = x_p + F_p (X - X_p); a point takes the mean of its nearest
    ones, weighted by (1 - (d / R)^2)^2 over the distance d, where R lies beyond the last of them. Affine
    deformations are met exactly, also a little outside the body.
    """

    def __init__(self, points: np.ndarray, rest: np.ndarray):
        d, self._index = cKDTree(rest).query(points, k=NEAR)
        w = (1 - (d / (1.05 * d[:, -1:] + 1e-12)) ** 2) ** 2
        self._weights = w / w.sum(1, keepdims=True)
        self._offset = points[:, None] - rest[self._index]  # (K, NEAR, 3)

    def __call__(self, positions: np.ndarray, gradients: np.ndarray) -> np.ndarray:
        """(..., K, 3) m where the points are, by particles (..., P, 3) m and gradients (..., P, 3, 3)."""
        there, turned = positions[..., self._index, :], gradients[..., self._index, :, :]
        mapped = there + np.einsum("...knij,knj->...kni", turned, self._offset)
        return np.einsum("kn,...kni->...ki", self._weights, mapped)


def carry(points: np.ndarray, rest: np.ndarray, positions: np.ndarray, gradients: np.ndarray) -> np.ndarray:
    """One use of `Carrier`: points (..., K, 3), m."""
    return Carrier(points, rest)(positions, gradients)
