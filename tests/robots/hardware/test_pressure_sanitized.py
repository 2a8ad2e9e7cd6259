"""The firmware under the address and undefined-behaviour sanitizers: a finding ends the program."""

import random
import shutil
import subprocess

import pytest
from pressure_rig import SimulatedTime, build

from lerobot_robot_pneutac.hardware import pneutac_serial as wire

FLAGS = "-O1 -Wall -Wextra -Werror -fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all"
EXTREMES = (2**31 - 1, -(2**31), 0, 16501, -1500, 28114)


@pytest.fixture(scope="module", autouse=True)
def sanitizers():
    compiler = shutil.which("g++") or shutil.which("clang++")
    probe = [compiler, "-fsanitize=address,undefined", "-x", "c++", "-", "-o", "/dev/null"]
    if compiler and subprocess.run(probe, input=b"int main() {}", capture_output=True).returncode:
        pytest.skip("the compiler has no sanitizers")


def damaged(rng) -> bytes:
    frames = [
        wire.hello(rng.randrange(65536), True, rng.randrange(2**32)),
        wire.set_point(7, rng.randrange(65536), rng.randrange(-(2**31), 2**31)),
        wire.vent(7, rng.randrange(65536)),
        wire.encode(wire.Frame(rng.randrange(256), 7, 1, rng.randbytes(rng.randrange(33)))),
        rng.randbytes(rng.randrange(1, 200)) + b"\0",
    ]
    data = bytearray(rng.choice(frames))
    if rng.random() < 0.5:
        data[rng.randrange(len(data))] = rng.randrange(256)
    return bytes(data)


@pytest.mark.parametrize("rounds", [300, pytest.param(30000, marks=pytest.mark.nightly)])
def test_no_bytes_and_no_readings_break_the_core(rounds):
    rng, rig = random.Random(0), SimulatedTime(build("pressure_sim", f"CXXFLAGS={FLAGS}"))
    heard = 0
    for k in range(rounds):
        if k % 10 == 0:
            heard += len(rig.frames)
            rig.frames.clear()  # a hello looks through all of them for its reply
            rig.open()
            rig.send(wire.set_point(7, 1, 15000))
        rig.send(damaged(rng))
        rig.see(*rng.choices([*EXTREMES, rng.randrange(15000)], k=3))
        rig.send(wire.heartbeat(7, k % 10 + 1))
        rig.skip(5)
    assert heard > rounds // 2
    rig.close()
    assert rig.exit_code == 0


def test_the_sketch_under_babble():
    rig = SimulatedTime(build("sketch_sim", f"CXXFLAGS={FLAGS}"))
    rig.open()
    rig.send_line("babble 1000")
    rig.run(300)
    rig.close()
    assert rig.exit_code == 0
