"""`pneutac convert`: makes a bench recording of OptiTrack, Vicon, MATLAB, ROS 2 or a film."""

from rich.console import Console

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.verbs.convert import ConvertConfig, convert


def main(argv: list[str]) -> None:
    """Runs the verb."""
    config, console = parse_options(ConvertConfig, argv), Console()
    recording = convert(config)
    seconds = recording.column("time_s").max()
    console.print(
        f"{config.out}: {len(recording)} samples in {len(recording.trials())} trials, {seconds:.0f} s",
        highlight=False,
    )
    for warning in recording.warnings:
        console.print(f"[yellow]note:[/] {warning}", highlight=False)
    console.print(f"next: pneutac new --twin=TWIN --recording={config.out}", highlight=False)
