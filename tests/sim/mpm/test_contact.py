"""Contact: Hertz, action and reaction, friction that does not creep, penetration."""

import csv
import os
from pathlib import Path

import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.mpm.body import Body, Material
from pneutac_sim.mpm.solve import MpmDiverged, simulate, solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads, TotalLagrangian

pytestmark = pytest.mark.slow

SPACING = 0.3e-3


SHAPES = ("sphere", "cylinder", "cube", "cone", "edge")


def slab(counts, nu=0.3, **values):
    n = np.asarray(counts)
    origin = (-n[0] * SPACING / 2, -n[1] * SPACING / 2, -n[2] * SPACING)  # the upper face lies at z = 0
    body = Body.box("slab", counts, SPACING, Material(1e5, nu, 1000.0), origin_m=origin, clamp="z-")
    return TotalLagrangian(body, device="cpu", **values)


def press(depth, radius=3e-3, shape="sphere", friction=0.5, x=0.0):
    sizes = {
        "sphere": (radius, 1, 1),
        "cylinder": (radius, 5e-3, 1),
        "cube": (radius, radius, 3e-3),
        "cone": (radius, radius, 1),
        "edge": (1, radius, 3e-3),
    }
    return Loads(
        indenter=shape,
        size_m=np.array(sizes[shape], float),
        position_m=np.array([x, 0, -depth]),
        friction=friction,
    )


def contact_radius(solver):
    """Radius of Hertz' pressure with the measured spread: <r^2> = 2/5 a^2."""
    g, force = solver.grid, -solver.contact()[0][0, :, 2].astype(float)
    w, corner = g.surface_weights.astype(float), solver.nodes()[0][g.cell_nodes[g.surface_cell]]
    at = np.einsum("sa,sb,sc,sabcd->sd", w[:, 0], w[:, 1], w[:, 2], corner.reshape(-1, 3, 3, 3, 3))
    return np.sqrt(2.5 * (force * (at[:, :2] ** 2).sum(1)).sum() / force.sum())


def thickness_factor(chi, nu):
    """Force on a bonded layer over Hertz', chi = sqrt(R d) / thickness (Dimitriadis et al. 2002, eq. 13)."""
    a = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1 - nu)
    b = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1 - nu)
    return (
        1
        - 2 * a / np.pi * chi
        + 4 * a**2 / np.pi**2 * chi**2
        - 8 / np.pi**3 * (a**3 + 4 * np.pi**2 / 15 * b) * chi**3
        + 16 * a / np.pi**4 * (a**3 + 3 * np.pi**2 / 5 * b) * chi**4
    )


def test_hertz_force_and_radius_on_a_thick_slab():
    """At 6 mm the slab's finite thickness adds 13 to 24 % to Hertz' force; the rest agrees within 3 %."""
    solver, radius = slab((32, 32, 20)), 6e-3
    depths, forces = (0.1e-3, 0.3e-3), []
    for depth in depths:
        e = solve_equilibrium(solver, press(depth, radius, friction=0.0), tolerance=1e-3, warm=bool(forces))
        hertz = 4 / 3 * 1e5 / (1 - 0.3**2) * np.sqrt(radius) * depth**1.5
        chi = np.sqrt(radius * depth) / (20 * SPACING)
        forces.append(-e.contact_force[0, 2])
        assert forces[-1] / hertz == pytest.approx(thickness_factor(chi, 0.3), rel=0.03)
        assert contact_radius(solver) == pytest.approx(np.sqrt(radius * depth), rel=0.08)
    power = np.polyfit(np.log(depths), np.log(forces), 1)[0]
    assert 1.5 < power < 1.65  # 3/2 on a half space, a little more on a layer


def test_contact_radius_of_real_photographs():
    """The gel's circle of contact follows sqrt(R d), as the computed one does."""
    if "PNEUTAC_DATA" not in os.environ:
        pytest.skip("PNEUTAC_DATA is unset: there are no real photographs to compare with")
    table = Path(os.environ["PNEUTAC_DATA"]) / "tactile" / "gelsight_thu" / "samples.csv"
    if not table.exists():
        pytest.skip(f"{table} is not there")
    rows = [r for r in csv.DictReader(table.open()) if r["role"] == "known_depth"]
    assert len(rows) >= 8
    for r in rows:
        radius, depth = float(r["indenter_radius_mm"]), float(r["depth_mm"])
        seen = float(r["contact_radius_px"]) / 16.875  # px/mm of this sensor
        assert seen == pytest.approx(np.sqrt(radius * depth), rel=0.05)


def test_the_indenter_feels_what_the_body_feels(reference):
    """Forces on the nodes beyond elasticity and weight add up to the indenter's; the clamp bears them."""
    solver = slab((16, 16, 8))
    loads = press(0.4e-3, x=0.15e-3)
    loads.gravity = np.array([0, 2.0, -9.81])
    e = solve_equilibrium(solver, loads, tolerance=1e-3)
    x = solver.nodes()[0]
    elastic = reference.forces(solver, x)
    weight = 1000.0 * solver.grid.volume[:, None] * loads.gravity
    size = np.abs(e.contact_force).max()
    assert np.abs(elastic.sum(0)).max() < 1e-9 * np.abs(elastic).sum()
    held = (solver.grid.ghost >= 0) | solver.grid.mirrored
    reaction = -elastic[held].sum(0) - weight[held].sum(0)
    assert np.abs(e.contact_force[0] + weight.sum(0) + reaction).max() < 0.01 * size
    # What the nodes got, one by one, is what the indenter gave.
    free = ~held
    total = reference.node_forces(solver, loads)
    given = total[free] - elastic[free] - weight[free]
    assert np.abs(given.sum(0) - solver.contact()[0][0].sum(0)).max() < 1e-3 * size


def test_resting_contact_does_not_creep():
    """Pressed, then pulled aside within the cone of friction, a slab stays where it is."""
    solver = slab((16, 16, 8))
    solve_equilibrium(solver, press(0.4e-3, friction=0.8), tolerance=1e-3)
    pulled = press(0.4e-3, friction=0.8, x=0.03e-3)
    simulate(solver, pulled, 0.05, 0.05, damping=400.0)
    out = simulate(solver, pulled, 0.4, 0.1, damping=400.0)
    side = out.contact_force[1:, 0, 0]
    assert side.min() > 0.02 * np.abs(out.contact_force[1:, 0, 2]).max()  # friction really holds it aside
    assert np.ptp(side) < 0.01 * side.mean()
    moved = [np.abs(b - a).max() for a, b in zip(out.positions[:-1], out.positions[1:], strict=True)]
    assert max(moved[1:]) < 2e-3 * SPACING  # in 0.1 s, and ever less: what is left of penetration goes
    assert moved[-1] < 0.8 * moved[1]


def test_friction_is_at_most_coulombs():
    forces = {}
    for friction in (0.0, 0.2, 2.0):
        solver = slab((16, 16, 8))
        solve_equilibrium(solver, press(0.4e-3, friction=friction))
        simulate(
            solver,
            lambda t, friction=friction: press(0.4e-3, friction=friction, x=min(0.3e-3, 0.01 * t)),
            0.06,
            5e-4,
            damping=400.0,
            particles=False,
        )
        forces[friction] = solver.contact()[0][0].sum(0)
    along, push = {k: f[0] for k, f in forces.items()}, -forces[0.2][2]
    assert abs(along[0.2]) <= 0.22 * push
    assert along[2.0] > 1.5 * along[0.2] > 0
    # Without friction only the slant of the surface pushes aside.
    assert along[0.0] < 0.5 * along[0.2]


def test_no_indenter_penetrates():
    """All shapes at once, each into a slab of its own."""
    solver, depth = slab((20, 20, 10), nu=0.45, batch=len(SHAPES)), 0.5e-3
    one = [press(depth, 1.5e-3, shape) for shape in SHAPES]
    sizes, positions = (np.stack([getattr(p, k) for p in one]) for k in ("size_m", "position_m"))
    loads = Loads(indenter=list(SHAPES), size_m=sizes, position_m=positions, friction=0.5)
    e = solve_equilibrium(solver, loads)
    for k, shape in enumerate(SHAPES):
        assert 0 < e.penetration_m[k] <= SPACING / 10, shape
        assert e.contact_force[k, 2] < -1e-3, shape
        sunk = -(e.positions[k] - solver.body.positions)[:, 2].min()
        # A point of a cone is finer than the particles, which sink less.
        assert (0.3 if shape == "cone" else 0.5) * depth < sunk < depth + SPACING / 10, shape


def test_a_mesh_indents_as_the_shape_that_it_is():
    """A sphere given as a table of signed distances."""
    radius, n, half = 1.5e-3, 65, 3.2e-3
    axis = np.linspace(-half, half, n)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    table = np.sqrt(x**2 + y**2 + (z - radius) ** 2) - radius
    loads = press(0.4e-3, radius)
    exact = solve_equilibrium(slab((16, 16, 8)), loads, tolerance=1e-3)
    loads = Loads(indenter="mesh", size_m=np.array([half, 1, 1]), position_m=loads.position_m)
    tabled = solve_equilibrium(slab((16, 16, 8), table=table), loads, tolerance=1e-3)
    assert tabled.contact_force[0, 2] == pytest.approx(exact.contact_force[0, 2], rel=0.03)
    assert np.abs(tabled.positions - exact.positions).max() < 0.05 * SPACING


def test_equilibrium_from_an_indenter_inside_the_body_is_that_from_outside():
    inside = solve_equilibrium(slab((16, 16, 8)), press(0.6e-3), tolerance=1e-3)
    solver = slab((16, 16, 8))
    for depth in (0.2e-3, 0.4e-3, 0.6e-3):
        outside = solve_equilibrium(solver, press(depth), tolerance=1e-3, warm=True)
    assert inside.contact_force[0, 2] == pytest.approx(outside.contact_force[0, 2], rel=0.02)


def test_a_motion_may_not_begin_inside_the_body():
    with pytest.raises(
        InputError, match=r"Body 'slab' \(number 0 .*indenter begins 0.00059. m inside the body"
    ):
        simulate(slab((16, 16, 8)), press(0.6e-3), 0.01, 0.01)


def test_an_unknown_indenter_is_refused():
    with pytest.raises(InputError, match="no indenter 'ball'; there are none, sphere"):
        solve_equilibrium(slab((4, 4, 4)), Loads(indenter="ball"))


@pytest.mark.parametrize("name", ["position_m", "gravity", "size_m"])
def test_a_load_that_is_no_number_is_refused(name):
    loads = press(0.1e-3)
    setattr(loads, name, np.array([0, np.nan, 0]))
    with pytest.raises(InputError, match="Body 'slab': a load is not a finite number"):
        solve_equilibrium(slab((4, 4, 4)), loads)


def test_a_step_too_large_is_refused_and_the_limit_told():
    solver = slab((4, 4, 4))
    limit = f"{solver.stable_dt[0]:.3g}"
    with pytest.raises(InputError, match=f"too large for its speed of sound .* use at most {limit} s"):
        simulate(solver, Loads(), 0.01, 0.01, dt=0.01)


@pytest.mark.parametrize(("duration", "frame"), [(0.0, 0.01), (0.01, 0.02), (float("nan"), 0.01)])
def test_times_that_make_no_sense_are_refused(duration, frame):
    with pytest.raises(InputError, match="must be positive"):
        simulate(slab((4, 4, 4)), Loads(), duration, frame)


def test_a_body_turned_inside_out_is_told_of():
    solver = slab((6, 6, 4))
    x = solver.grid.nodes.copy()
    x[:, 2] *= -1
    solver.set_nodes(x[None])
    with pytest.raises(MpmDiverged, match=r"Body 'slab' \(number 0 of the batch\) left the finite numbers"):
        simulate(solver, Loads(), 0.01, 0.01)


def test_a_search_that_ends_early_says_so():
    with pytest.raises(MpmDiverged, match="Body 'slab' .* not at rest after .* allow more substeps"):
        solve_equilibrium(slab((16, 16, 8)), press(0.4e-3), tolerance=1e-4, max_substeps=100)
