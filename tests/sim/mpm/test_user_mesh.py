"""A user's mesh: measures, placing, filling, bending, and what is refused."""

import numpy as np
import pytest
import trimesh

from pneutac_sim.errors import InputError
from pneutac_sim.mpm import devices
from pneutac_sim.mpm.solid import finger_mesh
from pneutac_sim.mpm.solve import solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads
from pneutac_sim.mpm.user_mesh import neutral_axis, read_mesh, store_mesh, stored_mesh
from pneutac_sim.twin import Twin

pytestmark = pytest.mark.slow

L_SHAPE = np.array([(0, 0), (12, 0), (12, 4), (4, 4), (4, 16), (0, 16)], float)  # mm, in y and z


def prism(section: np.ndarray, length: float, shift=lambda x: np.zeros((len(x), 2))) -> trimesh.Trimesh:
    """A bar along x of an L-shaped section (6, 2), its stations moved by `shift`."""
    n, stations = len(section), 41
    x = np.repeat(np.linspace(0, length, stations), n)
    vertices = np.column_stack([x, np.tile(section, (stations, 1)) + shift(x)])
    a = np.arange(n)
    b = np.roll(a, -1)
    sides = np.concatenate([np.stack([a, b, b + n], 1), np.stack([a, b + n, a + n], 1)])
    faces = [sides + k * n for k in range(stations - 1)]
    end = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)])
    mesh = trimesh.Trimesh(vertices, np.concatenate([*faces, end[:, ::-1], end + (stations - 1) * n]))
    assert mesh.is_watertight and mesh.volume > 0
    return mesh


def capsule(length: float, radius: float) -> trimesh.Trimesh:
    """Along z, from z = 0, mm."""
    mesh = trimesh.creation.capsule(height=length - 2 * radius, radius=radius, count=(24, 24))
    return mesh.apply_translation((0, 0, -mesh.bounds[0, 2]))


def saved(mesh: trimesh.Trimesh, path, name="body.stl"):
    mesh.export(path / name)
    return path / name


# ---------------------------------------------------------------- measures


def test_neutral_axis_of_an_l_is_its_areas_centroid():
    x, centres, areas = neutral_axis(prism(L_SHAPE, 90.0))
    # two rectangles: 12 x 4 about (6, 2), 4 x 12 about (2, 10)
    np.testing.assert_allclose(areas, 96.0, rtol=1e-9)
    np.testing.assert_allclose(centres, np.tile([4.0, 6.0], (len(x), 1)), rtol=1e-9)


# ---------------------------------------------------------------- placing


def test_axis_base_and_neutral_axis_are_where_the_spine_expects_them(tmp_path):
    body = read_mesh(saved(prism(L_SHAPE + [30, -70], 90.0).apply_translation((-12, 0, 0)), tmp_path))
    assert body.notes == () and body.length_mm == 90.0
    np.testing.assert_allclose(body.shift_mm, [12, -34, 64], atol=1e-4)  # the centroid was at (34, -64)
    np.testing.assert_allclose(body.mesh.bounds, [[0, -4, -6], [90, 8, 10]], atol=1e-4)


def test_metres_and_millimetres_give_the_same_body(tmp_path):
    mesh = prism(L_SHAPE, 90.0)
    mm = read_mesh(saved(mesh, tmp_path, "mm.ply"))
    m = read_mesh(saved(mesh.copy().apply_scale(1e-3), tmp_path, "m.ply"), unit="m")
    np.testing.assert_allclose(m.mesh.bounds, mm.mesh.bounds, atol=1e-4)
    with pytest.raises(
        InputError, match=r"read in mm is 0.09 mm long.*: if it is in metres, give the unit m\.$"
    ):
        read_mesh(tmp_path / "m.ply")
    with pytest.raises(InputError, match="read in m is 9e.04 mm long.*give the unit mm"):
        read_mesh(tmp_path / "mm.ply", unit="m")


@pytest.mark.parametrize(
    ("length", "unit", "ways"),
    [
        (4.33, "mm", "if it is in inches, scale it by 25.4"),
        (4.33, "m", "if it is in inches, scale it by 0.0254"),
        (0.11, "mm", "if it is in metres, give the unit m"),
        (0.5, "mm", "if it is in metres, give the unit m, or if it is in inches, scale it by 25.4"),
        (1e-6, "mm", "scale it"),
        (1e-6, "m", "scale it"),
        (2e5, "m", "scale it"),
    ],
)
def test_only_units_that_lead_to_an_accepted_size_are_named(tmp_path, length, unit, ways):
    file = saved(trimesh.creation.box((length, 0.2 * length, 0.2 * length)), tmp_path, "body.ply")
    with pytest.raises(InputError, match=f"only lengths of 5 to 2000 mm are taken: {ways}\\.$"):
        read_mesh(file, unit)


def test_an_unusual_length_is_told(tmp_path):
    usual, unusual = (saved(prism(L_SHAPE, x), tmp_path, f"{x}.stl") for x in (390.0, 410.0))
    assert read_mesh(usual).notes == ()
    assert "410 mm long, unusually long" in read_mesh(unusual).notes[0]


@pytest.mark.parametrize(
    "mesh",
    [trimesh.creation.box((100, 20, 20)), finger_mesh(0.11, 0.02).apply_scale(1000.0)],
    ids=["box", "finger"],
)
def test_an_inside_out_mesh_is_turned(tmp_path, mesh):
    flipped = trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1], process=False)
    assert flipped.volume < 0
    right, turned = (read_mesh(saved(m, tmp_path, "m.stl")) for m in (mesh, flipped))
    n = len(turned.mesh.faces)
    assert right.notes == () and turned.notes == (
        f"Turned {n} of {n} triangles, whose normals pointed inward.",
    )
    assert turned.mesh.volume == pytest.approx(mesh.volume, rel=1e-6)
    np.testing.assert_allclose(turned.mesh.bounds, right.mesh.bounds, atol=1e-9)
    centre = trimesh.triangles.mass_properties(turned.mesh.triangles).center_mass  # from the faces alone
    np.testing.assert_allclose(centre, right.mesh.center_mass, atol=1e-6)


def test_holes_and_turned_faces_are_repaired(tmp_path):
    mesh = capsule(90.0, 9.0)
    mesh.faces[5:40] = mesh.faces[5:40, ::-1]
    mesh.update_faces(~np.isin(np.arange(len(mesh.faces)), [200, 201, 300]))
    body = read_mesh(saved(mesh, tmp_path))
    assert body.mesh.is_watertight and "Holes were closed" in body.notes[0]
    assert "Turned 35 of" in body.notes[1]
    assert body.mesh.volume == pytest.approx(capsule(90.0, 9.0).volume, rel=1e-3)


def test_chambers_are_filled_and_scraps_left_out(tmp_path):
    outer, chamber = capsule(90.0, 9.0), capsule(70.0, 4.0).apply_translation((0, 0, 10))
    chamber.invert()
    scrap = trimesh.creation.box((2, 2, 2)).apply_translation((30, 0, 0))
    body = read_mesh(saved(trimesh.util.concatenate([scrap, outer, chamber]), tmp_path))
    assert body.mesh.volume == pytest.approx(outer.volume, rel=1e-6)
    assert any("1 small separate" in n for n in body.notes) and any(
        "1 closed chamber" in n for n in body.notes
    )


def test_a_crooked_neutral_axis_is_told(tmp_path):
    def bent(x):
        return np.column_stack([0 * x, 8 * np.sin(np.pi * x / 90)])

    body = read_mesh(saved(prism(L_SHAPE, 90.0, bent), tmp_path))
    assert any("neutral axis leaves a straight line by" in n for n in body.notes)
    slightly = read_mesh(saved(prism(L_SHAPE, 90.0, lambda x: 0.2 * bent(x)), tmp_path))
    assert slightly.notes == ()


# ---------------------------------------------------------------- bad input


def cut(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Three triangles at one edge: no hole to fill."""
    fin = [[*mesh.faces[0][:2], len(mesh.vertices)]]
    return trimesh.Trimesh(
        np.vstack([mesh.vertices, [50, 50, 50]]), np.vstack([mesh.faces, fin]), process=False
    )


def two(gap: float) -> trimesh.Trimesh:
    return trimesh.util.concatenate([capsule(90.0, 9.0), capsule(90.0, 9.0).apply_translation((gap, 0, 0))])


TUBE = trimesh.creation.annulus(r_min=7, r_max=9, height=90)


@pytest.mark.parametrize(
    ("mesh", "words"),
    [
        (cut(capsule(90, 9)), "is not closed: [0-9]+ edges do not join exactly two triangles"),
        (two(40.0), "holds 2 separate bodies, the largest with 50% of the volume"),
        (trimesh.creation.box((20, 20, 20)), "as long along . as along .*the axis of its length: x, y or z"),
        (TUBE, "no material along its neutral axis.*chamber"),
        (
            trimesh.Trimesh([[0, 0, 0], [90, 0, 0], [0, 9, 0]], [[0, 1, 2], [0, 2, 1]], process=False),
            "mesh.stl",
        ),
        (capsule(3000, 90), "is 3000 mm long, but only lengths of 5 to 2000 mm are taken: scale it"),
    ],
)
def test_meshes_that_are_no_device_are_refused(tmp_path, mesh, words):
    with pytest.raises(InputError, match=words) as refused:
        read_mesh(saved(mesh, tmp_path, "mesh.stl"))
    assert str(refused.value).count(". ") == 0 and str(refused.value).endswith(".")  # one sentence


def test_files_that_are_no_mesh_are_refused(tmp_path):
    with pytest.raises(InputError, match="There is no mesh"):
        read_mesh(tmp_path / "none.stl")
    (tmp_path / "part.step").write_text("ISO-10303-21;")
    with pytest.raises(InputError, match="export it as STL, OBJ or PLY"):
        read_mesh(tmp_path / "part.step")
    for name, text in (
        ("a.stl", b"not a mesh"),
        ("b.ply", b"ply\n"),
        ("c.obj", b"v 0 0 0\n"),
        ("d.stl", b""),
    ):
        (tmp_path / name).write_bytes(text)
        with pytest.raises(InputError, match=name):
            read_mesh(tmp_path / name)
    for option, value in (("unit", "inch"), ("axis", "w")):
        with pytest.raises(InputError, match=f"^{option} is '{value}'"):
            read_mesh(tmp_path / "a.stl", **{option: value})


def test_a_broken_stored_mesh_is_named():
    twin = Twin.builtin()
    store_mesh(twin, capsule(90, 9))
    twin.arrays["mesh_faces"] = twin.arrays["mesh_faces"] + 1
    with pytest.raises(InputError, match="'mesh_vertices_mm'.*hold no mesh"):
        stored_mesh(twin)
    del twin.arrays["mesh_faces"]
    with pytest.raises(InputError, match="hold no mesh"):
        devices.finger(twin)


# ---------------------------------------------------------------- filling and bending


def test_a_users_finger_bends_towards_z_about_its_own_axis(tmp_path):
    """Joints and length are the mesh's, and its far end goes where the spine's does."""
    body = read_mesh(saved(capsule(80.0, 8.0), tmp_path))
    twin = Twin("finger", body.length_mm, parameters=Twin.builtin().parameters)
    store_mesh(twin, body.mesh)
    solver = devices.finger(twin, batch=2, particles=800, device="cpu")
    assert solver.spine.joint_positions_m == pytest.approx([0.01, 0.03, 0.05, 0.07])
    assert len(solver.body.cells) == pytest.approx(800, rel=0.05)
    q_cmd = devices.joint_targets(twin, [0.0, 12.0])
    rest = solve_equilibrium(solver, Loads(q_cmd=q_cmd))
    assert (rest.q > 0).all() and (rest.q[1] > 2 * rest.q[0]).all()
    np.testing.assert_allclose(rest.q, q_cmd, rtol=0.03)
    tip = rest.positions[:, np.argmax(solver.body.positions[:, 0])]
    assert tip[1, 2] > tip[0, 2] + 0.01
    spine_tip = devices.spine_points(solver, rest.q)[:, -1]
    assert np.abs(tip - spine_tip).max() < 2 * solver.body.spacing_m
