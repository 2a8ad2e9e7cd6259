"""Refines a gel's light through the splat renderer, the last step of the paper's calibration.

The paper minimises |I^ - I_indent|^2, summed over pixels, over L and c_d, with I^ the picture that the splats
give (Sec. III-B), by Adam from what was fitted to the image plane. With the geometry fixed the picture is
linear in the Gaussians' colours, and they are nearly so in the unknowns, so that a few Gauss-Newton steps end
in the same minimum. The priors of the fit stay in the sum; effects keep the values that it found for them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from pneutac_sim.effects.registry import in_order
from pneutac_sim.gel.fit import Channel, GelFit, Problem
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.optics import upsample
from pneutac_sim.gel.pair import PressPhotograph, press_px, to_grid
from pneutac_sim.gel.photograph import Pressed, drift_known, gains, session_light
from pneutac_sim.gel.residual import ERROR_LEVELS, INDEPENDENT
from pneutac_sim.splat.gel import SplatSensor

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
