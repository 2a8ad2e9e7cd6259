"""The driver at a pseudo-terminal in real time, against the firmware's own core.

The one way of waiting for hardware, on a simulated clock.
"""

import os
import pty
import signal
import time
import tty

import pytest
from awake import awake_s, hold_up_us, undisturbed
from pressure_rig import connected, raised_by, raises_old, reaches, terminal, until
from simulated_clock import simulate_clock

from lerobot_robot_pneutac.hardware.parts import HardwareFault, wait
from lerobot_robot_pneutac.hardware.pneutac_serial import PneutacSerial
from lerobot_robot_pneutac.hardware.pressure_check import check_pressure_controller
from pneutac_sim.errors import InputError


@pytest.mark.realtime
def test_the_driver_passes_the_check_of_every_controller(program, tmp_path):
    with terminal(program, tmp_path / "rig"):
        check_pressure_controller(PneutacSerial(str(tmp_path / "rig")), 5.0)


@pytest.mark.realtime
def test_limits_of_host_and_controller_are_kept(program, tmp_path):
    link = tmp_path / "rig"
    with terminal(program, link, "--max-kpa", 10):
        with connected(PneutacSerial(str(link))) as controller:
            assert controller.max_kpa == 10
            with pytest.raises(InputError, match="0 ... 10 kPa"):
                controller.set_pressure(10.5)
        with connected(PneutacSerial(str(link), max_kpa="6")) as controller:
            with pytest.raises(InputError, match="0 ... 6 kPa"):
                controller.set_pressure(7)
        with pytest.raises(HardwareFault, match="limit is 10 kPa"):
            PneutacSerial(str(link), max_kpa=15).connect()


@pytest.mark.realtime
def test_a_host_that_falls_silent_leaves_the_chamber_vented(program, tmp_path):
    """The exact bound is tested in simulated time; this is the whole chain, with time for a busy computer."""
    link = tmp_path / "rig"
    with terminal(program, link), connected(PneutacSerial(str(link))) as controller:
        assert reaches(controller, 10)
        exchange = controller._exchange
        exchange.transmit = lambda now_s, command: b""
        assert until(lambda: not exchange._open, 1.0), "no status said that the heartbeat is lost"
        del exchange.transmit
        assert until(lambda: not raises_old(controller), 2.0)
        assert until(lambda: controller.pressure() < 0.5, 2.0)


@pytest.mark.realtime
def test_a_caller_that_hangs_keeps_no_pressure(program, tmp_path):
    with terminal(program, tmp_path / "rig"), connected(PneutacSerial(str(tmp_path / "rig"))) as controller:
        assert reaches(controller, 10)
        assert until(lambda: controller.pressure() < 0.5, 2.0)


@pytest.mark.realtime
def test_a_computer_that_stalls_is_not_taken_for_a_silent_controller(program, tmp_path):
    """For 0.3 s: longer than a measurement is good for, and than the controller waits for a heartbeat."""
    with terminal(program, tmp_path / "rig"), connected(PneutacSerial(str(tmp_path / "rig"))) as controller:
        assert reaches(controller, 8)

        def goes_on():
            hold_up_us(300_000)
            assert controller.pressure() < 8.5
            assert reaches(controller, 8), "it was vented meanwhile, and is filled again"

        for _ in range(3):
            undisturbed(goes_on, own_s=0.3)


@pytest.mark.realtime
def test_replugging_reconnects_and_waits_for_a_new_set_point(program, tmp_path):
    link = tmp_path / "rig"
    with terminal(program, link):
        controller = PneutacSerial(str(link), reconnect_s=10)
        controller.connect()
        assert reaches(controller, 8)
    try:
        assert until(lambda: raises_old(controller), 2.0)
        with terminal(program, link):
            assert until(lambda: not raises_old(controller), 3.0)
            assert controller.pressure() < 0.5
            assert reaches(controller, 8)
    finally:
        controller.disconnect()


@pytest.mark.realtime
def test_an_unplugged_controller_is_one_clear_fault_after_the_stated_time(program, tmp_path):
    link = tmp_path / "rig"
    with terminal(program, link):
        controller = PneutacSerial(str(link), reconnect_s=0.6)
        controller.connect()
        assert reaches(controller, 8)
    start_s, awake = time.monotonic(), awake_s()
    said = raised_by(controller, 8)
    assert 0.3 < time.monotonic() - start_s and awake_s() - awake < 2.0
    assert said.startswith(f"Pressure controller at {link} was lost for 0.6 s")
    controller.vent()
    controller.disconnect()
    controller.disconnect()


@pytest.mark.realtime
def test_a_controller_that_freezes_is_noticed_and_taken_up_again(program, tmp_path):
    link = tmp_path / "rig"
    controller = PneutacSerial(str(link), reconnect_s=10)
    with terminal(program, link) as process, connected(controller):
        assert reaches(controller, 8)
        process.send_signal(signal.SIGSTOP)
        assert until(lambda: raises_old(controller), 2.0)
        process.send_signal(signal.SIGCONT)
        assert reaches(controller, 6)


@pytest.mark.realtime
@pytest.mark.parametrize(
    "option, said", [("--burst", "burst finger"), ("--freeze-sensor", "sensor is stuck")]
)
def test_a_broken_rig_is_a_fault_that_says_what_to_look_for(program, tmp_path, option, said):
    link = tmp_path / "rig"
    with terminal(program, link, option, "--fault-at-s", 1.0, "--leak-per-s", 3):
        controller = PneutacSerial(str(link))
        controller.connect()
        kpa = iter(range(10**6))
        end_s = awake_s() + 8
        fault = ""
        while not fault and awake_s() < end_s:
            fault = raised_by(controller, 9 if next(kpa) % 2 else 12, 0.3)
        controller.disconnect()
        assert said in fault


@pytest.mark.realtime
def test_a_port_that_another_program_has_is_reported(program, tmp_path):
    link = tmp_path / "rig"
    with terminal(program, link), connected(PneutacSerial(str(link))):
        with pytest.raises(HardwareFault, match="cannot be used .*lock"):
            PneutacSerial(str(link)).connect()


@pytest.mark.realtime
def test_wrong_ports_are_reported_at_once(tmp_path):
    start_s = awake_s()
    with pytest.raises(HardwareFault, match="nowhere cannot be used"):
        PneutacSerial(str(tmp_path / "nowhere")).connect()
    assert awake_s() - start_s < 1.0
    with pytest.raises(HardwareFault, match="not connected"):
        PneutacSerial("nowhere").set_pressure(1.0)


def test_a_port_where_nobody_answers_is_reported(tmp_path):
    host, device = pty.openpty()
    tty.setraw(device)
    with pytest.raises(HardwareFault, match="does not answer"):
        PneutacSerial(os.ttyname(device), reconnect_s=0.3).connect()
    os.close(host)
    os.close(device)


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
