"""The looks of a finger or an arm: one Gaussian a particle, coloured by one segmented photograph.

    looks = fit_body_looks(solver.body, rest.positions[0], rest.gradients[0], image, mask, camera)
    picture = rasterise(looks.moved(bent.positions[0], bent.gradients[0]), other_camera)
    looks_into_twin(twin, looks)

Gaussians lie on the straight body's particles, so they follow any state of the same body.
"""

from dataclasses import replace

import cv2
import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.mpm.body import Body
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.colours import fit_looks
from pneutac_sim.splat.gaussians import Gaussians
from pneutac_sim.splat.rasteriser import Splats
from pneutac_sim.twin import Twin

SCALE = 0.4  # standard deviation over the particles' spacing: neighbours overlap without gaps
OPACITY = 0.9  # to start from; particles that the photograph does not show keep it
SEEN = 0.1  # a particle counts as seen from this share of its own footprint on
ARRAYS = {f"body_{name}": name for name in ("means", "scales", "colours", "opacities")}


def fit_body_looks(
    body: Body,
    positions: np.ndarray,
    gradients: np.ndarray,
    image: np.ndarray,
    mask: np.ndarray,
    camera: Camera,
    iterations: int = 300,
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

    Returns:
        Gaussians of the straight body; `moved` carries them to other states.

    Raises:
        InputError: image, mask, camera and particles do not fit together.
    """
    check_photograph(positions, image, mask, camera)
    looks = blank_looks(body)
    now = looks.moved(positions, gradients)
    inside = mask.astype(np.float32)
    target = image.astype(np.float32) / 255 * inside[..., None]
    colours, opacities = fit_looks(
        camera, now.means, now.covariances(), now.opacities, target, coverage=inside, iterations=iterations
    )
    hidden = unseen(replace(now, opacities=opacities), camera)
    colours[hidden] = surroundings(now, image, mask, camera, 2.0)[hidden]
    return replace(looks, colours=colours, opacities=opacities)


def blank_looks(body: Body) -> Gaussians:
    """Black Gaussians on the particles of a straight body."""
    n = len(body.positions)
    return Gaussians(
        body.positions,
        np.full((n, 3), SCALE * body.spacing_m),
        np.broadcast_to(np.eye(3), (n, 3, 3)),
        np.zeros((n, 3)),
        np.full(n, OPACITY),
    )


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


def looks_from_twin(twin: Twin, body: Body) -> Gaussians:
    """Looks that `looks_into_twin` kept.

    Args:
        twin: a finger's or an arm's.
        body: the particles that they shall follow.

    Raises:
        InputError: the twin has no looks, or they are of other particles than this body's.
    """
    if missing := [a for a in ARRAYS if a not in twin.arrays]:
        raise InputError(
            f"The twin has no looks (array '{missing[0]}' is missing); calibrate it with photographs first."
        )
    looks = Gaussians(
        rotations=np.broadcast_to(np.eye(3), (len(twin.arrays["body_means"]), 3, 3)),
        **{name: twin.arrays[array] for array, name in ARRAYS.items()},
    )
    same = looks.means.shape == body.positions.shape
    if not (same and np.abs(looks.means - body.positions).max() < 0.1 * body.spacing_m):
        raise InputError(
            f"The twin's looks are those of {len(looks)} particles, the body has {len(body.positions)} in "
            "other places; use as many as in the calibration, or calibrate with photographs again."
        )
    return looks


def unseen(looks: Gaussians, camera: Camera) -> np.ndarray:
    """(n,) bool: Gaussians that others hide from the camera."""
    depth = camera.project(looks.means)[1]
    footprint = 2 * np.pi * (looks.scales.mean(1) * camera.intrinsics[0, 0] / depth) ** 2  # px
    splats = Splats(camera, looks.means, looks.covariances(), looks.opacities)
    return splats.transpose(np.ones((camera.height, camera.width, 3)))[:, 0] < SEEN * footprint


def surroundings(
    looks: Gaussians, image: np.ndarray, mask: np.ndarray, camera: Camera, width: float
) -> np.ndarray:
    """(n, 3) mean colour of the photograph round each Gaussian, 0 to 1, of pixels inside the mask.

    Args:
        looks: where; colours do not matter.
        image: RGB uint8 (H, W, 3).
        mask: bool (H, W).
        camera: of the photograph.
        width: of the surroundings (a normal distribution) over the Gaussians' own.
    """
    pixels, depth = camera.project(looks.means)
    sigma = width * float(np.median(looks.scales.mean(1) * camera.intrinsics[0, 0] / depth))
    inside = mask.astype(np.float32)
    share = cv2.GaussianBlur(inside, (0, 0), sigma)
    near = cv2.GaussianBlur(image / np.float32(255) * inside[..., None], (0, 0), sigma)
    near /= np.maximum(share, 1e-6)[..., None]
    near[share < 1e-3] = image[mask].mean(0) / 255  # too far outside to have surroundings
    at = np.floor(pixels).clip(0, (camera.width - 1, camera.height - 1)).astype(int)
    return near[at[:, 1], at[:, 0]].clip(0, 1)
