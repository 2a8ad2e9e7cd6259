"""Touch back from an image: the gel's surface, where it is pressed, how deep and how hard.

The light of an image is s(u), see `gel.optics`; sought is the surface u on the probe grid with

    w s(u) = image - rest - drift,   u >= 0,   u = 0 where nothing has changed.

Three Levenberg-Marquardt steps do it, each the least of |J du - r|^2 + mu^2 |du|^2 + lambda^2 |lap du|^2,
with r what is left and J = w ds/du at rest. Its matrix is the same for all images of a sensor, factored once;
it integrates slopes to heights. More steps fit noise. Drift of light is smooth, fitted where nothing changed.

Force: the gel is taken for a bed of springs, F = 2.55 E / t V with E its modulus, t its thickness and V the
volume pressed in.
"""

from dataclasses import dataclass, replace
from typing import Self

import cv2
import numpy as np
from scipy import ndimage, sparse
from scipy.sparse.linalg import splu

from pneutac_sim.gel import optics
from pneutac_sim.gel.force import MATERIAL, MODULUS
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import FAR_ENOUGH, smooth_change, to_grid
from pneutac_sim.gel.probe import COLS, ROWS
from pneutac_sim.gel.sensor import centre_mm
from pneutac_sim.twin import Twin

MU, LAMBDA = 10.0, 3.0  # levels/mm, levels mm
STEPS = 3
AROUND_MM = 1.4  # round what has changed, where the surface still sags
EDGE = 0.4  # of a contact's deepest point: the surface there is where it leaves the object, on balls
SHALLOWEST_MM = 0.08  # of a contact
# Over E / t: of ten presses of balls, punches, an edge and a cone into 2.5 mm of material points, 2.1 to 3.0.
BED = 2.55


@dataclass(frozen=True)
class Touch:
    """What is read from an image, on the probe grid (80, 59)."""

    surface_mm: np.ndarray  # displacement into the gel, float64
    contact: np.ndarray  # where something presses, bool
    cell_mm: tuple[float, float]  # grid spacing along x and y
    depth_mm: float  # of the deepest point of what presses, below the resting surface; 0 where nothing does
    force_n: float  # on the gel, about; its modulus is mostly assumed

    @property
    def normals(self) -> np.ndarray:
        """Of the surface, unit vectors (80, 59, 3) out of the sensor; x along columns, y along rows."""
        dx, dy = optics.gradient(self.surface_mm, self.cell_mm)
        n = np.stack([dx, dy, np.ones_like(dx)], -1)
        return n / np.linalg.norm(n, axis=-1, keepdims=True)

    @property
    def area_mm2(self) -> float:
        return float(self.contact.sum() * self.cell_mm[0] * self.cell_mm[1])

    @property
    def centre_mm(self) -> np.ndarray:
        """Of the contact (2,), from the window's centre, weighed by depth; NaN where there is none."""
        window = COLS * self.cell_mm[0], ROWS * self.cell_mm[1]
        return centre_mm(self.surface_mm * self.contact, window)


class TouchReader:
    """Reads touch from the images of one sensor.

    Args:
        gel: as calibrated.
        youngs_modulus_mpa: of the gel, for the force.
    """

    def __init__(self, gel: GelModel, youngs_modulus_mpa: float = MATERIAL[MODULUS]):
        self.gel, self._bed = gel, BED * youngs_modulus_mpa / gel.thickness_mm
        self._cell = gel.cell_mm
        self._rest = to_grid(gel.rest_image)
        self._weight = gel.weight_on(self._rest).transpose(2, 0, 1).astype(float)
        # Residual fields double the time and make depths no truer (benchmarks/notes/tactile.md).
        self._light = replace(gel, prior_residual=None, residual=None).lighting
        J, lap = _derivative(self._light[0], self._weight, self._cell), _laplacian(self._cell)
        damping = MU**2 * sparse.eye(ROWS * COLS) + LAMBDA**2 * lap.T @ lap
        self._solve, self._JT = splu((J.T @ J + damping).tocsc()).solve, J.T.tocsr()
        reach = [2 * round(AROUND_MM / c) + 1 for c in self._cell]
        self._around = np.ones(reach[::-1], np.uint8)

    @classmethod
    def of_twin(cls, twin: Twin) -> Self:
        """Of a twin's gel, and its modulus where it is known."""
        known = twin.parameters.get(MODULUS)
        return cls(GelModel.from_twin(twin), MATERIAL[MODULUS] if known is None else known.value)

    def read(self, image: np.ndarray, rest: np.ndarray | None = None) -> Touch:
        """Touch in an image, uint8 (H, W, 3) of any size in the gel's proportions.

        `rest` is the image without contact of the same session; the gel's own where None.

        Raises ValueError: the image is no uint8 (H, W, 3).
        """
        if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
            raise ValueError(f"a tactile image is uint8 (H, W, 3); got {image.dtype} {image.shape}")
        rest_grid = self._rest if rest is None else to_grid(rest)
        difference = to_grid(image) - rest_grid
        changed = (np.abs(difference).mean(2) > self.gel.threshold_levels).astype(np.uint8)
        without_specks = cv2.morphologyEx(changed, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        near = cv2.dilate(without_specks, self._around) > 0  # cells that differ from rest, and those around
        if (~near).mean() >= FAR_ENOUGH:
            quiet = ~near
            quiet[::2] = False  # half of the rows suffice
            difference = difference - smooth_change(difference, rest_grid, quiet)
        seen = difference.transpose(2, 0, 1).ravel()
        u = np.zeros((ROWS, COLS))
        for k in range(STEPS):
            s = optics.light(u, self._cell, *self._light) * self._weight if k else np.zeros(1)
            step = self._solve(self._JT @ (seen - s.ravel()))
            u = np.where(near, np.clip(u + step.reshape(u.shape), 0.0, self.gel.thickness_mm), 0.0)
        return self._touch(u)

    def _touch(self, u: np.ndarray) -> Touch:
        parts, count = ndimage.label(u > SHALLOWEST_MM)
        deepest = np.concatenate([[np.inf], ndimage.maximum(u, parts, range(1, count + 1))])
        contact = u > EDGE * deepest[parts]
        drawn_back = (1 / self.gel.depth_scale - 1) * np.where(contact, deepest[parts], 0.0)  # see `imprint`
        volume = float((u + drawn_back)[contact].sum() * self._cell[0] * self._cell[1])
        depth = float(u.max() / self.gel.depth_scale) if count else 0.0
        return Touch(u, contact, self._cell, depth, self._bed * volume)


def _derivative(coefficients: np.ndarray, weight: np.ndarray, cell_mm) -> sparse.csr_matrix:
    """Of the weighted light by the surface at rest, (3 n, n) for n cells: w (L . grad + c_d)."""
    Gx = sparse.kron(sparse.eye(ROWS), _differences(COLS, cell_mm[0]))
    Gy = sparse.kron(_differences(ROWS, cell_mm[1]), sparse.eye(COLS))
    out = []
    for c, w, ex, ey in zip(
        coefficients, weight, *optics.towards_light(coefficients, (ROWS, COLS), cell_mm), strict=True
    ):
        scale = -np.hypot(c[0], c[1]) * w / np.maximum(np.hypot(ex, ey), 1e-9)
        parts = (scale * ex, Gx), (scale * ey, Gy), (c[2] * w, sparse.eye(ROWS * COLS))
        out.append(sum(sparse.diags(factor.ravel()) @ G for factor, G in parts))
    return sparse.vstack(out).tocsr()


def _differences(n: int, step: float) -> sparse.csr_matrix:
    """Central differences (n, n), one-sided at the rim, as in `optics.gradient`."""
    return sparse.csr_matrix(np.gradient(np.eye(n), step, axis=0))


def _laplacian(cell_mm) -> sparse.csr_matrix:
    def line(n: int, step: float):
        d = sparse.diags([1.0, -2.0, 1.0], [-1, 0, 1], shape=(n, n), format="lil")
        d[0, 0] = d[-1, -1] = -1.0
        return d.tocsr() / step**2

    along = sparse.kron(sparse.eye(ROWS), line(COLS, cell_mm[0]))
    return (along + sparse.kron(line(ROWS, cell_mm[1]), sparse.eye(COLS))).tocsr()
