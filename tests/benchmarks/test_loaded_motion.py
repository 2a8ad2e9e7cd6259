"""Motion under loads: what is drawn, and the finger of the world against material points."""

import numpy as np
import pytest

from pneutac_benchmarks.loaded_motion import Program, compare, to_tip
from pneutac_sim.surrogate.programs import joint_targets
from pneutac_sim.twin import Twin


def test_loads_are_forces_at_the_tip_that_are_held_and_let_go():
    twin, steps = Twin.builtin(), 60
    program = Program.draw(twin, "random", steps, 3)
    assert program.pressure_kpa.shape == (steps + 1,) and program.torque_nm.shape == (steps, 4)
    ways = [to_tip(twin, joint_targets(twin, p)) for p in program.pressure_kpa[1:]]
    force = []
    for way, torque in zip(ways, program.torque_nm, strict=True):
        F, left, *_ = np.linalg.lstsq(np.stack([-way.imag, way.real], 1), torque, rcond=None)
        assert left < 1e-20
        force.append(np.hypot(*F))
    force = np.array(force)
    assert (force < 1e-12).any() and 0.2 <= force[force > 1e-12].min() and force.max() <= 0.6
    np.testing.assert_array_equal(program.torque_nm, Program.draw(twin, "random", steps, 3).torque_nm)


@pytest.mark.nightly
def test_the_worlds_finger_moves_under_loads_as_material_points_do():
    """Within 1 % of the length, where the skeleton without the network has at least three times as much."""
    apart, seconds = compare(("steps", "chirp"), steps=12, seed=7)
    network, skeleton = (apart[k].mean() for k in ("network", "skeleton"))
    assert apart["network"].max() < 0.01 * 110.0
    assert skeleton > 3 * network and network < apart["springs"].mean()
    assert seconds["network"] < 0.01 * seconds["material points"]
