"""`pneutac augment`: makes many demonstrations out of a few, planned on the twin and guided by touch."""

from rich.console import Console

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.cli.progress import progress_bar
from lerobot_pneutac.cli.show import finish
from lerobot_pneutac.verbs.augment import AugmentConfig, augment


def main(argv: list[str]) -> None:
    """Runs the verb."""
    config, console = parse_options(AugmentConfig, argv), Console()
    with progress_bar(Console(stderr=True)) as progress:
        result = augment(config, progress)
    finish(result, console, config.out, "augment", argv)
