"""Teleoperators made as LeRobot makes them, on time that only their ticks move."""

import types

import numpy as np
import pytest
from lerobot.teleoperators import TeleoperatorConfig, make_teleoperator_from_config
from lerobot.teleoperators.keyboard import teleop_keyboard

import lerobot_robot_pneutac  # noqa: F401  registers the types
from lerobot_robot_pneutac.robots.base_robot import BEND_NAMES
from lerobot_robot_pneutac.teleoperators import velocity_teleop
from pneutac_sim.features import ACTION_HIGH, ACTION_LOW, ACTION_NAMES

TICK_S = 1 / 15


class Listener:
    def __init__(self, on_press, on_release):
        self.press, self.release, self.alive = on_press, on_release, False

    def start(self):
        self.alive = True

    def is_alive(self):
        return self.alive

    def stop(self):
        self.alive = False


@pytest.fixture
def clock(monkeypatch):
    """Time that only `tick` moves."""
    clock = types.SimpleNamespace(now_s=0.0)
    monkeypatch.setattr(velocity_teleop.time, "monotonic", lambda: clock.now_s)
    return clock


@pytest.fixture
def act(clock):
    """Ticks a teleoperator at 15 Hz; the last action (4,), checked against names and limits."""

    def act(device, ticks=1) -> np.ndarray:
        for _ in range(ticks):
            clock.now_s += TICK_S
            action = device.get_action()
        assert tuple(action) == tuple(device.action_features)
        assert tuple(action) in (ACTION_NAMES, BEND_NAMES)
        values = np.array(list(action.values()))
        assert ((values >= ACTION_LOW) & (values <= ACTION_HIGH)).all()
        return values

    return act


@pytest.fixture
def teleop(monkeypatch, tmp_path, act):
    """Makes a teleoperator the way LeRobot does."""
    made = []

    def make(kind, connect=True, **options):
        config = TeleoperatorConfig.get_choice_class(kind)(id="t", calibration_dir=tmp_path, **options)
        made.append(make_teleoperator_from_config(config))
        if connect:
            made[-1].connect()
            act(made[-1])  # everything is let go once
        return made[-1]

    monkeypatch.setattr(teleop_keyboard, "PYNPUT_AVAILABLE", True)
    monkeypatch.setattr(teleop_keyboard, "pynput_can_capture", lambda: True)
    monkeypatch.setattr(teleop_keyboard, "keyboard", types.SimpleNamespace(Listener=Listener))
    yield make
    for device in made:
        if device.is_connected:
            device.disconnect()
