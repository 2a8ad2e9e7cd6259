"""What the model's fit to the calibration press costs through material points of some Poisson's ratios.

    python benchmarks/tactile_poisson.py --sets=digit_nagoya,digit_fots

Beside it the cost by the closed form. Data: the folder `tactile` of $PNEUTAC_DATA, or `--data=DIR`.
"""

import argparse
import os
from pathlib import Path

import numpy as np

from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.gel.fit import fit_presses
from pneutac_sim.gel.layout import DIGIT
from pneutac_sim.gel.model import GelModel
from pneutac_sim.mpm.devices import PressedGel
from pneutac_sim.twin import Twin, Value

RATIOS = (0.1, 0.3, 0.46)


def main() -> None:
    """Prints a row a set."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("PNEUTAC_DATA", "data")) / "tactile")
    parser.add_argument("--sets", default="digit_nagoya,digit_fots")
    options = parser.parse_args()
    print(
        "| set | closed form |"
        + "".join(f" ratio {r} |" for r in RATIOS)
        + "\n|---" * (2 + len(RATIOS))
        + "|"
    )
    for name in options.sets.split(","):
        data = GelRecording.load(Recording.load(options.data / name))
        pair = data.presses[0]
        sizes = GelModel(data.rest, np.zeros((3, 2)), np.zeros(3), data.px_per_mm)
        given = [None]
        for ratio in RATIOS:
            twin = Twin("gel")
            twin.parameters["gel_poissons_ratio"] = Value(ratio)
            given.append(PressedGel(sizes, twin).between)
        costs, decays = [], []
        for pressed in given:
            fit = fit_presses([pair], data.px_per_mm, None, data.thickness_mm, (DIGIT,), pressed)
            costs.append(f"{fit.cost:.0f}")
            decays.append(f"{fit.gel.decay_mm:.2f}")
        print(f"| {name} | {' | '.join(costs)} |, decays {', '.join(decays)} mm", flush=True)


if __name__ == "__main__":
    main()
