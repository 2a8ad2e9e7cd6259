"""The least-squares problem of one colour channel, given the gel's surface under each photograph."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from pneutac_sim.effects.optics import CHANNELS, OPTICS, QUADRATIC
from pneutac_sim.gel import optics
from pneutac_sim.gel.layout import Layout

# What the model leaves over is smooth over a contact, so that a photograph counts as so many independent
# pixels of this error.
INDEPENDENT, ERROR_LEVELS = 100, 5.0

# Unknowns of a channel: light per unit slope and from where it comes, then those of the effects.
BASE = {"strength": (120.0, 120.0, 0.0, 2000.0), "direction": (), "depth_light": (0.0, 6.0, -60.0, 60.0)}
OF_EFFECT = {
    "exponent": ("rest_colour", "exponent_{}"),
    "distance": ("near_light", "distance_{}_mm"),
    "direct": ("photometric_nonlinearity", "direct_{}_levels"),
    "shadow": ("shadow", "shadow_{}_levels"),
    "elevation": ("shadow", "elevation_{}"),
    "edge": ("shadow", "edge_mm"),
    "along": ("photometric_nonlinearity", QUADRATIC[0]),
    "across": ("photometric_nonlinearity", QUADRATIC[1]),
    "deep": ("photometric_nonlinearity", QUADRATIC[2]),
}
NEUTRAL = {
    "exponent": 0.0,
    "distance": np.nan,
    "direct": np.inf,
    "shadow": 0.0,
    "elevation": 0.1,
    "edge": 0.1,
}
NEUTRAL |= {"along": 0.0, "across": 0.0, "deep": 0.0}
MAKE_SD = {"direction": 0.05, "distance": 2.0, "exponent": 0.05}  # how alike sensors of one make are


def priors(k: int, light: np.ndarray, layout: Layout | None, effects: Sequence[str]) -> dict[str, tuple]:
    """Unknown to its default, prior standard deviation (infinite for none), lower and upper bound.

    Args:
        k: channel.
        light: L of this channel (2,), roughly.
        layout: the make's lights, where it is known.
        effects: those that are fitted.
    """
    angle = np.arctan2(-light[1], -light[0])
    out = {"strength": BASE["strength"], "direction": (angle, np.inf), "depth_light": BASE["depth_light"]}
    for name, (effect, parameter) in OF_EFFECT.items():
        if effect in effects:
            i = [p.name for p in OPTICS[effect].parameters].index(parameter.format(CHANNELS[k]))
            p = OPTICS[effect].parameters[i]
            out[name] = (p.default, OPTICS[effect].prior_sd[i], p.lower, p.upper)
    if layout is not None:
        x, y = layout.positions_mm[k]
        out["direction"] = (np.arctan2(y, x), MAKE_SD["direction"])
        out["distance"] = (np.hypot(x, y), MAKE_SD["distance"], *out["distance"][2:])
        out["exponent"] = (layout.exponents[k], MAKE_SD["exponent"], *out["exponent"][2:])
    angle, sd = out["direction"]
    return out | {"direction": (angle, sd, angle - 3.2, angle + 3.2)}


def row(v: dict[str, float]) -> np.ndarray:
    """One channel's row of the coefficients of `optics.light`."""
    x, y, a, r = np.cos(v["direction"]), np.sin(v["direction"]), v["strength"], v["distance"]
    tail = [v[n] for n in ("direct", "shadow", "elevation", "edge", "along", "across", "deep")]
    return np.array([-a * x, -a * y, v["depth_light"], r * x, r * y, *tail])


def effects_of(values: Sequence[dict[str, float]], effects: Sequence[str]) -> dict[str, dict[str, float]]:
    """Effect to its parameters, from the unknowns of the three channels; a shadow's edge is their mean."""
    out: dict[str, dict[str, float]] = {}
    for name, (effect, parameter) in OF_EFFECT.items():
        if effect in effects:
            each = {parameter.format(c): float(v[name]) for c, v in zip(CHANNELS, values, strict=True)}
            out.setdefault(effect, {}).update(each)
    if "shadow" in out:
        out["shadow"]["edge_mm"] = float(np.mean([v["edge"] for v in values]))
    return out


class Channel:
    """One channel of some photographs on the probe grid; keeps its last solution as the next start.

    Args:
        k: channel.
        prior: see `priors`.
        cell_mm: grid spacing.
        masks: one (rows, columns) a photograph, where it is fitted.
        seen: (rows, columns, 3) what the contact changes, levels.
        rests: (rows, columns, 3) rest image.
    """

    def __init__(self, k: int, prior: dict, cell_mm, masks, seen, rests):
        self._prior, self._cell = prior, cell_mm
        self._default, self._sd, self._lower, self._upper = (
            np.array([p[i] for p in prior.values()], float) for i in range(4)
        )
        self._held = np.isfinite(self._sd)
        self._parts = []
        for mask, difference, rest in zip(masks, seen, rests, strict=True):
            bright = np.maximum(rest[..., k], 1.0)
            scale = np.sqrt(INDEPENDENT / max(mask.sum(), 1)) / ERROR_LEVELS
            box, centre = _box(mask, cell_mm)
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
        self._x = self._default

    @property
    def values(self) -> dict[str, float]:
        """The unknowns by name, those of absent effects at neutral."""
        return NEUTRAL | dict(zip(self._prior, self._x.tolist(), strict=True))

    def solve(self, surfaces: Sequence[np.ndarray]) -> float:
        """Fits to surfaces (rows, columns) in mm, one a photograph; returns the cost."""
        cropped = [np.ascontiguousarray(u[part[0]]) for u, part in zip(surfaces, self._parts, strict=True)]

        def residual(x: np.ndarray) -> np.ndarray:
            v = NEUTRAL | dict(zip(self._prior, x, strict=True))
            c, out = row(v), [((x - self._default) / self._sd)[self._held]]
            for u, (_, centre, mask, seen, bright, scale) in zip(cropped, self._parts, strict=True):
                s = optics.channel(u, self._cell, c - centre)[mask]
                out.append(scale * (np.exp(v["exponent"] * bright) * s - seen))
            return np.concatenate(out)

        start = np.clip(self._x, self._lower + 1e-6, self._upper - 1e-6)
        step = np.where(self._held, self._sd, 0.3)
        done = least_squares(
            residual,
            start,
            bounds=(self._lower, self._upper),
            x_scale=step,
            diff_step=1e-3,
            xtol=1e-4,
            ftol=1e-4,
        )
        self._x = done.x
        return float(done.cost)


def _box(mask: np.ndarray, cell_mm) -> tuple[tuple[slice, slice], np.ndarray]:
    """The part of the grid around a mask, and what to take from a row of coefficients to work in it alone."""
    rows, cols = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    centre = np.zeros(12)
    if not len(rows):
        return (slice(0, 2), slice(0, 2)), centre
    i0, i1 = max(rows[0] - 1, 0), min(rows[-1] + 2, mask.shape[0])
    j0, j1 = max(cols[0] - 1, 0), min(cols[-1] + 2, mask.shape[1])
    centre[3] = ((j0 + j1) / 2 - mask.shape[1] / 2) * cell_mm[0]
    centre[4] = ((i0 + i1) / 2 - mask.shape[0] / 2) * cell_mm[1]
    return (slice(i0, i1), slice(j0, j1)), centre
