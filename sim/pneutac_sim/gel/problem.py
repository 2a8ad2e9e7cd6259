"""Light and mechanics of a gel as one least-squares problem of some photographs, and what a fit found."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from pneutac_sim.effects.registry import sensor_effects
from pneutac_sim.effects.sensor_effect import SensorEffect
from pneutac_sim.gel.channel import Channel, effects_of, priors
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.late import pressed_on
from pneutac_sim.gel.layout import Layout, Orientation, recognise, recognise_rest
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.optics import gradient
from pneutac_sim.gel.optics import light as light_of
from pneutac_sim.gel.pair import CONTACT_DISC
from pneutac_sim.gel.photograph import (
    Pressed,
    PressPhotograph,
    Residues,
    drift_known,
    gains,
    press_depth,
    registered,
    session_light,
    to_grid,
)
from pneutac_sim.gel.residual import Leftover
from pneutac_sim.gel.surface import DECAY_MM

DECAY_RANGE_MM = (0.3, 4.0)  # from a skin-thin layer to nearly Hertz' half-space on a 16 mm window
DEPTH_SCALE_RANGE = (0.5, 1.0)
DEPTH_SCALE_SD = 0.2  # of the logarithm: stated depths are mostly estimates

# A sensor model's light is used even at several times the cost: the misfit of a single pair is mostly the
# model's own error, and on two real DIGITs keeping it predicts other images better.
TRUST_IN_MAKE = 3.0
TRUST_IN_REST = 10.0  # the same where the rest image identifies the sensor model


@dataclass
class GelFit:
    """What a fit found.

    Attributes:
        gel: the calibrated gel at the images' own resolution.
        cost: half the sum of squares, with priors, that the fit made least.
        evaluations: how many surfaces were tried.
        make: the sensor's make, where its light was recognised.
        orientation: which way round its images are against the make's.
        likeness: correlation of the rest image with the likest make's; None where no make was looked for.
        by_rest: whether the rest image identified the sensor model; else the less certain directions of the
            light did.
        channels: as solved, red, green and blue.
        presses: where the photographs' presses were found to be, within what is uncertain of them.
        leftovers: what the light alone leaves over of each, where there are enough to learn from.
        lent: the share of the prior residual field that was taken.
        refined: whether its light was refined through splats, see `splat.refine`; None where nobody tried.
    """

    gel: GelModel
    cost: float
    evaluations: int
    make: str = ""
    orientation: Orientation = field(default_factory=Orientation)
    likeness: float | None = None
    by_rest: bool = False
    channels: list[Channel] = field(default_factory=list, repr=False)
    presses: list[Press] = field(default_factory=list, repr=False)
    leftovers: list[Leftover] = field(default_factory=list, repr=False)
    lent: float = 0.0
    refined: bool | None = None


def slope_light(gel: GelModel, pair: PressPhotograph, pressed: Pressed | None = None) -> np.ndarray:
    """L (3, 2) of the paper's linear model fitted to one pair, levels per unit slope."""
    return Problem(gel, [pair], [], pressed).linear()


class Problem:
    """The least-squares problem of some photographs and effects.

    The gel gives size, scale, thickness and all that is not fitted here; effects of the light are fitted with
    it. `pressed` is as of `fit.fit_presses`.

    Attributes:
        gel: as given; may be replaced by what was found.
        cell: grid spacing in mm, along x and y.
        rests: (80, 59, 3) rest image of each photograph, levels.
        seen: (80, 59, 3) what its contact changes, levels; drift of the light is taken out.
        masks: (80, 59) where it is compared, bool.
    """

    def __init__(
        self,
        gel: GelModel,
        photographs: Sequence[PressPhotograph],
        effects: Sequence[SensorEffect],
        pressed: Pressed | None = None,
    ):
        self.gel, self.photographs, self.pressed = gel, photographs, pressed
        self.effects = [e for e in effects if e.of_channels]
        self.cell = gel.cell_mm
        self.depths = [press_depth(registered(p.press, gel), gel) for p in photographs]
        self._residues = Residues(gel, [p.earlier for p in photographs])
        self.masks = [to_grid(p.near(gel.px_per_mm)) > 0.5 for p in photographs]
        self.rests = [to_grid(p.rest) for p in photographs]
        self.seen = []
        for p in photographs:
            if drift_known(gel):
                self.seen.append(to_grid(p.image / gains(gel, p.clock) - p.rest))
            else:
                drift = session_light(p, gel.px_per_mm)
                self.seen.append(to_grid(p.image.astype(np.float32) - p.rest) - drift)
        self.evaluations = 0

    def surfaces(self, decay_mm: float, depth_scale: float) -> list[np.ndarray]:
        """Displacement (80, 59) in mm under each photograph."""
        us = self._closed(decay_mm, depth_scale) if self.pressed is None else self._given(depth_scale)
        return [self.gel.surface(u, self.gel.cell_mm) for u in us]

    def _closed(self, decay_mm: float, depth_scale: float) -> list[np.ndarray]:
        gel = replace(self.gel, depth_scale=depth_scale)
        left = self._residues.surfaces(replace(gel, decay_mm=decay_mm))
        each = zip(self.depths, left, strict=True)
        return [pressed_on(gel.imprint(d), r, self.cell, decay_mm) for d, r in each]

    def _given(self, depth_scale: float) -> list[np.ndarray]:
        assert self.pressed is not None
        return [self.pressed(registered(p.press, self.gel), depth_scale) for p in self.photographs]

    def nearest_decay(self, depth_scale: float) -> float:
        """Decay in mm of the closed form that is nearest to the given surfaces, by least squares."""
        given = self._given(depth_scale)

        def off(log_decay: float) -> float:
            both = zip(self._closed(np.exp(log_decay), depth_scale), given, self.masks, strict=True)
            return sum(float(np.square(u - v)[m].sum()) for u, v, m in both)

        return float(np.exp(minimize_scalar(off, bounds=np.log(DECAY_RANGE_MM), method="bounded").x))

    def leftovers(self) -> list[Leftover]:
        """What the gel, as it is, leaves over of each photograph."""
        gel, out = self.gel, []
        each = zip(self.photographs, self.masks, self.seen, self.rests, strict=True)
        surfaces = self.surfaces(gel.decay_mm, gel.depth_scale)
        for u, (p, near, seen, rest) in zip(surfaces, each, strict=True):
            weight = gel.weight_on(rest)
            s = light_of(u, self.cell, *gel.lighting).transpose(1, 2, 0)
            contact = to_grid(p.near(gel.px_per_mm, CONTACT_DISC)) > 0.5
            args = u, self.cell, gel.coefficients, weight, seen - weight * s, near, contact
            out.append(Leftover.of(*args))
        return out

    def linear(self) -> np.ndarray:
        """L (3, 2) of the paper's model, with the depth term, by linear least squares."""
        us = self.surfaces(DECAY_MM, 1.0)
        rows = [np.stack([*gradient(u, self.cell), u], -1)[m] for u, m in zip(us, self.masks, strict=True)]
        seen = np.concatenate([s[m] for s, m in zip(self.seen, self.masks, strict=True)])
        return np.linalg.lstsq(np.concatenate(rows), seen, rcond=None)[0].T[:, :2]

    def best(self, makes: Sequence[Layout], near: GelModel | None, quick: bool) -> GelFit:
        """The fit of least cost, with a make's light or without; see `fit.fit_photographs`."""
        light, first = self.linear(), self.photographs[0]
        free = best = self.search(light, None, near, quick)
        by_rest, by_light, likeness = [], [], None
        lenders = {e.name for e in sensor_effects().values() if e.lend}
        for make in makes if lenders <= {e.name for e in self.effects} else ():
            orientation, alike = recognise_rest(self.gel.rest_image, make)
            likeness = max(likeness or 0.0, alike)
            if orientation is not None:
                by_rest.append((alike, make, orientation))
                continue
            size = self.gel.rest_image.shape[1::-1]
            alone = light if len(self.photographs) == 1 else slope_light(self.gel, first, self.pressed)
            orientation = recognise(alone, first.press.x_mm, first.press.y_mm, size, make)
            if orientation is not None:
                by_light.append((alike, make, orientation))
        likest = [max(by_rest, key=lambda m: m[0])] if by_rest else by_light
        for _, make, orientation in likest:
            made = self.search(light, orientation.of(make), near or free.gel, quick)
            trusted = made.cost < (TRUST_IN_REST if by_rest else TRUST_IN_MAKE) * free.cost
            if trusted and (best is free or made.cost < best.cost):
                made.make, made.orientation, made.by_rest, best = make.name, orientation, bool(by_rest), made
        best.evaluations, best.likeness = self.evaluations, likeness
        return best

    def search(self, light: np.ndarray, layout: Layout | None, near: GelModel | None, quick: bool) -> GelFit:
        """Nelder-Mead over decay, unless surfaces are given, and depth scale; channels solved at each."""
        channels = []
        for k in range(3):
            prior = priors(k, light[k], layout, self.effects)
            channels.append(Channel(k, self.effects, prior, self.cell, self.masks, self.seen, self.rests))
        of = slice(0 if self.pressed is None else 1, 2)
        low, high = np.log(np.transpose([DECAY_RANGE_MM, DEPTH_SCALE_RANGE]))[:, of]

        def solve(x: np.ndarray) -> float:
            self.evaluations += 1
            inside = np.clip(x, low, high)
            *decay, scale = np.exp(inside)
            surfaces = self.surfaces(*decay or [DECAY_MM], scale)
            outside = 1e3 * np.square(x - inside).sum()
            return (
                outside + 0.5 * (inside[-1] / DEPTH_SCALE_SD) ** 2 + sum(c.solve(surfaces) for c in channels)
            )

        start = np.log([DECAY_MM, 0.9] if near is None else [near.decay_mm, min(near.depth_scale, 0.98)])[of]
        size = np.array([0.4, -0.15])[of] * (1.0 if near is None else 0.3)
        options = {
            "initial_simplex": start + np.vstack([np.zeros(len(size)), np.diag(size)]),
            "xatol": 0.02,
            "fatol": 0.02,
            "maxfev": 40 if near is None else 6 if quick else 15,
        }
        found = minimize(solve, start, method="Nelder-Mead", options=options).x
        cost = solve(found)
        *decay, scale = np.exp(np.clip(found, low, high))
        decay_mm = decay[0] if decay else self.nearest_decay(scale)
        gel = replace(self.lit(channels), decay_mm=float(decay_mm), depth_scale=float(scale))
        return GelFit(gel, float(cost), self.evaluations, channels=channels)

    def lit(self, channels: Sequence[Channel]) -> GelModel:
        """The gel with light and effects of these channels."""
        rows = np.array([c.row for c in channels])
        effects = self.gel.effects | effects_of([c.values for c in channels], self.effects)
        return replace(
            self.gel, light=rows[:, :2], depth_light=rows[:, 2], effects=effects, lent=None, residual=None
        )
