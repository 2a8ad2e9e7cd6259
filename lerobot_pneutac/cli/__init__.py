"""`pneutac VERB`: one command, one module a verb, options in LeRobot's own style (draccus)."""

import importlib
import importlib.metadata
import os
import sys

# verb -> (module with `main(argv)`, what it does)
VERBS: dict[str, tuple[str, str]] = {
    "demo": ("lerobot_pneutac.cli.demo", "the main job, end to end, on the built-in twin"),
    "new": ("lerobot_pneutac.cli.new", "a new twin"),
    "measure": ("lerobot_pneutac.cli.measure", "drive a pressure program and record finger and gel"),
    "calibrate": ("lerobot_pneutac.cli.calibrate", "fit a twin to a bench recording"),
    "compare": ("lerobot_pneutac.cli.compare", "errors of a twin against a recording, and where it fails"),
    "diagnose": ("lerobot_pneutac.cli.diagnose", "which physical effect is missing"),
    "add": ("lerobot_pneutac.cli.add", "switch an effect on, re-fit, show the error before and after"),
    "surrogate": ("lerobot_pneutac.cli.surrogate", "train the fast networks from full simulations"),
    "render": ("lerobot_pneutac.cli.render", "pictures and a film of a twin under pressure or an indenter"),
    "augment": ("lerobot_pneutac.cli.augment", "demonstrations in, more demonstrations out"),
    "ppo": ("lerobot_pneutac.cli.ppo", "train an actor by reinforcement learning"),
    "benchmark": ("lerobot_pneutac.cli.benchmark", "tables of speed and accuracy"),
    "doctor": ("lerobot_pneutac.cli.doctor", "what is installed; which GPU, ports and cameras answer"),
}


def main() -> None:
    """Entry point of the `pneutac` command."""
    try:
        try:
            _dispatch(sys.argv[1:])
        finally:
            sys.stdout.flush()
    except BrokenPipeError:  # whoever reads along, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else the exit would flush, too
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit(130)


def _dispatch(argv: list[str]) -> None:
    from pneutac_sim.errors import InputError

    verb = argv[0] if argv else "help"
    if verb in ("help", "-h", "--help"):
        rows = (f"  {name:10s} {text}" for name, (_, text) in VERBS.items())
        print("usage: pneutac VERB [--option=value ...]\n", *rows, sep="\n")
        print("\n`pneutac VERB --help` lists its options, `pneutac --version` the version.")
        return
    if verb == "--version":
        print(f"pneutac {importlib.metadata.version('lerobot_robot_pneutac')}")
        return
    if verb not in VERBS:
        sys.exit(f"pneutac: '{verb}' is not a verb; the verbs are {', '.join(VERBS)}.")
    sys.argv = [f"pneutac {verb}", *argv[1:]]  # the usage lines name the program so
    try:
        importlib.import_module(VERBS[verb][0]).main(argv[1:])
    except InputError as e:
        sys.exit(f"pneutac {verb}: {e}")
