"""What attacks a careless user and a hostile bench can make come to, at full size."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console
from rich.markdown import Markdown

from lerobot_pneutac.reports.page import write_result
from pneutac_benchmarks.robustness.images import damage_images, read_bombs
from pneutac_benchmarks.robustness.killed_parent import kill_parents
from pneutac_benchmarks.robustness.killed_recording import kill_recordings
from pneutac_benchmarks.robustness.outcome import Outcome
from pneutac_benchmarks.robustness.recordings import damage_recordings
from pneutac_benchmarks.robustness.twins import (
    compare_damaged_twins,
    damage_twins,
    kill_saves,
    sample_twin,
    save_at_once,
)
from pneutac_benchmarks.tables import markdown
from pneutac_sim.errors import InputError

ROOT = Path(__file__).parents[3]
HARDWARE = "tests/robots/hardware/test_"
# What needs the firmware's simulator, or parts that hang, is tried by the tests themselves.
TESTS = {
    "pressure sensor: stuck at 9 kPa with noise; 1,000 random faults for 20 s; supply of 40 kPa": (
        f"{HARDWARE}pressure_firmware.py::test_a_sensor_stuck_at_9_kpa_with_noise_fills_no_more_than_the_cut_off",
        f"{HARDWARE}pressure_firmware.py::test_the_chamber_stays_below_the_cut_off_whatever_one_sensor_reads[1000-20]",
        "the chamber stays below 16.5 kPa",
    ),
    "a host that babbles at 1 MB/s": (
        f"{HARDWARE}pressure_sketch.py::test_a_host_that_babbles_at_1_mb_a_second_delays_no_step_beyond_5_ms",
        "at most 5 ms between two control steps",
    ),
    "hellos of another time, played back": (
        f"{HARDWARE}pressure_firmware.py::test_hellos_of_another_time_are_answered_and_change_nothing",
        "refused",
    ),
    "30,000 rounds of random bytes and readings, under sanitizers": (
        f"{HARDWARE}pressure_sanitized.py::test_no_bytes_and_no_readings_break_the_core[30000]",
        "no undefined behaviour",
    ),
    "actions with NaN, infinity, too much; every fourth refused": (
        f"{HARDWARE}safety.py::test_a_refused_action_stops_the_arm_vents_and_is_logged",
        f"{HARDWARE}safety.py::test_refusals_that_are_a_quarter_of_the_last_actions_are_a_fault",
        "vented, then a fault",
    ),
    "a camera that gives the same picture, or none": (
        "tests/robots/cameras/test_digit_faults.py::test_no_new_image_is_noticed_within_the_stated_time",
        "a fault within the stated time",
    ),
    "an arm whose state hangs": (
        f"{HARDWARE}safety.py::test_an_arm_whose_state_hangs_is_a_fault_within_300_ms",
        "a fault within 300 ms",
    ),
    "power loss and a full disk while a twin is saved": (
        "tests/sim/test_twin.py::test_nothing_takes_a_files_place_before_the_disk_holds_it",
        "tests/sim/test_twin.py::test_a_full_disk_is_one_sentence_and_leaves_nothing_behind",
        "the old twin stays",
    ),
}


@dataclass
class BenchmarkRobustnessConfig:
    """Options of `pneutac benchmark robustness`.

    Attributes:
        share: of the full number of attempts; a small one shows that it runs.
        tests: whether the attacks that are tests are run too; they need the repository and a C++ compiler.
        out: folder for `result.json` and `robustness.md`.
    """

    share: float = 1.0
    tests: bool = True
    out: Path = Path("outputs/benchmark_robustness")

    def __post_init__(self):
        if not 0 < self.share <= 1:
            raise InputError(f"share is {self.share}; it must be above 0 and at most 1.")
        if self.tests and not (ROOT / "tests").is_dir():
            raise InputError("tests is true, but there is no repository here; give --tests=false.")


def benchmark_robustness(cfg: BenchmarkRobustnessConfig) -> None:
    """Runs the benchmark; each row is printed as soon as it is known."""
    console, outcomes = Console(), []
    for seconds, outcome in measure(cfg):
        outcomes.append(outcome)
        console.print(f"{outcome.attack}: {len(outcome.broken)} of {outcome.tried} ({seconds:.0f} s)")
        for line in outcome.broken[:5]:
            console.print(f"  {line}", markup=False, highlight=False)
    cfg.out.mkdir(parents=True, exist_ok=True)
    write_result(cfg.out, {"share": cfg.share, "attacks": [asdict(o) for o in outcomes]})
    (cfg.out / "robustness.md").write_text(page(outcomes, cfg.share))
    console.print(Markdown(page(outcomes, cfg.share)))
    console.print(f"result.json and robustness.md are in {cfg.out}", highlight=False)


def measure(cfg: BenchmarkRobustnessConfig) -> Iterator[tuple[float, Outcome]]:
    """Makes every attack; yields how long it took (s) and what it came to."""

    def size(full: int) -> int:
        return max(2, round(full * cfg.share))

    with tempfile.TemporaryDirectory() as folder:

        def work(name: str) -> Path:
            path = Path(folder) / name
            path.mkdir()
            return path

        twin = sample_twin(work("twin"))
        attacks: list[Callable[[], Outcome]] = [
            lambda: kill_recordings(work("killed"), size(100)),
            lambda: kill_saves(work("saves")),
            lambda: save_at_once(work("at_once"), size(10_000)),
            lambda: damage_twins(twin, work("twins"), size(10_000)),
            lambda: compare_damaged_twins(twin, work("compared"), size(1000)),
            lambda: damage_images(size(10_000)),
            read_bombs,
            lambda: damage_recordings(work("recordings"), size(10_000)),
            lambda: kill_parents(size(50)),
        ]
        attacks += [lambda a=a, t=t: run_tests(a, t) for a, t in TESTS.items() if cfg.tests]
        for attack in attacks:
            began = time.monotonic()
            outcome = attack()
            yield time.monotonic() - began, outcome


def run_tests(attack: str, tests: tuple[str, ...]) -> Outcome:
    """Runs tests of the repository; the last entry says what they ask for."""
    *names, wanted = tests
    command = [sys.executable, "-m", "pytest", "-q", "-m", "nightly or not nightly", "-p", "no:cacheprovider"]
    done = subprocess.run([*command, *names], cwd=ROOT, capture_output=True, text=True, check=False)
    lines = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    if done.returncode and not lines:
        lines = [done.stdout.strip().rpartition("\n")[2] or "pytest did not run"]
    passed = sum(int(n) for n, _, w in (s.partition(" ") for s in _summary(done.stdout)) if w == "passed")
    return Outcome(attack, passed + len(lines), tuple(lines), f"{wanted}; tests")


def _summary(text: str) -> list[str]:
    """`3 passed`, `1 failed` and so on of the last line."""
    return [part.strip() for part in text.strip().rpartition("\n")[2].partition(" in ")[0].split(",")]


def page(outcomes: list[Outcome], share: float) -> str:
    """The page of results."""
    harmed = sum(bool(o.broken) for o in outcomes)
    rows = [(o.attack, f"{o.tried:,}", f"{len(o.broken):,}", o.measured) for o in outcomes]
    lines = [
        "# Robustness tests\n",
        f"**Claim.** Of {len(outcomes)} kinds of attack {harmed or 'none'} did harm.\n",
        "**Command.**\n",
        f"    pneutac benchmark robustness{'' if share == 1 else f' --share={share:g}'}\n",
        "Harm is a traceback, a message of 400 characters or more, a loss, or a limit that was passed. The",
        "same attacks run at a small size with every test, at full size in `make nightly`.\n",
        *markdown(("attack", "tried", "did harm", "measured"), rows),
        "\n**Limitations.** Mutations are random; hardware is simulated.",
    ]
    return "\n".join(lines) + "\n"
