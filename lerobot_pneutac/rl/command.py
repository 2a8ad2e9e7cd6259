"""`pneutac ppo`."""

import importlib.util

from rich.table import Table

from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.rl.options import PpoConfig
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin
from pneutac_sim.world.station import Station


def command(config: PpoConfig, terminal: Terminal) -> None:
    if importlib.util.find_spec("stable_baselines3") is None:
        raise InputError("Stable-Baselines3 is missing; install lerobot_robot_pneutac[rl].")
    from lerobot_pneutac.rl.ppo import Compute, train_ppo

    twin = Twin.load(config.twin) if config.twin else None
    compute = Compute(config.envs, config.parallel, config.device, config.batch)
    station = Station.load(config.station) if config.station else None
    options = {"conditions": config.conditions} if config.conditions else {}
    options |= {"station": station} if station else {}
    train = (config.task, twin, config.seed, config.steps, config.out, compute)
    card = terminal.run(train_ppo, *train, **options)
    test = card["test"]
    table = Table("what", "number", title=f"Actor for {config.task}")
    table.add_row("steps of training", f"{card['steps']}")
    table.add_row("steps a second", f"{card['steps_per_s']:.0f}")
    table.add_row(f"success on {test['episodes']} new starts", f"{100 * test['success']:.0f} %")
    terminal.console.print(table)
    terminal.say(f"The actor and its curve are in {config.out}.")
    if config.student.root is not None:
        from lerobot_pneutac.rl.student import record_student

        options = {"conditions": config.conditions, "station": station}
        what = (config.out, config.task, twin, config.seed, config.student)
        accepted, trials = terminal.run(record_student, *what, **options)
        share = f"{accepted} demonstrations of {trials} trials ({100 * accepted / trials:.0f} %)"
        terminal.say(f"{share} in {config.student.root}.")
