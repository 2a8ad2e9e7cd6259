"""The surface of a body, and the silhouette that it shows to a camera.

Thresholded splats are wider than the body by a part of their lattice's spacing, the more the thicker it is.
That makes a body longer, to which a fit answers with its last joint. The surface has no such width.
"""

import numpy as np

from pneutac_sim.mpm.body import Body
from pneutac_sim.mpm.shapes import body_mesh
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.carry import Carrier
from pneutac_sim.splat.zbuffer import cover
from pneutac_sim.twin import Twin

EDGE = 0.05  # longest edge of a triangle, over the body's length, so that the surface can bend


class Outline:
    """The closed mesh of a twin's body.

    Args:
        twin: of a finger or an arm.

    Attributes:
        vertices: (V, 3) of the straight body, m.
        faces: (F, 3).
    """

    def __init__(self, twin: Twin):
        mesh = body_mesh(twin).subdivide_to_size(EDGE * 1e-3 * twin.length_mm)
        self.vertices, self.faces = np.array(mesh.vertices), np.array(mesh.faces)

    def on(self, body: Body) -> Carrier:
        """What carries the vertices along with a body's particles."""
        return Carrier(self.vertices, body.positions)

    def coverage(self, vertices: np.ndarray, camera: Camera) -> np.ndarray:
        """(H, W) share of each pixel that the body with these vertices (V, 3) in m covers."""
        return cover(camera, vertices, self.faces)
