"""A finger or an arm by splats from any side: in the twin's looks, or coloured by stretch without them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lerobot_pneutac.rendering import particles as draw
from lerobot_pneutac.rendering.options import RenderView
from lerobot_pneutac.rendering.particles import STRETCH, Painter, Pose, caption
from pneutac_sim.mpm.body import Body
from pneutac_sim.splat.body import ARRAYS, looks_from_twin
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.follow import blank_looks, carried, strain, stretch_colours
from pneutac_sim.splat.gaussians import Gaussians
from pneutac_sim.splat.render import rasterise
from pneutac_sim.twin import Twin

WIDTH, HEIGHT = 640, 480
CAPTION = 44  # px below the picture
FOV_DEG = 20.0  # so that four lengths away the straight body fills seven tenths of the height


def view_camera(view: RenderView, aim: np.ndarray, length_m: float) -> Camera:
    """The camera of a view; the body hangs from its base, and at no angle bends to the right.

    Args:
        view: from where.
        aim: (3,) what is in the middle, m.
        length_m: of the body.
    """
    around, above = np.radians([view.azimuth_deg, view.elevation_deg])
    side = np.array([0.0, -np.cos(around), np.sin(around)])
    base = np.array([-1.0, 0.0, 0.0])
    away = np.cos(above) * side + np.sin(above) * base
    eye = aim + view.distance_lengths * length_m * away
    return Camera.look_at(eye, aim, np.cos(above) * base - np.sin(above) * side, FOV_DEG, WIDTH, HEIGHT)


def view_painter(twin: Twin, body: Body, view: RenderView, spines: np.ndarray) -> tuple[Painter, str]:
    """Draws poses from a view, and says what one sees.

    Args:
        twin: with looks or without.
        body: its straight particles.
        view: from where.
        spines: (T, K, 3) about where the spine will be, m; their middle is the picture's.
    """
    points = spines.reshape(-1, 3)
    camera = view_camera(view, (points.min(0) + points.max(0)) / 2, 1e-3 * twin.length_mm)
    looks_of = body_looks(twin, body)

    def paint(pose: Pose) -> tuple[np.ndarray, dict]:
        now = looks_of(pose.positions, pose.gradients)
        seen = rasterise(now, camera, np.array(draw.PAPER) / 255)
        image = draw.blank(WIDTH, HEIGHT + CAPTION)
        image[:HEIGHT] = (255 * seen.image.clip(0, 1)).round()
        draw.write(image, caption(pose), 16, HEIGHT + CAPTION - 18, 0.55)
        return image, {}

    own = "The body in its own looks, by Gaussian splats on the particles."
    return paint, own if has_looks(twin) else STRETCH


def has_looks(twin: Twin) -> bool:
    """Whether a photograph gave the twin its looks."""
    return all(array in twin.arrays for array in ARRAYS)


def body_looks(twin: Twin, body: Body) -> Callable[[np.ndarray, np.ndarray], Gaussians]:
    """What gives the Gaussians of a body for its particles' positions (P, 3), m, and gradients (P, 3, 3).

    They are in the twin's looks, or coloured by stretch where it has none.
    """
    own = has_looks(twin)
    looks = looks_from_twin(twin) if own else blank_looks(body)

    def now(positions: np.ndarray, gradients: np.ndarray) -> Gaussians:
        moved = carried(looks, body, positions, gradients)
        return moved if own else replace(moved, colours=stretch_colours(strain(gradients)) / 255)

    return now
