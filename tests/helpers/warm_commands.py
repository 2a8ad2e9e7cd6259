"""Console commands in children of one process that has imported LeRobot, which takes ten seconds."""

import contextlib
import multiprocessing
import os
import sys
from importlib.metadata import entry_points
from pathlib import Path

PRELOADED = [
    "lerobot.scripts.lerobot_record",
    "lerobot.scripts.lerobot_train",
    "lerobot.scripts.lerobot_eval",
    "lerobot.scripts.lerobot_rollout",
    "lerobot.scripts.lerobot_replay",
    "lerobot.scripts.lerobot_edit_dataset",
    "lerobot_robot_pneutac",
    "pneutac_sim.world.world",
]


class WarmCommands:
    """Starts commands as if from a shell, each in a process of its own.

    Args:
        work: folder in which they run.
        environment: variables besides those of this process.
    """

    def __init__(self, work: Path, environment: dict[str, str]):
        self._work, self._count = work, 0
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload(PRELOADED)
        before = dict(os.environ)
        os.environ.update(environment)  # some is read when LeRobot is imported
        try:
            multiprocessing.forkserver.ensure_running()
        finally:
            os.environ.clear()
            os.environ.update(before)
        self._environment = environment

    def run(self, command: str, *options: str, timeout_s: float = 300) -> tuple[int, str]:
        """Exit code and all output of a command that an installed package names."""
        self._count += 1
        output = self._work / f"command_{self._count}.txt"
        arguments = (command, options, self._work, output, self._environment)
        process = self._context.Process(target=_run, args=arguments)
        process.start()
        process.join(timeout_s)
        if process.is_alive():
            process.kill()
            process.join()
        return process.exitcode, output.read_text()


def _run(
    command: str, options: tuple[str, ...], work: Path, output: Path, environment: dict[str, str]
) -> None:
    with output.open("w") as file:
        for stream in (1, 2):
            os.dup2(file.fileno(), stream)
    os.chdir(work)
    os.environ.update(environment)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        os.environ.pop(name, None)
    sys.argv = [command, *options]
    (entry,) = entry_points(group="console_scripts", name=command)
    import lerobot_robot_pneutac

    with contextlib.suppress(KeyboardInterrupt):
        try:
            lerobot_robot_pneutac.prepare()  # as the import would, were it not long done
            sys.exit(entry.load()())
        except Exception:
            sys.excepthook(*sys.exc_info())
            sys.exit(1)
