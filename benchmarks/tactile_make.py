"""Learns the residual fields that the make DIGIT lends again, from all photographs of the DIGITs in a folder.

    python benchmarks/tactile_make.py --sets=digit_fots,digit_nagoya

Their light is fitted without any field. Data: the folder `tactile` of $PNEUTAC_DATA, or `--data=DIR`.
"""

import argparse
import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.files import read_yaml
from pneutac_sim.gel import layout
from pneutac_sim.gel.fit import fit_presses
from pneutac_sim.gel.layout import SensorPrior


def unit(folder: Path) -> SensorPrior:
    """What the model leaves over on the sensor of a recording."""
    data = GelRecording.load(Recording.load(folder))
    pairs = data.samples
    fit = fit_presses(pairs, data.px_per_mm, None, data.thickness_mm, (replace(layout.DIGIT, units=()),))
    rest = np.asarray(layout.stored_rest(fit.gel.rest_image))
    return SensorPrior.of(rest, fit.leftovers, float(np.linalg.norm(fit.gel.light)))


def main() -> None:
    """Writes the file of the make."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("PNEUTAC_DATA", "data")) / "tactile")
    parser.add_argument("--sets", default="digit_fots,digit_nagoya")
    options = parser.parse_args()
    units = tuple(unit(options.data / name) for name in options.sets.split(","))
    file = Path(layout.__file__).parent / "makes" / "digit.yaml"
    replace(layout.DIGIT, units=units).write(file, read_yaml(file)["source"])


if __name__ == "__main__":
    main()
