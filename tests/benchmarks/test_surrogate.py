"""`pneutac benchmark surrogate`: a motion of the network itself, a press that holds, splats, bad input."""

import numpy as np
import pytest

from pneutac_benchmarks.surrogate.errors import motion_errors
from pneutac_benchmarks.surrogate.options import BenchmarkSurrogateConfig
from pneutac_benchmarks.surrogate.rows import row, table
from pneutac_benchmarks.surrogate.speed import DEPTH_M, _approach, draw_by_splats, press_on
from pneutac_sim.errors import InputError
from pneutac_sim.surrogate.action import without_torque
from pneutac_sim.surrogate.collect import FRAME_S, Motion
from pneutac_sim.surrogate.network import ActionNetwork
from pneutac_sim.surrogate.networks import builtin
from pneutac_sim.surrogate.programs import joint_targets
from pneutac_sim.twin import Twin
from pneutac_sim.world.world import World

pytestmark = pytest.mark.slow


def test_a_motion_of_the_network_itself_has_no_error():
    network, twin = ActionNetwork.load(builtin("action")), Twin.builtin()
    pressure = np.linspace(5.0, 10.0, 51)
    target = joint_targets(twin, pressure)
    still = np.zeros(target.shape[1])
    q, q_vel, _ = network.roll(target[0], still, target, pressure, 50 * FRAME_S)
    own = Motion(np.vstack([target[:1], q]), np.vstack([still, q_vel]), target, pressure)
    position, velocity, inside = motion_errors(network, own)
    assert position == 0 and velocity == 0 and inside == 1
    bare = motion_errors(without_torque(network), own)
    assert bare[0] > 0.05 and bare[1] > 1


@pytest.mark.nightly
def test_the_press_keeps_the_gel_on_the_object_and_splats_draw_it():
    world = World("switch", touch="image", fidelity="probe")
    _approach(world)
    deep = []
    for _ in range(100):
        world.step(press_on(world))
        deep.append(float(world.touch.depth_mm.max()))
    assert min(deep) > 0 and 0.6e3 * DEPTH_M < np.mean(deep[-30:]) < 1.1e3 * DEPTH_M
    assert np.std(deep[-30:]) < 0.05, "it is held there"
    drawn = world.touch.image
    draw_by_splats(world)
    world.touch.sense(world.data)
    by_splats = world.touch.image
    assert by_splats.dtype == np.uint8 and by_splats.shape == drawn.shape
    change, seen = (x.astype(float) - world.sensor.rest_image for x in (drawn, by_splats))
    assert np.abs(change).max() > 10 and (by_splats != drawn).any()
    assert np.corrcoef(change.ravel(), seen.ravel())[0, 1] > 0.95, "the same imprint at the same place"
    assert np.std(seen - change) < 0.3 * np.std(change)


def test_a_row_has_the_mean_and_its_standard_error():
    r = row("joint angle", "°", [1.0, 2.0, 3.0], 4.0, "≤ 0.03", "0.051", "a note")
    assert r["mean"] == 2 and r["sem"] == pytest.approx(1 / np.sqrt(3)) and r["cases"] == 3
    assert row("speed", "times", [5.0])["sem"] is None
    lines = table([r, row("steps", "steps/s", [1234.4])]).splitlines()
    assert lines[2] == "| joint angle | 2 ± 0.577 ° | 4 | ≤ 0.03 | 0.051 | a note |"
    assert lines[3] == "| steps | 1,234 steps/s |  |  |  |  |"


@pytest.mark.parametrize("options", [{"device": "tpu"}, {"contacts": 0}, {"steps": 5}, {"trajectories": 0}])
def test_bad_options_are_refused(options):
    with pytest.raises(InputError, match=next(iter(options))):
        BenchmarkSurrogateConfig(**options)
