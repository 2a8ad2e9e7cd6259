"""A camera of the robot's that is read at once: late because of the computer, and lost."""

import numpy as np
import pytest
from simulated_clock import simulate_clock

from lerobot_robot_pneutac.cameras.tactile import LiveCamera
from lerobot_robot_pneutac.hardware.parts import TURNS, HardwareFault


class Late:
    """Too old so many times, as after a stall, then new."""

    def __init__(self, times):
        self.times = times

    def read_latest(self, max_age_ms):
        self.times -= 1
        if self.times >= 0:
            raise TimeoutError("the newest picture is 812 ms old")
        return np.zeros((2, 2, 3), np.uint8)


@pytest.fixture(autouse=True)
def clock(monkeypatch):
    return simulate_clock(monkeypatch)


def test_a_computer_that_was_held_up_finds_the_next_picture():
    assert LiveCamera(Late(TURNS), "front").latest().shape == (2, 2, 3)


def test_a_lost_camera_is_a_fault():
    with pytest.raises(HardwareFault, match="'front' gives no picture: the newest picture is 812 ms old"):
        LiveCamera(Late(TURNS + 1), "front").latest()
