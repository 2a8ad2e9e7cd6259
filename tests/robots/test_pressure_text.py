"""The driver of text rigs, against a tiny one."""

import os
import pty
import sys
import threading
import tty
from pathlib import Path

import pytest

from lerobot_robot_pneutac.hardware.pressure_check import check_pressure_controller
from lerobot_robot_pneutac.hardware.serial_pressure import Command
from lerobot_robot_pneutac.hardware.text_serial import TextExchange, TextSerial

sys.path.insert(0, str(Path(__file__).parent))
from pressure_rig import connected, raised_by, raises_old, reaches, until  # noqa: E402


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
    text_rig.answers = True
    with connected(TextSerial(text_rig.port, max_kpa=15)) as controller:
        assert reaches(controller, 5)
    assert text_rig.kpa == 0


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
