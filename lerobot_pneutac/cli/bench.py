"""Which bench, an option of `pneutac learn` and `pneutac studio`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lerobot_pneutac.cli.options import parse_options
from pneutac_sim.errors import InputError

if TYPE_CHECKING:
    from lerobot_pneutac.verbs.benches import Bench

STANDIN, MEASURE = BENCHES = ("standin", "measure")


def check_bench(bench: str, measure: Path | None) -> None:
    """Raises InputError where there is no such bench, or the file of its options is missing or too much."""
    if bench not in BENCHES:
        raise InputError(f"bench={bench} must be one of {', '.join(BENCHES)}.")
    if (bench == MEASURE) != (measure is not None):
        raise InputError("bench=measure and --measure=FILE.yaml, the options of your bench, go together.")


def make_bench(
    measure: Path | None, out: Path, seed: int, device: str = "finger"
) -> tuple[Bench, dict[str, float]]:
    """The bench, and the conditions on it while no hand changes them.

    Args:
        measure: YAML file with the options of `pneutac measure`; None for the stand-in.
        out: folder for recordings.
        seed: of the stand-in's noise.
        device: of which the stand-in is, `finger` or `arm`.
    """
    from lerobot_pneutac.verbs.benches import MeasuredBench, StandinBench  # pandas

    if measure is None and device == "arm":
        from pneutac_datasets.generate.truth_bench import standin_arm

        return standin_arm(seed), {}
    if measure is None:
        from pneutac_datasets.generate.standin import HANGING

        return StandinBench(seed), dict(HANGING)
    if not measure.is_file():
        raise InputError(f"measure={measure} is no file; give a YAML file with the options of your bench.")
    from lerobot_pneutac.measuring.options import MeasureConfig

    config = parse_options(MeasureConfig, [f"--config_path={measure}", f"--out={out / 'round'}"])
    return MeasuredBench(config), config.conditions
