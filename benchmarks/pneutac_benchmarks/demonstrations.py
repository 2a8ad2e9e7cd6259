"""`pneutac benchmark demonstrations`: what ten demonstrations of the stand-in tell of physics hidden in it.

The twin was measured on the stand-in's bench and fitted to ten of its demonstrations. Then the stand-in is
changed, itself, not the twin, and shows ten others. Right is whoever names what was changed, whatever else
beside it, and nothing where nothing was; a change of light must be told by the rest frames.
"""

import json
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console

from lerobot_pneutac.cli.terminal import progress_bar
from lerobot_pneutac.verbs.add import add
from lerobot_pneutac.verbs.calibrate import calibrate
from lerobot_pneutac.verbs.diagnose import diagnose
from lerobot_robot_pneutac.standin.world import Physics, StandinWorld
from pneutac_benchmarks.tables import markdown, terminal
from pneutac_datasets.demonstrations.episodes import Episode
from pneutac_datasets.demonstrations.imprint import Dragging, light_drift
from pneutac_datasets.demonstrations.reading import Demonstrations, checked
from pneutac_datasets.generate.standin import write_finger, write_gel
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.laws import family
from pneutac_sim.errors import check_between, check_choice, check_least
from pneutac_sim.executor import ExecutorOptions, run_pieces
from pneutac_sim.features import CONTROL_HZ, TRIAL_S, task_names
from pneutac_sim.files import claim, write_json, write_text
from pneutac_sim.twin import Twin
from pneutac_sim.world.expert import ScriptedExpert

VALVE = ("valve_slew", "valve_lag", "leak", "orifice_flow")
# What is hidden, how the stand-in has it, and which kinds of finding are right.
CASES: dict[str, tuple[Physics, tuple[str, ...]]] = {
    **{f"nothing ({n})": (Physics(), ()) for n in range(1, 6)},
    "commands two steps late, not one": (Physics(late_commands=2), ("late_commands",)),
    "commands three steps late": (Physics(late_commands=3), ("late_commands",)),
    "creep 2.5 times as large": (Physics(creep=0.35), ("creep",)),
    "creep 3.5 times as large": (Physics(creep=0.50), ("creep",)),
    "commands three steps late and creep 3.5 times": (
        Physics(late_commands=3, creep=0.50),
        ("late_commands", "creep"),
    ),
    "valve of 60 % of its size": (Physics(orifice=0.27), VALVE),
    "valve of 40 % of its size": (Physics(orifice=0.18), VALVE),
    "red light 15 % brighter": (Physics(brightness=(1.15, 1.0, 1.0)), ("light",)),
    "all light 10 % darker": (Physics(brightness=(0.9, 0.9, 0.9)), ("light",)),
    "half the friction of the gel": (Physics(friction=0.5), ("gel friction",)),
    "finger of 70 % of its stiffness": (Physics(stiffness=0.7), ("compliance",)),
    "finger of 80 % of its stiffness": (Physics(stiffness=0.8), ("compliance",)),
    "finger of 140 % of its stiffness": (Physics(stiffness=1.4), ("compliance",)),
}
# Where the finger is dragged along the bar too: what is hidden, and whether the gel has less friction.
DRAG_M, DRAG_S = 0.012, 15.0
DRAGGED: dict[str, tuple[Physics, bool]] = {
    **{f"nothing ({n})": (Physics(), False) for n in range(1, 4)},
    "creep 3.5 times as large": (Physics(creep=0.50), False),
    "finger of 70 % of its stiffness": (Physics(stiffness=0.7), False),
    "70 % of the friction of the gel": (Physics(friction=0.7), True),
    "half the friction of the gel": (Physics(friction=0.5), True),
}


@dataclass
class BenchmarkDemonstrationsConfig(ExecutorOptions):
    """Options of `pneutac benchmark demonstrations`.

    Attributes:
        out: folder of the table; finished cases in it are not repeated.
        demonstrations: of each case.
        cases: so many of the cases, from the first on; all where left out.
        seed: of the demonstrations.
        task: that they show; the twin is fitted to demonstrations of `button` whatever it is.
    """

    out: Path = Path("outputs/benchmark_demonstrations")
    demonstrations: int = 10
    cases: int = len(CASES)
    seed: int = 0
    task: str = "button"

    def __post_init__(self):
        check_least(5, demonstrations=self.demonstrations)
        check_between(1, len(CASES), cases=self.cases)
        check_choice("task", self.task, task_names())
        self.check_executor()


def show(
    count: int, seed: int, physics: Physics, task: str = "button", drag_m: float = 0.0
) -> Demonstrations:
    """Demonstrations of a scripted expert on the stand-in; one that fails is shown again."""
    world, episodes = StandinWorld(task, physics=physics), []
    if drag_m:
        world.task.drag_m = drag_m
    while len(episodes) < count:
        seen, actions = [world.reset(seed)], []
        expert = ScriptedExpert(world, np.random.default_rng(seed))
        seed += 1
        while len(actions) < (TRIAL_S + (DRAG_S if drag_m else 0)) * CONTROL_HZ and not (
            world.success or world.failure
        ):
            actions.append(expert.action())
            seen.append(world.step(actions[-1]))
        if world.success:
            state = np.array([o.state for o in seen[:-1]], float)
            images = np.stack([o.tactile for o in seen[:-1]])
            episodes.append(
                Episode(state, np.array(actions, float), images, world.task.description, CONTROL_HZ)
            )
    return checked(Demonstrations(Path(f"standin/{task}"), task, episodes))


def measured_twin(folder: Path, count: int, seed: int) -> Twin:
    """The stand-in's twin by its bench, then by demonstrations; read where it has been made."""
    if (folder / "twin.yaml").is_file():
        return Twin.load(folder)
    bench = folder.with_name("bench")
    finger = write_finger(bench / "finger", seed)
    twin = calibrate(Twin.builtin(), finger).twin
    twin = add(twin, finger, diagnose(twin, finger)).twin
    twin = calibrate(twin, Recording.load(write_gel(bench / "gel", seed).folder)).twin
    plain = show(count, 1000 * seed + 300, Physics())
    result = add(twin, plain, diagnose(twin, plain))
    result.save(folder)
    return Twin.load(folder)


def run_case(twin: Twin, number: int, config: BenchmarkDemonstrationsConfig) -> dict:
    """One case: what is found, and errors before and after, of held-out episodes and of all touch."""
    name, (physics, right) = list(CASES.items())[number]
    given = show(config.demonstrations, 1000 * config.seed + 100 + 37 * number, physics, config.task)
    found = diagnose(twin, given, jobs=1)
    corrected = add(twin, given, found)  # replays the episodes again with the corrected twin
    before = found.before
    after = corrected.after if corrected.accepted and corrected.after else before
    light = light_drift(given.episodes, twin.arrays["rest_image"])
    kinds = [family(e) for e in found.selected] + ["light"] * light.drifted
    return {
        "case": name,
        "found": found.selected + ["light"] * light.drifted,
        "right": names_right(right, kinds),
        "accepted": corrected.accepted,
        "verdict": found.verdict,
        "before": before["heldout"],
        "after": after["heldout"],
        "touch_before": before["touch"],
        "touch_after": after["touch"],
        "sentence": found.sentence,
    }


def write_dragged(number: int, config: BenchmarkDemonstrationsConfig, file: Path) -> None:
    """How imprints turn where the finger is dragged, of a number of `DRAGGED`, or of -1, as known before."""
    name, (physics, _) = ("before", (Physics(), False)) if number < 0 else list(DRAGGED.items())[number]
    given = show(config.demonstrations, 1000 * config.seed + 700 + 37 * number, physics, "button", DRAG_M)
    dragging = Dragging.of(given.episodes)
    write_json(file, {"case": name, **(asdict(dragging) if dragging else {})})


def dragged_rows(files: dict[int, Path]) -> list[tuple[str, ...]]:
    """A row a case: what was hidden, how imprints turned, what is said of the gel, and whether rightly."""
    stored = {n: json.loads(file.read_text()) for n, file in files.items()}
    read = {
        n: Dragging(**{k: v for k, v in t.items() if k != "case"}) for n, t in stored.items() if len(t) > 1
    }
    rows = []
    for n, t in stored.items():
        if n not in read:
            rows.append((t["case"], "", "not identified", "no"))
            continue
        less = n >= 0 and read[n].less(read[-1])
        right = n < 0 or less == list(DRAGGED.values())[n][1]
        turn = f"{read[n].turn_deg_per_mm:.2f} ({read[n].error:.2f})"
        how = "slips" if less and read[n].slips(read[-1]) else "sticks less" if less else ""
        rows.append((t["case"], turn, how, "yes" if right else "no"))
    return rows


def _write(
    twin: Twin, config: BenchmarkDemonstrationsConfig, files: list[Path], cases: int, number: int
) -> None:
    """Runs a case, or one of those dragged, which follow them from -1 on, and writes it."""
    if number < cases:
        write_json(files[number], run_case(twin, number, config))
    else:
        write_dragged(number - cases - 1, config, files[number])


def names_right(right: tuple[str, ...], kinds: list[str]) -> bool:
    """Whether what was found names all that was hidden, any of the valve's; and nothing where nothing was."""
    named = set(kinds) & set(right)
    if not right:
        return not kinds
    return bool(named) if right == VALVE else named == set(right)


def benchmark_demonstrations(config: BenchmarkDemonstrationsConfig) -> None:
    """Runs the cases and writes `demonstrations.md` and one file a case."""
    console = Console()
    claim(config.out / "run.json", {n: getattr(config, n) for n in ("seed", "task", "demonstrations")})
    twin = measured_twin(config.out / "twin", config.demonstrations, config.seed)
    files = {n: config.out / f"case_{n:02d}.json" for n in range(min(config.cases, len(CASES)))}
    dragged = {n: config.out / f"dragged_{n + 1:02d}.json" for n in range(-1, len(DRAGGED))}
    if config.task != "button" or config.cases < len(CASES):
        dragged = {}
    both = [*files.values(), *dragged.values()]
    with progress_bar(Console(stderr=True)) as progress:
        make = partial(_write, twin, config, both, len(files))
        run_pieces(make, both, config.out / "logs", config, progress, "cases")
    rows = [json.loads(file.read_text()) for file in files.values()]
    heads = ("hidden in the stand-in", "found", "right", "before (mm)", "after", "touch before", "after")
    shown = [
        (
            r["case"],
            ", ".join(r["found"]) or "nothing",
            "yes" if r["right"] else "no",
            *(f"{r[k]:.2f}" for k in ("before", "after", "touch_before", "touch_after")),
        )
        for r in rows
    ]
    console.print(terminal("Physics hidden in the stand-in, by ten demonstrations", heads, shown, left=3))
    written = markdown(heads, shown)
    if dragged:
        heads = ("hidden in the stand-in, the finger dragged", "turn (degrees a mm)", "told", "right")
        rows = dragged_rows(dragged)
        console.print(terminal("Friction of the gel, by dragging", heads, rows, left=1))
        written += ["", *markdown(heads, rows)]
    write_text(config.out / "demonstrations.md", "\n".join(written) + "\n")
