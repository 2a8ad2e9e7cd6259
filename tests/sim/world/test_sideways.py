"""A finger that a load bends across its plane: where it goes freely, and how it turns under a drag."""

import numpy as np
import pytest
from arms import arm_twin

from lerobot_pneutac.verbs.design_motion import PRESS, carried_out, sideways
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin, Value
from pneutac_sim.world.base import Variation
from pneutac_sim.world.world import World


@pytest.fixture(scope="module")
def world():
    return World("button", touch="none", sideways=True)


def drag(world, friction, drag_mm=12.0):
    world.variation = Variation(friction=friction)
    return carried_out(world, 3, sideways(drag_mm))


def test_pressure_bends_it_in_its_plane_as_ever(world):
    flat = World("button", touch="none")
    for w in (world, flat):
        w.reset(1)
        for _ in range(40):
            w.step([0, 0, 0, 9.0])
    np.testing.assert_allclose(world.tip, flat.tip, atol=0.01)
    np.testing.assert_allclose(world.spine_rad[:, 1], 0, atol=1e-4)


def test_a_gel_that_sticks_turns_by_three_halves_of_the_way_over_the_length(world):
    """A beam held at its end, whose tip is free to turn, however stiff; the gel's middle is 15 mm beyond."""
    felt = drag(world, friction=5.0)
    beam = np.degrees(1.5 / (world.twin.length_mm + 15.0))
    assert felt.turn_deg_per_mm == pytest.approx(beam, rel=0.15)
    softer = Twin.builtin()
    whole = softer.parameter("joint_stiffness_nm_per_rad")
    softer.parameters = softer.parameters | {"joint_stiffness_nm_per_rad": Value(0.7 * whole)}
    soft = World("button", softer, touch="none", sideways=True)
    assert drag(soft, friction=5.0).turn_deg_per_mm == pytest.approx(felt.turn_deg_per_mm, rel=0.1)
    world.variation = soft.variation = Variation()
    press, pressed = (carried_out(w, 3, PRESS).force_n.mean() for w in (world, soft))
    assert pressed == pytest.approx(0.75 * press, rel=0.1)


def test_one_that_slips_turns_less(world):
    turns = [drag(world, friction).turn_deg_per_mm for friction in (5.0, 0.3, 0.05)]
    assert turns[0] > turns[1] > turns[2] and turns[2] < 0.3 * turns[0]
    assert carried_out(world, 3, PRESS).turn_deg_per_mm == 0


def test_a_body_of_several_chambers_is_refused():
    with pytest.raises(InputError, match="has 3 chambers"):
        World("button", arm_twin(), touch="none", sideways=True)
