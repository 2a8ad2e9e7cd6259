"""A tactile sensor in simulation: probe grid -> gel surface -> light -> image and contact area."""

from collections.abc import Callable

import numpy as np

from pneutac_sim.gel.contact import ContactArea, contact_area
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.optics import Renderer
from pneutac_sim.gel.probe import COLS, NO_TRIANGLES, ROWS, probe_grid
from pneutac_sim.gel.surface import surface
from pneutac_sim.twin import Twin


def centre_mm(pressed: np.ndarray, window_mm: tuple[float, float]) -> np.ndarray:
    """Centre of gravity (2,) of weights over a picture of a gel, mm along columns and rows.

    Weights (rows, columns) are 0 or more; `window_mm` is width and height of the picture; NaN where all
    weights are 0.
    """
    total = pressed.sum()
    if not total:
        return np.full(2, np.nan)
    return np.array(
        [
            size * ((np.arange(n) + 0.5) @ pressed.sum(axis) / (n * total) - 0.5)
            for axis, n, size in zip((0, 1), pressed.shape[::-1], window_mm, strict=True)
        ]
    )


class TactileSensor:
    """Images and contact areas of the gel of a twin.

    Args:
        twin: a twin with a gel, or its gel alone; the generated DIGIT where it is None or has none.
        surface: takes a probe grid (80, 59) in mm to the surface's displacement in mm, such as
            `surrogate.perception.GelSurrogate.displacement`; None for the analytic `gel.surface`.

    Attributes:
        model: the gel's sizes, mechanics and light.
        rest_image: the image without contact, uint8 (H, W, 3), 320 x 240 for a DIGIT.
        surface: as given; it takes several grids (B, 80, 59) at once where `areas` is called.
        draw: takes a surface's displacement, (80, 59) mm, to an image, uint8 (H, W, 3): light on every pixel
            (`gel.optics`), or in its place such as `splat.gel.SplatSensor.image`.
        triangles: of the meshes that it may touch, see `probe_grid`.
    """

    def __init__(
        self,
        twin: Twin | GelModel | None = None,
        surface: Callable[[np.ndarray], np.ndarray] | None = None,
    ):
        self.surface = surface
        self.model = twin if isinstance(twin, GelModel) else GelModel.from_twin(twin)
        self.rest_image = self.model.rest_image
        m, self._cell_mm = self.model, self.model.cell_mm
        self._renderer = Renderer(m.rest_image, m.weight, self._cell_mm, (ROWS, COLS), *m.lighting)
        self.draw = self._renderer.image
        self.triangles = NO_TRIANGLES

    def probe(
        self, kinds, sizes, positions, rotations, gel_position=np.zeros(3), gel_rotation=np.eye(3)
    ) -> np.ndarray:
        """`probe_grid` with this sensor's window and gel thickness: depth in mm, float32 (80, 59)."""
        return probe_grid(
            kinds,
            sizes,
            positions,
            rotations,
            gel_position,
            gel_rotation,
            self.model.window_mm,
            self.model.thickness_mm,
            triangles=self.triangles,
        )

    def displacement(self, depth_mm: np.ndarray, left_mm: np.ndarray | None = None) -> np.ndarray:
        """Displacement of the gel surface in mm under a probe grid (80, 59), float32 (80, 59).

        `left_mm` (80, 59) is what earlier presses left, see `gel.late`; None for a gel at rest.
        """
        if depth_mm.shape != (ROWS, COLS):
            raise ValueError(f"a probe grid has shape {(ROWS, COLS)}; got {depth_mm.shape}")
        if left_mm is None and not depth_mm.any():
            return np.zeros((ROWS, COLS), np.float32)
        imprint = self.model.imprint(depth_mm)
        if left_mm is not None:
            imprint = np.maximum(imprint - left_mm, 0)
        u = self._analytic(imprint) if self.surface is None else self.surface(imprint)
        if left_mm is not None:
            u = left_mm + u
        return self.model.surface(u, self.model.cell_mm)

    def _analytic(self, imprint: np.ndarray) -> np.ndarray:
        return surface(imprint, self._cell_mm, self.model.decay_mm)

    def image(self, depth_mm: np.ndarray, left_mm: np.ndarray | None = None) -> np.ndarray:
        """Tactile image of a probe grid (80, 59) in mm: uint8 (H, W, 3); arguments as of `displacement`."""
        u = self.displacement(depth_mm, left_mm)
        return self.draw(u) if u.any() else self.rest_image.copy()

    def contact(self, image: np.ndarray) -> ContactArea:
        """Contact area of a tactile image of this sensor."""
        return contact_area(image, self.rest_image, self.model.threshold_levels)

    def contact_from_depth(self, depth_mm: np.ndarray, left_mm: np.ndarray | None = None) -> ContactArea:
        """Exactly `contact(image(...))` without keeping the image, where no other `draw` is set."""
        n = self.rest_image.shape[0] * self.rest_image.shape[1]
        if left_mm is None and not depth_mm.any():
            return ContactArea.of(0, n)
        return ContactArea.of(self._pixels(self.displacement(depth_mm, left_mm)), n)

    def areas(self, depth_mm: np.ndarray) -> np.ndarray:
        """`contact_from_depth(...).area` of probe grids (B, 80, 59), (B,); a network takes them together."""
        pixels = np.zeros(len(depth_mm))
        touched = np.flatnonzero(depth_mm.reshape(len(depth_mm), -1).any(1))
        imprints = [self.model.imprint(depth_mm[b]) for b in touched]
        if self.surface is None or not imprints:
            moved = map(self._analytic, imprints)
        else:
            moved = self.surface(np.stack(imprints))
        for b, u in zip(touched, moved, strict=True):
            pixels[b] = self._pixels(self.model.surface(u, self.model.cell_mm))
        return pixels / (self.rest_image.shape[0] * self.rest_image.shape[1])

    def _pixels(self, displacement_mm: np.ndarray) -> int:
        return self._renderer.contact_pixels(displacement_mm, int(3 * self.model.threshold_levels))
