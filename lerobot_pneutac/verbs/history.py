"""The versions of a twin, and the way back to one of them."""

from dataclasses import dataclass
from pathlib import Path

from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.verbs.report import report
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin


def restore(folder: str | Path, version: int) -> Twin:
    """Writes an earlier version of a twin as its newest one, so that nothing is lost; returns it."""
    newest = Twin.load(folder, calibrated=False)  # going back mends one without its gain
    numbers = [e["version"] for e in newest.history]
    if version not in numbers:
        there = f"it has {', '.join(map(str, numbers))}" if numbers else "it was never fitted"
        raise InputError(f"{folder} has no version {version}; {there}.")
    if version == numbers[-1]:
        raise InputError(
            f"Version {version} is the newest of {folder}; give an earlier one to go back to it."
        )
    entry = newest.history[version]
    twin = Twin.load(folder, version)
    twin.history = newest.history
    rest = {k: v for k, v in entry.items() if k not in ("version", "change", "recording")}
    twin.save_version(
        folder, f"back to version {version}: {entry['change']}", entry.get("recording", ""), rest
    )
    return twin


@dataclass
class HistoryConfig:
    """Options of `pneutac history`."""

    twin: Path  # folder of the twin
    restore: int | None = None  # version to go back to; it is written as the newest, so that nothing is lost


def command(cfg: HistoryConfig, terminal: Terminal) -> None:
    """Lists the versions of a twin, and goes back to one of them."""
    if cfg.restore is None:
        twin = Twin.load(cfg.twin, calibrated=False)
    else:
        twin = restore(cfg.twin, cfg.restore)
    terminal.show(report(twin))
    if cfg.restore is not None:
        number = twin.history[-1]["version"]
        terminal.say(f"wrote version {number} of {cfg.twin}, equal to version {cfg.restore}")
