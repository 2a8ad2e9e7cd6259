"""`python -m pneutac_datasets.generate.hidden --effect=creep --out=DIR`: a recording with a hidden effect."""

import argparse
import sys
from pathlib import Path

from pneutac_datasets.generate.hidden.generate import disturbance_names, effect_names, generate
from pneutac_sim.errors import InputError


def main(argv: list[str] | None = None) -> int:
    """Writes the recording and says where the answer is."""
    parser = argparse.ArgumentParser(prog="python -m pneutac_datasets.generate.hidden", description=__doc__)
    parser.add_argument(
        "--effect",
        required=True,
        help=f"none, or one or more joined by commas: {', '.join(effect_names() + disturbance_names())}",
    )
    parser.add_argument("--out", required=True, type=Path, help="folder of the recording")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--strength", type=float, default=1.0, help="1 is a clear effect, 0.2 a faint one")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--hz", type=float, default=20.0)
    parser.add_argument("--no-measured-pressure", action="store_true")
    o = parser.parse_args(argv)
    try:
        generate(o.effect.split(","), o.out, o.seed, o.strength, o.minutes, o.hz, not o.no_measured_pressure)
    except InputError as e:
        sys.stderr.write(f"{e}\n")
        return 1
    truth = o.out.parent / "truth" / f"{o.out.name}.json"
    sys.stdout.write(f"recording: {o.out}\ntruth: {truth}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
