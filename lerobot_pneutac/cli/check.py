"""`pneutac check PATH ...`: everything that a later verb would refuse in a dataset, a recording or a twin."""

import sys

from rich.console import Console
from rich.markup import escape

from lerobot_pneutac.cli.tables import show_understood
from lerobot_pneutac.verbs.check import check_path
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin
from pneutac_sim.world.station import Station

USAGE = """usage: pneutac check PATH [PATH ...] [--twin=PATH] [--station=FILE]

Tells in seconds what a later verb would refuse, all faults at once, and exits with 1 where there is one.

  PATH            folder of a twin, a bench recording or a LeRobotDataset of demonstrations, a lab's table
                  (CSV, .mat, Parquet) or a station.yaml
  --twin=PATH     twin for which demonstrations or a station are looked at (default the built-in one)
  --station=FILE  station.yaml in which demonstrations were recorded (default what they tell)"""


def main(argv: list[str]) -> None:
    """Runs the verb."""
    if not argv or {"-h", "--help"} & set(argv):
        print(USAGE)
        return
    options = dict(a.split("=", 1) for a in argv if a.startswith("--") and "=" in a)
    wrong = [a for a in argv if a.startswith("-") and a.split("=")[0] not in ("--twin", "--station")]
    wrong += [a for a in ("--twin", "--station") if a in argv]
    if wrong:
        raise InputError(f"There is no option {wrong[0]}; the options are --twin=PATH and --station=FILE.")
    twin = Twin.load(options["--twin"]) if "--twin" in options else None
    station = Station.load(options["--station"]) if "--station" in options else None
    console, faulty = Console(), False
    for path in (a for a in argv if not a.startswith("-")):
        found = check_path(path, twin, station)
        faulty = faulty or bool(found.faults)
        if found.understood is not None:
            show_understood(found.understood, console)
        said = f"[red]{len(found.faults)} to mend[/]" if found.faults else "[green]good[/]"
        console.print(f"{escape(path)} ({found.kind}): {said}", highlight=False, soft_wrap=True)
        for mark, sentences in (("[red]fault:[/]", found.faults), ("[yellow]note:[/]", found.notes)):
            for sentence in sentences:
                console.print(f"  {mark} {escape(sentence)}", highlight=False, soft_wrap=True)
    if faulty:
        sys.exit(1)
