"""Devices of material points from a twin: geometry, joint targets, the gel's face, the world's finger."""

import numpy as np
import pytest

from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.finger.stages import joint_command
from pneutac_sim.gel.probe import SPHERE, probe_grid
from pneutac_sim.mpm import devices
from pneutac_sim.mpm.solid import finger_mesh
from pneutac_sim.mpm.solve import solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads
from pneutac_sim.twin import PAPER_FINGER, Twin, Value
from pneutac_sim.world.world import World

pytestmark = pytest.mark.slow


def with_effect(name: str, **values: float) -> Twin:
    twin = Twin.builtin()
    twin.effects[name] = {p.name: Value(p.default) for p in get_effect(name).parameters}
    twin.effects[name] |= {k: Value(v) for k, v in values.items()}
    return twin


@pytest.fixture(scope="module")
def finger():
    return devices.finger(Twin.builtin(), batch=2, device="cpu")


def test_finger_is_the_twins(finger):
    body, twin = finger.body, Twin.builtin()
    assert 3600 < len(body.cells) < 4400
    assert len(body.cells) * body.spacing_m**3 == pytest.approx(finger_mesh(0.11, 0.02).volume, rel=0.06)
    assert body.material.youngs_modulus_pa == pytest.approx(0.945e6)
    assert finger.spine.joint_positions_m == pytest.approx([1e-3 * s for s in twin.spine_joint_positions_mm])
    # bellows above, a flat back: more material below the axis than above it
    assert (body.positions[:, 2] < 0).sum() > 1.05 * (body.positions[:, 2] > 0).sum()


def test_finger_bends_as_its_pipeline_says(finger):
    g = PAPER_FINGER
    profile = (g["gain_rad_per_kpa"], g["gain_alpha"], g["gain_beta"], g["rest_pressure_kpa"], 4)
    q_cmd = devices.joint_targets(Twin.builtin(), [0.0, 15.0])
    np.testing.assert_allclose(q_cmd, joint_command(np.array([0.0, 15.0]), *profile), rtol=1e-9)
    rest = solve_equilibrium(finger, Loads(q_cmd=q_cmd))
    # the body takes back what its stiffness is worth against the controller's 20 N m/rad
    assert (rest.q < q_cmd).all()
    np.testing.assert_allclose(rest.q, q_cmd, rtol=0.025)
    top = rest.positions[:, np.argmax(finger.body.positions[:, 0])]
    assert top[1, 2] > top[0, 2] + 0.02  # towards +z with pressure


def test_arm_bends_towards_the_chamber_that_pushes():
    twin = Twin("arm", 200.0, parameters={"gain_rad_per_kpa": Value(0.02)})
    arm = devices.arm(twin, batch=2, particles=1500, device="cpu")
    q_cmd = devices.joint_targets(twin, [[10.0, 0.0, 0.0], [0.0, 10.0, 0.0]])
    rest = solve_equilibrium(arm, Loads(q_cmd=q_cmd))
    q = rest.q.reshape(2, 6, 2)
    tip = rest.positions[:, arm.body.positions[:, 0] > 0.195].mean(1)
    assert tip[0, 2] > 0.06 and abs(tip[0, 1]) < 2e-3
    assert tip[1, 1] > 0.05 and tip[1, 2] < -0.02  # 120 degrees from +z towards +y
    np.testing.assert_allclose(q, q_cmd.reshape(2, 6, 2), atol=0.02 * np.abs(q_cmd).max())


def test_effects_act_or_are_named():
    plain = devices.joint_targets(Twin.builtin(), [0.0, 10.0], [0.0, 0.5])
    lag = devices.joint_targets(with_effect("valve_lag"), [0.0, 10.0], [0.0, 0.5])
    assert (lag[0] == plain[0]).all() and (lag[1] < plain[1]).all()
    heavy = with_effect("payload")
    down = {"payload_g": 20.0, "gravity_x": 0.0, "gravity_y": 0.0, "gravity_z": -1.0}
    assert (devices.joint_targets(heavy, [5.0], conditions=down) < plain.mean(0)).all()
    with pytest.raises(InputError, match="payload.*payload_g"):
        devices.joint_targets(heavy, [5.0])
    with pytest.raises(InputError, match="'elongation' moves the tip against its joints"):
        devices.joint_targets(with_effect("elongation"), [5.0])
    with pytest.raises(InputError, match="finite"):
        devices.joint_targets(Twin.builtin(), [np.nan])


def test_bad_devices_are_refused():
    with pytest.raises(InputError, match="of a finger"):
        devices.arm(Twin.builtin())
    with pytest.raises(InputError, match="in metres"):
        devices.finger(Twin.builtin(), mesh=finger_mesh(0.05, 0.02))
    with pytest.raises(InputError, match="at least 2"):
        devices.gel(Twin("gel", 16.0), counts=(1, 2, 3))


def test_gels_face_lies_on_the_ball_in_the_frame_of_the_probe_grid():
    gel = devices.gel(Twin("gel", 16.0), counts=(30, 41, 7), device="cpu")
    assert not np.abs(devices.surface_displacement(gel)).max() > 1e-3
    ball, tip = 4e-3, np.array([2.0e-3, -3.0e-3, -1.0e-3])
    size = np.array([ball, 1.0, 1.0])
    rest = solve_equilibrium(gel, Loads(indenter="sphere", size_m=size, position_m=tip))
    moved = devices.surface_displacement(gel)
    assert moved.shape == (1, 80, 59)
    depth = probe_grid([SPHERE], [[ball, 0, 0]], [tip + [0, 0, ball]], [np.eye(3)])
    deep = depth > 0.75 * depth.max()
    # rows, columns and sign agree: where the ball is deep the face is where the ball is
    assert np.abs(moved[0] - depth)[deep].max() < 0.1
    row, column = np.unravel_index(moved[0].argmax(), moved[0].shape)
    assert abs(row - 24.5) <= 1.5 and abs(column - 38.8) <= 1.5
    assert rest.contact_force[0, 2] < 0


# ---------------------------------------------------------------- in the world


@pytest.fixture(scope="module")
def worlds():
    return World("switch", touch="none"), World("switch", touch="none", fidelity="mpm")


@pytest.mark.nightly
def test_two_seconds_in_the_world_agree_with_the_skeleton(worlds):
    """In free space: what the body takes back of the bend is in the calibrated targets already."""
    skeleton, full = worlds
    bends = []
    for world in worlds:
        world.reset(0)
        bends.append([])
        for k in range(30):
            world.step([0.0, 0.0, 0.0, min(1.5 * k, 15.0)])
            bends[-1].append(world.spine_rad.sum())
    difference = np.array(bends[1]) / np.array(bends[0]) - 1
    assert (np.abs(difference) < 0.01).all()
    again = full.reset(0).state
    np.testing.assert_array_equal(full.reset(0).state, again)
    assert full.finger.substeps > 0 and skeleton.finger is None


@pytest.mark.nightly  # every day: its stiffness, in tests/sim/world/test_fidelity.py
def test_the_material_follows_the_worlds_joints_and_resists(worlds):
    finger = worlds[1].finger
    tip = finger.solver.body.positions[:, 0] > 0.105
    free, bend, heights = (
        devices.joint_targets(Twin.builtin(), [5.0])[0],
        np.array([0.05, 0.03, 0.02, 0.01]),
        {},
    )
    for sign in (0, -1, 1):
        torque, J = finger.torque(free, free + sign * bend)
        np.testing.assert_allclose(torque, sign * J @ bend, rtol=0.1, atol=5e-4)
        heights[sign] = finger.solver.particles()[0][0, tip, 2].mean()
    assert heights[-1] < heights[0] - 1e-3 and heights[1] > heights[0] + 1e-3, "the body comes along"


def test_fidelity_is_checked():
    with pytest.raises(InputError, match="surrogate, mpm, probe"):
        World("switch", fidelity="fem")
