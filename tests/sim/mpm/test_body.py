"""Bodies from meshes: volume and mass, and what is refused.

Bending of a cantilever under its weight against the beam of Timoshenko.
"""

import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.mpm.body import Body, Material, RestGrid
from pneutac_sim.mpm.solve import simulate
from pneutac_sim.mpm.total_lagrangian import Loads, TotalLagrangian

trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed: there are no meshes to fill")

RUBBER = Material(1e5, 0.45, 1100.0)
SHAPES = {
    "sphere": lambda: trimesh.creation.icosphere(subdivisions=4, radius=0.01),
    "cylinder": lambda: trimesh.creation.cylinder(radius=0.008, height=0.03, sections=64),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_volume_and_mass_converge(shape):
    mesh = SHAPES[shape]()
    errors = []
    for per_radius in (4, 9, 16):
        spacing = 0.008 / per_radius
        body = Body.from_mesh(shape, mesh, RUBBER, mesh.volume / spacing**3)
        grid = RestGrid.of(body)
        volume = len(body.cells) * body.spacing_m**3
        assert grid.volume.sum() == pytest.approx(volume, rel=1e-9)  # nodes carry all the mass
        centre = (grid.volume[:, None] * grid.nodes).sum(0) / grid.volume.sum()
        assert np.abs(centre - mesh.center_mass).max() < 0.05 * spacing
        errors.append(abs(volume / mesh.volume - 1))
    assert errors[-1] < 0.015
    assert errors[-1] < 0.5 * errors[0]


def test_a_mesh_that_holds_no_particles_is_refused():
    whole = SHAPES["sphere"]()
    opened = trimesh.Trimesh(whole.vertices, whole.faces[4:])
    turned = trimesh.Trimesh(whole.vertices, whole.faces[:, ::-1], process=False)
    ring = trimesh.creation.annulus(r_min=0.009, r_max=0.01, height=0.01)
    for mesh, spacing_m, says in (
        (opened, 1e-3, "the mesh is open"),
        (turned, 1e-3, ".*turned inside out"),
        (trimesh.Trimesh(), 1e-3, ""),
        (ring, 0.02, ".*no particle lies inside"),
    ):
        with pytest.raises(InputError, match=f"Body 'part': {says}"):
            Body.from_mesh("part", mesh, RUBBER, abs(mesh.volume) / spacing_m**3)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ((1e5, 0.5), "poissons_ratio is 0.5"),
        ((1e5, float("nan")), "poissons_ratio is nan"),
        ((-1.0, 0.3), "youngs_modulus_pa is -1.0; it must be a positive number"),
        ((1e5, 0.3, 0.0), "density_kg_m3 is 0.0"),
    ],
)
def test_an_impossible_material_is_refused(values, words):
    with pytest.raises(InputError, match=words):
        Material(*values)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"counts": (4, 0, 4)}, "counts is"),
        ({"spacing_m": -1e-3}, "spacing_m is -0.001"),
        ({"clamp": "top"}, "clamp is 'top'; choose x-, y-, z-"),
    ],
)
def test_an_impossible_box_is_refused(change, words):
    good = {"name": "box", "counts": (4, 4, 4), "spacing_m": 1e-3, "material": RUBBER}
    with pytest.raises(InputError, match=words):
        Body.box(**(good | change))


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
