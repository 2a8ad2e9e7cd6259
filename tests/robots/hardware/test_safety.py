"""Every guarantee of docs/how_to/real_robot.md about limits and faults, with the fault injected."""

import itertools
import logging
import subprocess
import sys
import threading
import time
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from awake import awake_s, hold_up_us, until

import lerobot_camera_digit
import lerobot_robot_pneutac
from lerobot_robot_pneutac.hardware import safety
from lerobot_robot_pneutac.hardware.parts import COMMAND_S, ArmState, HardwareFault
from lerobot_robot_pneutac.hardware.safety import RECENT, REFUSALS, VENT_S, Guard, Limits

pytestmark = pytest.mark.realtime
CENTRE = np.array([0.5, 0.0, 0.4])


class Entry(NamedTuple):
    """What a part was sent; `awake_s` leaves out for how long this computer was held up."""

    at_s: float
    name: str
    value: object
    awake_s: float


class Parts:
    """An arm and a pressure controller in one, which keep a diary and fail on request."""

    def __init__(self):
        self.diary: list[Entry] = []
        self.breaks: dict[str, BaseException] = {}
        self.hangs: str | None = None
        self.slow_s, self.reads = 0.0, 0
        self.flange_m, self.force_n, self.kpa = CENTRE, 0.0, 0.0

    def _do(self, name, value=None):
        self.reads += name in ("state", "pressure")
        if name not in ("state", "pressure"):
            self.diary.append(Entry(time.monotonic(), name, value, awake_s()))
        time.sleep(self.slow_s)
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

    def disconnect(self):
        self._do("disconnect")

    def names(self):
        return [e.name for e in self.diary]

    def calls(self, name):
        return [e for e in self.diary if e.name == name]

    def last(self, *names):
        return next(((e.name, e.value) for e in reversed(self.diary) if e.name in names), None)

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


def assert_exit_waits_for_no_thread():
    assert [t for t in threading.enumerate() if not t.daemon] == [threading.main_thread()]


MOVE = np.array([0.05, 0.0, 0.0, 2.0])


# ---------------------------------------------------------------- actions


def test_an_action_is_carried_out_within_the_limits(parts, guard):
    parts.flange_m = np.array([0.5, 0.0, Limits().low_m[2]])
    done = guard.act(np.array([0.11, 0.02, -0.05, 0.1]))
    np.testing.assert_allclose(done[:3], [0.1, 0.02, 0.0])
    np.testing.assert_array_equal(parts.last("move")[1], done[:3])
    assert 0 < parts.last("set_pressure")[1] == done[3] <= 0.1


def test_a_refused_action_stops_the_arm_vents_and_is_logged(parts, guard, caplog):
    time.sleep(0.05)
    guard.act(MOVE)
    with caplog.at_level(logging.WARNING):
        done = guard.act(np.array([np.nan, 0, 0, 9.0]))
    np.testing.assert_array_equal(done, [0, 0, 0, 0])
    assert parts.halted()
    assert "dx.vel is nan" in caplog.text
    time.sleep(3 * safety.HOLD_S)  # the watchdog would hold the pressure by now
    assert parts.halted()
    guard.act(MOVE)  # a good one goes on
    assert parts.last("move", "stop")[0] == "move"
    assert guard.refused == 1 and guard.fault is None


def test_after_a_refused_action_the_pressure_begins_at_zero(parts, guard):
    for _ in range(3):
        time.sleep(0.05)
        guard.act(MOVE)
    time.sleep(0.15)
    start_s = time.monotonic()
    guard.act(np.full(4, np.inf))
    high = MOVE + [0, 0, 0, 13]
    assert guard.act(high)[3] <= Limits().pressure_rate_kpa_s * (time.monotonic() - start_s)


def test_a_set_point_that_the_limits_hold_back_is_logged_once(parts, caplog):
    guard = Guard(parts, parts, Limits(vacuum_kpa=-5.0, pressure_kpa=10.0))
    for kpa in (10.0, -5.0, 10.0009, -5.0009):
        guard.act(np.array([0.0, 0.0, 0.0, kpa]))
    assert not caplog.records
    for kpa in (12.0, -6.0, 13.0):
        guard.act(np.array([0.0, 0.0, 0.0, kpa]))
    assert [r.getMessage() for r in caplog.records] == [
        "A set-point of 12 kPa is clipped to the limits, -5 to 10 kPa; later ones are not logged."
    ]
    below = Guard(parts, parts, Limits(vacuum_kpa=-5.0))
    below.act(np.array([0.0, 0.0, 0.0, -6.0]))
    assert caplog.records[-1].getMessage().startswith("A set-point of -6 kPa is clipped")


@pytest.mark.parametrize("good_between", [0, 3])
def test_refusals_that_are_a_quarter_of_the_last_actions_are_a_fault(parts, guard, good_between):
    for _ in range(RECENT):
        guard.act(MOVE)
    for _ in range(REFUSALS - 1):
        guard.act(np.full(4, np.nan))
        for _ in range(good_between):
            guard.act(MOVE)
    with pytest.raises(HardwareFault, match=f"{REFUSALS} of the last {RECENT} actions were refused"):
        guard.act(np.full(4, np.nan))
    assert parts.halted()


def test_rarer_refusals_are_no_fault(parts, guard):
    for k in range(4 * RECENT):
        guard.act(np.full(4, np.nan) if k % REFUSALS == 0 else MOVE)
    assert guard.fault is None and guard.refused == 4 * RECENT // REFUSALS


def test_the_times_and_numbers_are_those_of_the_manual():
    assert COMMAND_S + 2 * safety.TICK_S <= 0.3  # the arm is stopped
    assert VENT_S + 2 * safety.TICK_S <= 1.1  # the chamber is vented
    assert safety.ARM_S + safety.HALT_S < 0.3  # an arm that hangs is a fault
    assert (safety.MOVE_S, safety.CLOSE_S) == (3.0, 1.0)
    assert safety.HOLD_S < COMMAND_S - 3 * safety.TICK_S  # before the controller takes a command as void
    assert (REFUSALS, RECENT) == (5, 20)


# ---------------------------------------------------------------- watchdog


def test_without_actions_the_arm_stops_then_the_chamber_is_vented_then_an_action_goes_on(parts, guard):
    start_s, awake = time.monotonic(), awake_s()
    guard.act(MOVE)
    assert until(lambda: "vent" in parts.names())
    for name, after_s in (("stop", COMMAND_S), ("vent", VENT_S)):
        first = parts.calls(name)[0]
        assert after_s <= first.at_s - start_s and first.awake_s - awake < after_s + 0.25
    time.sleep(4 * safety.TICK_S)
    assert parts.names().count("stop") == parts.names().count("vent") == 1
    assert parts.names()[-1] == "vent"  # and the pressure is held no more
    assert guard.fault is None
    done = guard.act(MOVE)
    assert parts.last("move", "stop")[0] == "move"
    assert done[3] == parts.last("set_pressure", "vent")[1] <= MOVE[3]


def test_before_the_first_action_the_watchdog_does_nothing(parts, monkeypatch):
    monkeypatch.setattr(safety, "COMMAND_S", 0.01)
    monkeypatch.setattr(safety, "VENT_S", 0.02)
    guard = Guard(parts, parts, Limits())
    guard.start()
    time.sleep(0.1)
    assert parts.names() == []
    assert all(thread.daemon for thread in guard._threads)  # Python's exit must not wait for them
    guard.close()


def test_the_pressure_is_held_before_the_controller_takes_the_command_as_void(parts, guard):
    guard.act(MOVE)
    assert until(lambda: parts.names().count("set_pressure") >= 2)
    first, second = parts.calls("set_pressure")[:2]
    assert safety.HOLD_S - 0.01 <= second.at_s - first.at_s and second.awake_s - first.awake_s < COMMAND_S
    assert second.value == first.value


def test_closing_halts_and_ends_the_threads(parts, guard):
    guard.act(MOVE)
    parts.slow_s = 0.1  # the monitor is in the middle of a reading
    time.sleep(2 * safety.TICK_S)
    guard.close()
    assert parts.halted()
    assert not [thread for thread in guard._threads if thread.is_alive()]


def test_a_closed_guard_is_not_called_at_the_end_of_the_program(parts, monkeypatch):
    calls = set()
    monkeypatch.setattr(safety, "atexit", SimpleNamespace(register=calls.add, unregister=calls.discard))
    guard = Guard(parts, parts, Limits())
    guard.start()
    assert calls == {guard._last_line}
    guard.close()
    assert not calls


def test_after_the_end_of_the_program_nothing_is_read(parts, guard):
    guard._last_line()
    time.sleep(3 * safety.TICK_S)
    reads = parts.reads
    time.sleep(3 * safety.TICK_S)
    assert parts.reads == reads


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
    start_s = awake_s()
    setattr(parts, name, value)
    assert until(parts.halted)
    assert awake_s() - start_s < COMMAND_S  # sooner than the watchdog would
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
    assert [e.value for e in parts.diary[parts.names().index("vent") :] if e.value] == []


@pytest.mark.parametrize("end", ["halt", "_last_line"])
def test_a_pressure_that_is_held_while_another_thread_ends_it_ends_vented(parts, guard, monkeypatch, end):
    monkeypatch.setattr(safety, "VENT_S", 60.0)
    guard.act(MOVE)
    set_pressure = parts.set_pressure

    def halted_meanwhile(kpa):
        monkeypatch.undo()
        getattr(guard, end)()
        set_pressure(kpa)

    monkeypatch.setattr(parts, "set_pressure", halted_meanwhile)
    assert until(lambda: parts.names().count("set_pressure") == 2)  # the second by the watchdog
    assert until(parts.halted)


def test_a_jump_of_the_pressure_is_followed_at_the_rate(parts):
    start_s = time.monotonic()
    guard = Guard(parts, parts, Limits(pressure_rate_kpa_s=2.0))
    for _ in range(4):
        guard.act(np.array([0.0, 0.0, 0.0, 10.0]))
        time.sleep(0.05)
    sent = parts.calls("set_pressure")
    assert len(sent) == 4 and all(0 < e.value <= 2.0 * (e.at_s - start_s) for e in sent)
    assert all(before.value < after.value for before, after in itertools.pairwise(sent))


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
    monkeypatch.setattr(safety, "MOVE_S", 0.8)
    with pytest.raises(HardwareFault, match="The arm has not answered for 0.8 s"):
        guard.act(MOVE)
    assert parts.calls("vent")[0].awake_s - parts.diary[0].awake_s < 0.6  # by the watchdog
    assert parts.halted()


@pytest.mark.parametrize("hangs_too", [None, "stop"])
def test_an_arm_whose_state_hangs_is_a_fault_within_300_ms(parts, guard, hangs_too):
    guard.act(MOVE)
    if hangs_too:
        parts.breaks["stop"] = OSError("gone")
    start_s = awake_s()
    parts.hangs = "state"
    with pytest.raises(HardwareFault, match="The arm has not answered for 0.2 s"):
        while True:
            guard.act(MOVE)
    assert awake_s() - start_s < 0.3
    assert until(parts.halted)
    assert_exit_waits_for_no_thread()
    guard.close()


def test_an_interpreter_that_is_held_up_is_no_fault_of_the_arm(parts, guard):
    """By a call into C that keeps it for longer than an arm may take."""
    quick = parts.state

    def state():
        hold_up_us(300_000)
        return quick()

    parts.state = state
    guard.act(MOVE)
    assert guard.fault is None


def test_a_halt_does_not_wait_for_a_stop_that_hangs(parts, guard):
    guard.act(MOVE)
    parts.hangs = "stop"
    start_s, awake = time.monotonic(), awake_s()
    guard.halt()
    assert safety.HALT_S <= time.monotonic() - start_s and awake_s() - awake < 0.3
    assert parts.halted()
    assert_exit_waits_for_no_thread()


def test_a_fault_during_a_command_has_the_last_word(parts, guard, monkeypatch):
    def move(velocity):
        guard.fail(HardwareFault("The camera is gone."))
        parts._do("move", velocity)

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
    # The packages without their front doors, which would import LeRobot.
    packages = {p.__name__: list(p.__path__) for p in (lerobot_camera_digit, lerobot_robot_pneutac)}
    program = f"""
import atexit, sys, time, types, numpy as np
sys.path[:0] = {sys.path!r}
for name, path in {packages!r}.items():
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].__path__ = path
from lerobot_robot_pneutac.hardware.safety import Limits
from lerobot_robot_pneutac.hardware.parts import ArmState
from lerobot_robot_pneutac.hardware import safety
from lerobot_robot_pneutac.hardware.safety import Guard
safety.HOLD_S = safety.COMMAND_S = 60.0  # the watchdog waits, however long this computer takes to end
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
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300)
    assert "KeyboardInterrupt" in done.stderr
    assert done.stdout.split("\n") == ["set", "vented", "stopped", "let go", ""]
