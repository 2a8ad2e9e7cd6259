"""Runs every step once on the simulated robot that stands in for a real one, by the commands of a user.

A finger with hidden physics is measured; its twin is compared with the measurements, the missing effects are
found and added, and the error falls. The corrected twin then turns ten demonstrations of a modelled person
into more. Two policies are trained with lerobot-train, on these and on the ten alone, and both are tried with
lerobot-eval on the same starts, which they have not seen.
"""

import importlib.util
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from PIL import Image
from scipy.stats import binomtest

from lerobot_pneutac.cli import INSTALL
from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.diagnosis.verdict import called
from lerobot_pneutac.reports.page import AFTER, BEFORE, MEASURED, Report
from lerobot_pneutac.verbs.compare import compare
from lerobot_pneutac.verbs.result import Result
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import joined
from pneutac_sim.errors import InputError, check_between, check_least
from pneutac_sim.executor import Progress
from pneutac_sim.features import CONTROL_HZ, TRIAL_S
from pneutac_sim.files import read_json, whole, write_json
from pneutac_sim.pace import DONE, read_outcomes
from pneutac_sim.twin import Twin

# Of three tasks augmentation helps most on this one. Person and starts are those of benchmarks/policy.md.
TASK, TASK_TEXT = "card", "pull the front card out of the deck"
PERSON, START_WIDTH = 0.5, 0.5
LEARNING = ("demonstrations", "augmented", "steps", "batch_size", "trials")  # which the quick demo leaves out
HIDDEN = "friction_maxwell"  # effect of the rod of the quick demo
FIRST_S = 14  # of the demonstration by lerobot-record; the person is done with most in 10 s
ALONE = "_alone"  # ends the folders of what is made of the recorded demonstrations alone
RESAMPLED = 10_000
COUNTED = r"[\w ]+: (\d+) of (\d+)(?:, about \d+ min left)?"  # a line of progress of a command of ours


@dataclass
class DemoConfig:
    """Options of `pneutac demo`."""

    resumed_by: ClassVar = "state.json"

    # folder of everything that the demo writes; of the quick one outputs/quick, where none is given
    out: Path = Path("outputs/demo")
    minutes: float = 3.0  # length of the session in which the finger is measured
    demonstrations: int = 10  # number of those recorded on the stand-in, one of them by lerobot-record itself
    augmented: int = 60  # number of those that `augment` makes of them on the corrected twin
    steps: int = 4000  # optimiser steps of lerobot-train, of each of the two policies
    batch_size: int = 32  # frames of an optimiser step
    trials: int = 40  # randomised starts on which both policies are tried
    seed: int = 1  # seed of every random choice
    fresh: bool = False  # deletion of an earlier demo in `out`, before all else
    # the bench alone, a minute or two and without LeRobot: a rod with a hidden effect is measured, compared,
    # diagnosed and corrected, and judged on another day
    quick: bool = False

    def __post_init__(self):
        check_between(1, 60, minutes=self.minutes)
        check_least(2, demonstrations=self.demonstrations)
        check_least(1, **{name: getattr(self, name) for name in LEARNING[1:]})
        if self.quick and self.out == type(self).out:
            self.out = Path("outputs/quick")
        for name in LEARNING if self.quick else ():
            if getattr(self, name) != type(self).__dict__[name]:
                raise InputError(f"--quick=true records and trains nothing; leave out --{name}.")


@dataclass(frozen=True)
class DemoResult(Result):
    """What a demo came to; the quick one has no policies."""

    out: Path  # its folder
    state: dict  # stage name to its numbers, seconds and commands

    @property
    def quick(self) -> bool:
        return "policies" not in self.state

    @property
    def title(self) -> str:
        return "A twin learns what it lacked of its finger" + ", and a policy pulls a card" * (not self.quick)

    @property
    def added(self) -> list[str]:
        """The effects that `add` stored, which may be fewer than the diagnosis found."""
        known = Twin.load(self.out / "before").effects
        return [e for e in Twin.load(self.out / "twin").effects if e not in known]

    @property
    def difference(self) -> tuple[float, float, float]:
        """Success with augmentation less that of the ten alone, percent, and its 95 % interval.

        Over the same starts, by resampling them.
        """
        e = self.state["policies"]
        points = 100 * np.subtract(e["augmented"], e["alone"], dtype=float)
        drawn = np.random.default_rng(0).choice(points, (RESAMPLED, len(points))).mean(1)
        return float(points.mean()), *map(float, np.percentile(drawn, [2.5, 97.5]))

    @property
    def sentence(self) -> str:
        before, after = (self.state[stage]["tip_error_mm"] for stage in ("twin", "add"))
        noise, went = self.state["add"]["noise_mm"], f"went from {before:.2f} to {after:.2f} mm (noise "
        added = f"With {joined(map(called, self.added))} added, the"
        if self.quick:
            return f"{added} tip error on another day {went}{noise:.2f} mm)."
        left = max(after**2 - noise**2, 0.0) ** 0.5
        e, made = self.state["policies"], self.state["augment"]
        mean, low, high = self.difference
        verdict = f"Augmentation {'helped' if low > 0 else 'did not help'}"
        if low <= 0 < mean:
            verdict = "Whether augmentation helped is uncertain"
        return (
            f"{added} test error of the tip {went}{noise:.2f} mm, unexplained {left:.2f} mm). "
            f"Trained on {made['recorded']} demonstrations and {made['kept']} made of them on the corrected"
            f" twin, the policy pulled the card in {_count(e['augmented'], 'starts that it had not seen')};"
            f" trained on the {made['recorded']} alone in {_count(e['alone'], 'of the same')}. {verdict} in"
            f" this run: {mean:+.0f} points (95 % interval {low:+.0f} to {high:+.0f}; one training each)."
        )

    @property
    def next_commands(self) -> list[str]:
        """Commands to try next; one opens the twin as it was before anything was added."""
        out, studio = self.out, f"pneutac studio --twin={self.out}/before --recording={self.finger}"
        if self.quick:
            return [f"pneutac history --twin={out}/twin", studio, "python -m pneutac_truths --list"]
        policy = f"--policy={out}/train/checkpoints/last/pretrained_model"
        return [
            f"pneutac diagnose --twin={out}/twin --recording={self.finger} --out=outputs/rest",
            f"pneutac render --twin={out}/twin --pressure_kpa=[0,15] --out=outputs/render",
            "python -m pneutac_datasets.generate --effect=hysteresis --seed=7 --out=outputs/hysteresis",
            f"{studio} --demonstrations={out}/demonstrations {policy}",
        ]

    @property
    def finger(self) -> Path:
        """The recording that the twin was fitted to."""
        return self.out / ("monday" if self.quick else "bench/finger")

    def subject(self) -> tuple[Twin, Path]:
        return Twin.load(self.out / "twin"), self.finger

    def content(self) -> dict:
        s = self.state
        error = {"before": s["twin"]["tip_error_mm"], "after": s["add"]["tip_error_mm"]}
        out = {"tip_error_mm": error, "noise_mm": s["add"]["noise_mm"], "selected": s["diagnose"]["selected"]}
        out |= {"seconds": {name: stage["seconds"] for name, stage in s.items() if name != "options"}}
        if self.quick:
            return out
        e, (mean, low, high) = s["policies"], self.difference
        return out | {
            "success_percent": {name: 100 * float(np.mean(e[name])) for name in ("augmented", "alone")},
            "success_ci95": {name: wilson(e[name]) for name in ("augmented", "alone")},
            "difference_percent": mean,
            "difference_ci95": [low, high],
            "trials": len(e["augmented"]),
            "final_loss": e["losses"]["augmented"][-1],
        }

    def page(self) -> Report:
        from lerobot_pneutac.reports.diagnosis import error_bars  # plotly
        from lerobot_pneutac.reports.figures import curves

        state, out, page = self.state, self.out, self.lead_page()
        after = f"with {joined(map(called, self.added))}"
        ends = (("calibrated", "twin", BEFORE), (after, "add", AFTER))
        steps = [(name, state[stage]["tip_error_mm"], None, colour) for name, stage, colour in ends]
        errors = error_bars(steps, "mm", state["add"]["noise_mm"])
        if self.quick:
            rod = "of a simulated rod with friction of many small elements; the twin has other equations"
            unseen = "The tip on another day, which neither calibration nor diagnosis saw"
            page.figure(_another_day(out), f"{unseen}. The measurements are {rod}.")
            page.figure(errors, "Error of the tip on that day, before and after.")
        else:
            page.heading("The error of the twin")
            rod = "of the stand-in: an elastic rod whose air, creep and hysteresis have other equations than"
            caption = f"Test error of the tip before and after. The measurements are {rod} the twin's."
            page.figure(errors, caption)
        page.text(state["diagnose"]["sentence"])
        if not self.quick:
            page.heading("What the policies do")
            sides = "at the left trained with augmentation, at the right on the recorded demonstrations alone"
            page.text(f"Both policies on the stand-in from the same starts: {sides}.")
            films = [sorted((out / folder).rglob("*.mp4")) for folder in ("eval", f"eval{ALONE}")]
            for start, pair in list(enumerate(zip(*films, strict=False)))[:FILMS]:
                done = [state["policies"][arm][start] for arm in ("augmented", "alone")]
                ends = ["done" if d else "not done" for d in done]
                page.videos(pair, f"Start {start + 1}: with augmentation {ends[0]}, the ten alone {ends[1]}.")
            page.heading("What it feels")
            page.image(demonstration_strip(out / "demonstrations"), "One demonstration: touch over time")
            for picture in sorted((out / "touch").glob("*.png"))[:1]:
                image = np.asarray(Image.open(picture).convert("RGB"))
                page.image(image, "Presses and the calibrated model")
            page.heading("Learning curve")
            training, names = (
                state["policies"],
                {"augmented": "with augmentation", "alone": "recorded ones alone"},
            )
            at = {arm: training["log_freq"] * (1 + np.arange(len(training["losses"][arm]))) for arm in names}
            lines = ((name, at[arm], training["losses"][arm], None) for arm, name in names.items())
            figure = curves(lines, "step", "loss (mm² per step + kPa²)").update_yaxes(type="log")
            loss = "Training loss of lerobot-train, each on its own data: not which policy is better"
            page.figure(figure, loss)
        page.heading("Try next")
        page.code("\n".join(self.next_commands))
        page.heading("What was run")
        for name, title in stages(state["options"], self.quick).items():
            page.text(f"**{title}**, {state[name]['seconds']:.0f} s")
            page.code("\n".join(state[name]["commands"]))
        return page


def wilson(successes: list[bool]) -> list[float]:
    interval = binomtest(sum(successes), len(successes)).proportion_ci(method="wilson")
    return [100 * interval.low, 100 * interval.high]


def _count(successes: list[bool], what: str) -> str:
    """Such as "8 of 10 starts (80 %, 95 % interval 49 to 94)"."""
    low, high = wilson(successes)
    rate = f"{100 * np.mean(successes):.0f} %, 95 % interval {low:.0f} to {high:.0f}"
    return f"{sum(successes)} of {len(successes)} {what} ({rate})"


def stages(options: dict, quick: bool) -> dict[str, str]:
    """Stages of a demo, each a method of `Demo`, and what they do."""
    rod = "an elastic rod with friction that the twin lacks"
    bench = {
        "bench": "Measure a finger on the bench (the stand-in for a real one)",
        "twin": "Make its twin, calibrate finger and gel, and compare",
        "diagnose": "Which physics is missing?",
        "add": "Add it, and see the error fall",
    }
    if quick:
        return bench | {
            "bench": f"Measure a finger on two days ({rod})",
            "twin": "Make its twin, calibrate it, and compare it with the other day",
        }
    return bench | {
        "record": f"Record {options['demonstrations']} demonstrations of a modelled person",
        "augment": f"Make {options['augmented']} more of them on the corrected twin",
        "policies": "Train a policy on all and one on the recorded alone, and try both from the same"
        f" {options['trials']} starts",
    }


Announce = Callable[[str], None]


class Demo:
    """One run: its folder, its stages and the commands that it ran. Finished stages are reused."""

    def __init__(self, cfg: DemoConfig, announce: Announce, progress: Progress):
        self.cfg, self._announce, self._progress = cfg, announce, progress
        self._commands: list[str] = []  # of the stage that runs
        # of each by program, what is done and of how much
        self._done: dict[str, dict[str, tuple[int, int]]] = defaultdict(dict)
        self._file = cfg.out / "state.json"
        options = {k: v for k, v in vars(cfg).items() if k not in ("fresh", "out", "quick")}
        self.state = read_json(self._file) if self._file.exists() else {"options": options}
        found = self.state.get("options")
        if not (isinstance(found, dict) and options.keys() == found.keys()):
            raise InputError(f"{self._file} is of no demo; give a new folder.")
        if cfg.fresh and self._file.exists():
            shutil.rmtree(cfg.out)
            self.state = {"options": options}
        write_json(self._file, self.state)  # first of all: by it a later call knows what it may continue
        if self.state["options"] != options:
            raise InputError(f"{cfg.out} holds a demo with other options; give fresh=true.")
        self.twin = self._path("twin")
        self.finger, self.gel = self._path("monday" if cfg.quick else "bench/finger"), self._path("bench/gel")

    def run(self) -> DemoResult:
        """All stages, except those that an earlier run finished."""
        titles = stages(self.state["options"], self.cfg.quick)
        for number, (name, title) in enumerate(titles.items(), 1):
            heading = f"{number}/{len(titles)}  {title}"
            if name in self.state:
                self._announce(f"{heading} (done before)")
                continue
            self._announce(heading)
            start, self._commands = time.monotonic(), []
            self._done.clear()
            found = getattr(self, f"_{name}")()
            self.state[name] = {**found, "seconds": time.monotonic() - start, "commands": self._commands}
            write_json(self._file, self.state)
        return DemoResult(self.cfg.out, self.state)

    # ------------------------------------------------------------ stages

    def _bench(self) -> dict:
        rod = "pneutac_truths", "--device=rod", f"--effect={HIDDEN}"
        days = {self.finger: (*rod, "--day=1"), self._path("friday"): (*rod, "--day=2")}
        standin = {self._path("bench"): ("pneutac_datasets.generate", "--device=standin")}
        for folder, module in (days if self.cfg.quick else standin).items():
            shutil.rmtree(folder, ignore_errors=True)
            session = f"--minutes={self.cfg.minutes}", f"--seed={self.cfg.seed}", f"--out={folder}"
            self._command("python", "-m", *module, *session)
        return {}

    def _twin(self) -> dict:
        shutil.rmtree(self.twin, ignore_errors=True)
        self._command("pneutac", "new", f"--twin={self.twin}", f"--recording={self.finger}")
        self._verb("calibrate", self.finger, "calibration")
        if not self.cfg.quick:
            self._verb("calibrate", self.gel, "touch")
        return self._compare("compare")

    def _diagnose(self) -> dict:
        found = self._verb("diagnose", self.finger, "diagnosis")
        if not found["selected"]:
            where = f"{found['verdict']}; see {self._path('diagnosis')}"
            remedy = "Give another seed, or a longer session with more minutes"
            raise InputError(f"The diagnosis found no missing effect ({where}). {remedy}.")
        return {name: found[name] for name in ("selected", "verdict", "sentence")}

    def _add(self) -> dict:
        """All that was found, at once: found together, one alone may not be worth it."""
        before = self._path("before")  # to be found again in the studio
        if not before.exists():
            with whole(before) as part:
                shutil.copytree(self.twin, part)
        if set(Twin.load(self.twin).effects) == set(Twin.load(before).effects):
            self._verb("add", self.finger, "added", f"--from={self._path('diagnosis')}")
        return self._compare("compare_after")

    def _record(self) -> dict:
        """One demonstration by lerobot-record in real time; meanwhile the same robot code records the others.

        These, unpaced, are recorded until they succeed; whether the first did is in its `outcomes.json`.
        """
        cfg, first, rest = self.cfg, self._path("recorded_1"), self._path("recorded_2")
        recorded = self._path("demonstrations")
        for folder in (first, rest, recorded):
            shutil.rmtree(folder, ignore_errors=True)
        paced = (
            "lerobot-record", "--robot.type=pneutac_sim", "--robot.id=demo", "--robot.standin=true",
            f"--robot.twin={self.twin}", f"--robot.task={TASK}", f"--robot.seed={cfg.seed}",
            f"--robot.start_width={START_WIDTH}", "--teleop.type=pneutac_scripted",
            f"--teleop.person={PERSON}", f"--teleop.seed={cfg.seed}",
            f"--dataset.repo_id=local/{first.name}", f"--dataset.root={first}", "--dataset.no_stamp=true",
            f"--dataset.single_task={TASK_TEXT}", f"--dataset.fps={CONTROL_HZ}", "--dataset.num_episodes=1",
            f"--dataset.episode_time_s={FIRST_S}", "--dataset.reset_time_s=0",
            "--dataset.streaming_encoding=true", "--dataset.push_to_hub=false", "--play_sounds=false",
        )  # fmt: skip
        with ThreadPoolExecutor(1) as pool:  # which mostly waits for the clock
            recording = pool.submit(self._command, *paced)
            self._unpaced(rest, cfg.demonstrations - 1)
            recording.result()
        done = read_outcomes(first / "meta").get(0) == DONE
        if done:
            ids, roots = [f"local/{first.name}", f"local/{rest.name}"], [str(first), str(rest)]
            self._command(
                "lerobot-edit-dataset", f"--new_repo_id=local/{recorded.name}", f"--new_root={recorded}",
                "--operation.type=merge", f"--operation.repo_ids={ids}", f"--operation.roots={roots}",
            )  # fmt: skip
        else:
            self._announce("It failed, as some of a person's do, and is left out.")
            self._unpaced(recorded, cfg.demonstrations)
        return {"first_done": done}

    def _unpaced(self, root: Path, episodes: int) -> None:
        from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
        from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
        from lerobot_robot_pneutac.teleoperators.base_teleop import PneutacScriptedConfig
        from lerobot_robot_pneutac.teleoperators.pneutac_scripted import PneutacScripted
        from pneutac_datasets.demonstrations.record import record_episodes

        seed, steps = self.cfg.seed + 1000, TRIAL_S * CONTROL_HZ
        options = {"id": "demo", "task": TASK, "seed": seed, "standin": True, "twin": self.twin}
        robot = PneutacSim(PneutacSimConfig(**options, start_width=START_WIDTH))
        person = PneutacScriptedConfig(id="scripted", seed=seed, episode_steps=steps, person=PERSON)
        name, teleop = f"local/{root.name}", PneutacScripted(person)
        record_episodes(robot, teleop, name, root, episodes, TASK_TEXT, True, self._progress)

    def _augment(self) -> dict:
        source, new = self._path("demonstrations"), self._path("augmented")
        out = self._path("augmentation")
        self._command(
            "pneutac", "augment", f"--dataset.repo_id=local/{source.name}", f"--dataset.root={source}",
            f"--output.repo_id=local/{new.name}", f"--output.root={new}", f"--task={TASK}",
            f"--twin={self.twin}", f"--start_width={START_WIDTH}", f"--episodes={self.cfg.augmented}",
            f"--seed={self.cfg.seed}", f"--out={out}",
        )  # fmt: skip
        result = json.loads((out / "result.json").read_text())
        return {name: result[name] for name in ("kept", "attempts")} | {"recorded": self.cfg.demonstrations}

    def _policies(self) -> dict:
        """The paper's behaviour-cloning policy on what `augment` has mixed, and on the recorded alone."""
        every = max(1, self.cfg.steps // 50)
        with ThreadPoolExecutor(2) as pool:
            augmented = pool.submit(self._policy, "augmented", "", every)
            alone = pool.submit(self._policy, "demonstrations", ALONE, every)
            losses = {"augmented": augmented.result(), "alone": alone.result()}
        success = {}
        for name, end in (("augmented", ""), ("alone", ALONE)):
            (task,) = json.loads((self._path(f"eval{end}") / "eval_info.json").read_text())["per_task"]
            success[name] = [bool(done) for done in task["metrics"]["successes"]]
        return {"log_freq": every, "losses": losses} | success

    def _policy(self, source: str, end: str, every: int) -> list[float]:
        """Trains a policy on a dataset and tries it; returns its training loss, of `every` so many steps."""
        cfg = self.cfg
        data, out, tried = (self._path(f"{name}{end}") for name in ("training", "train", "eval"))
        for folder in (data, out, tried):
            shutil.rmtree(folder, ignore_errors=True)
        # Small images, one row a sample: these cores see ten times the frames in the same time.
        pool = "python", "-m", "pneutac_datasets.demonstrations.pool", f"--out={data}"
        self._command(*pool, str(self._path(source)))
        training = (
            "lerobot-train", "--policy.type=pneutac_bc", "--policy.device=cpu",
            f"--dataset.repo_id=local/{data.name}", f"--dataset.root={data}", f"--output_dir={out}",
            f"--steps={cfg.steps}", f"--batch_size={cfg.batch_size}", f"--seed={cfg.seed}",
            "--policy.previous_action_in_data=true", "--policy.optimizer_lr=1e-3", "--num_workers=0",
            f"--log_freq={every}", "--save_freq=0", "--env_eval_freq=0", "--wandb.enable=false",
        )  # fmt: skip
        printed = self._command(*training, total=cfg.steps // every, pattern=r"\bloss:")
        self._command(
            "lerobot-eval", f"--policy.path={out}/checkpoints/last/pretrained_model",
            "--policy.device=cpu", "--env.type=pneutac_standin", f"--env.task={TASK}",
            f"--env.twin={self.twin}", f"--env.start_width={START_WIDTH}",
            f"--eval.n_episodes={cfg.trials}", "--eval.batch_size=1", f"--seed={cfg.seed + 5000}",
            f"--output_dir={tried}",
        )  # fmt: skip
        return [float(x) for x in re.findall(r"\bloss:([0-9.eE+-]+)", printed)]

    # ------------------------------------------------------------ what the stages share

    def _path(self, name: str) -> Path:
        return self.cfg.out / name

    def _verb(self, verb: str, recording: Path, out: str, *options: str) -> dict:
        """One of our verbs on twin and recording; returns its `result.json`."""
        folder = self._path(out)
        self._command(
            "pneutac", verb, f"--twin={self.twin}", f"--recording={recording}", *options, f"--out={folder}"
        )
        return json.loads((folder / "result.json").read_text())

    def _compare(self, out: str) -> dict:
        other, part = (self._path("friday"), "all") if self.cfg.quick else (self.finger, "heldout")
        result = self._verb("compare", other, out)
        return {"tip_error_mm": result["error"][part], "noise_mm": result["noise_floor"]}

    def _command(self, *command: str, total: int = 0, pattern: str = "") -> str:
        """Runs a command and returns what it printed, also into `logs/`; a match of `pattern` is progress."""
        shown = shlex.join(command)
        self._commands.append(shown)
        self._announce(f"$ {shown}")
        # More threads than cores left over make torch on small batches slower, not faster.
        env = os.environ | {"HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}
        env["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{env['PATH']}"
        number = 1 + self._commands.index(shown)
        log = self._path("logs") / f"{len(self.state):02d}_{number}_{Path(command[0]).name}.log"
        log.parent.mkdir(exist_ok=True)
        lines, done, name = [], 0, " ".join(w for w in command[:2] if not w.startswith("-"))
        pipe = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True, "errors": "replace"}
        with log.open("w", buffering=1) as file, subprocess.Popen(command, env=env, **pipe) as process:
            for line in process.stdout:
                file.write(line)
                lines.append(line)
                if pattern and re.search(pattern, line):
                    done += 1
                elif counted := re.fullmatch(COUNTED, line.rstrip()):
                    done, total = map(int, counted.groups())
                self._done[name][shown] = done, total
                self._progress(name, *map(sum, zip(*self._done[name].values(), strict=True)))
        if process.returncode != 0:
            raise InputError(f"the command above failed; the end of {log} says:\n{''.join(lines[-15:])}")
        return "".join(lines)


def command(cfg: DemoConfig, terminal: Terminal) -> None:
    if not cfg.quick and importlib.util.find_spec("lerobot_robot_pneutac") is None:
        half = "the bench's half is `pneutac demo --quick`"
        raise InputError(f"The whole demo needs LeRobot's half of PneuTac ({INSTALL}); {half}.")
    start = time.monotonic()

    def announce(text: str) -> None:
        terminal.say(text, style="dim" if text.startswith("$") else "bold")

    result = terminal.run(lambda progress: Demo(cfg, announce, progress).run())
    report = result.report(cfg.out)
    terminal.say(f"\n{result.sentence}", style="bold")
    terminal.say(f"Report: {report} ({(time.monotonic() - start) / 60:.1f} minutes)")
    terminal.say("\n  ".join(["Try next:", *result.next_commands]))


FILMS = 3  # starts of which both films are shown


def _another_day(out: Path):
    """Where the tip moves most in the longest trial of another day: measured, and by both twins."""
    from lerobot_pneutac.reports.figures import curves  # plotly

    recording = Recording.load(out / "friday")
    before, after = (compare(Twin.load(out / name), recording) for name in ("before", "twin"))
    rows = max(before.recording.trials().values(), key=lambda r: r.stop - r.start)
    column = int(np.ptp(before.measured[rows, : before.counted], axis=0).argmax())
    shown = (("measured", before.measured, MEASURED), ("before", before.model, BEFORE))
    time_s, shown = before.recording.column("time_s")[rows], (*shown, ("after", after.model, AFTER))
    lines = ((name, time_s, values[rows, column].round(3), colour) for name, values, colour in shown)
    return curves(lines, "time (s)", before.columns[column])


def demonstration_strip(root: Path) -> np.ndarray:
    """Tactile images of the first episode around its strongest contact, side by side, uint8 (H, W, 3)."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset(f"local/{root.name}", root=root, episodes=[0])
    names = dataset.features["observation.state"]["names"]
    states = dataset.hf_dataset["observation.state"]
    area = np.array([float(s[names.index("contact_area.pos")]) for s in states])
    peak = int(area.argmax())
    picks = np.clip(np.linspace(peak - 20, peak + 20, 8).astype(int), 0, len(dataset) - 1)
    images = [dataset[int(i)]["observation.images.tactile"].numpy() for i in picks]
    return (np.concatenate([i.transpose(1, 2, 0) for i in images], axis=1) * 255).round().astype(np.uint8)
