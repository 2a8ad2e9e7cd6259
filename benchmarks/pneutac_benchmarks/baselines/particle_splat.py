"""Baseline: every particle is a coloured disk of one radius, the nearest on top."""

from dataclasses import dataclass

import numpy as np

from pneutac_benchmarks.baselines.photo_colours import photo_colours
from pneutac_sim.mpm.body import Body
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.rasteriser import Rendering
from pneutac_sim.splat.zbuffer import draw_disks

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
