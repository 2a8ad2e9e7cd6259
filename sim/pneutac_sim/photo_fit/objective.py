"""How far renderings are from photographs: masked L1 difference and silhouettes' overlap, paper Sec. IV."""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numba import njit

from pneutac_sim.mpm.body import Body
from pneutac_sim.mpm.solid import body_mesh
from pneutac_sim.mpm.solve import MpmDiverged
from pneutac_sim.photo_fit.equilibria import Bodies, Equilibria
from pneutac_sim.splat.body import Carrier
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.gaussians import Gaussians
from pneutac_sim.splat.rasteriser import Rendering, Splats
from pneutac_sim.twin import Twin

SHARP = 4  # pixels drawn a pixel of the picture, each way, of silhouettes


def cover(camera: Camera, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(H, W) float32 share of each pixel that triangles (F, 3) of vertices (V, 3) m cover."""
    pixels, depth = camera.project(vertices)
    seen = faces[(depth[faces] > 0).all(1)]
    canvas = np.zeros((SHARP * camera.height, SHARP * camera.width), np.uint8)
    _cover(SHARP * pixels, seen, canvas)
    size = camera.width, camera.height
    return cv2.resize(canvas, size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255


@njit(cache=True)
def _cover(pixels, faces, canvas):
    """Row by row: between the crossings of a triangle's edges with the line of pixel centres."""
    height, width = canvas.shape
    for f in range(len(faces)):
        low, high = np.inf, -np.inf
        for k in range(3):
            low, high = min(low, pixels[faces[f, k], 1]), max(high, pixels[faces[f, k], 1])
        for i in range(max(0, int(np.ceil(low - 0.5))), min(height - 1, int(np.floor(high - 0.5))) + 1):
            y = i + 0.5
            left, right = np.inf, -np.inf
            for k in range(3):
                x0, y0 = pixels[faces[f, k]]
                x1, y1 = pixels[faces[f, (k + 1) % 3]]
                if min(y0, y1) <= y <= max(y0, y1) and y0 != y1:
                    x = x0 + (y - y0) / (y1 - y0) * (x1 - x0)
                    left, right = min(left, x), max(right, x)
            for j in range(max(0, int(np.ceil(left - 0.5))), min(width - 1, int(np.floor(right - 0.5))) + 1):
                canvas[i, j] = 255


# The surface of a body, and the silhouette that it shows to a camera.
#
# Thresholded splats are wider than the body by a part of their lattice's spacing, the more the thicker it is.
# That makes a body longer, to which a fit answers with its last joint. The surface has no such width.


EDGE = 0.05  # longest edge of a triangle, over the body's length, so that the surface can bend


class Outline:
    """The closed mesh of the body of a twin, a finger or an arm.

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


SILHOUETTE = 2.0  # lambda_s
WORST = 1.0 + SILHOUETTE  # of a body that finds no rest
SOLID = 0.5  # coverage from which a pixel belongs to the silhouette


@dataclass(frozen=True)
class MaskedPhotograph:
    """One segmented photograph of a body at rest under a pressure."""

    state: int  # index of the pressure
    camera: Camera  # from where, base frame
    image: np.ndarray  # RGB uint8 (H, W, 3)
    mask: np.ndarray  # bool (H, W), where the body is
    name: str = "a photograph"  # shown in errors


class Scores(NamedTuple):
    """Of K candidates on n photographs."""

    appearance: np.ndarray  # (K, n) mean absolute difference inside the mask, 0 to 1
    iou: np.ndarray  # (K, n) overlap of the silhouettes over their union
    # (K, n) root mean square difference over the union of both silhouettes, on black, 8-bit levels
    rmse: np.ndarray

    @property
    def objective(self) -> np.ndarray:
        """(K,) J = mean over photographs of L_app + lambda_s (1 - IoU), eq. 1 of the paper."""
        return (self.appearance + SILHOUETTE * (1 - self.iou)).mean(-1)


def score(
    drawn: np.ndarray, covered: np.ndarray, image: np.ndarray, mask: np.ndarray
) -> tuple[float, float, float]:
    """Appearance, IoU and RMSE of one rendering on black, (H, W, 3), 0 to 1, with its silhouette (H, W) bool.

    Against a photograph, RGB uint8 (H, W, 3), and where its body is, `mask` (H, W) bool, not empty.
    """
    union = mask | covered
    level = drawn.clip(0, 1)[union] - np.where(mask[union][:, None], image[union] / np.float32(255), 0)
    appearance = float(np.abs(level[mask[union]]).mean())  # L_app, eq. 2 of the paper
    iou = float((mask & covered).sum() / union.sum())  # eq. 3
    return appearance, iou, float(255 * np.sqrt((level.astype(float) ** 2).mean()))


class Objective:
    """Scores candidates by full material points: looks by splats, silhouettes by the body's surface.

    The photographs' `state` counts the pressures of the equilibria; looks are a Gaussian for each particle,
    in the particles' order.

    Attributes:
        best: (T, P, 3) particles of the best candidate so far, m; None before the first.
        outline: the body's surface.
    """

    def __init__(self, equilibria: Equilibria, photographs: list[MaskedPhotograph], looks: Gaussians):
        self.equilibria, self.photographs, self.looks = equilibria, photographs, looks
        # A round Gaussian stays the same however it turns.
        self._covariances = looks.covariances()
        self.outline = Outline(equilibria.parameters.twin)
        self.surface = self.outline.on(equilibria.body)
        self.best, self._least = None, np.inf

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """(K,) objective of candidates (K, P) in coordinates; `WORST` of one that finds no rest."""
        try:
            bodies = self.equilibria.solve(x)
        except MpmDiverged:
            return np.concatenate([self(one[None]) for one in x]) if len(x) > 1 else np.array([WORST])
        values = self.scores(bodies).objective
        if values.min() < self._least:
            self.best, self._least = bodies.positions[values.argmin()], values.min()
        return values

    def scores(self, bodies: Bodies) -> Scores:
        rows = [
            [self._score(p, at[p.state], edge[p.state]) for p in self.photographs]
            for at, edge in zip(bodies.positions, map(self.surface, *bodies[:2]), strict=True)
        ]
        return Scores(*np.moveaxis(np.array(rows), 2, 0))

    def _score(self, p: MaskedPhotograph, positions: np.ndarray, vertices: np.ndarray) -> tuple:
        covered = self.outline.coverage(vertices, p.camera) > SOLID
        return score(self.render(positions, p.camera).image, covered, p.image, p.mask)

    def render(self, positions: np.ndarray, camera: Camera) -> Rendering:
        """One body, particles at (P, 3) m, on black."""
        return Splats(camera, positions, self._covariances, self.looks.opacities).render(self.looks.colours)
