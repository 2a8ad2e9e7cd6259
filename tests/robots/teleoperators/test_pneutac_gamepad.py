"""The gamepad through a stub of pygame's controller interface.

The SpaceMouse through a stub with the calls of pyspacemouse, one report a read as there.
"""

import logging
import sys
import types

import numpy as np
import pytest
from draccus.utils import DecodingError
from lerobot.teleoperators import TeleoperatorConfig
from lerobot.utils.errors import DeviceNotConnectedError

AXES = ("LEFTX", "LEFTY", "RIGHTX", "RIGHTY", "TRIGGERLEFT", "TRIGGERRIGHT")


class Pad:
    """Stub with the calls of pygame's controller module and of its Controller."""

    def __init__(self, monkeypatch):
        self.axes, self.there = dict.fromkeys(AXES, 0), True
        names = {f"CONTROLLER_AXIS_{name}": name for name in AXES}
        controller = types.ModuleType("pygame._sdl2.controller")
        controller.init = controller.quit = controller.update = lambda: None
        controller.get_count = lambda: int(self.there)
        controller.is_controller = lambda i: True
        controller.Controller = lambda i: types.SimpleNamespace(
            attached=lambda: self.there, get_axis=self.axes.__getitem__, quit=lambda: None
        )
        pygame, sdl2 = types.ModuleType("pygame"), types.ModuleType("pygame._sdl2")
        vars(pygame).update(names)
        sdl2.controller = controller
        for module in (pygame, sdl2, controller):
            monkeypatch.setitem(sys.modules, module.__name__, module)

    def set(self, name, value):
        self.axes[name] = value

    def unplug(self):
        self.there = False


@pytest.fixture
def pad(monkeypatch):
    return Pad(monkeypatch)


@pytest.mark.parametrize(
    ("stick", "axis", "sign"), [("LEFTY", 0, -1), ("LEFTX", 1, -1), ("RIGHTY", 2, -1), ("RIGHTX", None, 0)]
)
def test_sticks_move_beyond_their_dead_zone(teleop, act, pad, stick, axis, sign):
    gamepad = teleop("pneutac_gamepad", speed_m_s=0.06, dead_zone=0.1)
    for value, share in ((32767, 1.0), (0.55 * 32767, 0.5), (-32768, -1.0), (0.09 * 32767, 0.0), (0, 0.0)):
        pad.set(stick, int(value))
        expected = np.zeros(4)
        if axis is not None:
            expected[axis] = sign * share * 0.06
        np.testing.assert_allclose(act(gamepad), expected, atol=1e-5)


def test_triggers_change_the_pressure_in_proportion(teleop, act, pad):
    gamepad = teleop("pneutac_gamepad", pressure_rate_kpa_s=4.0, dead_zone=0.1)
    pad.set("TRIGGERRIGHT", 32767)
    assert act(gamepad, 15)[3] == pytest.approx(4.0, abs=1e-3)
    pad.set("TRIGGERRIGHT", int(0.55 * 32767))
    assert act(gamepad, 15)[3] == pytest.approx(6.0, abs=1e-3)
    pad.set("TRIGGERRIGHT", 0)
    assert act(gamepad, 15)[3] == pytest.approx(6.0, abs=1e-3)
    pad.set("TRIGGERLEFT", 32767)
    assert act(gamepad, 45)[3] == 0.0


def test_unplugged_gamepad_stops_holds_the_pressure_and_says_so_once(teleop, act, pad, caplog):
    gamepad = teleop("pneutac_gamepad", pressure_rate_kpa_s=4.0)
    pad.set("TRIGGERRIGHT", 32767)
    pad.set("LEFTY", -32768)
    moving = act(gamepad, 15)
    assert moving[0] > 0
    pad.unplug()
    np.testing.assert_allclose(act(gamepad, 5), [0, 0, 0, moving[3]])
    assert [r.message for r in caplog.records if r.levelno == logging.ERROR] == [
        "The gamepad was unplugged: the arm is stopped and the pressure held; plug it in and start the"
        " command again."
    ]


def test_what_is_pressed_at_the_start_counts_only_once_let_go(teleop, act, pad, caplog):
    gamepad = teleop("pneutac_gamepad", connect=False)
    pad.set("TRIGGERRIGHT", 16383)
    gamepad.connect()
    np.testing.assert_array_equal(act(gamepad, 15), np.zeros(4))
    assert sum("let go" in r.message for r in caplog.records) == 1
    pad.set("TRIGGERRIGHT", 0)
    act(gamepad)
    pad.set("TRIGGERRIGHT", 32767)
    assert act(gamepad)[3] > 0


def test_missing_gamepad_or_pygame_is_one_sentence(teleop, monkeypatch):
    Pad(monkeypatch).unplug()
    gamepad = teleop("pneutac_gamepad", connect=False)
    with pytest.raises(DeviceNotConnectedError, match="No gamepad was found; plug one in"):
        gamepad.connect()
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(DeviceNotConnectedError, match=r"uv pip install .*\[gamepad\]"):
        gamepad.connect()


class UsbError(Exception):
    pass


class Mouse:
    def __init__(self, monkeypatch):
        self.reports = []
        self.state = types.SimpleNamespace(t=-1.0, x=0.0, y=0.0, z=0.0, buttons=[0, 0])
        self.there, self.closed = True, False
        module = types.ModuleType("pyspacemouse")
        module.AxisConvention = types.SimpleNamespace(ROS="ros")
        module.open = self.open
        monkeypatch.setitem(sys.modules, "pyspacemouse", module)
        easyhid = types.ModuleType("easyhid")
        easyhid.HIDException = UsbError
        monkeypatch.setitem(sys.modules, "easyhid", easyhid)

    def open(self, axis_convention):
        assert axis_convention == "ros"
        if not self.there:
            raise RuntimeError("No connected or supported devices found.")
        return self

    def read(self):
        if not self.there:
            raise UsbError
        if self.reports:
            vars(self.state).update(self.reports.pop(0), t=self.state.t + 0.008)
        return self.state

    def close(self):
        self.closed = True


def test_spacemouse_follows_the_newest_report_and_its_buttons(teleop, act, monkeypatch):
    mouse = Mouse(monkeypatch)
    device = teleop("pneutac_spacemouse", speed_m_s=0.1, pressure_rate_kpa_s=3.0)
    mouse.reports = [{"x": 0.1 * i, "y": -0.5, "z": 0.25} for i in range(6)] + [{"buttons": [0, 1]}]
    np.testing.assert_allclose(act(device), [0.05, -0.05, 0.025, 3.0 / 15])
    mouse.reports = [{"x": 0.0, "y": 0.0, "z": 0.0, "buttons": [0, 0]}]
    np.testing.assert_allclose(act(device, 5), [0, 0, 0, 3.0 / 15])
    device.disconnect()
    assert mouse.closed


def test_unplugged_or_missing_spacemouse_is_one_sentence(teleop, act, monkeypatch, caplog):
    mouse = Mouse(monkeypatch)
    device = teleop("pneutac_spacemouse")
    mouse.reports = [{"x": 1.0}]
    assert act(device)[0] > 0
    mouse.there = False
    np.testing.assert_array_equal(act(device, 3), np.zeros(4))
    assert [r.message.split(":")[0] for r in caplog.records] == ["The SpaceMouse was unplugged"]
    device.disconnect()
    with pytest.raises(DeviceNotConnectedError, match="No SpaceMouse can be opened.*plug one in"):
        device.connect()
    monkeypatch.setitem(sys.modules, "pyspacemouse", None)
    with pytest.raises(DeviceNotConnectedError, match=r"uv pip install .*\[spacemouse\]"):
        device.connect()


@pytest.mark.parametrize(
    ("kind", "options", "text"),
    [
        ("pneutac_keyboard", {"speed_m_s": 0.2}, "speed_m_s is 0.2; it must be above 0 and at most 0.1"),
        ("pneutac_keyboard", {"max_pressure_kpa": 0.0}, "and not both 0"),
        ("pneutac_keyboard", {"bend_range_rad": (1.2, 0.5)}, "give the smaller bend first"),
        ("pneutac_gamepad", {"dead_zone": 1.0}, "dead_zone is 1.0"),
    ],
)
def test_bad_options_are_one_sentence(kind, options, text):
    with pytest.raises(DecodingError, match=text):
        TeleoperatorConfig.get_choice_class(kind)(**options)
