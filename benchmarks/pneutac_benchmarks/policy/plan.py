"""The policy benchmark's conditions, and the units of work that they come to."""

import math
from dataclasses import asdict, dataclass, field

from pneutac_sim.features import TASK_NAMES
from pneutac_sim.twin import Twin, twin_digest

RESULT = "unit.json"  # of each finished unit
# Starts of a unit's trials or training derive from seed, task and purpose, so that no two share one.
PURPOSES = ("real", "more", "augmented", "naive", "ppo", "student", "network")
# The trials' starts follow one another from here, above all others; options are chosen by 2**30 on.
TEST_START = 5 * 2**28
MAX_TRIALS, MAX_SEED = 1000, 10**5
CHUNK = 10  # trials of a unit
PIECE = 25  # demonstrations that one unit makes
SETS = 8  # seeds that follow one another and, where more than twenty are asked for, share demonstrations
# Strength of the modelled person and width of the starts by task, chosen before anything was augmented.
PERSON = {"switch": (1.0, 0.25), "egg": (1.0, 1.0), "card": (0.5, 0.5)}
OTHER_TASK = (1.0, 0.0)
# Core seconds, by kind: of each demonstration, try or trial; of the others once.
COST_S = {
    "record": 6.5,
    "library": 2.5,
    "expert": 1.5,
    "planner": 30.0,
    "naive": 0.2,
    "student": 2.0,
    "film": 6.0,
}
ONCE_S = {"scenes": 70.0, "ppo": 1200.0, "train": 240.0, "evaluate": 3.2}
TRAIN_GPU_S = 30.0  # of a core, where a GPU trains


@dataclass(frozen=True)
class Condition:
    """How one policy comes about.

    Attributes:
        words: for tables.
        made: kind of the demonstrations that are made; None for real ones alone.
        real: real ones, in tens.
        then: whether it is trained on what is made first, and then on the real ones, as in the paper; else on
            both at once, the real ones by `real_share`.
        use_tactile: whether the policy feels.
        memory: whether it remembers and answers early, as by default after `augment`; the paper's does not.
        huber_delta, networks: see PneutacBCConfig.
    """

    words: str
    made: str | None = None
    real: float = 1.0
    then: bool = False
    use_tactile: bool = True
    memory: bool = False
    huber_delta: float = 0.0
    networks: int = 1


AFTER_AUGMENT = {"memory": True, "huber_delta": 0.5, "networks": 3}  # by default
CONDITIONS = {
    "real": Condition("ten real ones"),
    "real_tuned": Condition("ten real ones, trained as with the library's", **AFTER_AUGMENT),
    "real_20": Condition("twenty real ones", real=2),
    "real_100": Condition("a hundred real ones", real=10),
    "library": Condition("ten real ones and the library's", "library", **AFTER_AUGMENT),
    "library_1": Condition("the same, one network", "library", **AFTER_AUGMENT | {"networks": 1}),
    "expert": Condition("ten real ones and the scripted expert's on the twin", "expert"),
    "planner": Condition("ten real ones and planned ones", "planner"),
    "sim_real": Condition("planned ones, then ten real ones", "planner", then=True),
    "n_aug": Condition("ten varied without a simulator, then ten real ones", "naive", then=True),
    "no_tac": Condition("as library, without touch", "library", use_tactile=False),
    "ppo": Condition("an actor's, trained by PPO on the twin, then ten real ones", "student", then=True),
    "real_1": Condition("one real one", real=0.1),
    "real_3": Condition("three real ones", real=0.3),
    "real_5": Condition("five real ones", real=0.5),
    "real_50": Condition("fifty real ones", real=5),
}
ALIASES = {"mixed": "planner", "library_3": "library"}  # old name to new, for one more version
# What correcting the twin changes: `twin_before` against `twin`.
COMPARED = {
    "sim_only_before": Condition("the library's alone, twin before", "library_before", real=0),
    "sim_only": Condition("the library's alone, twin after", "library", real=0),
    "library_before": Condition(
        "ten real ones and the library's, twin before", "library_before", **AFTER_AUGMENT
    ),
    "library": CONDITIONS["library"],
    "expert_before": Condition("ten real ones and the expert's, twin before", "expert_before"),
    "expert": CONDITIONS["expert"],
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

    @property
    def core_s(self) -> float:
        """Roughly, for the order of the work and the time left."""
        o = self.options
        if self.kind == "train":
            return o["networks"] * (TRAIN_GPU_S if o["device"] == "cuda" else ONCE_S["train"])
        if self.kind == "scenes":
            return ONCE_S["scenes"] * o["episodes"]
        if self.kind == "evaluate":
            return ONCE_S["evaluate"] * o["trials"]
        kind = o["method"] if self.kind == "augment" else self.kind
        return COST_S[kind] * o["episodes"] if kind in COST_S else ONCE_S[kind]


def derived_seed(seed: int, task: str, purpose: str) -> int:
    """The seed of one purpose; below `TEST_START`."""
    index = TASK_NAMES.index(task) if task in TASK_NAMES else 0  # seeds of two tasks may be the same
    return (seed * len(TASK_NAMES) + index) * len(PURPOSES) + PURPOSES.index(purpose)


def conditions(cfg) -> dict[str, Condition]:
    """Those that a BenchmarkPolicyConfig asks for."""
    return (COMPARED if cfg.twin_before else {}) | {name: CONDITIONS[name] for name in cfg.conditions}


def plan(cfg) -> list[Unit]:
    """All units of a benchmark, in the order of the conditions; those that others need come first.

    The first trials of every condition come before the further ones of any, so that a benchmark that is cut
    short has some of each.

    Args:
        cfg: BenchmarkPolicyConfig.
    """
    units: dict[str, Unit] = {}
    twins = {path: _of_twin(path) for path in {cfg.twin, cfg.twin_before}}
    for name, condition in conditions(cfg).items():
        for seed in cfg.seeds:
            for task in cfg.tasks:
                for unit in _of_condition(cfg, twins, task, seed, name, condition):
                    units.setdefault(unit.name, unit)
    return sorted(units.values(), key=lambda u: 2 * (u.kind == "film") + u.options.get("further", False))


def recordings(seed: int, sets: int) -> list[tuple[int, str]]:
    """Seed and purpose of so many recordings of a set each: two of its own, then those of its neighbours."""
    group, place = seed // SETS * SETS, 2 * (seed % SETS)
    at = [(place + k) % (2 * SETS) for k in range(sets)]
    return [(group + k // 2, PURPOSES[k % 2]) for k in at]


def _of_condition(cfg, twins: dict, task: str, seed: int, name: str, condition: Condition) -> list[Unit]:
    at = f"{task}/{seed}"
    wanted = max(round(condition.real * cfg.demonstrations), 1) if condition.real else 0
    real = [
        _recording(cfg, twins, task, *of) for of in recordings(seed, math.ceil(wanted / cfg.demonstrations))
    ]
    made = _made(cfg, twins, task, seed, condition.made) if condition.made else []
    options = {
        "use_tactile": condition.use_tactile,
        "memory": condition.memory,
        "huber_delta": condition.huber_delta,
        "networks": condition.networks,
        "real": len(real),  # of its needs, the last ones
        "episodes": wanted,
        "then": condition.then,
        "real_share": cfg.real_share,
        "pretrain_updates": cfg.pretrain_updates,
        "finetune_updates": cfg.finetune_updates,
        "batch": cfg.batch,
        "lr": cfg.lr,
        "finetune_lr": cfg.finetune_lr,
        "select": cfg.select,
        "device": cfg.device,
        "seed": derived_seed(seed, task, "network"),
    }
    sources = tuple(u.name for u in [*made, *real] if u.kind not in ("scenes", "ppo"))
    if condition.made and condition.made not in ("student",) and not real:
        real = [_recording(cfg, twins, task, seed, "real")]  # what is made is made of them
    policy = Unit(f"{at}/{name}_policy", "train", options, sources)
    where = {"task": task, **twins[cfg.twin], "start_width": cfg.of_task(task)[1]}
    trials = []
    for k in range(0, cfg.trials, CHUNK):
        numbers = {"start": TEST_START + seed * MAX_TRIALS + k, "trials": min(CHUNK, cfg.trials - k)}
        numbers["further"] = k >= 2 * CHUNK
        trials.append(Unit(f"{at}/{name}_trials_{k:03d}", "evaluate", where | numbers, (policy.name,)))
    films = []
    if cfg.films and seed == cfg.seeds[0]:
        needs = (policy.name, *(u.name for u in trials if not u.options["further"]))
        films = [Unit(f"{at}/{name}_films", "film", where | {"episodes": cfg.films}, needs)]
    return [*real, *made, policy, *trials, *films]


def _recording(cfg, twins: dict, task: str, seed: int, purpose: str) -> Unit:
    person, width = cfg.of_task(task)
    options = {"task": task, **twins[cfg.twin], "episodes": cfg.demonstrations}
    options |= {"person": person, "start_width": width, "seed": derived_seed(seed, task, purpose)}
    return Unit(f"{task}/{seed}/{purpose}", "record", options)


def _made(cfg, twins: dict, task: str, seed: int, source: str) -> list[Unit]:
    """Units that make demonstrations; all but scenes and actors hold some."""
    at, needs = f"{task}/{seed}", (f"{task}/{seed}/real",)
    before = source.endswith("_before")
    method, twin = source.removesuffix("_before"), cfg.twin_before if before else cfg.twin
    options = {"task": task, **twins[twin]}
    if source == "naive":
        seeded = {"seed": derived_seed(seed, task, "naive"), "episodes": cfg.augmented}
        return [Unit(f"{at}/naive", "naive", seeded, needs)]
    if source == "student":
        seeded = {"seed": derived_seed(seed, task, "ppo"), "steps": cfg.ppo_steps, "tries": cfg.trials}
        actor = Unit(f"{at}/ppo_actor", "ppo", options | seeded)
        seeded = {"seed": derived_seed(seed, task, "student"), "episodes": cfg.augmented}
        return [actor, Unit(f"{at}/student", "student", options | seeded | _fidelity(cfg), (actor.name,))]
    options |= _fidelity(cfg) | {"method": method, "seed": derived_seed(seed, task, "augmented")}
    options |= {"start_width": cfg.of_task(task)[1]}
    scenes = []
    if method == "planner":
        scenes = [Unit(f"{at}/scenes", "scenes", options | {"episodes": cfg.demonstrations}, needs)]
        needs = (*needs, scenes[0].name)
    pieces = []
    for k in range(0, cfg.augmented, PIECE):
        numbers = {"first": k, "episodes": min(PIECE, cfg.augmented - k)}
        pieces.append(Unit(f"{at}/{source}_{k:03d}", "augment", options | numbers, needs))
    return [*scenes, *pieces]


def _fidelity(cfg) -> dict:
    return {"fidelity": cfg.fidelity}


def _of_twin(path) -> dict:
    """Options of a unit that loads a twin; what was made with an earlier version of it is not taken over."""
    return {"twin": None} if path is None else {"twin": str(path), "digest": twin_digest(Twin.load(path))}


def as_dict(unit: Unit) -> dict:
    """For JSON; what must be equal for a finished unit to be taken over."""
    return asdict(unit) | {"needs": list(unit.needs)}
