"""Baseline: a surface round the particles, coloured by the nearest of them."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from pneutac_benchmarks.baselines.isosurface import isosurface
from pneutac_benchmarks.baselines.photo_colours import photo_colours
from pneutac_benchmarks.baselines.triangles import draw_triangles
from pneutac_sim.mpm.body import Body
from pneutac_sim.splat.body import Carrier
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.rasteriser import Rendering

FINE = 2  # nodes of the density's lattice a particle, each way
BORDER = 4  # empty nodes round the body
SMOOTH = 0.5  # standard deviation of a particle's density over the spacing


@dataclass(frozen=True)
class TexturedMesh:
    """A body as a mesh that follows its particles.

    Attributes:
        rest: (P, 3) particles of the straight body, m.
        vertices: (V, 3) of the straight surface, m.
        faces: (F, 3).
        colours: (V, 3), 0 to 1.
    """

    rest: np.ndarray
    vertices: np.ndarray
    faces: np.ndarray
    colours: np.ndarray

    @classmethod
    def fit(cls, body: Body, positions, gradients, image, mask, camera: Camera) -> "TexturedMesh":
        """From one photograph; arguments as in `photo_colours`."""
        colours = photo_colours(body, positions, gradients, image, mask, camera)
        mesh = surface(body)
        nearest = cKDTree(body.positions).query(mesh.vertices)[1]
        return cls(body.positions, np.asarray(mesh.vertices), np.asarray(mesh.faces), colours[nearest])

    def image(self, positions: np.ndarray, gradients: np.ndarray, camera: Camera) -> Rendering:
        """The body in another state."""
        moved = Carrier(self.vertices, self.rest)(positions, gradients)
        return draw_triangles(camera, moved, self.faces, self.colours)


def surface(body: Body):
    """`trimesh.Trimesh` where the density of a straight body's particles has fallen to half."""
    cells = FINE * body.cells[:, None] + np.stack(np.meshgrid(*[range(FINE)] * 3, indexing="ij"), -1).reshape(
        -1, 3
    )
    density = np.zeros(FINE * (body.cells.max(0) + 1) + 2 * BORDER)
    density[tuple((cells + BORDER).reshape(-1, 3).T)] = 1.0
    spacing = body.spacing_m / FINE
    return isosurface(
        gaussian_filter(density, SMOOTH * FINE, mode="constant"),
        0.5,
        spacing,
        body.origin_m + (0.5 - BORDER) * spacing,
    )
