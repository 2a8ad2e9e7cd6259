"""The SpaceMouse through a stub with the calls of pyspacemouse, one report a read as there."""

import sys
import types

import numpy as np
import pytest
from lerobot.utils.errors import DeviceNotConnectedError


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
