"""A body in real time is the pipeline's, its links are its kinematics, and its skin goes with them."""

import numpy as np

from lerobot_pneutac.studio.live import LiveBody, Shape, Skin, links
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.finger import PressurePipeline
from pneutac_sim.finger.kinematics import forward_kinematics_spatial
from pneutac_sim.twin import PAPER_FINGER, Twin, Value

FINGER = Twin.builtin()
AT = np.array(FINGER.spine_joint_positions_mm)


def test_links_end_where_the_kinematics_says():
    q = np.random.default_rng(0).normal(0, 0.4, (4, 2))
    shape = Shape(*links(q, AT), np.zeros(5))
    tip, _ = forward_kinematics_spatial(q[None], AT, FINGER.length_mm)
    np.testing.assert_allclose(shape.spine_mm(FINGER.length_mm, AT)[-1], tip[0], atol=1e-9)
    np.testing.assert_allclose(
        shape.turns @ shape.turns.transpose(0, 2, 1), np.tile(np.eye(3), (5, 1, 1)), atol=1e-12
    )


def test_it_goes_on_as_the_pipeline_does():
    twin = Twin.builtin()
    twin.effects["valve_lag"] = get_effect("valve_lag").start(15.0)
    body, same = LiveBody(twin, {}), PressurePipeline(twin)
    for _ in range(5):
        shape = body.step(np.array([10.0]), np.zeros(3), 0.03)
        markers = same.place(same.step(10.0, 0.03), 0.03)
    np.testing.assert_array_equal(shape.markers, markers)
    assert 0 < shape.bend_deg < LiveBody(FINGER, {}).step(np.array([10.0]), np.zeros(3), 0.03).bend_deg


def test_a_poke_bends_towards_where_it_pushes_as_springs_do():
    stiff = FINGER.copy()
    stiff.parameters["joint_stiffness_nm_per_rad"] = Value(100 * PAPER_FINGER["joint_stiffness_nm_per_rad"])
    free = LiveBody(stiff, {}).step(np.zeros(1), np.zeros(3), 0.1)
    poked = LiveBody(stiff, {}).step(np.zeros(1), np.array([0.0, 0.0, 0.1]), 0.1)
    # small angles: each joint turns by F lever / K, and moves the tip by lever times that
    levers = free.markers[0] - free.places_mm[1:, 0]
    moved = 0.1 * (1e-3 * levers**2).sum() / stiff.parameter("joint_stiffness_nm_per_rad")
    np.testing.assert_allclose(poked.markers[2] - free.markers[2], moved, rtol=0.03)


def test_the_skin_rests_where_it_is_made_and_its_tip_goes_with_the_last_link():
    skin = Skin.of(FINGER)
    straight = Shape(*links(np.zeros(4), AT), np.zeros(5))
    np.testing.assert_allclose(skin.carried_mm(straight, AT), skin.vertices_mm, atol=1e-9)
    bent = Shape(*links(np.full(4, 0.3), AT), np.zeros(5))
    end = skin.vertices_mm[:, 0] > FINGER.length_mm - 1
    local = skin.vertices_mm[end] - [AT[-1], 0, 0]
    there = local @ bent.turns[-1].T + bent.places_mm[-1]
    np.testing.assert_allclose(skin.carried_mm(bent, AT)[end], there, atol=1e-6)
