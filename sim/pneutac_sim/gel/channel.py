"""The least-squares problem of one colour channel, given the gel's surface under each photograph."""

import copy
from collections.abc import Sequence

import numpy as np

from pneutac_sim.effects.sensor_effect import SensorEffect
from pneutac_sim.gel import optics
from pneutac_sim.gel.layout import Layout
from pneutac_sim.gel.model import further_light
from pneutac_sim.gel.residual import ERROR_LEVELS, INDEPENDENT
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
            lent = effect.lend(layout, k).items()
            out |= {(effect.name, n): (*prior, *out[effect.name, n][2:]) for n, prior in lent}
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
