"""`pneutac VERB`: a table of commands, with options in LeRobot's own style (draccus).

A verb's module has `command(options, terminal)` and the dataclass of its options, whose comments are the
text of `--help`; a `command(argv, terminal)` reads its arguments by itself.
"""

import difflib
import errno
import importlib
import importlib.metadata
import importlib.util
import inspect
import multiprocessing
import os
import re
import shutil
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

# verb -> what it does
VERBS = {
    "demo": "run every step once, on a simulated robot that stands in for a real one",
    "new": "make a new twin: the model of a finger, an arm or a touch sensor",
    "check": "list everything that a later command would refuse in a dataset, a recording or a twin",
    "measure": "drive a pressure program at the bench and record finger and touch sensor",
    "convert": "make a bench recording from a CSV, OptiTrack, Vicon, MATLAB, ROS 2 or a film",
    "calibrate": "fit the parameters of a twin to a bench recording",
    "compare": "compare a twin with a recording and show where it fails",
    "diagnose": "find which physical effects a twin is missing",
    "design": "choose the next test: the one with most information about what is missing",
    "learn": "choose and measure tests automatically until the cause is found or time is up",
    "studio": "open a twin in the browser: bend it, load it, find and add what is missing",
    "report": "write a twin and its history as one page, or as a file for Rerun",
    "export": "write a twin as one Python file that needs NumPy alone, or its body as MJCF",
    "history": "list the versions of a twin, and go back to one",
    "effects": "list, show and export the effects and laws that a twin may have",
    "add": "add effects to a twin, re-fit it, and store it if the test error falls significantly",
    "control": "make the pressure program for a wanted bend, and show how well it was followed",
    "surrogate": "train the networks that replace slow full simulations",
    "render": "draw a twin under pressure or an indenter, as pictures and a film",
    "augment": "generate more demonstrations from a few",
    "ppo": "train a policy for a task in simulation by reinforcement learning",
    "repair": "recover a dataset whose recording was interrupted",
    "benchmark": "measure accuracy and speed, as tables",
    "doctor": "check what is installed, and which GPU, ports and cameras answer",
}
# Modules of commands that are not `lerobot_pneutac.verbs.VERB`; none is imported before it is asked for.
MODULES = {
    "benchmark": "lerobot_pneutac.cli.benchmark",
    "ppo": "lerobot_pneutac.rl.command",
    "report": "lerobot_pneutac.studio.report",
    "studio": "lerobot_pneutac.studio.command",
}
# What others call a verb.
SYNONYMS = {"fit": "calibrate", "record": "measure", "import": "convert", "validate": "check"}
# What only the distribution `lerobot_robot_pneutac` installs, and the commands that do nothing without it;
# none of the packages is on PyPI yet.
PLUGIN = "lerobot_robot_pneutac"
INSTALL = "in a clone: pip install . ./packages/lerobot_camera_digit ./robots"
PACKAGES = "av datasets datatrove lerobot pyarrow quadrants rerun serial taichi torch"
PLUGIN_PACKAGES = {PLUGIN, *PACKAGES.split()}
PLUGIN_VERBS = ("measure", "surrogate", "render", "augment", "ppo", "repair")
RESUMED = ("demo", "learn", "surrogate", "augment", "ppo")  # commands that go on where one was interrupted
AT_THE_END = ("diagnose", "add")


AGAIN_S = 1.0  # after which Ctrl-C is raised again where a library has swallowed it


def _interrupt(signum: int, frame) -> None:
    """Raises KeyboardInterrupt, and each second again until it is on its way: Taichi swallows some."""
    signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
    error = sys.exception() if signum == signal.SIGALRM else None
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return  # what is cleaned up meanwhile, as a chamber that is vented, is not disturbed
        error = error.__context__
    raise KeyboardInterrupt


def _terminate(signum: int, frame) -> None:
    """Ends as Ctrl-C does, so that a chamber is vented and a cluster's jobs are cancelled; a fork at once."""
    if multiprocessing.parent_process() is None:
        _interrupt(signum, frame)
    os._exit(128 + signum)


def main() -> None:
    try:
        if hasattr(signal, "setitimer"):
            signal.signal(signal.SIGINT, _interrupt)
            signal.signal(signal.SIGALRM, _interrupt)
            for signum in (signal.SIGTERM, signal.SIGHUP):
                if signal.getsignal(signum) == signal.SIG_DFL:  # else nohup, or who started this, decided
                    signal.signal(signum, _terminate)
        try:
            _dispatch(sys.argv[1:])
        finally:
            if hasattr(signal, "setitimer"):
                signal.setitimer(signal.ITIMER_REAL, 0.0)
            sys.stdout.flush()
    except BrokenPipeError:  # whoever reads along, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else the exit would flush, too
        sys.exit(1)
    except (KeyboardInterrupt, RuntimeError) as e:
        # an interrupt inside a lock, as of a wait, ends in "release unlocked lock"
        if isinstance(e, RuntimeError) and not isinstance(e.__context__, KeyboardInterrupt):
            raise
        verb, goes_on = sys.argv[0].rpartition(" ")[2], ""
        if verb in RESUMED:
            goes_on = "; the same command goes on from what is finished"
        elif verb in AT_THE_END:
            goes_on = "; only what ends is stored, so the same command begins anew"
        print(f"{sys.argv[0]}: interrupted{goes_on}.", file=sys.stderr)
        sys.exit(130)


def _dispatch(argv: list[str]) -> None:
    from lerobot_pneutac.cli.options import name_option
    from pneutac_sim.errors import InputError, printable

    verb, missing = argv[0] if argv else "help", () if importlib.util.find_spec(PLUGIN) else PLUGIN_VERBS
    if verb in ("help", "-h", "--help"):
        rows = {name: f"  {name:10s} {text}" for name, text in VERBS.items()}
        later = [f"\nWith {PLUGIN} also ({INSTALL}):\n", *(rows.pop(n) for n in missing)] if missing else []
        print("usage: pneutac VERB [--option=value ...]\n", *rows.values(), *later, sep="\n")
        print("\n`pneutac VERB --help` lists its options, `pneutac --version` the version.")
        return
    if verb == "--version":
        print(f"pneutac {importlib.metadata.version('pneutac')}")
        return
    if verb not in VERBS:
        near = [*SYNONYMS.get(verb, "").split(), *difflib.get_close_matches(verb, VERBS, n=1)]
        hint = f"did you mean '{near[0]}'?" if near else f"the commands are {', '.join(VERBS)}."
        sys.exit(f"pneutac: There is no command '{verb}'; {hint}")
    if verb in missing:
        sys.exit(f"pneutac {verb}: This needs LeRobot's half of PneuTac; {INSTALL}")
    sys.argv = [f"pneutac {verb}", *argv[1:]]  # the usage lines name the program so
    try:
        run_verb(verb, argv[1:])
    except InputError as e:
        known = options_class(verb)
        sys.exit(f"pneutac {verb}: {name_option(str(e), known, argv[1:]) if known else e}")
    except ModuleNotFoundError as e:
        package = (e.name or "").partition(".")[0]
        if package not in PLUGIN_PACKAGES:
            raise
        what = f"the package {package}" if importlib.util.find_spec(PLUGIN) else "LeRobot's half of PneuTac"
        sys.exit(f"pneutac {verb}: This needs {what}; {INSTALL}")
    except BrokenPipeError:
        raise
    except OSError as e:  # a folder that cannot be read or written, a full disk, a Hub out of reach
        if e.errno in (errno.ENOSPC, errno.EDQUOT):
            sys.exit(f"pneutac {verb}: No space is left on the disk; free some and repeat.")
        what = f"{e.filename}: {e.strerror}" if e.filename and e.strerror else " ".join(str(e).split())
        sys.exit(f"pneutac {verb}: {printable(what)}.")


def run_verb(verb: str, argv: list[str]) -> None:
    """Runs a command with its arguments; raises InputError where they are bad."""
    from lerobot_pneutac.cli.options import parse_options
    from lerobot_pneutac.cli.terminal import Terminal
    from pneutac_sim.files import check_new

    if verb == "measure":  # its options need LeRobot, which takes ten seconds to import
        for out in (a.partition("=")[2] for a in argv if re.match("--out=.", a)):
            check_new(Path(out), f"out={out}")
    command, terminal = _module(verb).command, Terminal(verb, argv)
    if "argv" in inspect.signature(command).parameters:
        command(argv, terminal)
    else:
        options = parse_options(options_class(verb), argv, f"{VERBS[verb]}.")
        with _alone(options.out) if hasattr(options, "resumed_by") else nullcontext():
            command(options, terminal)


@contextmanager
def _alone(out: Path) -> Iterator[None]:
    """One process at a time; where the command is refused before it writes, no folder is left."""
    from pneutac_sim.errors import InputError
    from pneutac_sim.files import LOCK, locked

    new = not out.exists()
    try:
        with locked(out, wait_s=0.0):
            yield
    except InputError:
        if new and out.is_dir() and {p.name for p in out.iterdir()} <= {LOCK}:
            shutil.rmtree(out)
        raise


def options_class(command: str) -> type | None:
    """The dataclass of the options of `diagnose`, `benchmark policy` and so on; None for none."""
    verb, _, name = command.partition(" ")
    module = _module(verb)
    if name:
        module = importlib.import_module(module.TABLES[name])
    found = (c for c in vars(module).values() if isinstance(c, type))
    return next((c for c in found if f"Options of `pneutac {command}`" in (c.__doc__ or "")), None)


def _module(verb: str):
    return importlib.import_module(MODULES.get(verb, f"lerobot_pneutac.verbs.{verb}"))
