"""`pneutac VERB`: one command, one module a verb, options in LeRobot's own style (draccus)."""

import importlib
import sys

# verb -> (module with `main(argv)`, what it does); a verb without a module is not there yet
VERBS: dict[str, tuple[str | None, str]] = {
    "demo": ("lerobot_pneutac.verbs.demo", "the main job, end to end, on the built-in twin"),
    "new": ("lerobot_pneutac.verbs.new", "a new twin"),
    "measure": (
        "lerobot_pneutac.verbs.measure",
        "drive a pressure program and record finger and gel",
    ),
    "calibrate": ("lerobot_pneutac.verbs.calibrate", "fit a twin to a bench recording"),
    "compare": ("lerobot_pneutac.verbs.compare", "errors of a twin against a recording, and where it fails"),
    "diagnose": ("lerobot_pneutac.verbs.diagnose", "which physical effect is missing"),
    "add": ("lerobot_pneutac.verbs.add", "switch an effect on, re-fit, show the error before and after"),
    "surrogate": ("lerobot_pneutac.verbs.surrogate", "train the fast networks from full simulations"),
    "render": ("lerobot_pneutac.verbs.render", "pictures and a film of a twin under pressure or an indenter"),
    "augment": ("lerobot_pneutac.verbs.augment", "demonstrations in, more demonstrations out"),
    "ppo": ("lerobot_pneutac.cli.ppo", "train an actor by reinforcement learning"),
    "benchmark": ("lerobot_pneutac.cli.benchmark", "tables of speed and accuracy"),
    "doctor": (
        "lerobot_pneutac.verbs.doctor",
        "what is installed; which GPU, ports and cameras answer",
    ),
}


def main() -> None:
    """Entry point of the `pneutac` command."""
    from pneutac_sim.errors import InputError

    verb = sys.argv[1] if len(sys.argv) > 1 else "help"
    if verb in ("help", "-h", "--help"):
        print("usage: pneutac VERB [--option=value ...]\n")
        for name, (module, text) in VERBS.items():
            print(f"  {name:10s} {text}" + ("" if module else " (not there yet)"))
        return
    if verb not in VERBS:
        sys.exit(f"pneutac: '{verb}' is not a verb; the verbs are {', '.join(VERBS)}.")
    module, _ = VERBS[verb]
    sys.argv = [f"pneutac {verb}", *sys.argv[2:]]  # the usage lines name the program so
    if module is None:
        sys.exit(f"pneutac: '{verb}' is not there yet; the README's status table says what is.")
    try:
        importlib.import_module(module).main(sys.argv[1:])
    except InputError as e:
        sys.exit(f"pneutac {verb}: {e}")
    except KeyboardInterrupt:
        sys.exit(130)
