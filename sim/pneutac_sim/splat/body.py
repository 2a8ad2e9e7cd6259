"""The looks of a finger or an arm: Gaussians on its particles, coloured by one segmented photograph.

looks = fit_body_looks(solver.body, rest.positions[0], rest.gradients[0], image, mask, camera)
now = carried(looks, solver.body, bent.positions[0], bent.gradients[0])
picture = rasterise(now, other_camera)
looks_into_twin(twin, looks)
"""

from dataclasses import replace

import cv2
import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.mpm.body import Body
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.colours import fit_looks
from pneutac_sim.splat.follow import blank_looks, carried
from pneutac_sim.splat.gaussians import Gaussians
from pneutac_sim.splat.rasteriser import Splats
from pneutac_sim.twin import Twin

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
        Gaussians of the straight body; `follow.carried` brings them to other states.

    Raises:
        InputError: image, mask, camera and particles do not fit together.
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
    n = len(twin.arrays["body_means"])
    return Gaussians(
        rotations=np.broadcast_to(np.eye(3), (n, 3, 3)),
        **{name: twin.arrays[array] for array, name in ARRAYS.items()},
    )


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
    """(n, ...) what a picture (H, W, ...) shows where the centres of Gaussians are."""
    pixels, _ = camera.project(looks.means)
    at = np.floor(pixels).clip(0, (camera.width - 1, camera.height - 1)).astype(int)
    return picture[at[:, 1], at[:, 0]]
