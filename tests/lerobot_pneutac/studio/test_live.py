"""A body in real time is the pipeline's, its links are its kinematics, and its skin goes with them."""

import numpy as np

from lerobot_pneutac.studio.live import LiveBody, Shape, links
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


def test_a_poke_bends_towards_where_it_pushes_as_springs_do():
    stiff = FINGER.copy()
    stiff.parameters["joint_stiffness_nm_per_rad"] = Value(100 * PAPER_FINGER["joint_stiffness_nm_per_rad"])
    free = LiveBody(stiff, {}).step(np.zeros(1), np.zeros(3), 0.1)
    poked = LiveBody(stiff, {}).step(np.zeros(1), np.array([0.0, 0.0, 0.1]), 0.1)
    # small angles: each joint turns by F lever / K, and moves the tip by lever times that
    levers = free.markers[0] - free.places_mm[1:, 0]
    moved = 0.1 * (1e-3 * levers**2).sum() / stiff.parameter("joint_stiffness_nm_per_rad")
    np.testing.assert_allclose(poked.markers[2] - free.markers[2], moved, rtol=0.03)
