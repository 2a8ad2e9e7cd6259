"""Generated bench recordings, to try the product without a bench; the answers are stored separately.

python -m pneutac_datasets.generate --effect=creep --seed=7 --out=outputs/bench
python -m pneutac_datasets.generate --device=gel --effect=shadow --out=outputs/gel
python -m pneutac_datasets.generate --device=photographs --seed=3 --out=outputs/photographs
python -m pneutac_datasets.generate --device=standin --out=outputs/standin
"""

import argparse
import inspect
import sys
from pathlib import Path

from pneutac_datasets.generate.finger import generate, truth_file
from pneutac_sim.errors import InputError

DEVICES = (
    "finger (default): pressure programs with a tracked tip; gel: a rest image and presses of balls;"
    " photographs: a finger or arm with hidden parameters, seen from several sides; standin: finger and"
    " gel of the robot that stands in for a real one"
)
HIDDEN = (
    "finger, gel: what to hide, names joined by commas, or none (default); an unknown name lists those that"
    " there are"
)
# Options that some devices take, see `_WRITERS`, as of `ArgumentParser.add_argument`.
OPTIONS = {
    "seed": {"type": int, "help": "decides everything random; default 0"},
    "effect": {"help": HIDDEN},
    "strength": {"type": float, "help": "finger: 1 (default) is a clear effect, 0.2 a faint one"},
    "minutes": {"type": float, "help": "finger, standin: length of the session; default 10, stand-in 6"},
    "program": {"help": "standin: CSV of commands, as `pneutac control` writes it; the finger follows it"},
    "hz": {"type": float, "help": "finger: samples a second; default 20"},
    "no_measured_pressure": {
        "action": "store_true", "default": None,
        "help": "finger: the recording has the commanded pressure alone",
    },
    "images": {"type": int, "help": "gel: number of presses, the first to calibrate by; default 16"},
    "body": {"choices": ("finger", "arm"), "help": "photographs: which body; default finger"},
    "particles": {"type": int, "help": "photographs: material points of the hidden body; default 6000"},
}  # fmt: skip


def main(argv: list[str] | None = None) -> int:
    """Writes the recording and says where it and the answer are."""
    how = {"formatter_class": argparse.RawDescriptionHelpFormatter, "description": __doc__}
    parser = argparse.ArgumentParser(prog="python -m pneutac_datasets.generate", **how)
    parser.add_argument("--device", default="finger", choices=list(_WRITERS), help=DEVICES)
    where = "folder of the recording (standin: of its two recordings, with --program of one)"
    parser.add_argument("--out", required=True, type=Path, help=where)
    for name, option in OPTIONS.items():
        parser.add_argument(f"--{name.replace('_', '-')}", **option)
    given = {k: v for k, v in vars(parser.parse_args(argv)).items() if v is not None}
    device, out = given.pop("device"), given.pop("out")
    takes = [o for o in inspect.signature(_WRITERS[device]).parameters if o != "out"]
    try:
        for option in set(given) - set(takes):
            wrong, *names = (f"--{o.replace('_', '-')}" for o in (option, *takes))
            raise InputError(f"{wrong} is not for --device={device}, which takes {', '.join(names)}.")
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise InputError(f"{out} exists already; delete it or give another --out.")
        lines = _WRITERS[device](out, **given) or {"recording": out, "truth": truth_file(out)}
    except InputError as e:
        sys.stderr.write(f"{e}\n")
        return 1
    sys.stdout.write("".join(f"{name}: {path}\n" for name, path in lines.items()))
    return 0


def _finger(out, effect="none", strength=1.0, minutes=10.0, hz=20.0, no_measured_pressure=False, seed=0):
    generate(effect.split(","), out, seed, strength, minutes, hz, not no_measured_pressure)


def _gel(out, effect="none", images=16, seed=0):
    from pneutac_datasets.generate.gel import write_hidden_gel

    write_hidden_gel(out, [] if effect == "none" else effect.split(","), seed, images)


def _photographs(out, body="finger", particles=6000, seed=0):
    from pneutac_datasets.generate.photographs import write_photographs

    write_photographs(out, seed, body, particles=particles)


def _standin(out, minutes=None, program=None, seed=0):
    from pneutac_datasets.generate.standin import write_finger, write_gel, write_program

    if program is not None:
        if minutes is not None:
            raise InputError("--program is as long as it is; leave --minutes out.")
        write_program(out, program, seed)
        return {"finger": out}
    write_finger(out / "finger", seed, 6.0 if minutes is None else minutes)
    write_gel(out / "gel", seed)
    return {"finger": out / "finger", "gel": out / "gel"}


_WRITERS = {"finger": _finger, "gel": _gel, "photographs": _photographs, "standin": _standin}

if __name__ == "__main__":
    sys.exit(main())
