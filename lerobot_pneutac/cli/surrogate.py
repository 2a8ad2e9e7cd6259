"""`pneutac surrogate`: trains the networks in place of a twin's material points, from full simulations."""

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.cli.progress import progress_bar
from lerobot_pneutac.cli.show import finish
from lerobot_pneutac.verbs.surrogate import CARD, Collection, train_networks
from pneutac_sim.twin import Twin


@dataclass
class SurrogateConfig:
    """Options of `pneutac surrogate`.

    Attributes:
        twin: folder of a finger's twin; the networks are written into it.
        trajectories: number of motions of the full finger; two sixths of them are held out.
        seconds: length of each motion.
        contacts: number of presses on the full gel; of two kinds of indenter all are held out.
        particles: number of material points of the finger, about.
        fresh: training also where the networks that are shipped were trained for such a finger and gel.
        device: `auto`, `cpu` or `cuda`.
        seed: seed of programs, contacts and weights.
        out: folder for `result.json` and `report.html`; nothing is written without it.
    """

    twin: Path
    trajectories: int = 12
    seconds: float = 0.5
    contacts: int = 24
    particles: int = 4000
    fresh: bool = False
    device: str = "auto"
    seed: int = 0
    out: Path | None = None


def main(argv: list[str]) -> None:
    """Runs the verb."""
    config, console = parse_options(SurrogateConfig, argv), Console()
    twin = Twin.load(config.twin)
    collection = Collection(
        config.trajectories, config.seconds, config.contacts, config.particles, config.seed
    )
    minutes = collection.minutes(twin, config.fresh)
    if minutes:
        console.print(
            f"Full simulations and training: about {max(1, round(minutes))} min on two cores of their own.",
            highlight=False,
        )
    with progress_bar(Console(stderr=True)) as progress:
        trained = train_networks(twin, config.twin, collection, config.fresh, config.device, progress)
    finish(trained, console, config.out, "surrogate", argv)
    console.print(f"networks and {CARD} are in {config.twin}", highlight=False)
