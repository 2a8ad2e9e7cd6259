"""The torques that lead the free finger on its path: against MuJoCo's own dynamics.

The gel's face in MuJoCo: the law's spring, by the present state alone.

Meshes in the world: the gel sees what the plain shapes, and `render` of the same punch, would show it.
"""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import trimesh
from arms import alone, arm_twin

from pneutac_sim.errors import InputError
from pneutac_sim.gel.probe import SPHERE
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.twin import Twin
from pneutac_sim.world.scene import PHYSICS_HZ
from pneutac_sim.world.soft_finger import Springs
from pneutac_sim.world.spine import Follower, Spine
from pneutac_sim.world.touch import Touch
from pneutac_sim.world.world import World

JOINTS = 4


@pytest.mark.parametrize(("twin", "axes"), [(Twin.builtin(), ()), (arm_twin(angle_rad=0.35, joints=4), (2,))])
def test_a_free_body_goes_along_the_path_whatever_its_stiffness(twin, axes):
    """Where the gel's pad is held, to rounding: each control step ends at its target, at the rate told."""
    model = alone(twin, 1 / PHYSICS_HZ)
    model.dof_armature[model.joint("pad").dofadr[0]] = 1e9
    data, rng, spine = mujoco.MjData(model), np.random.default_rng(0), Spine(model, twin)
    springs, follower = Springs(model, JOINTS, 0.006, 0.458), Follower(model, JOINTS)
    at, rate = rng.uniform(-0.2, 0.2, (JOINTS, *axes)), np.zeros((JOINTS, *axes))
    spine.write(data, at)
    for stiffness in (0.4, 0.1, 1.0, 0.4, 0.4):
        K = stiffness * np.eye(JOINTS) + (0 if axes else 0.04) * (np.eye(JOINTS, k=1) + np.eye(JOINTS, k=-1))
        target = at + rng.uniform(-0.15, 0.15, at.shape)
        torques, end = follower.torques(at, rate, target, K, springs.set(K), 50)
        for row in torques:
            data.ctrl[:] = row
            mujoco.mj_step(model, data)
        np.testing.assert_allclose(spine.read(data), target, atol=1e-5 if axes else 2e-6)
        np.testing.assert_allclose(end, (target - at) / (50 * model.opt.timestep), rtol=1e-9)
        assert axes or np.abs(data.qvel[spine.dofs] - end).max() < 2e-4
        at, rate = target, end


@pytest.fixture(scope="module")
def world():
    return World("switch", touch="none")


def ball(radius_m, depth_m):
    """A ball in the gel's frame, arguments of `probe_grid`."""
    at = (0, 0, radius_m - depth_m)
    return [SPHERE], [(radius_m, 0, 0)], [at], [np.eye(3)], np.zeros(3), np.eye(3)


def test_the_model_has_the_springs_force_and_slope(world):
    pad, model, data = world._pad, world.model, world.data
    at = model.joint("pad")
    forces = []
    for x in (0.7e-3, 0.8e-3, 0.9e-3):
        world.reset(0)
        pad.feel(ball(0.006, 0.0008))
        data.qpos[at.qposadr[0]] = -x
        data.qvel[:] = 0.0
        mujoco.mj_forward(model, data)
        forces.append(data.qfrc_spring[at.dofadr[0]])
    assert forces[1] == pytest.approx(pad.spring.force(0.8e-3))
    assert (forces[2] - forces[0]) / 0.2e-3 == pytest.approx(pad.spring.slope(0.8e-3), rel=0.02)


def test_where_nothing_is_near_what_was_pressed_before_does_not_matter(world):
    pad = world._pad
    pad.feel(None)
    free = pad.spring, world.model.dof_armature.copy(), world.model.dof_damping.copy()
    pad.feel(ball(0.002, 0.0015))
    assert pad.spring != free[0]
    pad.feel(ball(0.004, -0.05))
    assert pad.spring == free[0]
    assert np.array_equal(world.model.dof_armature, free[1])
    assert np.array_equal(world.model.dof_damping, free[2])


def test_a_face_that_is_dragged_off_stays_on_the_sensor():
    """Cards that rub along the gel's side, some 10 N each, once tore it off and ended an augmentation."""
    world = World("switch", touch="none")
    world.reset(0)
    pad = world.model.joint("pad")
    world.data.qfrc_applied[pad.dofadr[0]] = 40.0
    for _ in range(15):
        world.step([0, 0, 0, 0])  # would raise where the physics diverges
    assert 0.5e-3 < world.data.qpos[pad.qposadr[0]] < 2.1e-3
    world.data.qfrc_applied[:] = 0.0
    for _ in range(15):
        world.step([0, 0, 0, 0])
    assert world.data.qpos[pad.qposadr[0]] < 0.2e-3


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
