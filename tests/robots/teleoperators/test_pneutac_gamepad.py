"""The gamepad through a stub of pygame's controller interface, and through SDL's own virtual gamepad."""

import ctypes
import importlib
import logging
import sys
import types
from pathlib import Path

import numpy as np
import pytest
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


class VirtualPad:
    """A gamepad that SDL itself takes for one; its sixth axes are the triggers."""

    def __init__(self):
        pygame = importlib.import_module("pygame")
        bundled = Path(pygame.__file__).parents[1] / "pygame.libs"
        self.sdl = ctypes.CDLL(str(next(bundled.glob("libSDL2-2*"))))
        self.sdl.SDL_JoystickOpen.restype = ctypes.c_void_p
        importlib.import_module("pygame._sdl2.controller").init()
        self.index = self.sdl.SDL_JoystickAttachVirtual(1, 6, 15, 0)
        assert self.index == 0
        self.joystick = ctypes.c_void_p(self.sdl.SDL_JoystickOpen(0))
        for name in AXES[4:]:
            self.set(name, 0)

    def set(self, name, value):
        raw = 2 * value - 32768 if name.startswith("TRIGGER") else value
        value = ctypes.c_int16(max(-32768, min(32767, raw)))
        self.sdl.SDL_JoystickSetVirtualAxis(self.joystick, AXES.index(name), value)

    def unplug(self):
        self.sdl.SDL_JoystickDetachVirtual(0)


@pytest.fixture(params=["stub", "sdl"])
def pad(request, monkeypatch):
    if request.param == "stub":
        return Pad(monkeypatch)
    pygame = pytest.importorskip("pygame", reason="pygame is not installed: no virtual gamepad")
    if not list((Path(pygame.__file__).parents[1] / "pygame.libs").glob("libSDL2-2*")):
        pytest.skip("this pygame brings no SDL library of its own: no virtual gamepad")
    virtual = VirtualPad()
    request.addfinalizer(virtual.unplug)
    return virtual


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
