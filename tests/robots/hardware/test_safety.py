"""Every guarantee of docs/how_to/real_robot.md about limits and faults, with the fault injected."""

import itertools
import logging
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import lerobot_robot_pneutac
from lerobot_robot_pneutac.hardware import safety
from lerobot_robot_pneutac.hardware.limits import Limits
from lerobot_robot_pneutac.hardware.parts import COMMAND_S, ArmState, HardwareFault
from lerobot_robot_pneutac.hardware.safety import REFUSALS, VENT_S, Guard

CENTRE = np.array([0.5, 0.0, 0.4])


class Parts:
    """An arm and a pressure controller in one, which keep a diary and fail on request."""

    def __init__(self):
        self.diary: list[tuple[float, str, object]] = []
        self.breaks: dict[str, BaseException] = {}
        self.hangs: str | None = None
        self.flange_m, self.force_n, self.kpa = CENTRE, 0.0, 0.0

    def _do(self, name, value=None):
        if name not in ("state", "pressure"):
            self.diary.append((time.monotonic(), name, value))
        if self.hangs == name:
            time.sleep(30)
        if name in self.breaks:
            raise self.breaks[name]

    def state(self):
        self._do("state")
        return ArmState(np.zeros(7), np.zeros(7), self.flange_m, self.force_n)

    def pressure(self):
        self._do("pressure")
        return self.kpa

    def move(self, velocity):
        self._do("move", velocity)

    def stop(self):
        self._do("stop")

    def set_pressure(self, kpa):
        self._do("set_pressure", kpa)

    def vent(self):
        self._do("vent")

    def names(self):
        return [name for _, name, _ in self.diary]

    def last(self, *names):
        return next(((n, v) for _, n, v in reversed(self.diary) if n in names), None)

    def halted(self):
        return self.last("move", "stop") == ("stop", None) and self.last("set_pressure", "vent") == (
            "vent",
            None,
        )


@pytest.fixture
def parts():
    return Parts()


@pytest.fixture
def guard(parts):
    guard = Guard(parts, parts, Limits())
    guard.start()
    yield guard
    guard.close()


def until(true, seconds=2.0):
    end = time.monotonic() + seconds
    while not true() and time.monotonic() < end:
        time.sleep(0.005)
    return true()


MOVE = np.array([0.05, 0.0, 0.0, 2.0])


# ---------------------------------------------------------------- actions


def test_an_action_is_carried_out_within_the_limits(parts, guard):
    parts.flange_m = np.array([0.5, 0.0, Limits().low_m[2]])
    done = guard.act(np.array([0.11, 0.02, -0.05, 0.1]))
    np.testing.assert_allclose(done[:3], [0.1, 0.02, 0.0])
    np.testing.assert_array_equal(parts.last("move")[1], done[:3])
    assert 0 < parts.last("set_pressure")[1] == done[3] <= 0.1


def test_a_refused_action_stops_the_arm_holds_the_pressure_and_is_logged(parts, guard, caplog):
    time.sleep(0.05)
    held = guard.act(MOVE)[3]
    with caplog.at_level(logging.WARNING):
        done = guard.act(np.array([np.nan, 0, 0, 9.0]))
    np.testing.assert_array_equal(done, [0, 0, 0, held])
    assert parts.last("move", "stop")[0] == "stop"
    assert parts.last("set_pressure", "vent") == ("set_pressure", held)
    assert "dx.vel is nan" in caplog.text
    guard.act(MOVE)  # a good one goes on
    assert parts.last("move", "stop")[0] == "move"
    assert guard.refused == 1


def test_refusals_in_a_row_are_a_fault(parts, guard):
    guard.act(MOVE)
    for _ in range(REFUSALS - 1):
        guard.act(np.full(4, np.nan))
    with pytest.raises(HardwareFault, match="in a row were refused"):
        guard.act(np.full(4, np.nan))
    assert parts.halted()


# ---------------------------------------------------------------- watchdog


def test_without_actions_the_arm_stops_then_the_chamber_is_vented_then_an_action_goes_on(parts, guard):
    guard.act(MOVE)
    start = time.monotonic()
    assert until(lambda: "stop" in parts.names())
    assert COMMAND_S <= time.monotonic() - start < COMMAND_S + 0.25
    assert "vent" not in parts.names()
    assert until(lambda: "vent" in parts.names())
    assert VENT_S <= time.monotonic() - start < VENT_S + 0.5
    assert guard.fault is None
    done = guard.act(MOVE)
    assert parts.last("move", "stop")[0] == "move"
    assert done[3] == parts.last("set_pressure", "vent")[1] <= MOVE[3]


def test_refused_actions_do_not_keep_the_watchdog_quiet(parts, guard, monkeypatch):
    monkeypatch.setattr(safety, "VENT_S", 0.1)
    monkeypatch.setattr(safety, "REFUSALS", 10**6)
    guard.act(MOVE)

    def vented():
        guard.act(np.full(4, np.nan))
        return "vent" in parts.names()

    assert until(vented)


# ---------------------------------------------------------------- faults


@pytest.mark.parametrize("part", ["state", "move", "pressure", "set_pressure"])
@pytest.mark.parametrize("error", [HardwareFault("The cable is out."), OSError("bad descriptor")])
def test_a_lost_part_halts_everything_and_stays_a_fault(parts, guard, part, error):
    guard.act(MOVE)
    parts.breaks[part] = error
    with pytest.raises(HardwareFault, match="cable is out|bad descriptor"):
        guard.act(MOVE)
    assert parts.halted()
    parts.breaks.clear()
    before = parts.names().count("move")
    for call in (guard.look, lambda: guard.act(MOVE)):
        with pytest.raises(HardwareFault, match="cable is out|bad descriptor"):
            call()
    assert parts.names().count("move") == before


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("force_n", 25.0, "force at the flange is 25.0 N"),
        ("force_n", np.nan, "check the sensors"),
        ("kpa", 18.0, "pressure is 18.0 kPa"),
        ("kpa", np.nan, "check the sensors"),
    ],
)
def test_a_broken_limit_is_seen_although_nobody_asks(parts, guard, name, value, said):
    guard.act(MOVE)
    start = time.monotonic()
    setattr(parts, name, value)
    assert until(parts.halted)
    assert time.monotonic() - start < COMMAND_S  # sooner than the watchdog would
    with pytest.raises(HardwareFault, match=said):
        guard.look()


@pytest.mark.parametrize("part", ["stop", "vent"])
def test_halting_goes_on_where_one_part_raises(parts, guard, part):
    guard.act(MOVE)
    parts.breaks[part] = OSError("gone")
    guard.halt()
    assert parts.halted()


def test_a_stop_that_hangs_does_not_keep_the_chamber_full(parts, guard):
    guard.act(MOVE)
    parts.hangs = "stop"
    threading.Thread(target=guard.fail, args=(HardwareFault("Test."),), daemon=True).start()
    assert until(lambda: "vent" in parts.names())
    time.sleep(3 * safety.HOLD_S)  # the watchdog would hold the pressure by now
    assert [kpa for _, name, kpa in parts.diary[parts.names().index("vent") :] if kpa] == []


def test_a_pressure_that_is_held_while_another_thread_halts_ends_vented(parts, guard, monkeypatch):
    monkeypatch.setattr(safety, "VENT_S", 60.0)
    guard.act(MOVE)
    set_pressure = parts.set_pressure

    def halted_meanwhile(kpa):
        monkeypatch.undo()
        guard.halt()
        set_pressure(kpa)

    monkeypatch.setattr(parts, "set_pressure", halted_meanwhile)
    assert until(lambda: parts.names().count("set_pressure") == 2)  # the second by the watchdog
    assert until(parts.halted)


def test_a_jump_of_the_pressure_is_followed_at_the_rate(parts):
    start_s = time.monotonic()
    guard = Guard(parts, parts, Limits(pressure_rate_kpa_s=20.0))
    for _ in range(4):
        guard.act(np.array([0.0, 0.0, 0.0, 10.0]))
        time.sleep(0.05)
    sent = [(at_s, kpa) for at_s, name, kpa in parts.diary if name == "set_pressure"]
    assert all(0 < kpa <= 20.0 * (at_s - start_s) for at_s, kpa in sent)
    assert all(before[1] < after[1] for before, after in itertools.pairwise(sent))


@pytest.mark.parametrize(("part", "said"), [("stop", "Stopping the arm"), ("vent", "Venting")])
def test_a_watchdog_that_cannot_halt_a_part_is_a_fault(parts, guard, part, said):
    guard.act(MOVE)
    parts.breaks[part] = OSError("no answer")
    assert until(lambda: guard.fault is not None)
    assert f"{said} failed: no answer" in str(guard.fault)
    assert until(lambda: {"stop", "vent"} <= set(parts.names()))  # the other one is not forgotten


def test_an_arm_that_hangs_in_a_command_leaves_the_watchdog_working(parts, guard, monkeypatch):
    monkeypatch.setattr(safety, "VENT_S", 0.3)
    guard.act(MOVE)
    parts.hangs = "move"
    threading.Thread(target=guard.act, args=(MOVE,), daemon=True).start()
    assert until(parts.halted)


def test_a_fault_during_a_command_has_the_last_word(parts, guard, monkeypatch):
    def move(velocity):
        guard.fail(HardwareFault("The camera is gone."))
        parts.diary.append((time.monotonic(), "move", velocity))

    monkeypatch.setattr(parts, "move", move)
    with pytest.raises(HardwareFault, match="camera is gone"):
        guard.act(MOVE)
    assert parts.halted()


@pytest.mark.parametrize("part", ["state", "move", "set_pressure"])
def test_ctrl_c_within_a_command_halts_at_once_and_goes_on_up(parts, part):
    guard = Guard(parts, parts, Limits())  # its threads rest: only the main thread is interrupted
    guard.act(MOVE)
    parts.breaks[part] = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt):
        guard.act(MOVE)
    assert parts.halted()


def test_the_end_of_the_program_halts_where_nobody_disconnected():
    # The package without its front door, which would import LeRobot.
    program = f"""
import atexit, sys, time, types, numpy as np
sys.path[:0] = {sys.path!r}
package = sys.modules["lerobot_robot_pneutac"] = types.ModuleType("lerobot_robot_pneutac")
package.__path__ = {list(lerobot_robot_pneutac.__path__)!r}
from lerobot_robot_pneutac.hardware.limits import Limits
from lerobot_robot_pneutac.hardware.parts import ArmState
from lerobot_robot_pneutac.hardware.safety import Guard
class Parts:
    def state(self): return ArmState(np.zeros(7), np.zeros(7), np.array([.5, 0, .4]), 0.0)
    def pressure(self): return 0.0
    def move(self, v): pass
    def set_pressure(self, kpa): print("set", flush=True)
    def stop(self): print("stopped", flush=True)
    def vent(self): print("vented", flush=True)
    def disconnect(self): print("let go", flush=True)
parts = Parts()
atexit.register(time.sleep, 0.5)  # runs after the guard's hook; its threads are alive still
guard = Guard(parts, parts, Limits())
guard.start()
guard.act(np.array([.05, 0, 0, 2.]))
raise KeyboardInterrupt
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert "KeyboardInterrupt" in done.stderr
    assert done.stdout.split("\n") == ["set", "vented", "stopped", "let go", ""]
