"""The driver of text rigs, against a tiny one."""

import os
import pty
import re
import shutil
import subprocess
import threading
import time
import tty
from pathlib import Path

import pytest
from pressure_rig import connected, raised_by, raises_old, reaches, until

from lerobot_robot_pneutac.hardware.serial_pressure import Command, TextExchange, TextSerial


class TextRig:
    """Speaks text; follows at once and keeps the last set-point for ever, as simple rigs do."""

    def __init__(self):
        self.host, self.device = pty.openpty()
        tty.setraw(self.device)
        self.port, self.kpa, self.answers, self.takes_s = os.ttyname(self.device), 0.0, True, 0.0
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self):
        with os.fdopen(self.host, "rb", buffering=0) as host:
            rest = b""
            while data := host.read(100):
                *lines, rest = (rest + data).split(b"\n")
                for line in lines:
                    if line == b"end":
                        return
                    time.sleep(self.takes_s)
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


@pytest.mark.realtime
def test_a_text_rig_is_vented_on_leaving_and_its_silence_noticed(text_rig):
    with connected(TextSerial(text_rig.port, max_kpa=15, reconnect_s=1.0)) as controller:
        assert reaches(controller, 5)
        text_rig.answers = False
        assert until(lambda: raises_old(controller), 2.0)
        assert "was lost for 1 s" in raised_by(controller, 5)
    text_rig.answers = True
    with connected(TextSerial(text_rig.port, max_kpa=15)) as controller:
        assert reaches(controller, 5)
    assert text_rig.kpa == 0


@pytest.mark.realtime
@pytest.mark.slow
def test_a_rig_that_answers_slowly_is_vented_on_leaving_whenever_that_is(text_rig):
    text_rig.takes_s = 0.08
    for k in range(4):
        with connected(TextSerial(text_rig.port, max_kpa=15)) as controller:
            assert reaches(controller, 5)
            time.sleep(0.02 * k)
        assert until(lambda: text_rig.kpa == 0, 2.0)


def test_a_vent_waits_for_no_answer_and_a_set_point_does():
    exchange = TextExchange(15.0)
    exchange.transmit(0.0, Command(None, 0))
    exchange.receive(b"0.00\n", 0.01)
    assert exchange.transmit(1.0, Command(8.0, 1)) == b"P 8.00\n"
    assert exchange.transmit(1.01, Command(9.0, 2)) == b""
    assert exchange.transmit(1.02, Command(None, 3)) == b"P 0.00\n"
    assert exchange.transmit(1.03, Command(None, 3)) == b""


BOARD = r"""
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#define constrain(amt, low, high) ((amt) < (low) ? (low) : ((amt) > (high) ? (high) : (amt)))
static uint32_t now_ms = 0;
static uint32_t millis() { return now_ms; }
static float driven = 0;
static float measuredKpa() { return driven; }
static void drive(float kpa) { driven = kpa; }
struct Port {
  const char* text = "";
  void begin(long) {}
  void setTimeout(long) {}
  int available() { return *text != 0; }
  int read() { return *text ? *text++ : -1; }
  float parseFloat() {  // what is no number is skipped; without one it gives 0, as a board does
    while (*text && !strchr_(*text)) ++text;
    char* end = const_cast<char*>(text);
    const float value = *text ? strtof(text, &end) : 0;
    text = end;
    return value;
  }
  void println(float value, int) { printf("%.2f\n", value); }
  static bool strchr_(char c) { return c == '-' || (c >= '0' && c <= '9'); }
} Serial;
"""
PLAY = r"""
static void run(const char* text, int ms) {
  Serial.text = text;
  for (int i = 0; i < ms; ++i, ++now_ms) loop();
  printf("%.2f\n", driven);
}
int main() {
  setup();
  run("P 8.00\n", 50);
  run("P 99.00\n", 50);
  run("", 300);
}
"""


def test_the_documents_rig_follows_limits_and_lets_go(tmp_path):
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("needs a C++ compiler")
    document = Path(__file__).parents[3] / "docs" / "reference" / "pressure_protocol.md"
    (sketch,) = re.findall(r"```cpp\n(.*?)```", document.read_text(), re.S)
    (tmp_path / "rig.cpp").write_text(BOARD + sketch + PLAY)
    subprocess.run([compiler, tmp_path / "rig.cpp", "-o", tmp_path / "rig"], check=True)
    said = subprocess.run([tmp_path / "rig"], check=True, capture_output=True, text=True).stdout.split()
    assert said[1::2][:2] == ["8.00", "15.00"] and said[-1] == "0.00"


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
