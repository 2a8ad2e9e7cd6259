"""Fits what a session of photographs adds: its drift of light, and contacts beside their stated place."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pneutac_sim.effects.optics import CHANNELS, OPTICS
from pneutac_sim.gel.channel import ERROR_LEVELS, INDEPENDENT
from pneutac_sim.gel.model import GelModel, rest_weight
from pneutac_sim.gel.optics import light
from pneutac_sim.gel.photograph import PressPhotograph, press_depth, registered, to_grid
from pneutac_sim.gel.probe import COLS, ROWS
from pneutac_sim.gel.surface import surface

GAIN_SD = 0.01  # how far the brightness of one photograph may be off a steady drift
STEP_MM = 0.05  # by which presses are moved to see what the images do


def fit_drift(gel: GelModel, photographs: Sequence[PressPhotograph]) -> dict[str, float]:
    """Parameters of `illumination_drift`, from the pixels away from the contacts."""
    effect = OPTICS["illumination_drift"]
    sd = np.array(effect.prior_sd).reshape(2, 3)
    gain, drift = {}, {}
    for k, c in enumerate(CHANNELS):
        A, b = [np.diag(1 / sd[:, k])], [np.zeros(2)]
        for p in photographs:
            far = p.far(gel.px_per_mm)
            if far.mean() > 0.1:
                rest, image = to_grid(p.rest)[..., k][far], to_grid(p.image)[..., k][far]
                A.append(np.array([[1.0, p.clock]]) / GAIN_SD)
                b.append([((image * rest).sum() / max((rest * rest).sum(), 1e-9) - 1) / GAIN_SD])
        x = np.linalg.lstsq(np.concatenate(A), np.concatenate(b), rcond=None)[0]
        gain[f"gain_{c}"], drift[f"drift_{c}"] = 1 + float(x[0]), float(x[1])
    found = gain | drift
    return {p.name: min(max(found[p.name], p.lower), p.upper) for p in effect.parameters}


def unregistered() -> dict[str, float]:
    """Parameters of `registration_shift` that leave every contact where the recording says."""
    return {p.name: p.neutral for p in OPTICS["registration_shift"].parameters}


def fit_registration(
    gel: GelModel,
    photographs: Sequence[PressPhotograph],
    masks: Sequence[np.ndarray],
    seen: Sequence[np.ndarray],
    rests: Sequence[np.ndarray],
) -> dict[str, float]:
    """One Gauss-Newton step of `registration_shift` from what the gel has, all else held.

    Args:
        gel: fitted with the presses where it thinks them now.
        photographs: n of them.
        masks: (80, 59) each, where they are compared.
        seen: (80, 59, 3) each, what the contacts change, levels.
        rests: (80, 59, 3) each, rest images.
    """
    specs = OPTICS["registration_shift"].parameters
    sd = np.array(OPTICS["registration_shift"].prior_sd)
    names, neutral = [p.name for p in specs], np.array([p.neutral for p in specs])
    now = np.array([gel.effects["registration_shift"][n] for n in names])
    cell = gel.window_mm[0] / COLS, gel.window_mm[1] / ROWS
    exponents = np.zeros(3)
    if "rest_colour" in gel.effects:
        exponents = np.array([gel.effects["rest_colour"][f"exponent_{c}"] for c in CHANNELS])

    def predicted(x: np.ndarray) -> list[np.ndarray]:
        moved = replace(gel, effects=gel.effects | {"registration_shift": dict(zip(names, x, strict=True))})
        out = []
        for p, rest in zip(photographs, rests, strict=True):
            u = surface(moved.imprint(press_depth(registered(p.press, moved), moved)), cell, gel.decay_mm)
            out.append(light(u, cell, gel.coefficients).transpose(1, 2, 0) * rest_weight(rest, exponents))
        return out

    reach = max(1.0, *(np.hypot(p.press.x_mm, p.press.y_mm) for p in photographs))
    steps = STEP_MM / np.array([1.0, 1.0, reach, reach])
    base = predicted(now)
    moved = [predicted(now + step * unit) for step, unit in zip(steps, np.eye(4), strict=True)]
    A, b = [np.diag(1 / sd)], [(neutral - now) / sd]
    for j, (mask, difference) in enumerate(zip(masks, seen, strict=True)):
        scale = np.sqrt(INDEPENDENT / max(mask.sum(), 1)) / ERROR_LEVELS
        slopes = [((m[j] - base[j]) / step)[mask].ravel() for m, step in zip(moved, steps, strict=True)]
        A.append(scale * np.stack(slopes, -1))
        b.append(scale * (difference - base[j])[mask].ravel())
    x = now + np.linalg.lstsq(np.concatenate(A), np.concatenate(b), rcond=None)[0]
    x = np.clip(x, [p.lower for p in specs], [p.upper for p in specs])
    return dict(zip(names, x.tolist(), strict=True))
