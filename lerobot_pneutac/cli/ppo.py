"""`pneutac ppo`: trains an actor by reinforcement learning, and records its demonstrations for a student."""

import importlib.util

from rich.console import Console
from rich.table import Table

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.cli.progress import progress_bar
from lerobot_pneutac.rl.options import PpoConfig
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin
from pneutac_sim.world.station import Station


def main(argv: list[str]) -> None:
    """Runs the verb."""
    config, console = parse_options(PpoConfig, argv), Console()
    if importlib.util.find_spec("stable_baselines3") is None:
        raise InputError("Stable-Baselines3 is missing; install lerobot_robot_pneutac[rl].")
    from lerobot_pneutac.rl.ppo import Compute, train_ppo

    twin = Twin.load(config.twin) if config.twin else None
    compute = Compute(config.envs, config.parallel, config.device)
    station = Station.load(config.station) if config.station else None
    options = {"conditions": config.conditions} if config.conditions else {}
    options |= {"station": station} if station else {}
    with progress_bar(Console(stderr=True)) as progress:
        train = (config.task, twin, config.seed, config.steps, config.out, compute)
        card = train_ppo(*train, progress=progress, **options)
    test = card["test"]
    table = Table("what", "number", title=f"Actor for {config.task}")
    table.add_row("steps of training", f"{card['steps']}")
    table.add_row("steps a second", f"{card['steps_per_s']:.0f}")
    table.add_row(f"success on {test['episodes']} new starts", f"{100 * test['success']:.0f} %")
    console.print(table)
    console.print(f"The actor and its curve are in {config.out}.", highlight=False)
    if config.student.root is not None:
        from lerobot_pneutac.rl.student import record_student

        with progress_bar(Console(stderr=True)) as progress:
            what = (config.out, config.task, twin, config.seed, config.student)
            done = record_student(*what, progress, config.conditions, station)
        share = f"{done.episodes} demonstrations of {done.trials} trials ({100 * done.success:.0f} %)"
        console.print(f"{share} in {config.student.root}.", highlight=False)
