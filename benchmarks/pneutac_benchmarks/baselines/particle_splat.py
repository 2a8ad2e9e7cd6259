"""Baseline: every particle is a coloured disk of one radius, the nearest on top."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from pneutac_benchmarks.baselines.photo_colours import photo_colours
from pneutac_benchmarks.baselines.triangles import FINE, canvas_of, picture_of
from pneutac_sim.mpm.body import Body
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.rasteriser import Rendering

RADII = (0.5, 0.6, 0.7, 0.8, 0.9)  # over the particles' spacing; the one that suits the photograph is taken


@dataclass(frozen=True)
class ParticleSplat:
    """A body as disks.

    Attributes:
        colours: (P, 3), 0 to 1.
        radius_m: of every disk.
    """

    colours: np.ndarray
    radius_m: float

    @classmethod
    def fit(cls, body: Body, positions, gradients, image, mask, camera: Camera) -> "ParticleSplat":
        """From one photograph; arguments as in `photo_colours`."""
        colours = photo_colours(body, positions, gradients, image, mask, camera)
        wanted = image / 255 * mask[..., None]

        def error(radius):
            return np.square(draw_disks(camera, positions, radius, colours).image - wanted).sum()

        return cls(colours, min((r * body.spacing_m for r in RADII), key=error))

    def image(self, positions: np.ndarray, gradients: np.ndarray, camera: Camera) -> Rendering:
        """The body in another state; its deformation gradients do not matter to disks."""
        return draw_disks(camera, positions, self.radius_m, self.colours)


def draw_disks(camera: Camera, centres: np.ndarray, radius_m: float, colours: np.ndarray) -> Rendering:
    """Disks of one radius in space that face the camera, on black.

    Args:
        camera: from where.
        centres: (P, 3) m.
        radius_m: of each.
        colours: (P, 3), 0 to 1.
    """
    pixels, depth = camera.project(centres)
    seen = depth > 0
    radius = FINE * radius_m * camera.intrinsics[0, 0] / np.where(seen, depth, 1)
    image, nearest = canvas_of(camera)
    _disks(
        FINE * pixels[seen], 1 / depth[seen], radius[seen], np.asarray(colours, float)[seen], image, nearest
    )
    return picture_of(camera, image, nearest)


@njit(cache=True)
def _disks(pixels, nearness, radius, colours, image, nearest):
    height, width = nearest.shape
    for p in range(len(pixels)):
        x, y = pixels[p]
        r = radius[p]
        for i in range(max(0, int(y - r)), min(height - 1, int(y + r)) + 1):
            for j in range(max(0, int(x - r)), min(width - 1, int(x + r)) + 1):
                if (j + 0.5 - x) ** 2 + (i + 0.5 - y) ** 2 <= r * r and nearness[p] > nearest[i, j]:
                    nearest[i, j] = nearness[p]
                    image[i, j] = colours[p]
