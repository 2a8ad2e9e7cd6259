"""`pneutac demo` as a sequence of stages; the commands themselves are played."""

import json
import re

import numpy as np
import pytest
from rich.console import Console
from verbs import verb

from lerobot_pneutac.verbs import demo as pages
from lerobot_pneutac.verbs.demo import Demo, DemoConfig
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin, Value

SELECTED = ["creep", "valve_lag"]
STAGES = ["bench", "twin", "diagnose", "add", "record", "augment", "policies"]


class Commands:
    """Writes what each command would, and fails at the `stop`-th.

    Attributes:
        lines: the commands that came.
    """

    def __init__(self):
        self.lines, self.stop, self.selected, self.left_out = [], None, SELECTED, ()
        self.first, self.tenths = "done", (9, 5)  # of the recorded one, of starts with augmentation and alone

    def __call__(self, demo, *words, total=0, pattern=""):
        line = " ".join(words)
        demo._commands.append(line)
        self.lines.append(line)
        if self.stop and self.stop in line:
            raise InputError("the computer was switched off")
        options = dict(w.removeprefix("--").split("=", 1) for w in words if w.startswith("--") and "=" in w)
        if words[1:2] == ("new",):
            Twin.builtin().save(demo.twin)
        if words[1:2] == ("add",):
            twin = Twin.load(demo.twin)
            assert options["from"] == str(demo.cfg.out / "diagnosis")
            for name in (n for n in self.selected if n not in self.left_out):
                twin.effects[name] = {p.name: Value(0.1) for p in get_effect(name).parameters}
            twin.save(demo.twin)
        result = {
            "compare": {"error": {"heldout": 2.5 / (1 + 2 * len(self.added))}, "noise_floor": 0.5},
            "diagnose": {
                "selected": self.selected,
                "verdict": "missing_effect",
                "sentence": "Two are missing.",
            },
            "augment": {"kept": 3, "attempts": 4},
        }.get(words[1], {})
        if "out" in options:
            self.write(demo.cfg.out / options["out"].removeprefix(f"{demo.cfg.out}/"), "result.json", result)
        if words[0] == "lerobot-record":
            self.write(demo.cfg.out / "recorded_1" / "meta", "outcomes.json", {"0": self.first})
        if words[0] == "lerobot-eval":
            folder, n = options["output_dir"].rsplit("/", 1)[1], demo.cfg.trials
            done = [k % 10 < self.tenths[folder.endswith("_alone")] for k in range(n)]
            info = {"per_task": [{"metrics": {"successes": done}}]}
            self.write(demo.cfg.out / folder, "eval_info.json", info)
        return "step:1 loss:3.5 grdn:1\nstep:2 loss:0.25 grdn:1\n" if words[0] == "lerobot-train" else ""

    @property
    def added(self):
        return [line for line in self.lines if line.startswith("pneutac add")]

    @staticmethod
    def write(folder, name, content):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(json.dumps(content))

    def verbs(self):
        """The commands in short: program and verb, or `-m`'s module."""
        return [re.sub(r"^python -m ", "", line).split(" --")[0] for line in self.lines]


@pytest.fixture
def commands(monkeypatch):
    played = Commands()
    monkeypatch.setattr(Demo, "_command", lambda demo, *words, **more: played(demo, *words, **more))
    monkeypatch.setattr(
        Demo, "_unpaced", lambda demo, root, episodes: played.lines.append(f"unpaced {episodes}")
    )
    monkeypatch.setattr(pages, "demonstration_strip", lambda root: np.zeros((4, 8, 3), np.uint8))
    return played


def demo(out, **options):
    told = []
    return Demo(DemoConfig(out, **options), told.append, lambda text, done, total: None), told


def test_the_stages_run_in_order_and_hand_on_what_they_found(commands, tmp_path):
    run, told = demo(tmp_path / "d", trials=10)
    result = run.run()
    assert [name for name in result.state if name != "options"] == STAGES
    assert [line.split("  ")[0] for line in told] == [f"{i}/7" for i in range(1, 8)]
    policy = ["pneutac_datasets.demonstrations.pool", "lerobot-train", "lerobot-eval"]
    lines, recorded = commands.verbs(), ["lerobot-record", "unpaced 9"]
    assert lines[:8] == [
        "pneutac_datasets.generate",
        *["pneutac new", "pneutac calibrate", "pneutac calibrate", "pneutac compare"],
        "pneutac diagnose",
        *["pneutac add", "pneutac compare"],
    ]
    assert sorted(lines[8:10]) == sorted(recorded), "side by side"
    assert lines[10:12] == ["lerobot-edit-dataset", "pneutac augment"]
    short_of = list(zip(commands.lines, lines, strict=True))[12:]
    for alone in (False, True):
        own = [short for line, short in short_of if ("_alone" in line) == alone]
        assert own == policy
    assert {k: result.state["augment"][k] for k in ("kept", "attempts", "recorded")} == {
        "kept": 3,
        "attempts": 4,
        "recorded": 10,
    }
    assert result.state["policies"]["losses"] == {arm: [3.5, 0.25] for arm in ("augmented", "alone")}
    assert sum(result.state["policies"]["augmented"]) == 9 and sum(result.state["policies"]["alone"]) == 5
    policies = [line for line in commands.lines if line.startswith("lerobot-")]
    for seed in ("--seed=1", "--seed=5001"):
        assert sum(seed in line.split() for line in policies) == 2, "both are trained and tried alike"
    d = result.to_dict()
    assert d["tip_error_mm"] == {"before": 2.5, "after": pytest.approx(2.5 / 3)} and d["noise_mm"] == 0.5
    assert d["selected"] == SELECTED and d["final_loss"] == 0.25 and set(d["seconds"]) == set(STAGES)
    assert json.loads((tmp_path / "d" / "state.json").read_text()) == result.state


@pytest.mark.parametrize(
    ("stop", "finished", "first"),
    [
        ("pneutac new", 1, "pneutac new"),
        ("compare_after", 3, "pneutac compare"),
        ("lerobot-eval", 6, "pneutac_datasets.demonstrations.pool"),
    ],
)
def test_an_interrupted_demo_goes_on_where_it_stopped(commands, tmp_path, stop, finished, first):
    commands.stop = stop
    with pytest.raises(InputError, match="switched off"):
        demo(tmp_path / "d")[0].run()
    before, commands.stop = list(commands.verbs()), None
    run, told = demo(tmp_path / "d")
    result = run.run()
    again = commands.verbs()[len(before) :]
    assert [line.endswith("(done before)") for line in told] == [True] * finished + [False] * (7 - finished)
    assert again[0] == first
    for name in ("pneutac_datasets.generate", "pneutac diagnose", "lerobot-record"):
        assert commands.verbs().count(name) == 1
    assert len(commands.added) == 1, "what was found is added once"
    assert result.to_dict()["success_percent"] == {"augmented": 90.0, "alone": 50.0}


def test_a_finished_demo_runs_nothing_again_and_fresh_begins_anew(commands, tmp_path):
    demo(tmp_path / "d")[0].run()
    n = len(commands.lines)
    again, told = demo(tmp_path / "d")
    again.run()
    assert len(commands.lines) == n and all("done before" in line for line in told)
    (tmp_path / "d" / "mine.txt").touch()
    demo(tmp_path / "d", seed=2, fresh=True)[0].run()
    assert len(commands.lines) == 2 * n and not (tmp_path / "d" / "mine.txt").exists()


def test_a_folder_with_other_options_is_refused(commands, tmp_path):
    demo(tmp_path / "d")[0].run()
    with pytest.raises(InputError, match="holds a demo with other options; give fresh=true"):
        demo(tmp_path / "d", seed=2)


def test_a_diagnosis_that_finds_nothing_ends_the_demo(commands, tmp_path):
    commands.selected = []
    with pytest.raises(InputError, match="found no missing effect .missing_effect.*longer session"):
        demo(tmp_path / "d")[0].run()


def test_a_failed_command_shows_the_end_of_its_log(tmp_path):
    run, told = demo(tmp_path / "d")
    run._commands = []
    code = "print(*range(100), sep='\\n'); raise SystemExit('the valve is stuck')"
    with pytest.raises(InputError, match="the command above failed; the end of .*log says:") as error:
        run._command("python", "-c", code)
    assert "the valve is stuck" in str(error.value) and "\n99\n" in str(error.value)
    assert "\n80\n" not in str(error.value)
    (log,) = (tmp_path / "d" / "logs").iterdir()
    assert log.read_text().startswith("0\n1\n") and str(log) in str(error.value)
    assert told[0].startswith("$ python -c ")


def test_progress_is_that_of_all_commands_that_run_together(tmp_path):
    shown, run = [], demo(tmp_path / "d")[0]
    run._progress = lambda *what: shown.append(what)
    for n in (2, 3):
        run._command("python", "-c", f"print('loss:1\\n' * {n}, end='')", total=3, pattern="loss:")
    assert shown[-1] == ("python", 5, 6)
    run._command("echo", "hello")
    assert shown[-1] == ("echo hello", 0, 0), "another program has its own"
    run._done.clear()
    run._command("python", "-c", "print('making demonstrations: 20 of 60, about 3 min left')")
    assert shown[-1] == ("python", 20, 60)


def test_the_sentence_says_what_was_found_and_the_report_is_written(commands, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "lerobot_pneutac.cli.terminal.Console", lambda **options: Console(width=500, **options)
    )
    out = tmp_path / "d"
    verb("demo", out=out)
    result = json.loads((out / "result.json").read_text())
    assert result["trials"] == 40
    assert result["success_ci95"]["augmented"] == pytest.approx([76.95, 96.04], abs=0.01)
    assert result["difference_percent"] == 40 and 20 < result["difference_ci95"][0] < 30
    page = (out / "report.html").read_text()
    sentence = (
        "With creep and a slow valve added, the test error of the tip went from 2.50 to 0.83 mm "
        "(noise 0.50 mm, unexplained 0.67 mm). Trained on 10 demonstrations and 3 made of them on the"
        " corrected twin, the policy pulled the card in 36 of 40 starts that it had not seen (90 %, 95 %"
        " interval 77 to 96); trained on the 10 alone in 20 of 40 of the same (50 %, 95 % interval 35 to 65)."
        " Augmentation helped in this run: +40 points (95 % interval +25 to +55; one training each)."
    )
    assert sentence in page
    for text in ("The error of the twin", "Learning curve", "lerobot-eval", "Two are missing."):
        assert text in page
    assert result["selected"] == SELECTED


def test_what_the_quick_demo_leaves_out_is_no_option_of_it():
    assert DemoConfig(quick=True).out.name == "quick"
    with pytest.raises(InputError, match="--quick=true records and trains nothing; leave out --trials"):
        DemoConfig(quick=True, trials=8)


def test_an_effect_that_add_left_out_is_not_called_added_and_the_twin_before_stays(commands, tmp_path):
    commands.left_out, commands.stop = ("valve_lag",), "compare_after"
    with pytest.raises(InputError):
        demo(tmp_path / "d")[0].run()
    commands.stop = None
    result = demo(tmp_path / "d")[0].run()
    assert result.sentence.startswith("With creep added, ")
    assert "creep" not in Twin.load(tmp_path / "d" / "before").effects
    assert sum(" add " in line for line in commands.lines) == 1


@pytest.mark.parametrize(
    ("tenths", "said"),
    [
        ((5, 5), "Augmentation did not help in this run: +0 points"),
        ((3, 6), "Augmentation did not help in this run: -30 points"),
        ((6, 5), "Whether augmentation helped is uncertain in this run: +10 points"),
    ],
)
def test_it_says_where_augmentation_did_not_help(commands, tmp_path, tenths, said):
    commands.tenths = tenths
    assert said in demo(tmp_path / "d", trials=10)[0].run().sentence


def test_a_first_demonstration_that_failed_is_left_out(commands, tmp_path):
    commands.first = "the task was not done"
    demo(tmp_path / "d")[0].run()
    assert "unpaced 10" in commands.lines and "lerobot-edit-dataset" not in commands.verbs()


def test_films_of_both_policies_stand_side_by_side(commands, tmp_path):
    result = demo(tmp_path / "d")[0].run()
    for folder, marks in (("eval", b"xy"), ("eval_alone", b"zw")):
        for k, mark in enumerate(marks):
            (tmp_path / "d" / folder / f"eval_episode_{k}.mp4").write_bytes(bytes([mark]) * 3)
    page = result.page().fragment()
    films = re.findall(r"<figure>(.*?)</figure>", page)
    pairs = [re.findall(r"base64,(\w+)", film) for film in films if "<video" in film]
    assert pairs == [["eHh4", "enp6"], ["eXl5", "d3d3"]]
    assert "Start 1: with augmentation done, the ten alone done." in page
