"""`pneutac convert FILE`: makes a bench recording of any CSV, OptiTrack, Vicon, MATLAB, ROS 2 or a film."""

import shlex

from rich.console import Console
from rich.markup import escape

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.cli.tables import show_understood
from lerobot_pneutac.verbs.convert import ConvertConfig, convert
from pneutac_datasets.recording.sources.plain import extent


def main(argv: list[str]) -> None:
    """Runs the verb."""
    given = [f"--source={argv[0]}", *argv[1:]] if argv and not argv[0].startswith("-") else argv
    config, console = parse_options(ConvertConfig, given), Console()
    shown = []

    def show(understood):
        shown.append(understood)
        show_understood(understood, console)

    recording = convert(config, show)
    if not shown:
        console.print(f"{config.source}: {extent(recording)}", highlight=False, soft_wrap=True)
    for warning in recording.warnings:
        console.print(f"[yellow]note:[/] {escape(warning)}", highlight=False, soft_wrap=True)
    console.print(
        f"{recording.folder} holds the recording; next: `pneutac new --twin=TWIN"
        f" --recording={shlex.quote(str(recording.folder))}`.",
        highlight=False, soft_wrap=True, markup=False,
    )  # fmt: skip
