"""Calibrates a gel: light, effects and mechanics, from one rest and one indentation image or more.

Given the surface, each channel is a least-squares problem of its own with up to twelve unknowns, tied to the
priors of its effects where the images do not identify them. Around that, a search finds how far the surface
recovers around a contact and how much of an imprint shows. All of it works on the probe grid, to which the
photographs are averaged: the light varies no faster, and noise drops out.

Fits what a session of photographs adds: its drift of light, and contacts away from their stated place.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from pneutac_sim.effects.registry import in_order, of_sensor, sensor_effects
from pneutac_sim.effects.sensor_effect import Quiet, SensorEffect
from pneutac_sim.effects.shadow import cast
from pneutac_sim.gel.contact import quiet_threshold
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.layout import DIGIT, Layout
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import check_pair
from pneutac_sim.gel.photograph import Pressed, PressPhotograph, Residues, contact_light, to_grid
from pneutac_sim.gel.probe import COLS, ROWS, THICKNESS_MM
from pneutac_sim.gel.problem import GelFit, Problem
from pneutac_sim.gel.residual import ERROR_LEVELS, INDEPENDENT, faded, learn, levels, trusted_share

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

    Minimises |(predicted - seen) / error|^2 + |(x - neutral) / prior_sd|^2 linearised at the present x. Of
    each photograph: where it is compared, `masks` (80, 59); what its contact changes, `seen` (80, 59, 3)
    levels; its rest image, `rests` (80, 59, 3). Returns effect to its values.
    """
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
            out.append(contact_light(moved, p.press, left) * gel.weight_on(rest))
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
    """One Gauss-Newton step of what is uncertain of a photograph's press, all else as it is.

    Minimises |(predicted - seen) / error|^2 + |(x - stated) / sd|^2; the step is halved until it does. Where
    it is compared, `mask` (80, 59); what the contact changes, `seen` (80, 59, 3) levels; and `rest` (80, 59,
    3).
    """
    now, names, sd = photograph.press, list(photograph.sd), np.array(list(photograph.sd.values()))
    weight, scale = gel.weight_on(rest), np.sqrt(INDEPENDENT / max(mask.sum(), 1)) / ERROR_LEVELS

    def moved(by: np.ndarray) -> Press:
        values = {n: getattr(now, n) + b for n, b in zip(names, by.tolist(), strict=True)}
        return replace(now, **values | {"depth_mm": max(values.get("depth_mm", now.depth_mm), SHALLOWEST_MM)})

    left = Residues(gel, [photograph.earlier]).surfaces(gel)[0]

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


def _steps(effect: SensorEffect, reach_mm: float) -> np.ndarray:
    if effect.steps is not None:
        return np.asarray(effect.steps(reach_mm), float)
    return np.array([STEP * (p.upper - p.lower) for p in effect.parameters])


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
            near, data = best.gel, (problem.masks, problem.seen, problem.rests)
            if of_contacts:
                gel.effects |= refine_contacts(near, of_contacts, photographs, *data)
            if uncertain:
                each = zip(photographs, stated, *data, strict=True)
                photographs = [
                    replace(p, press=refine_press(near, p, *rest)) if p.sd else p for p, *rest in each
                ]
    best.presses = [p.press for p in photographs]
    quiet = [(p.image - p.rest.astype(np.float32), ~p.near(gel.px_per_mm)) for p in photographs]
    levels = [quiet_threshold(difference, far) for difference, far in quiet if far.any()]
    if levels:
        best.gel.threshold_levels = max(MIN_THRESHOLD_LEVELS, float(np.median(levels)))
    return best
