"""The policy benchmark's conditions, and the units of work that they come to."""

from dataclasses import asdict, dataclass, field

from pneutac_sim.features import TASK_NAMES

# kind -> rough seconds on one core, for the order of the work and the time left
COST_S = {
    "ppo": 1200,
    "augment": 600,
    "record": 40,
    "student": 200,
    "naive": 100,
    "frames": 30,
    "train": 240,
    "evaluate": 60,
}
# Starts of a unit's trials or training derive from seed, task and purpose, so that no two share one.
PURPOSES = ("real", "more", "augmented", "naive", "ppo", "student", "network")
# The trials' starts follow one another from here, above all others; options are chosen by 2**30 on.
TEST_START = 5 * 2**28
MAX_TRIALS, MAX_SEED = 1000, 10**5


@dataclass(frozen=True)
class Condition:
    """How one policy comes about.

    Attributes:
        words: for tables.
        pretrain: name of the frames to train on first; None for no pre-training.
        final: name of the frames to train on then.
        use_tactile: whether the policy feels.
    """

    words: str
    pretrain: str | None
    final: str
    use_tactile: bool = True


CONDITIONS = {
    "sim_real": Condition("augmented on the twin, then real", "augmented", "real"),
    "mixed": Condition("augmented on the twin, and real counted twice, at once", None, "mixed"),
    "real": Condition("real", None, "real"),
    "n_aug": Condition("augmented without a simulator, then real", "naive", "real"),
    "real_20": Condition("twice as many real", None, "real_20"),
    "no_tac": Condition("as sim_real, without touch", "augmented", "real", use_tactile=False),
    "ppo": Condition("of an actor trained by PPO on the twin, then real", "student", "real"),
}
# What correcting the twin changes: `twin_before` against `twin`.
COMPARED = {
    "sim_only_before": Condition("augmented alone, twin before", None, "augmented_before"),
    "sim_only": Condition("augmented alone, twin after", None, "augmented"),
    "sim_real_before": Condition("augmented, then real, twin before", "augmented_before", "real"),
    "sim_real": Condition("augmented, then real, twin after", "augmented", "real"),
}
# frames -> the units whose datasets they are read from
FRAMES = {
    "real": ("real",),
    "real_20": ("real", "more"),
    "augmented": ("augmented",),
    "mixed": ("real", "real", "augmented"),
    "naive": ("naive",),
    "student": ("student",),
    "augmented_before": ("augmented_before",),
}


@dataclass(frozen=True)
class Unit:
    """One piece of work in a folder of its own.

    Attributes:
        name: `task/seed/what`, also its folder below the benchmark's.
        kind: which function does it.
        options: all that decides its result, besides the units that it needs.
        needs: units that must be there.
    """

    name: str
    kind: str
    options: dict = field(default_factory=dict)
    needs: tuple[str, ...] = ()


def derived_seed(seed: int, task: str, purpose: str) -> int:
    """The seed of one purpose; below `TEST_START`."""
    index = TASK_NAMES.index(task) if task in TASK_NAMES else 0  # seeds of two tasks may be the same
    return (seed * len(TASK_NAMES) + index) * len(PURPOSES) + PURPOSES.index(purpose)


def conditions(cfg) -> dict[str, Condition]:
    """Those that a BenchmarkPolicyConfig asks for."""
    return (COMPARED if cfg.twin_before else {}) | {name: CONDITIONS[name] for name in cfg.conditions}


def plan(cfg) -> list[Unit]:
    """All units of a benchmark; those that others need come first.

    Args:
        cfg: BenchmarkPolicyConfig.
    """
    units: dict[str, Unit] = {}
    for task in cfg.tasks:
        for seed in cfg.seeds:
            for name, condition in conditions(cfg).items():
                for unit in _of_condition(cfg, task, seed, name, condition):
                    units.setdefault(unit.name, unit)
    return list(units.values())


def _of_condition(cfg, task: str, seed: int, name: str, condition: Condition) -> list[Unit]:
    at = f"{task}/{seed}"
    units, read = [], [f for f in (condition.pretrain, condition.final) if f]
    for frames in read:
        for source in FRAMES[frames]:
            units += _of_dataset(cfg, task, seed, source)
        sources = tuple(f"{at}/{s}" for s in FRAMES[frames])
        units.append(Unit(f"{at}/{frames}_frames", "frames", {}, sources))
    finetune = {
        "use_tactile": condition.use_tactile,
        "pretrain_updates": cfg.pretrain_updates,
        "finetune_updates": cfg.finetune_updates,
        "batch": cfg.batch,
        "lr": cfg.lr,
        "finetune_lr": cfg.finetune_lr,
        "select": cfg.select,
        "device": cfg.device,
        "seed": derived_seed(seed, task, "network"),
    }
    needs = tuple(f"{at}/{f}_frames" for f in read)
    units.append(Unit(f"{at}/{name}_policy", "train", finetune, needs))
    trials = {"task": task, "twin": _text(cfg.twin), "trials": cfg.trials}
    trials["start"] = TEST_START + seed * MAX_TRIALS
    units.append(Unit(f"{at}/{name}_trials", "evaluate", trials, (f"{at}/{name}_policy",)))
    return units


def _of_dataset(cfg, task: str, seed: int, source: str) -> list[Unit]:
    at = f"{task}/{seed}"
    made = {"task": task, "episodes": cfg.augmented, "fidelity": cfg.fidelity}
    real = {"task": task, "twin": _text(cfg.twin), "episodes": cfg.demonstrations}

    def seeded(options: dict, purpose: str) -> dict:
        return options | {"seed": derived_seed(seed, task, purpose)}

    first = Unit(f"{at}/real", "record", seeded(real, "real"))
    if source == "real":
        return [first]
    if source == "more":
        return [Unit(f"{at}/more", "record", seeded(real, "more"))]
    if source == "naive":
        options = {"task": task, "episodes": cfg.augmented}
        return [first, Unit(f"{at}/naive", "naive", seeded(options, "naive"), (first.name,))]
    if source == "student":
        options = {"task": task, "twin": _text(cfg.twin), "steps": cfg.ppo_steps, "tries": cfg.trials}
        actor = Unit(f"{at}/ppo_actor", "ppo", seeded(options, "ppo"))
        options = seeded(made | {"twin": _text(cfg.twin)}, "student")
        return [actor, Unit(f"{at}/student", "student", options, (actor.name,))]
    twin = {"augmented": cfg.twin, "augmented_before": cfg.twin_before}[source]
    options = seeded(made | {"twin": _text(twin)}, "augmented")
    return [first, Unit(f"{at}/{source}", "augment", options, (first.name,))]


def _text(path) -> str | None:
    return None if path is None else str(path)


def as_dict(unit: Unit) -> dict:
    """For JSON; what must be equal for a finished unit to be taken over."""
    return asdict(unit) | {"needs": list(unit.needs)}
