"""`pneutac benchmark NAME`: tables of accuracy and speed, each one command."""

import importlib
import sys

from lerobot_pneutac.cli.options import parse_options
from pneutac_sim.errors import InputError

# name -> module with the dataclass `BenchmarkNameConfig` and the function `benchmark_name` that takes it
TABLES = {
    "diagnosis": "lerobot_pneutac.benchmarks.diagnosis.main",
    "body": "lerobot_pneutac.benchmarks.body.main",
    "tactile": "lerobot_pneutac.benchmarks.tactile.main",
    "surrogate": "lerobot_pneutac.benchmarks.surrogate.main",
    "augment": "lerobot_pneutac.benchmarks.augment",
    "policy": "lerobot_pneutac.benchmarks.policy.main",
    "speed": "lerobot_pneutac.benchmarks.speed.main",
}


def main(argv: list[str]) -> None:
    """Runs one table."""
    name = argv[0] if argv else ""
    if name in ("-h", "--help"):
        print(f"usage: pneutac benchmark NAME [--option=value ...]\n\nNAME is {', '.join(TABLES)}.")
        return
    if name not in TABLES:
        raise InputError(f"'{name}' is no benchmark; give one of {', '.join(TABLES)}.")
    sys.argv[0] = f"pneutac benchmark {name}"
    module = importlib.import_module(TABLES[name])
    config = parse_options(getattr(module, f"Benchmark{name.capitalize()}Config"), argv[1:])
    getattr(module, f"benchmark_{name}")(config)
