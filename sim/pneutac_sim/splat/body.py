"""The looks of a finger or an arm: Gaussians on its particles, coloured by one segmented photograph.

looks = fit_body_looks(solver.body, rest.positions[0], rest.gradients[0], image, mask, camera)
now = carried(looks, solver.body, bent.positions[0], bent.gradients[0])
picture = rasterise(now, other_camera)
looks_into_twin(twin, looks)

A body without looks of its own is coloured by its largest stretch, from calm to warm.
"""

from dataclasses import replace

import cv2
import numpy as np
from scipy.ndimage import binary_erosion
from scipy.spatial import cKDTree

from pneutac_sim.errors import InputError
from pneutac_sim.mpm.body import Body
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.rasteriser import Splats, fit_looks
from pneutac_sim.splat.render import Gaussians
from pneutac_sim.twin import Twin

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
    n, scales = len(points), np.repeat(scale[:, None], 3, 1)
    turns = np.broadcast_to(np.eye(3), (n, 3, 3))
    return Gaussians(points, scales, turns, np.zeros((n, 3)), np.full(n, OPACITY))


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


SEEN = 0.1  # a particle counts as seen from this share of its own footprint on
OUTSIDE = 0.1  # opacity to start from where the mask says that there is nothing, on the far side too
FAR_SIDE = 1.6  # blur of what the far side takes from the near one, over the particles' spacing
ARRAYS = {f"body_{name}": name for name in ("means", "scales", "colours", "opacities")}


def fit_body_looks(
    body: Body,
    positions: np.ndarray,
    gradients: np.ndarray,
    image: np.ndarray,
    mask: np.ndarray,
    camera: Camera,
    iterations: int = 300,
    detail: int = 1,
) -> Gaussians:
    """Colours and opacities of a body's Gaussians from one photograph; scales stay fixed.

    Colours start from the linear solution and go on, with opacities, by Adam at the paper's rate. A particle
    that the photograph does not show takes the photograph's colour in front of it, smoothed over its
    surroundings: the far side is thought to look as the near one does, without its details.

    Args:
        body: its particles, straight.
        positions: (P, 3) of the particles when the photograph was taken, m.
        gradients: (P, 3, 3) deformation gradients then.
        image: RGB uint8 (H, W, 3).
        mask: bool (H, W), where the body is.
        camera: from where, in the frame of `positions`.
        iterations: of Adam.
        detail: Gaussians along each edge of a particle at the surface. 1, one a particle, is the paper's and
            fast; 3 resolves what is smaller than a particle and wants twice the iterations.

    Returns:
        Gaussians of the straight body; `carried` brings them to other states.

    Raises InputError: image, mask, camera and particles do not fit together.
    """
    check_photograph(positions, image, mask, camera)
    looks = blank_looks(body, detail)
    now = carried(looks, body, positions, gradients)
    inside = mask.astype(np.float32)
    # On the body's own mean colour a Gaussian across its outline is identified by coverage, not by darkness.
    behind = image[mask].mean(0) / 255
    target = np.where(mask[..., None], image / 255, behind)
    start = np.where(_there(now, inside, camera) > 0.5, now.opacities, OUTSIDE)
    splats = Splats(camera, now.means, now.covariances(), start)
    colours, opacities = fit_looks(splats, target, behind, coverage=inside, iterations=iterations)
    hidden = unseen(replace(now, opacities=opacities), camera)
    colours[hidden] = surroundings(now, image, mask, camera, FAR_SIDE * body.spacing_m)[hidden]
    return replace(looks, colours=colours, opacities=opacities)


def check_photograph(positions: np.ndarray, image: np.ndarray, mask: np.ndarray, camera: Camera) -> None:
    """Raises InputError where a photograph is none of this body from this camera."""
    size = (camera.height, camera.width)
    image, mask = np.asarray(image), np.asarray(mask)
    if image.dtype != np.uint8 or image.shape != (*size, 3):
        raise InputError(
            f"The photograph is {image.dtype} of shape {image.shape}; the camera takes RGB uint8 of shape "
            f"{(*size, 3)}."
        )
    if mask.dtype != bool or mask.shape != size:
        raise InputError(f"The mask is {mask.dtype} of shape {mask.shape}; it must be bool of shape {size}.")
    if not 1e-4 < mask.mean() < 0.95:
        raise InputError(
            f"The mask covers {mask.mean():.1%} of the photograph; mark the body and nothing else."
        )
    if not np.isfinite(positions).all():
        raise InputError("The particles' positions are not all finite; bring the body to rest first.")
    pixels, depth = camera.project(positions)
    inside = (depth > 0) & (pixels >= 0).all(1) & (pixels < (camera.width, camera.height)).all(1)
    if not inside.any():
        raise InputError(
            "The camera does not see the body; check that its extrinsics lead from base to camera, in metres."
        )
    at = pixels[inside].astype(int)
    share = mask[at[:, 1], at[:, 0]].mean()
    if share < 0.3:
        raise InputError(
            f"Only {share:.0%} of the body's particles lie inside the mask; the camera's place or the body's "
            "shape is wrong, or the mask marks something else."
        )


def looks_into_twin(twin: Twin, looks: Gaussians) -> None:
    """Keeps the looks of a straight body in the twin's arrays."""
    twin.arrays |= {array: getattr(looks, name) for array, name in ARRAYS.items()}


def looks_from_twin(twin: Twin) -> Gaussians:
    """Looks that `looks_into_twin` stored; raises InputError where the twin has none."""
    if missing := [a for a in ARRAYS if a not in twin.arrays]:
        raise InputError(
            f"The twin has no looks (array '{missing[0]}' is missing); calibrate it with photographs first."
        )
    turns = np.broadcast_to(np.eye(3), (len(twin.arrays["body_means"]), 3, 3))
    return Gaussians(rotations=turns, **{name: twin.arrays[array] for array, name in ARRAYS.items()})


def unseen(looks: Gaussians, camera: Camera) -> np.ndarray:
    """(n,) bool: Gaussians that others hide from the camera."""
    depth = camera.project(looks.means)[1]
    footprint = 2 * np.pi * (looks.scales.mean(1) * camera.intrinsics[0, 0] / depth) ** 2  # px
    splats = Splats(camera, looks.means, looks.covariances(), looks.opacities)
    return splats.transpose(np.ones((camera.height, camera.width, 3)))[:, 0] < SEEN * footprint


def surroundings(
    looks: Gaussians, image: np.ndarray, mask: np.ndarray, camera: Camera, sigma_m: float
) -> np.ndarray:
    """(n, 3) mean colour of the photograph round each Gaussian, 0 to 1, of pixels inside the mask.

    The photograph is RGB uint8 (H, W, 3), the mask bool (H, W); `sigma_m` is the standard deviation of the
    surroundings, m in the body's plane.
    """
    depth = camera.project(looks.means)[1]
    sigma = sigma_m * camera.intrinsics[0, 0] / float(np.median(depth))
    inside = mask.astype(np.float32)
    share = cv2.GaussianBlur(inside, (0, 0), sigma)
    near = cv2.GaussianBlur(image / np.float32(255) * inside[..., None], (0, 0), sigma)
    near /= np.maximum(share, 1e-6)[..., None]
    near[share < 1e-3] = image[mask].mean(0) / 255  # too far outside to have surroundings
    return _there(looks, near, camera).clip(0, 1)


def _there(looks: Gaussians, picture: np.ndarray, camera: Camera) -> np.ndarray:
    pixels, _ = camera.project(looks.means)
    at = np.floor(pixels).clip(0, (camera.width - 1, camera.height - 1)).astype(int)
    return picture[at[:, 1], at[:, 0]]
