"""Colours of particles as one photograph gives them, the same for every baseline."""

import numpy as np

from pneutac_sim.mpm.body import Body
from pneutac_sim.splat.body import FAR_SIDE, SCALE, blank_looks, check_photograph, surroundings, unseen
from pneutac_sim.splat.camera import Camera


def photo_colours(
    body: Body,
    positions: np.ndarray,
    gradients: np.ndarray,
    image: np.ndarray,
    mask: np.ndarray,
    camera: Camera,
) -> np.ndarray:
    """(P, 3) colours, 0 to 1: the photograph's over a particle's own breadth; hidden ones as in the splats.

    Args:
        body: its particles, straight.
        positions: (P, 3) when the photograph was taken, m.
        gradients: (P, 3, 3) deformation gradients then.
        image: RGB uint8 (H, W, 3).
        mask: bool (H, W).
        camera: from where.
    """
    check_photograph(positions, image, mask, camera)
    now = blank_looks(body).moved(positions, gradients)
    seen = surroundings(now, image, mask, camera, SCALE * body.spacing_m)
    hidden = surroundings(now, image, mask, camera, FAR_SIDE * body.spacing_m)
    return np.where(unseen(now, camera)[:, None], hidden, seen)
