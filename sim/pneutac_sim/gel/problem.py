"""Light and mechanics of a gel as one least-squares problem of some photographs, and what a fit found.

Given the surface under each photograph, each colour channel is a least-squares problem of its own.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from pneutac_sim.effects.registry import sensor_effects
from pneutac_sim.effects.sensor_effect import SensorEffect
from pneutac_sim.gel import optics
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.layout import Layout, Orientation, recognise, recognise_rest
from pneutac_sim.gel.model import GelModel, further_light
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
from pneutac_sim.gel.residual import ERROR_LEVELS, INDEPENDENT, Leftover
from pneutac_sim.gel.sensor import pressed_on
from pneutac_sim.gel.surface import DECAY_MM
from pneutac_sim.least_squares import minimise

DIFFERENCE = 1e-2  # of a prior's deviation, by which an unknown is moved to see what the light does

# Unknowns of a channel besides those of effects: default, prior's deviation, bounds. The light is so many
# levels per unit slope and comes from a direction.
STRENGTH, DEPTH_LIGHT = (120.0, 120.0, 0.0, 2000.0), (0.0, 6.0, -60.0, 60.0)

Unknown = tuple[str, str]  # effect (empty for the light itself) and name without the channel


def priors(
    k: int, light: np.ndarray, layout: Layout | None, effects: Sequence[SensorEffect]
) -> dict[Unknown, tuple[float, float, float, float]]:
    """Unknown of channel k to its default, its prior's deviation (infinite for none) and its bounds.

    `light` is L (2,) of this channel, roughly; `layout` the make's lights, where it is known; `effects` are
    those that are fitted with the channel.
    """
    angle, sd = np.arctan2(-light[1], -light[0]), np.inf
    if layout is not None:
        x, y = layout.positions_mm[k]
        angle, sd = np.arctan2(y, x), layout.directions_sd_rad[k]
    out = {
        ("", "strength"): STRENGTH,
        ("", "direction"): (angle, sd, angle - 3.2, angle + 3.2),
        ("", "depth_light"): DEPTH_LIGHT,
    }
    # Factors of whole pixels first and what starts at nothing last: the order decides rounding alone.
    unknowns = [(e, *unknown) for e in effects for unknown in e.of_channel(k)]
    for effect, name, p, sd in sorted(
        unknowns, key=lambda u: (u[2].default == u[2].neutral, not u[0].weight)
    ):
        out[effect.name, name] = (p.default, sd, p.lower, p.upper)
    for effect in effects:
        if layout is not None and effect.lend is not None:
            found = effect.lend(layout, k).items()
            out |= {(effect.name, n): (*prior, *out[effect.name, n][2:]) for n, prior in found}
    return out


def effects_of(
    values: Sequence[dict[Unknown, float]], effects: Sequence[SensorEffect]
) -> dict[str, dict[str, float]]:
    """Effect to its parameters, from the unknowns of the three channels; what they share is their mean."""
    out = {}
    for effect in effects:
        found: dict[str, list[float]] = {p.name: [] for p in effect.parameters}
        for k, v in enumerate(values):
            for name, p, _ in effect.of_channel(k):
                found[p.name].append(v[effect.name, name])
        out[effect.name] = {name: float(np.mean(each)) for name, each in found.items()}
    return out


class Channel:
    """Channel k of some photographs on the probe grid; keeps its last solution as the next start.

    Of each photograph: where it is fitted, `masks` (rows, columns); what the contact changes, `seen` (rows,
    columns, 3) levels; and its rest image, `rests` (rows, columns, 3).

    Attributes:
        prior: see `priors`.
    """

    def __init__(self, k: int, effects: Sequence[SensorEffect], prior: dict, cell_mm, masks, seen, rests):
        self._k, self._effects, self.prior, self._cell = k, effects, prior, cell_mm
        self._default, self._sd, self._lower, self._upper = (
            np.array([p[i] for p in prior.values()], float) for i in range(4)
        )
        self._with_prior = np.isfinite(self._sd)
        whole = any(e.light for e in effects)  # which may depend on where a cell lies
        self._parts = []
        for mask, difference, rest in zip(masks, seen, rests, strict=True):
            bright = np.maximum(rest[..., k], 1.0)
            scale = np.sqrt(INDEPENDENT / max(mask.sum(), 1)) / ERROR_LEVELS
            box, centre = _box(np.ones_like(mask) if whole else mask, cell_mm)
            self._parts.append(
                (
                    box,
                    centre,
                    mask[box],
                    difference[..., k][mask],
                    np.log(bright / bright.mean())[mask],
                    scale,
                )
            )
        self._x, self._information = self._default, np.diag(1 / self._sd**2)

    @property
    def values(self) -> dict[Unknown, float]:
        return dict(zip(self.prior, self._x.tolist(), strict=True))

    @property
    def row(self) -> np.ndarray:
        """The coefficients (12,) of `optics.light` as found."""
        return self.light(self._x)[0]

    def _of_effects(self, x: np.ndarray) -> dict[str, dict[str, float]]:
        out: dict[str, dict[str, float]] = {e.name: {} for e in self._effects}
        for (effect, name), value in zip(self.prior, x, strict=True):
            if effect:
                out[effect][name] = value
        return out

    def light(self, x: np.ndarray) -> tuple[np.ndarray, list[optics.Further]]:
        """The row (12,) of `optics.light` and what acts after it, of unknowns x (F,)."""
        strength, direction, depth_light = x[:3]
        towards, of = np.array([np.cos(direction), np.sin(direction)]), self._of_effects(x)
        acting = [(e, of[e.name]) for e in self._effects]
        row = optics.row(-strength * towards, depth_light, towards, acting)
        further = [further_light(e, lambda k, e=e: of[e.name]) for e in self._effects if e.light]
        return row, further

    def _weight(self, x: np.ndarray, log_rest: np.ndarray) -> np.ndarray | float:
        factor, of = 1.0, self._of_effects(x)
        for effect in self._effects:
            if effect.weight is not None:
                factor = factor * effect.weight(log_rest, of[effect.name])
        return factor

    def solve(self, surfaces: Sequence[np.ndarray]) -> float:
        """Fits to surfaces (rows, columns) in mm, one a photograph; returns the cost."""
        cropped = [np.ascontiguousarray(u[part[0]]) for u, part in zip(surfaces, self._parts, strict=True)]
        size = self._upper - self._lower

        def residual(v: np.ndarray) -> np.ndarray:
            x = self._lower + size * v
            c, further = self.light(x)
            out = []
            for u, (_, centre, mask, seen, log_rest, scale) in zip(cropped, self._parts, strict=True):
                s = optics.channel(u, self._cell, c - centre, self._k, further)[mask]
                out.append(scale * (self._weight(x, log_rest) * s - seen))
            return np.concatenate(out)

        def jacobian(v: np.ndarray) -> np.ndarray:
            here = residual(v)
            steps = np.where(v + step < 1, step, -step)
            return np.stack([(residual(v + h) - here) / h.sum() for h in np.diag(steps)], -1)

        step = DIFFERENCE * np.where(self._with_prior, self._sd, 0.3) / size
        prior = (self._default - self._lower) / size, np.diag((size / self._sd) ** 2)
        found = minimise(residual, jacobian, (self._x - self._lower) / size, tolerance=1e-4, prior=prior)
        self._x = self._lower + size * found.v
        J = jacobian(found.v) / size
        self._information = J.T @ J + np.diag(1 / self._sd**2)
        return found.cost / 2

    def seeing(self, seen: Sequence[np.ndarray]) -> "Channel":
        """This channel with other differences, (rows, columns, 3) each, at the same solution."""
        out = copy.copy(self)
        out._parts = [
            (box, centre, mask, difference[..., self._k][box][mask], *rest)
            for (box, centre, mask, _, *rest), difference in zip(self._parts, seen, strict=True)
        ]
        return out

    def without(self, i: int, surfaces: Sequence[np.ndarray]) -> "Channel":
        """This channel re-fitted without photograph i, to the surfaces of all of them."""
        out = copy.copy(self)
        out._parts = self._parts[:i] + self._parts[i + 1 :]
        out.solve([*surfaces[:i], *surfaces[i + 1 :]])
        return out

    @property
    def covariance(self) -> np.ndarray:
        """Of the unknowns (F, F) about the solution, (J^T J + 1 / sd^2)^-1."""
        return np.linalg.pinv(self._information)

    def deviations(self) -> dict[Unknown, float]:
        """Unknown to the standard deviation that the photographs and the priors leave it."""
        return dict(zip(self.prior, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def learnt(self) -> dict[Unknown, float]:
        """Unknown to the share of its prior's variance that the photographs removed, where it has a prior."""
        share = 1 - np.diag(self.covariance) / self._sd**2
        return {k: float(s) for k, s, has in zip(self.prior, share, self._with_prior, strict=True) if has}

    def gram(self, displacement_mm: np.ndarray, rest: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """Mean of g g^T (F, F) over a mask, g the derivatives of the predicted light by the unknowns.

        Under a surface (rows, columns) in mm and with a rest image in levels. With the covariance S, trace(g
        g^T S) is the light's variance in levels^2.
        """
        u = np.ascontiguousarray(displacement_mm, np.float32)
        bright = np.maximum(rest, 1.0)
        log_rest = np.log(bright / bright.mean())

        def predicted(x: np.ndarray) -> np.ndarray:
            c, further = self.light(x)
            return self._weight(x, log_rest) * optics.channel(u, self._cell, c, self._k, further)

        slopes = []
        for i, step in enumerate(0.05 * np.sqrt(np.diag(self.covariance)) + 1e-9):
            low, high = self._x.copy(), self._x.copy()
            low[i] -= (
                step if self._x[i] - step > self._lower[i] else 0
            )  # an effect may begin with a jump there
            high[i] += step if self._x[i] + step < self._upper[i] or low[i] == high[i] else 0
            slopes.append((predicted(high) - predicted(low)) / (high[i] - low[i]))
        slope = np.stack(slopes, -1)[mask]
        return slope.T @ slope / max(len(slope), 1)


def _box(mask: np.ndarray, cell_mm) -> tuple[tuple[slice, slice], np.ndarray]:
    """The part of the grid around a mask, and what to take from a row of coefficients to work in it alone."""
    rows, cols = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    centre = np.zeros(optics.SIZE)
    if not len(rows):
        return (slice(0, 2), slice(0, 2)), centre
    i0, i1 = max(rows[0] - 1, 0), min(rows[-1] + 2, mask.shape[0])
    j0, j1 = max(cols[0] - 1, 0), min(cols[-1] + 2, mask.shape[1])
    centre[3] = ((j0 + j1) / 2 - mask.shape[1] / 2) * cell_mm[0]
    centre[4] = ((i0 + i1) / 2 - mask.shape[0] / 2) * cell_mm[1]
    return (slice(i0, i1), slice(j0, j1)), centre


DECAY_RANGE_MM = (0.3, 4.0)  # from a skin-thin layer to nearly Hertz' half-space on a 16 mm window
DEPTH_SCALE_RANGE = (0.5, 1.0)
DEPTH_SCALE_SD = 0.2  # of the logarithm: stated depths are mostly estimates

# A sensor model's light is used even at several times the cost: the misfit of a single pair is mostly the
# model's own error, and on two real DIGITs keeping it predicts other images better.
TRUST_IN_MAKE = 3.0
TRUST_IN_REST = 10.0  # the same where the rest image identifies the sensor model


@dataclass
class GelFit:
    """What a fit found."""

    gel: GelModel  # the calibrated gel at the images' own resolution
    cost: float  # half the sum of squares, with priors, that the fit made least
    evaluations: int  # how many surfaces were tried
    make: str = ""  # the sensor's make, where its light was recognised
    # which way round its images are against the make's
    orientation: Orientation = field(default_factory=Orientation)
    # correlation of the rest image with the likest make's; None where no make was looked for
    likeness: float | None = None
    # whether the rest image identified the sensor model; else the less certain directions of the light did
    by_rest: bool = False
    channels: list[Channel] = field(default_factory=list, repr=False)  # as solved, red, green and blue
    # where the photographs' presses were found to be, within what is uncertain of them
    presses: list[Press] = field(default_factory=list, repr=False)
    # what the light alone leaves over of each, where there are enough to learn from
    leftovers: list[Leftover] = field(default_factory=list, repr=False)
    prior_share: float = 0.0  # share of the prior residual field that was taken
    # whether its light was refined through splats, see `splat.refine`; None where nobody tried
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
            s = optics.light(u, self.cell, *gel.lighting).transpose(1, 2, 0)
            contact = to_grid(p.near(gel.px_per_mm, CONTACT_DISC)) > 0.5
            args = u, self.cell, gel.coefficients, weight, seen - weight * s, near, contact
            out.append(Leftover.of(*args))
        return out

    def linear(self) -> np.ndarray:
        """L (3, 2) of the paper's model, with the depth term, by linear least squares."""
        us = self.surfaces(DECAY_MM, 1.0)
        rows = [
            np.stack([*optics.gradient(u, self.cell), u], -1)[m] for u, m in zip(us, self.masks, strict=True)
        ]
        seen = np.concatenate([s[m] for s, m in zip(self.seen, self.masks, strict=True)])
        return np.linalg.lstsq(np.concatenate(rows), seen, rcond=None)[0].T[:, :2]

    def best(self, makes: Sequence[Layout], near: GelModel | None, quick: bool) -> GelFit:
        """The fit of least cost, with a make's light or without; see `fit.fit_photographs`."""
        light, first = self.linear(), self.photographs[0]
        free = best = self.search(light, None, near, quick)
        by_rest, by_light, likeness = [], [], None
        with_priors = {e.name for e in sensor_effects().values() if e.lend}
        for make in makes if with_priors <= {e.name for e in self.effects} else ():
            orientation, match = recognise_rest(self.gel.rest_image, make)
            likeness = max(likeness or 0.0, match)
            if orientation is not None:
                by_rest.append((match, make, orientation))
                continue
            size = self.gel.rest_image.shape[1::-1]
            alone = light if len(self.photographs) == 1 else slope_light(self.gel, first, self.pressed)
            orientation = recognise(alone, first.press.x_mm, first.press.y_mm, size, make)
            if orientation is not None:
                by_light.append((match, make, orientation))
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
            self.gel,
            light=rows[:, :2],
            depth_light=rows[:, 2],
            effects=effects,
            prior_residual=None,
            residual=None,
        )
