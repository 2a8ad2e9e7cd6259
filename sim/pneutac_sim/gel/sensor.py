"""A tactile sensor in simulation: probe grid -> gel surface -> light -> image and contact area.

What earlier presses leave in a gel that creeps, and how the next press lies on it.

See the effect `gel_creep`. A press meets a face that is still r deep: what it adds is the surface under an
imprint that is less deep by r, so that the face lies on the indenter as it does on a gel that does not creep.
"""

from collections.abc import Callable, Sequence

import numpy as np

from pneutac_sim.gel.contact import ContactArea, contact_area
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.optics import Renderer
from pneutac_sim.gel.probe import COLS, NO_TRIANGLES, ROWS, probe_grid
from pneutac_sim.gel.surface import surface
from pneutac_sim.twin import Twin

Branches = Sequence[tuple[float, float]]

REST_FRAMES, LEAST_PIXELS = 8, 50  # of an imprint's middle: frames at rest, smallest imprint
LEAST_MM = 2e-4  # what is left of a press that is not drawn: a fiftieth of a grey level


class Memory:
    """What is left in a gel of a simulator, step by step; after one press it is `share_left` of its surface.

    Args:
        branches: (share, time in s) each.
    """

    def __init__(self, branches: Branches):
        share, time = np.array(branches, np.float64).reshape(-1, 2).T
        self._share, self._time_s = share[:, None, None], time[:, None, None]
        self._late, self._held, self._at_s = np.zeros((len(share), ROWS, COLS)), np.zeros((ROWS, COLS)), 0.0

    def left_mm(self, at_s: float) -> np.ndarray | None:
        """Displacement (80, 59) that is left now, or None; a clock that goes back starts again."""
        if at_s < self._at_s:
            self._late[:], self._held = 0.0, np.zeros((ROWS, COLS))
        self._late += -np.expm1(-max(at_s - self._at_s, 0.0) / self._time_s) * (self._held - self._late)
        self._at_s = at_s
        left = (self._share * self._late).sum(0)
        return np.float32(left) if left.max() > LEAST_MM else None

    def hold(self, surface_mm: np.ndarray | None) -> None:
        """The displacement (80, 59) under what presses from now on; None where nothing does."""
        self._held = np.zeros((ROWS, COLS)) if surface_mm is None else surface_mm


def branches_of(gel: GelModel) -> list[tuple[float, float]]:
    """Branches of all the gel's effects, in order."""
    return [b for effect, values in gel.acting if effect.late is not None for b in effect.late(values)]


def pressed_on(imprint_mm: np.ndarray, left_mm: np.ndarray | None, cell_mm, decay_mm: float) -> np.ndarray:
    """Displacement (80, 59) in mm under an imprint on a face that earlier presses left uneven."""
    if left_mm is None:
        return surface(imprint_mm, cell_mm, decay_mm)
    return left_mm + surface(np.maximum(imprint_mm - left_mm, 0), cell_mm, decay_mm)


def centre_mm(pressed: np.ndarray, window_mm: tuple[float, float]) -> np.ndarray:
    """Centre of gravity (2,) of weights over a picture of a gel, mm along columns and rows.

    Weights (rows, columns) are 0 or more; `window_mm` is width and height of the picture; NaN where all
    weights are 0.
    """
    total = pressed.sum()
    if not total:
        return np.full(2, np.nan)
    sides = zip((0, 1), pressed.shape[::-1], window_mm, strict=True)
    shares = [((np.arange(n) + 0.5) @ pressed.sum(i) / (n * total) - 0.5, size) for i, n, size in sides]
    return np.array([size * share for share, size in shares])


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
        self, twin: Twin | GelModel | None = None, surface: Callable[[np.ndarray], np.ndarray] | None = None
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
        objects = kinds, sizes, positions, rotations, gel_position, gel_rotation
        size = {"window_mm": self.model.window_mm, "thickness_mm": self.model.thickness_mm}
        return probe_grid(*objects, **size, triangles=self.triangles)

    def displacement(self, depth_mm: np.ndarray, left_mm: np.ndarray | None = None) -> np.ndarray:
        """Displacement of the gel surface in mm under a probe grid (80, 59), float32 (80, 59).

        `left_mm` (80, 59) is what earlier presses left, see `Memory`; None for a gel at rest.
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

    def imprint_centres_mm(self, images: np.ndarray, area: np.ndarray) -> np.ndarray:
        """Middle of the imprint in each image (T, 2), mm across and along the finger; NaN without touch.

        Images uint8 (T, H, W, 3) before the first touch, where `area` (T,) is 0, show the gel at rest.
        """
        untouched = np.flatnonzero(np.cumsum(area) == 0)[:REST_FRAMES]
        rest = images[untouched if len(untouched) else [0]].mean(0)
        centres, limit = np.full((len(images), 2), np.nan), 3 * self.model.threshold_levels
        for t in np.flatnonzero(area > 0):
            pressed = np.abs(images[t] - rest).sum(2) > limit
            if pressed.sum() >= LEAST_PIXELS:
                centres[t] = centre_mm(pressed, self.model.window_mm)
        return centres

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
