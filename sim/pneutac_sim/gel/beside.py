"""Residual fields of a fit: lent by the sensor's make, and learnt from its presses. See `gel.residual`."""

import numpy as np

from pneutac_sim.effects.shadow import cast
from pneutac_sim.gel.layout import Layout
from pneutac_sim.gel.problem import GelFit, Problem
from pneutac_sim.gel.residual import faded, learn, levels, trusted_share

SHARES = (0.0, 0.25, 0.5)  # of a make's field: two DIGITs have half of what is left over in common


def lend(make: Layout, problem: Problem, fit: GelFit) -> None:
    """Adds to a fit the share of its make's field that explains its presses best, with the light anew.

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
    """Adds to a fit the residual field of its presses, as far as fields of all but one bear out on that one.

    The light is fitted anew without the one, since it would know it too well.

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
