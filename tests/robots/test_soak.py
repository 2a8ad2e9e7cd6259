"""Hours of use: nothing grows, nothing is left open, and programs that start cold at once do not meet."""

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from lerobot_robot_pneutac.cameras.simulated import DigitGeneratedConfig
from lerobot_robot_pneutac.hardware.arms import SimulatedArmConfig
from lerobot_robot_pneutac.robots.config_pneutac import PneutacConfig, PressureConfig
from lerobot_robot_pneutac.robots.pneutac import Pneutac
from pneutac_sim.world.world import World

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.timeout(3600),
    pytest.mark.skipif(sys.platform != "linux", reason="memory and files are read from /proc"),
]
MOST_MB = 8.0  # that memory may grow after the first tenth
COLD = """
import numpy as np, taichi as ti
from pneutac_sim.world.world import World
world = World("switch", fidelity="surrogate")
for _ in range(3):
    world.step([0.05, 0, 0, 5.0])
ti.init(arch=ti.cpu, log_level=ti.ERROR)

@ti.kernel
def total(n: int) -> float:
    s = 0.0
    for i in range(n):
        s += 0.5
    return s

assert total(10) == 5.0
print(*world.flange_m.round(9))
"""


def used() -> tuple[float, int, int]:
    """Resident memory in MB, open files, threads of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return (
        pages * os.sysconf("SC_PAGE_SIZE") / 1e6,
        len(os.listdir("/proc/self/fd")),
        threading.active_count(),
    )


def stays(begun: tuple[float, int, int]) -> None:
    memory_mb, files, threads = used()
    assert memory_mb < begun[0] + MOST_MB and files <= begun[1] and threads <= begun[2]


def test_half_an_hour_of_steps_and_resets():
    world, rng, start, begun = (
        World("switch", fidelity="surrogate"),
        np.random.default_rng(0),
        time.monotonic(),
        None,
    )
    episode = 0
    while time.monotonic() < start + 1800:
        world.reset(episode if episode % 3 else None)
        for _ in range(60):
            world.step(np.append(rng.uniform(-0.1, 0.1, 3), rng.uniform(0, 15)))
        episode += 1
        if begun is None and time.monotonic() > start + 180:
            begun = used()
    stays(begun)


def test_a_thousand_connections_of_the_robot(tmp_path):
    begun = None
    for k in range(1000):  # half a second each, in which the gel's rest image is taken
        parts = {"arm": SimulatedArmConfig(), "pressure": PressureConfig(type="simulated")}
        robot = Pneutac(
            PneutacConfig(id="soak", calibration_dir=tmp_path, digit=DigitGeneratedConfig(), **parts)
        )
        robot.connect()
        robot.get_observation()
        robot.disconnect()
        if k == 100:
            begun = used()
    stays(begun)


def test_eight_programs_that_start_cold_at_once_agree(tmp_path):
    """Compiled code of numba and Taichi is made by all of them, into one empty cache."""
    own = {
        "NUMBA_CACHE_DIR": str(tmp_path / "numba"),
        "XDG_CACHE_HOME": str(tmp_path / "xdg"),
        "OMP_NUM_THREADS": "1",
    }
    program = tmp_path / "cold.py"  # Taichi reads a kernel's source from its file
    program.write_text(COLD)
    programs = [
        subprocess.Popen(
            [sys.executable, program],
            env=os.environ | own | {"OMP_NUM_THREADS": "1"},
            stdout=subprocess.PIPE,
            text=True,
        )
        for _ in range(8)
    ]
    said = [p.communicate(timeout=1800)[0].splitlines() for p in programs]
    assert [p.returncode for p in programs] == [0] * 8
    assert len({lines[-1] for lines in said}) == 1
