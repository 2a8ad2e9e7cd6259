"""`python -m pneutac_truths --device=rod --effect=creep_fractional,gravity --seed=1 --out=DIR`."""

import argparse
import signal
import sys
from pathlib import Path

from pneutac_truths import EFFECTS, PAIRS, generate, write
from pneutac_truths.gel import GEL_EFFECTS, write_gel


def main(arguments: list[str] | None = None) -> int:
    """Writes one recording; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m pneutac_truths", description=__doc__)
    parser.add_argument("--device", default="rod", help="rod, arm, cosserat or gel")
    parser.add_argument("--effect", default="plain", help="names with commas; plain, device, or see --list")
    parser.add_argument("--seed", type=int, default=0, help="which device")
    parser.add_argument("--day", type=int, default=1, help="another day: same device, other programs")
    parser.add_argument("--gauge", choices=("yes", "no"), help="whether pressure is measured; default drawn")
    parser.add_argument("--minutes", type=float, help="of recording")
    parser.add_argument("--presses", type=int, default=13, help="of a gel, the first to calibrate by")
    parser.add_argument("--state-noise", "--tell-noise", choices=("yes", "no"), default="yes")
    parser.add_argument("--state-pauses", "--tell-pauses", choices=("yes", "no"), default="no")
    parser.add_argument("--out", type=Path, help="folder to write, which must not exist")
    parser.add_argument("--list", action="store_true", help="names the effects and pairs")
    o = parser.parse_args(arguments)
    if o.list:
        for e in EFFECTS.values():
            sys.stdout.write(f"{e.name}: {e.summary}{'' if e.physics else ' (no physics)'}\n")
        for name, pair in PAIRS.items():
            sys.stdout.write(f"{name}: {' and '.join(pair)}\n")
        for fault in GEL_EFFECTS.values():
            sys.stdout.write(f"{fault.name}: {fault.summary} (gel)\n")
        return 0
    if o.out is None or o.out.exists():
        parser.error("Give --out." if o.out is None else f"'{o.out}' exists; name a new folder.")
    try:
        if o.device == "gel":
            sys.stdout.write(f"{write_gel(o.effect.split(','), o.out, o.seed, o.day, o.presses)}\n")
            return 0
        stated = {name: getattr(o, name) == "yes" for name in ("state_noise", "state_pauses")}
        gauge = None if o.gauge is None else o.gauge == "yes"
        truth = generate(o.device, o.effect.split(","), o.seed, o.day, gauge, o.minutes, **stated)
    except (ValueError, ImportError, ArithmeticError) as e:
        parser.error(str(e))
    sys.stdout.write(f"{write(truth, o.out)}\n")
    return 0


if __name__ == "__main__":
    if hasattr(signal, "SIGPIPE"):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # `--list | head` ends quietly
    sys.exit(main())
