"""Meshes in the world: the gel sees what the plain shapes, and `render` of the same punch, would show it."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import trimesh

from pneutac_sim.errors import InputError
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.world.touch import Touch


def touched(geom, assets="", at="0 0 0", euler="0 0 0", gel=None):
    """The touch of one geom; MuJoCo moves a mesh's origin, and its pose with it."""
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><compiler eulerseq='xyz'/><asset>{assets}</asset><worldbody><site name='gel'/>"
        f"<body pos='{at}' euler='{euler}'><geom group='2' {geom}/></body></worldbody></mujoco>"
    )
    touch, data = Touch(model, TactileSensor(), "image", gel), mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    touch.sense(data)
    assert touch.area > 0.01
    return touch


def apart(one, other):
    return np.abs(one.astype(int) - other).max()


@pytest.mark.parametrize(("plain", "mesh", "turned"), [
    ("type='box' size='.003 .002 .004'", trimesh.creation.box((6, 4, 8)), "12 20 30"),
    ("type='cylinder' size='.003 .004'", trimesh.creation.cylinder(3, 8, 128), "0 90 40"),
])  # fmt: skip
def test_a_shape_given_as_a_mesh_shows_the_same(plain, mesh, turned, tmp_path):
    mesh.copy().apply_translation([5, -3, 40]).export(tmp_path / "shape.stl")
    assets = f"<mesh name='shape' file='{tmp_path / 'shape.stl'}' scale='.001 .001 .001'/>"
    wanted = touched(plain, at="0.001 -0.002 0.0025", euler=turned)
    found = touched("type='mesh' mesh='shape' pos='-.005 .003 -.04'", assets, "0.001 -0.002 0.0025", turned)
    assert apart(found.image, wanted.image) <= 1


def test_a_hollow_mesh_is_felt_with_its_hollow(tmp_path):
    trimesh.creation.annulus(2.0, 4.0, 8.0, sections=128).export(tmp_path / "ring.stl")
    asset = f"<mesh name='ring' file='{tmp_path / 'ring.stl'}' scale='.001 .001 .001'/>"
    ring = "type='mesh' mesh='ring'", asset, "0 0 0.0035"
    depth = touched(*ring).depth_mm
    assert depth[40, 29] == 0 and depth[40, 29 + 15] == pytest.approx(0.5, abs=1e-5)


def test_the_full_gel_refuses_an_open_mesh(tmp_path):
    mesh = trimesh.creation.box((4, 4, 4))
    trimesh.Trimesh(mesh.vertices, mesh.faces[:-1]).export(tmp_path / "open.stl")
    asset = f"<mesh name='open' file='{tmp_path / 'open.stl'}' scale='.001 .001 .001' inertia='shell'/>"
    with pytest.raises(InputError, match="geom lid is open; close it"):
        touched("name='lid' type='mesh' mesh='open'", asset, gel=SimpleNamespace(displacement=None))
