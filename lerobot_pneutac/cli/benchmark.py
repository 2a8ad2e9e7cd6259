"""`pneutac benchmark NAME`: tables of accuracy and speed, each one command."""

import importlib
import shlex
import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

from lerobot_pneutac.cli.options import name_option, parse_options
from lerobot_pneutac.reports import page
from pneutac_sim.errors import InputError

# name -> module with the dataclass `BenchmarkNameConfig` and the function `benchmark_name` that takes it
TABLES = {
    "diagnosis": "pneutac_benchmarks.diagnosis.main",
    "body": "pneutac_benchmarks.body.main",
    "tactile": "pneutac_benchmarks.tactile.main",
    "surrogate": "pneutac_benchmarks.surrogate.main",
    "augment": "pneutac_benchmarks.augment",
    "policy": "pneutac_benchmarks.policy.main",
    "diagnosis_speed": "pneutac_benchmarks.speed.diagnosis",
    "speed": "pneutac_benchmarks.speed.main",
    "worlds": "pneutac_benchmarks.speed.worlds",
    "rates": "pneutac_benchmarks.speed.rates",
    "experiments": "pneutac_benchmarks.experiments",
    "demonstrations": "pneutac_benchmarks.demonstrations",
    "robustness": "pneutac_benchmarks.robustness.main",
}


def command(argv: list[str], terminal) -> None:
    name = argv[0] if argv else ""
    if name in ("-h", "--help"):
        print(f"usage: pneutac benchmark NAME [--option=value ...]\n\nNAME is {', '.join(TABLES)}.")
        return
    if name not in TABLES:
        wrong = f"There is no benchmark '{name}'" if name else "Name a benchmark"
        raise InputError(f"{wrong}; give one of {', '.join(TABLES)}.")
    sys.argv[0] = f"pneutac benchmark {name}"
    module = importlib.import_module(TABLES[name])
    config_class = getattr(module, f"Benchmark{name.title().replace('_', '')}Config")
    # by what a result can be repeated: command, version and, of a clone, commit
    page.made_by |= {"made_by": shlex.join(["pneutac", "benchmark", *argv]), "version": version("pneutac")}
    root = Path(__file__).parents[2]
    if (root / ".git").exists() and shutil.which("git"):
        ask = ["git", "-C", str(root), "describe", "--always", "--dirty", "--exclude=*"]
        page.made_by["commit"] = subprocess.run(ask, capture_output=True, text=True).stdout.strip()
    try:
        config = parse_options(config_class, argv[1:])
        getattr(module, f"benchmark_{name}")(config)
    except InputError as e:
        raise InputError(name_option(str(e), config_class, argv)) from e
    finally:
        page.made_by.clear()
