"""Stress of the neo-Hookean solid against its closed form."""

import numpy as np
import pytest

from pneutac_sim.mpm.body import Body, Material
from pneutac_sim.mpm.solve import solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads, TotalLagrangian

RUBBER = Material(1e5, 0.46)
MU, LAM = RUBBER.lame


@pytest.fixture(scope="module")
def block():
    return TotalLagrangian(Body.box("block", (6, 8, 4), 1e-3, RUBBER), device="cpu")


def stress(solver, F, reference):
    """Mean first Piola stress under an affine map, by virtual work: sum_n f_n X_n^T = - V P."""
    solver.set_nodes((solver.grid.nodes @ F.T)[None])
    f = reference.node_forces(solver, Loads())
    return -f.T @ solver.grid.nodes / (len(solver.body.cells) * solver.body.spacing_m**3)


@pytest.mark.parametrize("stretch", [0.6, 0.9, 1.2, 1.8])
def test_uniaxial_strain_has_the_closed_form(block, reference, stretch):
    P = stress(block, np.diag([stretch, 1, 1]), reference)
    side = LAM * np.log(stretch)
    along = MU * (stretch - 1 / stretch) + side / stretch
    assert np.allclose(P, np.diag([along, side, side]), rtol=2e-4, atol=2e-4 * MU)


@pytest.mark.parametrize("shear", [0.05, 0.3, 1.0])
def test_simple_shear_has_the_closed_form(block, reference, shear):
    F = np.eye(3) + shear * np.outer([1, 0, 0], [0, 1, 0])
    cauchy = stress(block, F, reference) @ F.T
    expected = MU * np.array([[shear**2, shear, 0], [shear, 0, 0], [0, 0, 0]])
    assert np.allclose(cauchy, expected, rtol=2e-4, atol=2e-4 * MU)


def test_a_turned_body_has_no_stress(block, reference):
    c, s = np.cos(1.1), np.sin(1.1)
    P = stress(block, np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), reference)
    assert np.abs(P).max() < 1e-4 * MU


def test_force_is_the_slope_of_the_energy(reference):
    solver = TotalLagrangian(Body.box("block", (6, 8, 7), 1e-3, RUBBER, clamp="z-"), device="cpu")
    g, rng = solver.grid, np.random.default_rng(0)
    x = g.nodes + rng.normal(size=g.nodes.shape) * 2e-4
    own = np.flatnonzero(g.ghost >= 0)
    x[g.ghost[own]] = g.nodes[g.ghost[own]] - (x[own] - g.nodes[own])
    solver.set_nodes(x[None])
    f = reference.node_forces(solver, Loads())
    size, step = np.abs(f[solver.role == -1]).max(), 1e-7
    for n in rng.choice(np.flatnonzero(solver.role == -1), 8):
        for axis in range(3):
            shift = np.zeros_like(x)
            shift[n, axis] = step
            if g.ghost[n] >= 0:
                shift[g.ghost[n], axis] = -step
            slope = (reference.energy(solver, x + shift) - reference.energy(solver, x - shift)) / (2 * step)
            assert abs(f[n, axis] + slope) < 1e-5 * size


@pytest.mark.slow
def test_a_pressed_column_carries_the_uniaxial_load():
    """Far from its ends a slender column under a frictionless plate is in uniaxial stress."""
    spacing, counts = 1e-3, (6, 6, 24)
    body = Body.box("column", counts, spacing, Material(1e5, 0.3), origin_m=(-3e-3, -3e-3, 0), clamp="z-")
    solver = TotalLagrangian(body, device="cpu")
    plate = Loads(
        indenter="cube",
        size_m=np.array([10e-3, 10e-3, 5e-3]),
        position_m=np.array([0, 0, 24e-3 * 0.94]),
        friction=0.0,
    )
    e = solve_equilibrium(solver, plate, tolerance=1e-3)
    middle = np.abs(body.cells[:, 2] - 11.5) < 3
    F = e.gradients[0, middle].mean(0)
    across, along = (F[0, 0] + F[1, 1]) / 2, F[2, 2]
    mu, lam = body.material.lame
    log_j = np.log(across**2 * along)
    assert abs(mu * (across - 1 / across) + lam * log_j / across) < 0.01 * abs(mu * (along - 1 / along))
    nominal = mu * (along - 1 / along) + lam * log_j / along
    assert -e.contact_force[0, 2] == pytest.approx(-nominal * (6e-3) ** 2, rel=0.02)
    assert along < 0.96  # the column is really compressed
