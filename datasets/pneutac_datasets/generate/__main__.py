"""Generated bench recordings, to try the product without a bench; the answers are stored separately.

python -m pneutac_datasets.generate --effect=creep --seed=7 --out=outputs/bench
python -m pneutac_datasets.generate --device=gel --effect=shadow --out=outputs/gel
python -m pneutac_datasets.generate --device=photographs --seed=3 --out=outputs/photographs
python -m pneutac_datasets.generate --device=standin --out=outputs/standin
"""

import argparse
import sys
from pathlib import Path

from pneutac_datasets.generate.finger import truth_file
from pneutac_sim.errors import InputError

# What each device takes besides --out and --seed.
OPTIONS = {
    "finger": ("effect", "strength", "minutes", "hz", "no_measured_pressure"),
    "gel": ("effect", "images"),
    "photographs": ("body", "particles"),
    "standin": ("minutes", "program"),
}


def main(argv: list[str] | None = None) -> int:
    """Writes the recording and says where it and the answer are."""
    given = {k: v for k, v in vars(_parser().parse_args(argv)).items() if v is not None}
    device, out = given.pop("device"), given.pop("out")
    try:
        for option in set(given) - {"seed", *OPTIONS[device]}:
            name = option.replace("_", "-")
            raise InputError(
                f"--{name} is not for --device={device}, which takes "
                + ", ".join(f"--{o.replace('_', '-')}" for o in (*OPTIONS[device], "seed"))
                + "."
            )
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise InputError(f"{out} exists already; delete it or give another --out.")
        lines = _WRITERS[device](out, **given)
    except InputError as e:
        sys.stderr.write(f"{e}\n")
        return 1
    sys.stdout.write("".join(f"{name}: {path}\n" for name, path in lines.items()))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m pneutac_datasets.generate",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add(
        "--device",
        default="finger",
        choices=list(OPTIONS),
        help="finger (default): pressure programs with a tracked tip; gel: a rest image and presses of balls;"
        " photographs: a finger or arm with hidden parameters, seen from several sides; standin: finger and"
        " gel of the robot that stands in for a real one",
    )
    add(
        "--out",
        required=True,
        type=Path,
        help="folder of the recording (standin: of its two recordings, with --program of one)",
    )
    add("--seed", type=int, help="decides everything random; default 0")
    add(
        "--effect",
        help="finger, gel: what to hide, names joined by commas, or none (default); an unknown name lists"
        " those that there are",
    )
    add("--strength", type=float, help="finger: 1 (default) is a clear effect, 0.2 a faint one")
    add("--minutes", type=float, help="finger, standin: length of the session; default 10, of the stand-in 6")
    add("--program", help="standin: CSV of commands, as `pneutac control` writes it; the finger follows it")
    add("--hz", type=float, help="finger: samples a second; default 20")
    add(
        "--no-measured-pressure",
        action="store_true",
        default=None,
        help="finger: the recording has the commanded pressure alone",
    )
    add("--images", type=int, help="gel: number of presses, the first to calibrate by; default 16")
    add("--body", choices=("finger", "arm"), help="photographs: which body; default finger")
    add("--particles", type=int, help="photographs: material points of the hidden body; default 6000")
    return parser


def _finger(
    out: Path, effect: str = "none", no_measured_pressure: bool = False, **options
) -> dict[str, Path]:
    from pneutac_datasets.generate.finger import generate

    generate(effect.split(","), out, measured_pressure=not no_measured_pressure, **options)
    return {"recording": out, "truth": truth_file(out)}


def _gel(out: Path, effect: str = "none", **options) -> dict[str, Path]:
    from pneutac_datasets.generate.gel import write_hidden_gel

    write_hidden_gel(out, [] if effect == "none" else effect.split(","), **options)
    return {"recording": out, "truth": truth_file(out)}


def _photographs(out: Path, body: str = "finger", seed: int = 0, **options) -> dict[str, Path]:
    from pneutac_datasets.generate.photographs import write_photographs

    write_photographs(out, seed, body, **options)
    return {"recording": out, "truth": truth_file(out)}


def _standin(out: Path, seed: int = 0, program: str | None = None, **options) -> dict[str, Path]:
    from pneutac_datasets.generate.standin import write_finger, write_gel, write_program

    if program is not None:
        if options:
            raise InputError("--program is as long as it is; leave --minutes out.")
        write_program(out, program, seed)
        return {"finger": out}
    write_finger(out / "finger", seed, **options)
    write_gel(out / "gel", seed)
    return {"finger": out / "finger", "gel": out / "gel"}


_WRITERS = {"finger": _finger, "gel": _gel, "photographs": _photographs, "standin": _standin}

if __name__ == "__main__":
    sys.exit(main())
