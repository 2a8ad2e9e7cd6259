"""Reference formulas in double precision that several tests compare the solver with."""

from types import SimpleNamespace

import numpy as np
import pytest

from pneutac_sim.mpm.body import SLOPE, WEIGHT


def _slopes(body, grid):
    """(P, 27, 3) gradients of the splines at the particles, 1/m."""
    local = body.cells % 2
    w, d = WEIGHT[local], SLOPE[local] / grid.dx
    rows = [
        np.einsum("pa,pb,pc->pabc", *((d if axis == a else w)[:, a] for a in range(3))).reshape(-1, 27)
        for axis in range(3)
    ]
    return np.stack(rows, -1)


def gradients(solver, x):
    """(P, 3, 3) deformation gradients of nodes `x` (N, 3)."""
    nodes = solver.grid.cell_nodes[solver.grid.particle_cell]
    return np.einsum("pni,pnj->pij", np.asarray(x, float)[nodes], _slopes(solver.body, solver.grid))


def energy(solver, x):
    """Elastic energy in J of nodes `x` (N, 3): mu/2 (tr F^T F - 3) - mu ln J + lambda/2 (ln J)^2."""
    F = gradients(solver, x)
    mu, lam = solver.body.material.lame
    log_j = np.log(np.linalg.det(F))
    density = mu / 2 * ((F**2).sum((1, 2)) - 3) - mu * log_j + lam / 2 * log_j**2
    return float(density.sum() * solver.body.spacing_m**3)


def forces(solver, x):
    """(N, 3) elastic forces in N on nodes `x` (N, 3)."""
    F = gradients(solver, x)
    mu, lam = solver.body.material.lame
    back = np.linalg.inv(F).transpose(0, 2, 1)
    P = mu * (F - back) + lam * np.log(np.linalg.det(F))[:, None, None] * back
    share = -np.einsum("pij,pnj->pni", P, _slopes(solver.body, solver.grid)) * solver.body.spacing_m**3
    out = np.zeros((len(solver.grid.nodes), 3))
    np.add.at(out, solver.grid.cell_nodes[solver.grid.particle_cell], share)
    return out


def node_forces(solver, loads):
    """(N, 3) forces in N that the solver finds on the nodes of its first body, where they are now."""
    solver.apply(loads, dt=1e-9)
    solver.step(1)
    return solver._unflat(solver.arrays["total"].to_numpy())[0].astype(float)


def throw(solver, velocity):
    """Gives the nodes velocities (B, N, 3) in m/s."""
    solver.arrays["v"].from_numpy(solver._flat(np.asarray(velocity, np.float32)))


def velocity(solver):
    """(B, N, 3) of the nodes, m/s."""
    return solver._unflat(solver.arrays["v"].to_numpy()).astype(float)


@pytest.fixture(scope="session")
def reference():
    """The functions above."""
    return SimpleNamespace(
        gradients=gradients,
        energy=energy,
        forces=forces,
        node_forces=node_forces,
        throw=throw,
        velocity=velocity,
    )
