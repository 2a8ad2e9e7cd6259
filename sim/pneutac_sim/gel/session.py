"""Fits what a session of photographs adds: its drift of light, and contacts away from their stated place."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from pneutac_sim.effects.sensor_effect import Quiet, SensorEffect
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.late import pressed_on
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.optics import light
from pneutac_sim.gel.photograph import PressPhotograph, Residues, press_depth, registered, to_grid
from pneutac_sim.gel.probe import COLS, ROWS
from pneutac_sim.gel.residual import ERROR_LEVELS, INDEPENDENT

FAR_ENOUGH = 0.1  # share of a photograph that must lie away from its contact to measure its light
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
    gel: GelModel,
    effects: Sequence[SensorEffect],
    photographs: Sequence[PressPhotograph],
    masks: Sequence[np.ndarray],
    seen: Sequence[np.ndarray],
    rests: Sequence[np.ndarray],
) -> dict[str, dict[str, float]]:
    """One Gauss-Newton step of effects on the contacts from what the gel has, all else as it is.

    Minimises |(predicted - seen) / error|^2 + |(x - neutral) / prior_sd|^2 linearised at the present x.

    Args:
        gel: fitted with the contacts where it thinks them now.
        effects: of the stage `gel`, with p parameters together.
        photographs: n of them.
        masks: (80, 59) each, where they are compared.
        seen: (80, 59, 3) each, what the contacts change, levels.
        rests: (80, 59, 3) each, rest images.

    Returns:
        Effect to its values.
    """
    cell = gel.window_mm[0] / COLS, gel.window_mm[1] / ROWS
    specs = [(e, p) for e in effects for p in e.parameters]
    neutral = np.array([p.neutral for _, p in specs])
    now = np.array([gel.effects[e.name][p.name] for e, p in specs])
    reach = max(1.0, *(np.hypot(p.press.x_mm, p.press.y_mm) for p in photographs))
    steps = np.concatenate([_steps(e, reach) for e in effects])

    def values(x: np.ndarray) -> dict[str, dict[str, float]]:
        out: dict[str, dict[str, float]] = {}
        for (e, p), value in zip(specs, x.tolist(), strict=True):
            out.setdefault(e.name, {})[p.name] = value
        return out

    def predicted(x: np.ndarray) -> list[np.ndarray]:
        moved = replace(gel, effects=gel.effects | values(x))
        out = []
        for p, rest in zip(photographs, rests, strict=True):
            left = Residues(moved, [p.earlier]).surfaces(moved)[0]
            imprint = moved.imprint(press_depth(registered(p.press, moved), moved))
            u = pressed_on(imprint, left, cell, gel.decay_mm)
            s = light(moved.surface(u, cell), cell, *gel.lighting)
            out.append(s.transpose(1, 2, 0) * gel.weight_on(rest))
        return out

    late = any(e.late for e in effects)
    base = predicted(now)
    moved = [predicted(now + step * unit) for step, unit in zip(steps, np.eye(len(now)), strict=True)]
    sd = np.concatenate([e.prior_sd for e in effects])
    A, b = [np.diag(1 / sd)], [(neutral - now) / sd]
    for j, (near, difference) in enumerate(zip(masks, seen, strict=True)):
        scale, mask = np.sqrt(INDEPENDENT / max(near.sum(), 1)) / ERROR_LEVELS, near
        if late:
            mask = near | _left_in(gel, photographs[j])
        slopes = [((m[j] - base[j]) / step)[mask].ravel() for m, step in zip(moved, steps, strict=True)]
        A.append(scale * np.stack(slopes, -1))
        b.append(scale * (difference - base[j])[mask].ravel())
    M, y = np.concatenate(A), np.concatenate(b)
    if late:  # branches are much alike: without bounds one would stand against another
        low, high = np.array([(p.lower, p.upper) for _, p in specs]).T
        x = now + lsq_linear(M, y, (low - now, high - now)).x
    else:
        x = now + np.linalg.lstsq(M, y, rcond=None)[0]
    return {e.name: e.inside(v) for e, v in zip(effects, values(x).values(), strict=True)}


def refine_press(
    gel: GelModel,
    photograph: PressPhotograph,
    stated: Press,
    mask: np.ndarray,
    seen: np.ndarray,
    rest: np.ndarray,
) -> Press:
    """One Gauss-Newton step of what is uncertain of a press, all else as it is.

    Minimises |(predicted - seen) / error|^2 + |(x - stated) / sd|^2; the step is halved until it does.

    Args:
        gel: fitted with the press where it is thought now.
        photograph: of the press there, with the deviations of what is uncertain.
        stated: the press as the recording has it.
        mask: (80, 59), where image and prediction are compared.
        seen: (80, 59, 3), what the contact changes, levels.
        rest: (80, 59, 3), rest image.
    """
    cell = gel.window_mm[0] / COLS, gel.window_mm[1] / ROWS
    now, names, sd = photograph.press, list(photograph.sd), np.array(list(photograph.sd.values()))
    weight, scale = gel.weight_on(rest), np.sqrt(INDEPENDENT / max(mask.sum(), 1)) / ERROR_LEVELS

    def moved(by: np.ndarray) -> Press:
        values = {n: getattr(now, n) + b for n, b in zip(names, by.tolist(), strict=True)}
        return replace(now, **values | {"depth_mm": max(values.get("depth_mm", now.depth_mm), SHALLOWEST_MM)})

    left = Residues(gel, [photograph.earlier]).surfaces(gel)[0]

    def residual(press: Press) -> np.ndarray:
        imprint = gel.imprint(press_depth(registered(press, gel), gel))
        u = pressed_on(imprint, left, cell, gel.decay_mm)
        s = light(gel.surface(u, cell), cell, *gel.lighting).transpose(1, 2, 0)
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


def _steps(effect: SensorEffect, reach_mm: float) -> np.ndarray:
    if effect.steps is not None:
        return np.asarray(effect.steps(reach_mm), float)
    return np.array([STEP * (p.upper - p.lower) for p in effect.parameters])
