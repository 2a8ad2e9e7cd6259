"""`pneutac demo`: the main job, end to end, on the stand-in, with LeRobot's own commands."""

import time

from rich.console import Console

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.cli.progress import progress_bar
from lerobot_pneutac.verbs.demo import Demo, DemoConfig


def main(argv: list[str]) -> None:
    """Runs the demo, or what is left of it."""
    cfg, console, start = parse_options(DemoConfig, argv), Console(), time.monotonic()

    def announce(text: str) -> None:
        console.print(text, style="dim" if text.startswith("$") else "bold", soft_wrap=True, highlight=False)

    with progress_bar(Console(stderr=True)) as progress:
        result = Demo(cfg, announce, progress).run()
    report = result.report(cfg.out)
    console.print(f"\n[bold]{result.sentence}[/]", highlight=False)
    minutes = (time.monotonic() - start) / 60
    console.print(f"Report: {report} ({minutes:.1f} minutes)", highlight=False, soft_wrap=True)
    console.print("Try next:", highlight=False)
    for command in result.next_commands:
        console.print(f"  {command}", soft_wrap=True, highlight=False, markup=False)
