"""True dynamics: what must be conserved is.

The face of a gel of material points under bench presses.
"""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.mpm import devices
from pneutac_sim.mpm.body import Body, Material
from pneutac_sim.mpm.devices import PressedGel
from pneutac_sim.mpm.solve import MpmDiverged, simulate
from pneutac_sim.mpm.total_lagrangian import Loads, TotalLagrangian
from pneutac_sim.twin import Twin

pytestmark = pytest.mark.slow

RUBBER = Material(3e5, 0.4, 1100.0)


def free_block():
    body = Body.box("block", (8, 6, 4), 2e-3, RUBBER, origin_m=(-8e-3, -6e-3, -4e-3))
    return TotalLagrangian(body, device="cpu")


def stir(solver, reference):
    """Sets a body in motion: drift, spin and stretching waves."""
    x = solver.grid.nodes
    drift, spin = np.array([0.3, -0.2, 0.1]), np.array([5.0, -8.0, 12.0])
    waves = 0.4 * np.stack([np.sin(200 * x[:, 0]), np.cos(300 * x[:, 2]), np.sin(150 * x[:, 1])], -1)
    reference.throw(solver, (drift + np.cross(spin, x) + waves)[None])


def momenta(solver, reference):
    mass = RUBBER.density_kg_m3 * solver.grid.volume[:, None]
    x, v = solver.nodes()[0].astype(float), reference.velocity(solver)[0]
    return (mass * v).sum(0), (mass * np.cross(x, v)).sum(0)


def test_a_free_body_keeps_its_momenta_and_energy(reference):
    solver = free_block()
    stir(solver, reference)
    p0, l0 = momenta(solver, reference)
    totals = []
    for _ in range(20):
        simulate(solver, Loads(), 1e-3, 1e-3)
        totals.append(solver.energy()[0] + reference.energy(solver, solver.nodes()[0]))
    p1, l1 = momenta(solver, reference)
    stored = reference.energy(solver, solver.nodes()[0])
    assert np.abs(p1 - p0).max() < 2e-5 * np.abs(p0).max()
    assert np.abs(l1 - l0).max() < 1e-3 * np.abs(l0).max()
    assert stored > 1e-3 * totals[0]  # energy really went into the solid and back
    assert np.ptp(totals) < 0.08 * totals[0]  # swings by the order of the step ...
    assert abs(np.mean(totals[10:]) / np.mean(totals[:10]) - 1) < 0.01  # ... and does not drift


def test_damping_takes_momentum_at_its_rate(reference):
    solver = free_block()
    reference.throw(solver, np.broadcast_to([1.0, 0, 0], solver.grid.nodes.shape)[None])
    p0, _ = momenta(solver, reference)
    simulate(solver, Loads(), 0.01, 0.01, damping=80.0)
    p1, _ = momenta(solver, reference)
    assert p1[0] / p0[0] == pytest.approx(np.exp(-0.8), rel=1e-4)


def test_free_fall():
    solver = free_block()
    out = simulate(solver, Loads(gravity=np.array([0, 2.0, -9.81])), 0.05, 0.01)
    fall = (out.positions[:, 0] - out.positions[0, 0]).mean(1)
    step = 0.01 / np.ceil(0.01 / solver.stable_dt[0])
    expected = 0.5 * np.outer(out.time_s * (out.time_s + step), [0, 2.0, -9.81])  # symplectic Euler's own sum
    assert np.abs(fall - expected).max() < 1e-4 * np.abs(expected).max()
    shape = out.positions[-1, 0] - out.positions[-1, 0].mean(0)
    assert np.abs(shape - (out.positions[0, 0] - out.positions[0, 0].mean(0))).max() < 1e-6


def test_a_bar_rings_at_the_frequency_of_pressure_waves(reference):
    """Stretched along x with no sideways motion, a bar held at one end rings at c / (4 L)."""
    solid = Material(1e5, 0.0, 1000.0)
    body = Body.box("bar", (40, 2, 2), 1e-3, solid, clamp="x-")
    solver = TotalLagrangian(body, device="cpu")
    length = 40e-3
    u = np.zeros_like(solver.grid.nodes)
    u[:, 0] = 2e-4 * np.sin(np.pi * solver.grid.nodes[:, 0] / (2 * length))
    solver.set_nodes((solver.grid.nodes + u)[None])
    period = 4 * length / solid.sound_speed
    out = simulate(solver, Loads(), 1.25 * period, period / 200)
    tip = out.positions[:, 0, -1, 0] - body.positions[-1, 0]
    k = np.flatnonzero((tip[:-1] < 0) & (tip[1:] >= 0))[0]  # three quarters of a period
    when = out.time_s[k] - tip[k] * (out.time_s[k + 1] - out.time_s[k]) / (tip[k + 1] - tip[k])
    assert when / 0.75 == pytest.approx(period, rel=0.01)


BALL = Press("sphere", 3.0, 1.0, -1.5, 0.6)


@pytest.fixture
def points(monkeypatch):
    """A gel of few particles."""
    monkeypatch.setattr(devices, "gel", partial(devices.gel, counts=(24, 32, 5)))
    return PressedGel(GelModel.builtin(), Twin("gel"), device="cpu")


def test_a_share_of_a_press_is_a_less_deep_press_and_the_gel_rises_around_it(points):
    whole, half = points.surface(BALL), points.surface(BALL, 0.5)
    np.testing.assert_allclose(half, points.surface(replace(BALL, depth_mm=0.3)), atol=1e-6)
    row, column = np.unravel_index(whole.argmax(), whole.shape)
    assert abs((column + 0.5) / 59 * 12 - 6 - BALL.x_mm) < 0.3 and abs((row + 0.5) / 5 - 8 - BALL.y_mm) < 0.3
    assert whole.max() == pytest.approx(0.6, abs=0.08) and half.max() == pytest.approx(0.3, abs=0.05)
    assert -0.15 < whole.min() < -0.005, "a gel that hardly changes its volume bulges, the closed form never"


def test_no_rest_ends_in_one_sentence_and_leaves_the_steps_as_they_were(points, monkeypatch):
    def fail(solver, *_, **__):
        raise MpmDiverged("Body 'gel' is not at rest", "wait")

    before = points._solver.stable_dt
    monkeypatch.setattr(devices, "solve_equilibrium", fail)
    with pytest.raises(InputError, match="not at rest, under the sphere pressed 0.6 mm deep; correct"):
        points.surface(BALL)
    assert points._solver.stable_dt == before
