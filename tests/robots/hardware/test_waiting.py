"""The one way of waiting for hardware, on a simulated clock."""

import pytest
from simulated_clock import simulate_clock

from lerobot_robot_pneutac.hardware.parts import wait


@pytest.fixture
def clock(monkeypatch):
    return simulate_clock(monkeypatch)


def test_what_is_true_is_not_waited_for(clock):
    assert wait(lambda: True, 0.0) and clock.sleeps == 0


@pytest.mark.parametrize("after, found", [(3, True), (4, False)])
def test_it_is_asked_until_the_limit(clock, after, found):
    assert wait(lambda: clock.sleeps >= after, 3 * 0.03, 0.03) == found
    assert clock.sleeps == 3


def test_a_stall_of_the_computer_counts_as_two_ticks(clock):
    clock.stalls_s = {1: 5.0}
    assert not wait(lambda: False, 0.5, 0.1) and clock.sleeps == 4


def test_what_is_raised_ends_it(clock):
    with pytest.raises(ZeroDivisionError):
        wait(lambda: 1 / 0, 10.0)
