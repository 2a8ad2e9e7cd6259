"""Bending of a cantilever under its weight against the beam of Timoshenko."""

import numpy as np
import pytest

from pneutac_sim.mpm.body import Body, Material
from pneutac_sim.mpm.loads import Loads
from pneutac_sim.mpm.solve import simulate
from pneutac_sim.mpm.total_lagrangian import TotalLagrangian

LENGTH, SIDE, DENSITY, YOUNG = 0.08, 0.01, 1000.0, 1e6


def sag(across: int, gravity: float) -> float:
    """How far the end's middle comes down, m, with `across` particles over the height."""
    spacing = SIDE / across
    counts = (round(LENGTH / spacing), across, across)
    body = Body.box("beam", counts, spacing, Material(YOUNG, 0.0, DENSITY), clamp="x-")
    solver = TotalLagrangian(body, device="cpu")
    # Let it settle as a motion that is damped critically, until 1e-3 of the way is left.
    slowest = 1.875**2 * np.sqrt(YOUNG * SIDE**2 / 12 / DENSITY) / LENGTH**2
    loads = Loads(gravity=np.array([0, 0, -gravity]))
    out = simulate(solver, loads, 10 / slowest, 10 / slowest, damping=2 * slowest)
    u = (out.positions[-1, 0] - body.positions)[:, 2].reshape(counts).mean((1, 2))
    return -(1.5 * u[-1] - 0.5 * u[-2])  # the end lies half a spacing beyond the last particle


def timoshenko(gravity: float) -> float:
    """w L^4 / (8 E I) + w L^2 / (2 kappa G A) with kappa = 5/6 at Poisson's ratio 0."""
    load, second = DENSITY * gravity * SIDE**2, SIDE**4 / 12
    return load * LENGTH**4 / (8 * YOUNG * second) + load * LENGTH**2 / (2 * 5 / 6 * YOUNG / 2 * SIDE**2)


def test_a_cantilever_sags_as_a_beam_and_refines_at_second_order():
    gravity = 2.0  # sag of 1.6 % of the length: the beam's linear theory holds to 0.1 %
    expected = timoshenko(gravity)
    errors = [sag(n, gravity) / expected - 1 for n in (2, 4, 8)]
    assert abs(errors[-1]) < 0.03
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 1.5).all() and (orders < 3).all()


def test_sag_is_in_proportion_to_a_small_load():
    assert sag(4, 4.0) == pytest.approx(2 * sag(4, 2.0), rel=0.01)
