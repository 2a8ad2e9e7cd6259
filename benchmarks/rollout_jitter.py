"""Does `lerobot-rollout` hold 15 Hz? `python benchmarks/rollout_jitter.py --policy=CHECKPOINT --seconds=30`.

Runs the very command on `--robot.type=pneutac` with simulated arm, pressure controller and sensor, and prints
how the time between two ticks scatters.
"""

import argparse
import sys
import tempfile
import time

import numpy as np
from lerobot.scripts.lerobot_rollout import main as rollout

from lerobot_robot_pneutac.robots.pneutac import Pneutac
from pneutac_sim.features import CONTROL_HZ


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--policy", required=True, help="folder of a checkpoint, `.../pretrained_model`")
    parser.add_argument("--seconds", type=int, default=30)
    options = parser.parse_args()
    ticks, get_observation = [], Pneutac.get_observation

    def timed(self):
        ticks.append(time.perf_counter())
        return get_observation(self)

    Pneutac.get_observation = timed  # once a tick; actions are also sent on the way to the first pose
    parts = ("arm.type=simulated", "pressure.type=simulated", "digit.type=digit_generated", "id=jitter")
    with tempfile.TemporaryDirectory() as folder:
        sys.argv = [
            "lerobot-rollout",
            "--strategy.type=base",
            "--device=cpu",
            f"--fps={CONTROL_HZ}",
            f"--duration={options.seconds}",
            "--task=jitter",
            f"--policy.path={options.policy}",
            "--robot.type=pneutac",
            f"--robot.calibration_dir={folder}",
            *(f"--robot.{part}" for part in parts),
            "--play_sounds=false",
        ]
        rollout()
    period = 1e3 * np.diff(ticks)
    late = np.mean(period > 1.5e3 / CONTROL_HZ)
    low, median, high = np.percentile(period, (1, 50, 99))
    print(f"{len(ticks)} ticks at {1e3 / period.mean():.2f} Hz, {100 * late:.1f} % late by half a period.")
    print(f"ms between two: median {median:.1f}, 1 % {low:.1f}, 99 % {high:.1f}, most {period.max():.1f}.")


if __name__ == "__main__":
    main()
