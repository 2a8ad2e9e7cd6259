"""Calibrates a gel: light, effects and mechanics, from one rest and one indentation image or more.

Given the surface, each channel is a least-squares problem of its own with up to twelve unknowns, tied to the
priors of its effects where the images do not identify them. Around that, a search finds how far the surface
recovers around a contact and how much of an imprint shows. All of it works on the probe grid, to which the
photographs are averaged: the light varies no faster, and noise drops out.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pneutac_sim.effects.registry import in_order, of_sensor, sensor_effects
from pneutac_sim.effects.shadow import cast
from pneutac_sim.gel.contact import quiet_threshold
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.layout import DIGIT, Layout
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import check_pair
from pneutac_sim.gel.photograph import Pressed, PressPhotograph
from pneutac_sim.gel.probe import THICKNESS_MM
from pneutac_sim.gel.problem import GelFit, Problem
from pneutac_sim.gel.residual import faded, learn, levels, trusted_share
from pneutac_sim.gel.session import estimate_gains, refine_contacts, refine_press

SHARES = (0.0, 0.25, 0.5)  # of a make's field: two DIGITs have half of what is left over in common


def lend(make: Layout, problem: Problem, fit: GelFit) -> None:
    """Adds to a fit the share of its make's field that explains its presses best, with the light again.

    The field is in proportion to the light's strength. What it explains is taken out of what the problem's
    photographs show.

    Args:
        make: the sensor's.
        problem: of the fit's photographs, with its gel.
        fit: changed in place.
    """
    lent = make.lent(fit.gel.rest_image, fit.orientation)
    if lent is None:
        return
    gel, seen = fit.gel, problem.seen
    lent = lent.times(float(np.linalg.norm(gel.light)))
    surfaces, rows = problem.surfaces(gel.decay_mm, gel.depth_scale), gel.coefficients
    added = []
    for u, rest in zip(surfaces, problem.rests, strict=True):
        each = levels([lent], u, problem.cell, [cast(u, *problem.cell, row) for row in rows])
        added.append(each.transpose(1, 2, 0) * faded(gel.weight_on(rest)))
    costs, tried = [], []
    for share in SHARES:
        less = [s - share * a for s, a in zip(seen, added, strict=True)]
        channels = [c.seeing(less) for c in fit.channels]
        costs.append(sum(c.solve(surfaces) for c in channels))
        tried.append((less, channels))
    best = int(np.argmin(costs))
    fit.lent = SHARES[best]
    if fit.lent:
        problem.seen, fit.channels = tried[best]
        fit.gel = problem.gel = problem.lit(fit.channels)
        fit.gel.lent = lent.times(fit.lent)


def learn_beside(problem: Problem, fit: GelFit) -> None:
    """Adds to a fit the residual field of its presses, weighted by leave-one-out prediction.

    The light is re-fitted without the one, since it would know it too well.

    Args:
        problem: of the fit's photographs, without what its make explains.
        fit: changed in place.
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


def fit_gel(
    rest: np.ndarray,
    indentation: np.ndarray,
    press: Press,
    px_per_mm: float,
    effects: Sequence[str] | None = None,
    thickness_mm: float = THICKNESS_MM,
    makes: Sequence[Layout] = (DIGIT,),
) -> GelFit:
    """Fits a gel to one pair of images.

    Args:
        rest: image without contact, uint8 (H, W, 3).
        indentation: image under the indenter, uint8, same shape.
        press: which indenter, where and how deep.
        px_per_mm: scale of the images.
        effects: to fit, those of every sensor where None; with none this is the paper's linear model.
        thickness_mm: gel thickness.
        makes: sensors whose lights are known.

    Raises:
        InputError: the pair is no rest and indentation image, see `check_pair`.
    """
    pair = PressPhotograph(press, indentation, rest)
    return fit_presses([pair], px_per_mm, effects, thickness_mm, makes)


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

    A recognised sensor model has a prior from the residuals of its other sensors; from five presses on
    what it leaves over of these is learnt too, see `learn_beside`.

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

    Raises:
        InputError: a pair is no rest and indentation image, see `check_pair`.
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
            lend(make, problem, fit)
        if enough:
            learn_beside(problem, fit)
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
    told = any(p.earlier for p in photographs)
    untold = [e for e in chosen if e.late and e.name in known and not told]
    gel.effects |= {e.name: known[e.name] for e in untold}
    of_contacts = [e for e in chosen if e.stage == "gel" and e not in untold]
    gel.effects |= {e.name: {p.name: p.neutral for p in e.parameters} for e in of_contacts}
    stated = [p.press for p in photographs]
    uncertain = pressed is None and any(p.sd for p in photographs)
    for left in reversed(range(CONTACT_ROUNDS if of_contacts or uncertain else 1)):
        problem = Problem(gel, photographs, chosen, pressed)
        best = problem.best(makes, near, quick=quick or left > 0)
        if left:
            near, told = best.gel, (problem.masks, problem.seen, problem.rests)
            if of_contacts:
                gel.effects |= refine_contacts(near, of_contacts, photographs, *told)
            if uncertain:
                each = zip(photographs, stated, *told, strict=True)
                photographs = [
                    replace(p, press=refine_press(near, p, *rest)) if p.sd else p for p, *rest in each
                ]
    best.presses = [p.press for p in photographs]
    quiet = [(p.image - p.rest.astype(np.float32), ~p.near(gel.px_per_mm)) for p in photographs]
    levels = [quiet_threshold(difference, far) for difference, far in quiet if far.any()]
    if levels:
        best.gel.threshold_levels = max(MIN_THRESHOLD_LEVELS, float(np.median(levels)))
    return best
