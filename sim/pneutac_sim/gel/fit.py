"""Calibrates a gel: light, effects and mechanics, from one rest and one indentation image or more.

Given the surface, each channel is a least-squares problem of its own with up to twelve unknowns, tied to the
priors of its effects where the images do not identify them. Around that, a search finds how far the surface
recovers around a contact and how much of an imprint shows. All of it works on the probe grid, to which the
photographs are averaged: the light varies no faster, and noise drops out.

A session of photographs adds its drift of light, and contacts away from their stated place.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import lsq_linear, minimize, minimize_scalar

from pneutac_sim.effects.registry import in_order, of_sensor, sensor_effects
from pneutac_sim.effects.sensor_effect import Quiet, SensorEffect
from pneutac_sim.effects.shadow import cast
from pneutac_sim.gel import optics
from pneutac_sim.gel.contact import quiet_threshold
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.layout import DIGIT, Layout, Orientation, recognise, recognise_rest
from pneutac_sim.gel.model import GelModel, further_light
from pneutac_sim.gel.pair import CONTACT_DISC, FAR_ENOUGH, PressPhotograph, check_pair, to_grid
from pneutac_sim.gel.photograph import (
    Pressed,
    Residues,
    contact_light,
    drift_known,
    gains,
    press_depth,
    registered,
    smooth_part,
)
from pneutac_sim.gel.probe import COLS, ROWS, THICKNESS_MM
from pneutac_sim.gel.residual import ERROR_LEVELS, INDEPENDENT, Leftover, faded, learn, levels, trusted_share
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
            log_rest = np.log(bright / bright.mean())[mask]
            self._parts.append((box, centre, mask[box], difference[..., k][mask], log_rest, scale))
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
            if self._x[i] - step > self._lower[i]:  # an effect may begin with a jump there
                low[i] -= step
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
        changes: (80, 59, 3) difference of each photograph to its rest image, levels, by one brightness.
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
        self.changes = [to_grid(p.image / gains(gel, p.clock) - p.rest) for p in photographs]
        self.seen = []
        for i, (change, left) in enumerate(zip(self.changes, self.left(gel), strict=True)):
            light = 0 if left is None else self.contact_light(gel, i, left)
            self.seen.append(light + self.without_drift(i, change - light))
        self.evaluations = 0

    def contact_light(self, gel: GelModel, i: int, left_mm: np.ndarray | None) -> np.ndarray:
        """What the press of photograph i changes, (80, 59, 3) levels."""
        return contact_light(gel, self.photographs[i].press, left_mm) * gel.weight_on(self.rests[i])

    def without_drift(self, i: int, change: np.ndarray) -> np.ndarray:
        """A change of photograph i, (80, 59, 3) levels, without what may be drift of the session's light."""
        if drift_known(self.gel):
            return change
        return change - smooth_part(change, self.photographs[i], self.gel.px_per_mm)

    def surfaces(self, decay_mm: float, depth_scale: float) -> list[np.ndarray]:
        """Displacement (80, 59) in mm under each photograph."""
        us = self._closed(decay_mm, depth_scale) if self.pressed is None else self._given(depth_scale)
        return [self.gel.surface(u, self.gel.cell_mm) for u in us]

    def _closed(self, decay_mm: float, depth_scale: float) -> list[np.ndarray]:
        gel = replace(self.gel, depth_scale=depth_scale)
        left = self.left(replace(gel, decay_mm=decay_mm))
        each = zip(self.depths, left, strict=True)
        return [pressed_on(gel.imprint(d), r, self.cell, decay_mm) for d, r in each]

    def left(self, gel: GelModel) -> list[np.ndarray | None]:
        """What earlier presses left under each photograph, (80, 59) mm by this gel's mechanics."""
        return self._residues.surfaces(gel)

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
        both = zip(us, self.masks, strict=True)
        rows = [np.stack([*optics.gradient(u, self.cell), u], -1)[m] for u, m in both]
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
            prior = 1e3 * np.square(x - inside).sum() + 0.5 * (inside[-1] / DEPTH_SCALE_SD) ** 2
            return prior + sum(c.solve(surfaces) for c in channels)

        start = np.log([DECAY_MM, 0.9] if near is None else [near.decay_mm, min(near.depth_scale, 0.98)])[of]
        size = np.array([0.4, -0.15])[of] * (1.0 if near is None else 0.3)
        simplex, most = (
            start + np.vstack([0 * size, np.diag(size)]),
            40 if near is None else 6 if quick else 15,
        )
        options = {"initial_simplex": simplex, "xatol": 0.02, "fatol": 0.02, "maxfev": most}
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
        bare = replace(self.gel, prior_residual=None, residual=None)
        return replace(bare, light=rows[:, :2], depth_light=rows[:, 2], effects=effects)


# By which a press is moved to see what changes: about half a cell, since an indenter with a sharp edge covers
# whole cells alone.
MOVED_MM, DEEPER_MM = 0.1, 0.02
SHALLOWEST_MM = 0.02  # to which a press may be corrected
LEFT_RADII = 2.0  # contact radii of an earlier press within which it is looked for what is left of it
STEP = 1e-3  # of a parameter's range, where its effect does not say how far to move it


def estimate_gains(
    gel: GelModel, effects: Sequence[SensorEffect], photographs: Sequence[PressPhotograph]
) -> dict[str, dict[str, float]]:
    """Values of those effects that have a gain, from the pixels away from the contacts."""
    quiet = []
    for p in photographs if any(e.estimate for e in effects) else ():
        far = p.far(gel.px_per_mm)
        if far.mean() > FAR_ENOUGH:
            quiet.append(Quiet(p.clock, to_grid(p.rest)[far], to_grid(p.image)[far]))
    return {e.name: e.estimate(quiet) for e in effects if e.estimate is not None}


def refine_contacts(
    gel: GelModel, effects: Sequence[SensorEffect], problem: Problem
) -> dict[str, dict[str, float]]:
    """One Gauss-Newton step of effects on the contacts from what the gel has, all else as it is.

    Minimises |(predicted - seen) / error|^2 + |(x - neutral) / prior_sd|^2 linearised at the present x.
    Returns effect to its values.
    """
    photographs, late = problem.photographs, any(e.late for e in effects)
    specs = [(e, p) for e in effects for p in e.parameters]
    neutral = np.array([p.neutral for _, p in specs])
    now = np.array([gel.effects[e.name][p.name] for e, p in specs])
    reach = max(1.0, *(np.hypot(p.press.x_mm, p.press.y_mm) for p in photographs))
    plain = [[STEP * (p.upper - p.lower) for p in e.parameters] for e in effects]
    steps = [e.steps(reach) if e.steps else own for e, own in zip(effects, plain, strict=True)]
    steps = np.concatenate(steps).astype(float)

    def values(x: np.ndarray) -> dict[str, dict[str, float]]:
        out: dict[str, dict[str, float]] = {}
        for (e, p), value in zip(specs, x.tolist(), strict=True):
            out.setdefault(e.name, {})[p.name] = value
        return out

    def left_over(x: np.ndarray) -> list[np.ndarray]:
        moved = replace(gel, effects=gel.effects | values(x))
        out = []
        for i, p in enumerate(photographs):
            left = Residues(moved, [p.earlier]).surfaces(moved)[0]
            light = problem.contact_light(moved, i, left)
            # earlier presses may lie where this photograph's drift is read off
            off = problem.without_drift(i, problem.changes[i] - light) if late else problem.seen[i] - light
            out.append(off)
        return out

    base = left_over(now)
    moved = [left_over(now + step * unit) for step, unit in zip(steps, np.eye(len(now)), strict=True)]
    sd = np.concatenate([e.prior_sd for e in effects])
    A, b = [np.diag(1 / sd)], [(neutral - now) / sd]
    for j, near in enumerate(problem.masks):
        scale = np.sqrt(INDEPENDENT / max(near.sum(), 1)) / ERROR_LEVELS
        mask = near | _left_in(gel, photographs[j]) if late else near
        slopes = [((base[j] - m[j]) / step)[mask].ravel() for m, step in zip(moved, steps, strict=True)]
        A.append(scale * np.stack(slopes, -1))
        b.append(scale * base[j][mask].ravel())
    M, y = np.concatenate(A), np.concatenate(b)
    low, high = np.array([(p.lower, p.upper) for _, p in specs]).T
    # branches are much alike: without bounds one would stand against another
    step = lsq_linear(M, y, (low - now, high - now)).x if late else np.linalg.lstsq(M, y, rcond=None)[0]
    return {e.name: e.inside(v) for e, v in zip(effects, values(now + step).values(), strict=True)}


def refine_press(gel: GelModel, problem: Problem, i: int, stated: Press) -> Press:
    """One Gauss-Newton step of what is uncertain of the press of photograph i, all else as it is.

    Minimises |(predicted - seen) / error|^2 + |(x - stated) / sd|^2; the step is halved until it does.
    """
    photograph, mask, seen = problem.photographs[i], problem.masks[i], problem.seen[i]
    now, names, sd = photograph.press, list(photograph.sd), np.array(list(photograph.sd.values()))
    weight, scale = gel.weight_on(problem.rests[i]), np.sqrt(INDEPENDENT / max(mask.sum(), 1)) / ERROR_LEVELS

    def moved(by: np.ndarray) -> Press:
        values = {n: getattr(now, n) + b for n, b in zip(names, by.tolist(), strict=True)}
        return replace(now, **values | {"depth_mm": max(values.get("depth_mm", now.depth_mm), SHALLOWEST_MM)})

    left = problem.left(gel)[i]

    def residual(press: Press) -> np.ndarray:
        s = contact_light(gel, press, left)
        off = np.array([getattr(press, n) - getattr(stated, n) for n in names]) / sd
        return np.concatenate([scale * (s * weight - seen)[mask].ravel(), off])

    turned = MOVED_MM / max(now.contact_radius_mm, MOVED_MM)
    steps = {"x_mm": MOVED_MM, "y_mm": MOVED_MM, "depth_mm": DEEPER_MM, "yaw_rad": turned}
    units = np.diag([steps.get(n, DEEPER_MM / MOVED_MM * turned) for n in names])
    slopes = [(residual(moved(h)) - residual(moved(-h))) / (2 * h.max()) for h in units]
    here = residual(now)
    step = np.linalg.lstsq(np.stack(slopes, -1), -here, rcond=None)[0]
    for share in (1.0, 0.5, 0.25):
        there = residual(moved(share * step))
        if there @ there < here @ here:
            return moved(share * step)
    return now


def _left_in(gel: GelModel, photograph: PressPhotograph) -> np.ndarray:
    """Cells (80, 59) where earlier presses may have left something."""
    near = [replace(photograph, press=e.press).near(gel.px_per_mm, LEFT_RADII) for e in photograph.earlier]
    return to_grid(np.any(near, axis=0)) > 0.5 if near else np.zeros((ROWS, COLS), bool)


SHARES = (0.0, 0.25, 0.5)  # of a make's field: two DIGITs have half of what is left over in common


def add_prior_field(make: Layout, problem: Problem, fit: GelFit) -> None:
    """Adds to a fit, in place, the share of its make's field that explains its presses best.

    The light is fitted again. The field is in proportion to the light's strength. What it explains is taken
    out of what the photographs of the problem show.
    """
    prior = make.prior_field(fit.gel.rest_image, fit.orientation)
    if prior is None:
        return
    gel, seen = fit.gel, problem.seen
    prior = prior.times(float(np.linalg.norm(gel.light)))
    surfaces, rows = problem.surfaces(gel.decay_mm, gel.depth_scale), gel.coefficients
    added = []
    for u, rest in zip(surfaces, problem.rests, strict=True):
        each = levels([prior], u, problem.cell, [cast(u, *problem.cell, row) for row in rows])
        added.append(each.transpose(1, 2, 0) * faded(gel.weight_on(rest)))
    costs, tried = [], []
    for share in SHARES:
        less = [s - share * a for s, a in zip(seen, added, strict=True)]
        channels = [c.seeing(less) for c in fit.channels]
        costs.append(sum(c.solve(surfaces) for c in channels))
        tried.append((less, channels))
    best = int(np.argmin(costs))
    fit.prior_share = SHARES[best]
    if fit.prior_share:
        problem.seen, fit.channels = tried[best]
        fit.gel = problem.gel = problem.lit(fit.channels)
        fit.gel.prior_residual = prior.times(fit.prior_share)


def learn_residual(problem: Problem, fit: GelFit) -> None:
    """Adds to a fit, in place, the residual field of its presses, weighted by leave-one-out prediction.

    The light is re-fitted without the one, since it would know it too well.
    """
    surfaces, tried = problem.surfaces(fit.gel.decay_mm, fit.gel.depth_scale), []
    for i in range(len(surfaces)):
        problem.gel = problem.lit([c.without(i, surfaces) for c in fit.channels])
        others = problem.leftovers()
        one = others.pop(i)
        tried.append((learn(others), one))
    problem.gel = problem.lit(fit.channels)
    share = trusted_share(tried)
    if share:
        fit.gel.residual = learn(problem.leftovers()).times(share)


# One photograph shows noise and compression, but not how far the light drifts until the next.
MIN_THRESHOLD_LEVELS = 6.0
SHADOW = "shadow"
FIELD_PRESSES = 5  # from which on the residual is learnt; three predict one another too poorly
CONTACT_ROUNDS = 4  # of light and contacts in turn, where an effect changes these or presses are uncertain


def fit_presses(
    presses: Sequence[PressPhotograph],
    px_per_mm: float,
    effects: Sequence[str] | None = None,
    thickness_mm: float = THICKNESS_MM,
    makes: Sequence[Layout] = (DIGIT,),
    pressed: Pressed | None = None,
    known: dict[str, dict[str, float]] | None = None,
) -> GelFit:
    """Fits a gel to one press or several, whose lights are the same and whose drifts are each one's own.

    Without effects this is the paper's linear model. A recognised sensor model has a prior from the residuals
    of its other sensors; from five presses on what it leaves over of these is learnt too, see
    `learn_residual`.

    Args:
        presses: of one gel; the first one's rest image becomes the gel's.
        px_per_mm: scale of the images.
        effects: to fit; None for those of every sensor. Of a make that nobody knows one press shows no shadow
            apart from the light, and a shadow that nobody saw spoils other images: it needs a second press.
        thickness_mm: gel thickness.
        makes: sensors whose lights are known.
        pressed: gives the surfaces, such as `mpm.pressed.PressedGel.between`; None for the closed form. The
            gel's decay is then that of the closed form nearest to them.
        known: values of effects that stay where the presses do not identify them, see `fit_photographs`.

    Raises InputError: a pair is no rest and indentation image, see `check_pair`.
    """
    for p in presses:
        check_pair(p.rest, p.image, p.press, px_per_mm)
    gel = GelModel(
        presses[0].rest, np.zeros((3, 2)), np.zeros(3), px_per_mm, thickness_mm, effects=known or {}
    )
    names = standard_effects() if effects is None else effects
    fit = fit_photographs(gel, presses, names, makes, pressed=pressed)
    if effects is None and not fit.make and len(presses) == 1:
        names = [e for e in names if e != SHADOW]
        fit = fit_photographs(gel, presses, names, makes, pressed=pressed)
    make = next((m for m in makes if m.name == fit.make), None)
    enough = len(presses) >= FIELD_PRESSES
    if names and pressed is None and (make or enough):
        found = [replace(p, press=press) for p, press in zip(presses, fit.presses, strict=True)]
        problem = Problem(fit.gel, found, in_order(of_sensor(names)))
        fit.leftovers = problem.leftovers() if enough else []
        if make:
            add_prior_field(make, problem, fit)
        if enough:
            learn_residual(problem, fit)
    return fit


def standard_effects() -> list[str]:
    """What a sensor has whose light nobody has looked at yet."""
    return [name for name, effect in sensor_effects().items() if effect.standard]


def fit_photographs(
    gel: GelModel,
    photographs: Sequence[PressPhotograph],
    effects: Sequence[str],
    makes: Sequence[Layout] = (DIGIT,),
    near: GelModel | None = None,
    quick: bool = False,
    pressed: Pressed | None = None,
) -> GelFit:
    """Fits light, mechanics and these effects again.

    Args:
        gel: gives size, scale and thickness, and the values of effects of which the photographs show
            nothing since no press came before.
        photographs: checked pairs of images; what is uncertain of their presses is found with the light.
        effects: of the sensor, to fit.
        makes: sensors whose lights are known.
        near: a fit with almost the same effects; the search stays around its mechanics.
        quick: whether `near` has the same effects and almost the same photographs, so that few steps do.
        pressed: see `fit_presses`; presses stay where they are stated.
    """
    chosen, known = in_order(of_sensor(effects)), gel.effects
    gel = replace(gel, effects=estimate_gains(gel, chosen, photographs))
    history = any(p.earlier for p in photographs)
    not_shown = [e for e in chosen if e.late and e.name in known and not history]
    gel.effects |= {e.name: known[e.name] for e in not_shown}
    of_contacts = [e for e in chosen if e.stage == "gel" and e not in not_shown]
    gel.effects |= {e.name: {p.name: p.neutral for p in e.parameters} for e in of_contacts}
    stated = [p.press for p in photographs]
    uncertain = pressed is None and any(p.sd for p in photographs)
    for left in reversed(range(CONTACT_ROUNDS if of_contacts or uncertain else 1)):
        problem = Problem(gel, photographs, chosen, pressed)
        best = problem.best(makes, near, quick=quick or left > 0)
        if left:
            near = best.gel
            gel = replace(near, effects=dict(near.effects))
            if of_contacts:
                gel.effects |= refine_contacts(near, of_contacts, problem)
            if uncertain:
                photographs = [
                    replace(p, press=refine_press(near, problem, i, stated[i])) if p.sd else p
                    for i, p in enumerate(photographs)
                ]
    best.presses = [p.press for p in photographs]
    quiet = [(p.image - p.rest.astype(np.float32), ~p.near(gel.px_per_mm)) for p in photographs]
    levels = [quiet_threshold(difference, far) for difference, far in quiet if far.any()]
    if levels:
        best.gel.threshold_levels = max(MIN_THRESHOLD_LEVELS, float(np.median(levels)))
    return best
