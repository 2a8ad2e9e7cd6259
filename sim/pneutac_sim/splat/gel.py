"""A touch sensor's gel as splats: one Gaussian a particle, moving with it and taking the light of contact.

Geometry of the paper (Sec. III-A, III-B): a regular grid of particles, 59 x 80 a layer for a DIGIT, seen
through the gel by a camera below it. The gel is clear and its outer coating is what the camera sees, so
Gaussians of the inner layers start nearly transparent; colours and opacities are then fitted to the one rest
image.

The last step of the paper's calibration refines the light through the renderer: it minimises
|I^ - I_indent|^2, summed over pixels, over L and c_d, with I^ the picture that the splats give (Sec. III-B),
by Adam from what was fitted to the image plane. With the geometry fixed the picture is linear in the
Gaussians' colours, and they are nearly so in the unknowns, so that a few Gauss-Newton steps end in the same
minimum. The priors of the fit stay in the sum; effects keep the values that it found for them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np
from numba import njit

from pneutac_sim.effects.registry import in_order
from pneutac_sim.errors import InputError
from pneutac_sim.gel.fit import Channel, GelFit, Problem
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.optics import light, upsample
from pneutac_sim.gel.pair import PressPhotograph, press_px, to_grid
from pneutac_sim.gel.photograph import Pressed, drift_known, gains, session_light
from pneutac_sim.gel.probe import COLS, ROWS
from pneutac_sim.gel.residual import ERROR_LEVELS, INDEPENDENT
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.rasteriser import Rendering, Splats, fit_looks, numbers
from pneutac_sim.splat.render import CudaSplats, on

CAMERA_MM = 22.0  # a DIGIT's camera before its gel surface
# The paper has 13. By 4, photographs of two DIGITs are met as well (0.01 levels), a GelSight's nearly so
# (0.16 in the contact), since the gel between window and coating is clear, in a third of the time.
LAYERS = 4
SCALE_CELLS = 0.5  # standard deviation over the spacing of particles: neighbours close the surface
COATING, INSIDE = 0.95, 0.012  # opacities to start from
ITERATIONS = 30


class SplatSensor:
    """Renders a gel's surface displacements as splats.

    Layers compress linearly from the surface to the bonded window. A Gaussian takes the light of contact that
    falls where the camera sees it, and what it lets pass falls on the next, at last on the background: light
    that was calibrated on the image plane stays there. What splats of a cell's size cannot show of
    the rest image, such as noise, stays where it is, so that no contact gives the rest image.

    Args:
        model: the gel's sizes, rest image and light.
        device: that draws: `cpu`, `cuda`, or `auto` for CUDA where gsplat and a device are there; looks are
            fitted to the rest image on the CPU (seconds).

    Attributes:
        camera: the gel's camera, in the gel's frame.
        looks: colours (n, 3) and opacities (n,).

    Raises InputError: there is no such device, or CUDA or gsplat is missing.
    """

    def __init__(self, model: GelModel, device: str = "cpu"):
        self.model, self._on = model, on(device)
        self._model_weight, self._lighting = model.weight, model.lighting
        height, width = model.rest_image.shape[:2]
        focal_px = model.px_per_mm * CAMERA_MM
        view = np.eye(4)
        view[2, 3] = CAMERA_MM * 1e-3
        K = np.array([[focal_px, 0, width / 2], [0, focal_px, height / 2], [0, 0, 1]])
        self.camera = Camera(K, view, width, height)
        self._means, self._fraction = particles(model)
        n = len(self._means)
        scale = SCALE_CELLS * model.cell_mm[0] * 1e-3
        self._covariances = np.tile(scale**2 * np.eye(3, dtype=np.float32), (n, 1, 1))
        rest = model.rest_image.astype(np.float32) / 255
        self._background = rest.mean((0, 1))
        start = np.where(self._fraction == 1, COATING, INSIDE)
        splats = Splats(self.camera, self._means, self._covariances, start)
        self.looks = fit_looks(splats, rest, self._background, iterations=ITERATIONS)
        splats = self._on(self.camera, self._means, self._covariances, self.looks[1])
        self._residual = rest - splats.render(self.looks[0], self._background).image

    @property
    def rest_error_levels(self) -> float:
        """Root mean square of what splats do not show of the rest image."""
        return float(255 * np.sqrt(np.mean(np.square(self._residual))))

    def image(self, displacement_mm: np.ndarray) -> np.ndarray:
        """Tactile image, uint8 (H, W, 3), of a displacement (80, 59) in mm; raises InputError as `splats`."""
        displacement_mm = self._checked(displacement_mm)
        return self.render(displacement_mm, self.increment(displacement_mm))

    def render(self, displacement_mm: np.ndarray, increment: np.ndarray) -> np.ndarray:
        """Tactile image, uint8 (H, W, 3), of a displacement with any light; raises InputError as `splats`.

        `increment` (H, W, 3) in levels is what contact adds to the picture: each Gaussian takes what there is
        where it is seen.
        """
        increment = numbers("increment", increment, self.model.rest_image.shape)
        splats = self.splats(displacement_mm)
        colours = self.looks[0] + self.take(splats, increment) / np.float32(255)
        seen = splats.render(colours, self._background)
        out = np.empty(self.model.rest_image.shape, np.uint8)
        _levels(seen.image, self._residual, seen.alpha, increment, out)
        return out

    def splats(self, displacement_mm: np.ndarray) -> Splats | CudaSplats:
        """The gel's Gaussians under a displacement (80, 59), mm into the gel, ready to render.

        Raises InputError where a shape is wrong, a number not finite or a displacement too large.
        """
        u = self._checked(displacement_mm)
        means = self._means.copy()
        moved = means.reshape(-1, ROWS * COLS, 3)
        moved[..., 2] -= np.float32(1e-3) * self._fraction.reshape(-1, ROWS * COLS) * u.ravel()
        return self._on(self.camera, means, self._covariances, self.looks[1])

    def bare(self, splats: Splats | CudaSplats) -> Rendering:
        """Moved Gaussians in the light of the rest image: levels (H, W, 3) float32, and their coverage."""
        image, alpha = splats.render(self.looks[0], self._background)
        return Rendering(np.float32(255) * (image + self._residual), alpha)

    def lit(self, splats: Splats | CudaSplats, alpha: np.ndarray, increment: np.ndarray) -> np.ndarray:
        """What an increment adds to `bare`, levels (H, W, 3) float32, linear in it; unrounded `render`."""
        return splats.render(self.take(splats, increment)).image + (1 - alpha)[..., None] * increment

    def take(self, splats: Splats | CudaSplats, picture: np.ndarray) -> np.ndarray:
        """A picture (H, W, 3) float32 where each Gaussian is seen, (n, 3)."""
        spots = self.camera.project(splats.means)[0].astype(np.float32)
        out = np.empty((len(spots), 3), np.float32)
        _sample(picture, spots, out)
        return out

    def _checked(self, displacement_mm) -> np.ndarray:
        u = numbers("displacement_mm", displacement_mm, (ROWS, COLS))
        if u.max() >= self.model.thickness_mm:
            raise InputError(
                f"The gel's surface moves by {u.max():.2f} mm, through its thickness of "
                f"{self.model.thickness_mm} mm."
            )
        return u

    def increment(self, displacement_mm: np.ndarray, gel: GelModel | None = None) -> np.ndarray:
        """What contact under a displacement (80, 59) mm adds to the picture, (H, W, 3) float32 levels.

        `gel` has another light than this sensor's but the same weight w; the sensor's where None.
        """
        model, lighting = self.model, self._lighting if gel is None else gel.lighting
        grid = light(displacement_mm, model.cell_mm, *lighting).transpose(1, 2, 0)
        size = model.rest_image.shape[1::-1]
        return self._model_weight * cv2.resize(np.ascontiguousarray(grid), size)  # bilinear, by centres


def particles(model: GelModel, layers: int = LAYERS) -> tuple[np.ndarray, np.ndarray]:
    """Particles at rest, in the gel's frame (see `gel.probe`), layer by layer from the window to the surface.

    Returns:
        Means, (layers * 80 * 59, 3) float32 m, and the share of the surface's displacement that each takes.
    """
    width, height = model.window_mm
    z, y, x = np.meshgrid(
        np.linspace(-model.thickness_mm, 0, layers),
        ((np.arange(ROWS) + 0.5) / ROWS - 0.5) * height,
        ((np.arange(COLS) + 0.5) / COLS - 0.5) * width,
        indexing="ij",
    )
    means = np.stack([x, y, z], -1).reshape(-1, 3)
    return (means * 1e-3).astype(np.float32), (1 + means[:, 2] / model.thickness_mm).astype(np.float32)


@njit(cache=True, nogil=True)
def _sample(picture, spots, out):
    """Bilinear values of a picture (H, W, 3) at pixels (n, 2), the rim's beyond it."""
    h, w, channels = picture.shape
    for i in range(len(spots)):
        x = min(max(spots[i, 0] - np.float32(0.5), np.float32(0)), np.float32(w - 1))
        y = min(max(spots[i, 1] - np.float32(0.5), np.float32(0)), np.float32(h - 1))
        p, q = min(int(y), h - 2), min(int(x), w - 2)
        fy, fx = y - np.float32(p), x - np.float32(q)
        for k in range(channels):
            above = picture[p, q, k] + fx * (picture[p, q + 1, k] - picture[p, q, k])
            below = picture[p + 1, q, k] + fx * (picture[p + 1, q + 1, k] - picture[p + 1, q, k])
            out[i, k] = above + fy * (below - above)


@njit(cache=True, nogil=True)
def _levels(image, residual, alpha, increment, out):
    """Image plus residual, 0 to 1, and the light on what splats do not cover, rounded to 8 bits."""
    a, b, c, light, covered = image.ravel(), residual.ravel(), out.ravel(), increment.ravel(), alpha.ravel()
    for i in range(len(a)):
        level = (a[i] + b[i]) * np.float32(255) + np.float32(0.5)
        level += (np.float32(1) - covered[i // 3]) * light[i]
        c[i] = np.uint8(min(max(level, np.float32(0)), np.float32(255)))


UNKNOWNS = "strength", "direction", "depth_light"  # of a channel: L in polar form, and c_d
STEPS = 1.0, 0.01, 0.1  # by which they are moved to see what the picture does
ROUNDS = 3  # of Gauss-Newton; the second changes the cost by a thousandth


class Viewed:
    """A photograph of a press, and the Gaussians under that press's surface (80, 59).

    Attributes:
        near: pixels near the contact, (H, W) bool.
    """

    def __init__(self, sensor: SplatSensor, displacement_mm: np.ndarray, photograph: PressPhotograph):
        gel, p = sensor.model, photograph
        self._sensor, self._moved = sensor, displacement_mm
        self._splats = sensor.splats(displacement_mm)
        self._bare, self._alpha = sensor.bare(self._splats)
        if drift_known(gel):
            image = p.image / gains(gel, p.clock)
        else:
            image = p.image - upsample(session_light(p, gel.px_per_mm), *p.rest.shape[:2])
        self._seen = image.astype(np.float32)
        self.near = p.near(gel.px_per_mm)

    def added(self, gel: GelModel) -> np.ndarray:
        """What contact adds to the picture before it is rendered, (H, W, 3) levels, by this gel's light."""
        return self._sensor.increment(self._moved, gel)

    def lit(self, increment: np.ndarray) -> np.ndarray:
        """What the renderer makes of an increment, (H, W, 3) levels."""
        return self._sensor.lit(self._splats, self._alpha, increment)

    def off(self, gel: GelModel) -> np.ndarray:
        """Rendered minus photographed, (H, W, 3) levels; the photograph's drift of light is taken out."""
        return self._bare + self.lit(self.added(gel)) - self._seen


def refine_light(
    gel: GelModel,
    channels: Sequence[Channel],
    viewed: Sequence[Viewed],
    masks: Sequence[np.ndarray] | None = None,
) -> GelModel:
    """The gel with the light L and c_d of least squares through the renderer, from its own.

    It was fitted to the image plane. The channels, red, green and blue, give the priors. Compared are the
    pixels of `masks`, bool (H, W) for each photograph; those near its contact where None.
    """
    priors = np.array([[c.prior["", name] for name in UNKNOWNS] for c in channels])  # (3, 3, 4)
    centre, (low, high) = priors[..., 0], np.moveaxis(priors[..., 2:], -1, 0)
    weight = 1 / priors[..., 1] ** 2
    x, best, least = _polar(gel), gel, np.inf
    for k in range(ROUNDS + 1):
        here = _with_light(gel, x)
        away = x - centre
        away[:, 1] = (away[:, 1] + np.pi) % (2 * np.pi) - np.pi
        H, b, cost = np.stack([np.diag(w) for w in weight]), weight * away, float(np.sum(weight * away**2))
        for v, near in zip(viewed, masks or [v.near for v in viewed], strict=True):
            each = INDEPENDENT / ERROR_LEVELS**2 / max(near.sum(), 1)
            now, off = v.added(here), v.off(here)[near]
            cost += each * float(np.square(off).sum())
            if k == ROUNDS:
                continue
            by = [v.lit((v.added(_with_light(gel, moved)) - now) / h)[near] for moved, h in _moved(x)]
            J = np.stack(by, -1)  # (pixels, channels, unknowns)
            H += each * np.einsum("pci,pcj->cij", J, J, optimize=True)
            b += each * np.einsum("pci,pc->ci", J, off, optimize=True)
        if cost < least:
            best, least = here, cost
        if k < ROUNDS:
            x = np.clip(x - np.linalg.solve(H, b[..., None])[..., 0], low, high)
    return best


def refine_fit(fit: GelFit, photographs: Sequence[PressPhotograph], pressed: Pressed | None = None) -> None:
    """Refines a fit's light, in place, if that significantly lowers the error of held-out parts.

    Parts are the photographs, or the quarters about the contact of a single one. Each is held out in turn,
    the light re-fitted to the others and refined there. The refinement is taken where the mean fall of the
    squared error in the parts is more than its standard error. The fit is without residual fields.
    """
    problem = Problem(fit.gel, photographs, in_order(fit.gel.effects), pressed)
    surfaces = problem.surfaces(fit.gel.decay_mm, fit.gel.depth_scale)
    sensors: dict[int, SplatSensor] = {}
    viewed = []
    for u, p in zip(surfaces, photographs, strict=True):
        if id(p.rest) not in sensors:
            sensors[id(p.rest)] = SplatSensor(replace(fit.gel, rest_image=p.rest))
        viewed.append(Viewed(sensors[id(p.rest)], u, p))
    falls = []
    for held in _parts(photographs, fit.gel.px_per_mm):
        left = [v.near & ~h for v, h in zip(viewed, held, strict=True)]
        judged = [v.near & h for v, h in zip(viewed, held, strict=True)]
        channels = []
        for k, c in enumerate(fit.channels):
            grids = [to_grid(m) > 0.5 for m in left]
            args = problem.cell, grids, problem.seen, problem.rests
            channels.append(Channel(k, problem.effects, c.prior, *args))
            channels[-1].solve(surfaces)
        before = problem.lit(channels)
        after = refine_light(before, channels, viewed, left)
        falls.append(_squared(viewed, judged, before) - _squared(viewed, judged, after))
    fit.refined = bool(np.mean(falls) > np.std(falls, ddof=1) / np.sqrt(len(falls)))
    if fit.refined:
        fit.gel = refine_light(fit.gel, fit.channels, viewed)


def _parts(photographs: Sequence[PressPhotograph], px_per_mm: float) -> Iterator[list[np.ndarray]]:
    shapes = [p.rest.shape[:2] for p in photographs]
    if len(photographs) > 1:
        for i in range(len(photographs)):
            yield [np.full(shape, i == j) for j, shape in enumerate(shapes)]
        return
    x, y = press_px(photographs[0].press, photographs[0].rest.shape, px_per_mm)
    i, j = np.ogrid[: shapes[0][0], : shapes[0][1]]
    for below in (False, True):
        for right in (False, True):
            yield [((i > y) == below) & ((j > x) == right)]


def _squared(viewed: Sequence[Viewed], masks: Sequence[np.ndarray], gel: GelModel) -> float:
    off = np.concatenate([v.off(gel)[m] for v, m in zip(viewed, masks, strict=True)])
    return float(np.square(off).mean()) if len(off) else 0.0


def _polar(gel: GelModel) -> np.ndarray:
    strength, angle = np.linalg.norm(gel.light, axis=1), np.arctan2(-gel.light[:, 1], -gel.light[:, 0])
    return np.stack([strength, angle, gel.depth_light], -1)


def _with_light(gel: GelModel, x: np.ndarray) -> GelModel:
    towards = np.stack([np.cos(x[:, 1]), np.sin(x[:, 1])], -1)
    return replace(gel, light=-x[:, :1] * towards, depth_light=x[:, 2])


def _moved(x: np.ndarray) -> Iterator[tuple[np.ndarray, np.float32]]:
    for j, step in enumerate(STEPS):
        yield x + step * (np.arange(3) == j), np.float32(step)
