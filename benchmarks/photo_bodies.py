"""Calibrates hidden fingers to their photographs; prints tip errors at other pressures and parameters.

python benchmarks/photo_bodies.py --seeds=3,4,5,6,7,8 --device=auto --evaluations=84
"""

import json
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lerobot_pneutac.fit_photographs import fit_photographs
from lerobot_pneutac.options import parse_options
from pneutac_datasets.photographs import write_photographs
from pneutac_sim.twin import Twin

PRESSURES_KPA = [0.0, 1.0, 3.0, 4.0, 6.0, 7.0, 9.0, 10.0, 12.0, 13.0, 15.0]
COMPARED = ("gain_rad_per_kpa", "gain_alpha", "gain_beta", "rest_pressure_kpa")


@dataclass
class Config:
    seeds: str = "3,4,5,6,7,8"
    device: str = "auto"
    evaluations: int = 84


def main(argv: list[str]) -> None:
    config = parse_options(Config, argv)
    means = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in config.seeds.split(","):
            recording = write_photographs(Path(folder) / seed, seed=int(seed), pressures_kpa=PRESSURES_KPA)
            truth = json.loads((Path(folder) / "truth" / f"{seed}.json").read_text())["parameters"]
            twin = Twin.builtin()
            twin.length_mm = recording.length_mm
            twin.spine_joint_positions_mm = recording.spine_joint_positions_mm
            found = fit_photographs(twin, recording, evaluations=config.evaluations, device=config.device)
            tips = found.tip_error_mm[~found.session.train]
            means.append(tips.mean())
            off = {k: found.twin.parameters[k].value - _number(truth[k]) for k in COMPARED}
            shares = {k: f"{100 * off[k] / _number(truth[k]):+.1f} %" for k in (COMPARED[0], COMPARED[3])}
            print(
                f"seed {seed}: {found.seconds:.0f} s, tip {tips.mean():.2f} mm (worst {tips.max():.2f}), "
                f"gain {shares[COMPARED[0]]}, alpha {off['gain_alpha']:+.3f}, beta {off['gain_beta']:+.3f}, "
                f"rest pressure {shares[COMPARED[3]]}",
                flush=True,
            )
    if len(means) > 1:
        error = np.std(means, ddof=1) / np.sqrt(len(means))
        print(f"mean over bodies: {np.mean(means):.2f} mm, standard error {error:.2f} mm")


def _number(value) -> float:
    return float(value["value"] if isinstance(value, dict) else value)


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
