"""The drivers at a pseudo-terminal in real time: the firmware's own core, and a tiny rig that speaks text."""

import os
import pty
import signal
import sys
import threading
import time
import tty
from contextlib import contextmanager
from pathlib import Path

import pytest

from lerobot_robot_pneutac.hardware.parts import HardwareFault
from lerobot_robot_pneutac.hardware.pneutac_serial import PneutacSerial
from lerobot_robot_pneutac.hardware.pressure_check import check_pressure_controller
from lerobot_robot_pneutac.hardware.serial_pressure import Command
from lerobot_robot_pneutac.hardware.text_serial import TextExchange, TextSerial
from pneutac_sim.errors import InputError

sys.path.insert(0, str(Path(__file__).parent))
from pressure_rig import build, terminal, until  # noqa: E402


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    return build(tmp_path_factory.mktemp("firmware"))


@contextmanager
def connected(controller):
    controller.connect()
    try:
        yield controller
    finally:
        controller.disconnect()


def reaches(controller, kpa, timeout_s=5.0, within=0.3):
    """Whether the pressure gets there, the set-point repeated as a control loop does.

    A reading that is too old is waited for: this computer may stall for longer than a real line would.
    """

    def there():
        try:
            controller.set_pressure(kpa)
            return abs(controller.pressure() - kpa) < within
        except HardwareFault as e:
            assert " s old" in str(e)
            return False

    return until(there, timeout_s)


def raised_by(controller, kpa, timeout_s=5.0):
    """The final fault of a control loop, past readings that are merely too old."""
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        try:
            controller.set_pressure(kpa)
            controller.pressure()
        except HardwareFault as e:
            if " s old" not in str(e):
                return str(e)
        time.sleep(0.01)
    return ""


def test_the_driver_passes_the_check_of_every_controller(program, tmp_path):
    with terminal(program, tmp_path / "rig"):
        check_pressure_controller(PneutacSerial(str(tmp_path / "rig")), 5.0)


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


def test_a_caller_that_hangs_keeps_no_pressure(program, tmp_path):
    with terminal(program, tmp_path / "rig"), connected(PneutacSerial(str(tmp_path / "rig"))) as controller:
        assert reaches(controller, 10)
        assert until(lambda: controller.pressure() < 0.5, 2.0)


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


def raises_old(controller):
    try:
        controller.pressure()
    except HardwareFault as e:
        assert " s old; check cable and power" in str(e)
        return True
    return False


def test_an_unplugged_controller_is_one_clear_fault_after_the_stated_time(program, tmp_path):
    link = tmp_path / "rig"
    with terminal(program, link):
        controller = PneutacSerial(str(link), reconnect_s=0.6)
        controller.connect()
        assert reaches(controller, 8)
    start = time.monotonic()
    said = raised_by(controller, 8)
    assert 0.3 < time.monotonic() - start < 2.0
    assert said.startswith(f"Pressure controller at {link} was lost for 0.6 s")
    controller.vent()
    controller.disconnect()
    controller.disconnect()


def test_a_controller_that_freezes_is_noticed_and_taken_up_again(program, tmp_path):
    link = tmp_path / "rig"
    controller = PneutacSerial(str(link), reconnect_s=10)
    with terminal(program, link) as process, connected(controller):
        assert reaches(controller, 8)
        process.send_signal(signal.SIGSTOP)
        assert until(lambda: raises_old(controller), 2.0)
        process.send_signal(signal.SIGCONT)
        assert reaches(controller, 6)


@pytest.mark.parametrize(
    "option, said", [("--burst", "burst finger"), ("--freeze-sensor", "sensor is stuck")]
)
def test_a_broken_rig_is_a_fault_that_says_what_to_look_for(program, tmp_path, option, said):
    link = tmp_path / "rig"
    with terminal(program, link, option, "--fault-at-s", 1.0, "--leak-per-s", 3):
        controller = PneutacSerial(str(link))
        controller.connect()
        kpa = iter(range(10**6))
        end = time.monotonic() + 8
        fault = ""
        while not fault and time.monotonic() < end:
            fault = raised_by(controller, 9 if next(kpa) % 2 else 12, 0.3)
        controller.disconnect()
        assert said in fault


def test_wrong_ports_are_told_at_once(tmp_path):
    start = time.monotonic()
    with pytest.raises(HardwareFault, match="nowhere cannot be used"):
        PneutacSerial(str(tmp_path / "nowhere")).connect()
    assert time.monotonic() - start < 1.0
    with pytest.raises(HardwareFault, match="not connected"):
        PneutacSerial("nowhere").set_pressure(1.0)


def test_a_port_where_nobody_answers_is_told(tmp_path):
    host, device = pty.openpty()
    tty.setraw(device)
    with pytest.raises(HardwareFault, match="does not answer"):
        PneutacSerial(os.ttyname(device), reconnect_s=0.3).connect()
    os.close(host)
    os.close(device)


class TextRig:
    """Speaks text; follows at once and keeps the last set-point for ever, as simple rigs do."""

    def __init__(self):
        self.host, self.device = pty.openpty()
        tty.setraw(self.device)
        self.port, self.kpa, self.answers = os.ttyname(self.device), 0.0, True
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self):
        with os.fdopen(self.host, "rb", buffering=0) as host:
            rest = b""
            while data := host.read(100):
                *lines, rest = (rest + data).split(b"\n")
                for line in lines:
                    if line == b"end":
                        return
                    self.kpa = float(line.removeprefix(b"P "))
                    if self.answers:
                        os.write(self.host, b"noise\n%.2f\r\n" % self.kpa)

    def close(self):
        os.write(self.device, b"end\n")
        os.close(self.device)


@pytest.fixture
def text_rig():
    rig = TextRig()
    yield rig
    rig.close()


def test_text_passes_the_check_of_every_controller(text_rig):
    check_pressure_controller(TextSerial(text_rig.port, max_kpa=15), 5.0)


def test_a_text_rig_is_vented_on_leaving_and_its_silence_noticed(text_rig):
    with connected(TextSerial(text_rig.port, max_kpa=15, reconnect_s=0.5)) as controller:
        assert reaches(controller, 5)
        text_rig.answers = False
        assert until(lambda: raises_old(controller), 2.0)
        assert "was lost for 0.5 s" in raised_by(controller, 5)
    with connected_when_answering(text_rig) as controller:
        assert reaches(controller, 5)
    assert text_rig.kpa == 0


@contextmanager
def connected_when_answering(rig):
    rig.answers = True
    with connected(TextSerial(rig.port, max_kpa=15)) as controller:
        yield controller


def test_text_takes_only_lines_that_are_a_plausible_pressure_and_an_answer():
    exchange = TextExchange(15.0)
    exchange.receive(b"4.00\n", 0.0)
    assert exchange.measured_kpa is None
    assert exchange.transmit(0.5, Command(None, 0)) == b"P 0.00\n"
    exchange.receive(b"0.00\n", 0.51)
    assert exchange.transmit(1.0, Command(8.0, 1)) == b"P 8.00\n"
    exchange.receive(b"nan\n1e3\n8,0\n999\nP 8.00\n\xff\n-80\n7.", 1.01)
    assert exchange.measured_kpa == 0
    exchange.receive(b"98\r\n", 1.02)
    assert (exchange.measured_kpa, exchange.measured_s) == (7.98, 1.0)
    exchange.restart()
    assert exchange.transmit(2.0, Command(8.0, 1)) == b"P 0.00\n"
    assert exchange.transmit(2.2, Command(8.0, 2)) == b"P 8.00\n"
    exchange.receive(b"0.10\n", 2.21)
    assert exchange.measured_s == 2.0, "the answer may be the first question's"
