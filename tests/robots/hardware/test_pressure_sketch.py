"""The sketch's own loop on a stub of its board, whose clock moves by what each call takes on an Uno."""

import pytest
from pressure_rig import SimulatedTime, build

from lerobot_robot_pneutac.hardware import pneutac_serial as wire
from lerobot_robot_pneutac.hardware.pneutac_serial import Flag


@pytest.fixture(scope="module")
def program():
    return build("sketch_sim")


@pytest.fixture
def rig(program):
    rig = SimulatedTime(program)
    yield rig
    rig.close()


def longest_gap_ms(rig) -> float:
    times = [step[0] for step in rig.trace]
    return max(b - a for a, b in zip(times, times[1:], strict=False))


def test_it_fills_a_chamber_and_vents_it_where_the_heartbeat_ends(rig):
    rig.open()
    rig.send(wire.set_point(7, 1, 8000))
    rig.beat(1000)
    assert abs(rig.trace[-1][1] - 8000) < 200
    assert rig.status.flags & ~Flag.INLET_OPEN == 0
    assert longest_gap_ms(rig) < 2
    rig.run(85)
    assert rig.trace[-1][3:] == (0, 1)


def test_a_host_that_babbles_at_1_mb_a_second_delays_no_step_beyond_5_ms(rig):
    """A gap of more than 60 ms would also end the program: the board's watchdog is on."""
    rig.open()
    rig.send(wire.set_point(7, 1, 8000))
    rig.beat(300)
    rig.send_line("babble 1000")
    began_ms = rig.trace[-1][0]
    rig.run(3000)
    assert longest_gap_ms(rig) <= 5
    assert next(step[0] for step in rig.trace if step[0] > began_ms and step[4] == 1) - began_ms < 100
    assert rig.trace[-1][1] < 100
    assert Flag.HEARTBEAT_LOST in rig.status.flags
