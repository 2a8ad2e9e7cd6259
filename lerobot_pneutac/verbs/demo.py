"""`pneutac demo`: the main job, end to end, on the built-in twin, with LeRobot's own commands.

Calibrates the gel from one pair of tactile images, records scripted switch demonstrations, augments them,
trains `pneutac_bc` with lerobot-train, evaluates it with lerobot-eval and writes a report. Finished stages
are kept, so an interrupted demo goes on where it stopped.
"""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.reports.demo import write_report
from pneutac_sim.errors import InputError
from pneutac_sim.features import DEMONSTRATION_S
from pneutac_sim.surrogate.networks import builtin, fits
from pneutac_sim.twin import Twin

FPS = 15
TASK_TEXT = "flip the switch"


@dataclass
class DemoConfig:
    """Options of `pneutac demo`.

    Attributes:
        out: folder of everything that the demo writes.
        episodes: scripted demonstrations, one of them recorded by lerobot-record itself.
        augmented: further demonstrations made from these without a simulator.
        steps: optimiser steps of lerobot-train.
        batch_size: frames per optimiser step.
        eval_episodes: randomised starts on which the policy is tried.
        seed: decides every random choice.
        fresh: delete an earlier demo in `out` first.
    """

    out: Path = Path("outputs/demo")
    episodes: int = 12
    augmented: int = 16
    steps: int = 4000
    batch_size: int = 16
    eval_episodes: int = 20
    seed: int = 1
    fresh: bool = False

    def __post_init__(self):
        for name in ("episodes", "augmented", "steps", "batch_size", "eval_episodes"):
            least = 2 if name == "episodes" else 1
            if getattr(self, name) < least:
                raise InputError(f"--{name} is {getattr(self, name)}; it must be at least {least}.")


class Demo:
    """One run: its folder, its stages and the commands that it ran."""

    def __init__(self, cfg: DemoConfig):
        self.cfg = cfg
        self.console = Console()
        self.state_file = cfg.out / "state.json"
        if cfg.fresh and self.state_file.exists():
            shutil.rmtree(cfg.out)
        cfg.out.mkdir(parents=True, exist_ok=True)
        options = {k: v for k, v in vars(cfg).items() if k not in ("fresh", "out")}
        self.state = json.loads(self.state_file.read_text()) if self.state_file.exists() else {}
        if self.state.setdefault("options", options) != options:
            raise InputError(f"{cfg.out} holds a demo with other options; add --fresh=true.")

    def path(self, name: str) -> Path:
        """A file or folder of this run."""
        return self.cfg.out / name

    def stage(self, name: str, title: str, function) -> None:
        """Runs `function` unless an earlier run finished this stage; its dict result is kept in the state."""
        if name in self.state:
            self.console.print(f"[dim]done before:[/] {title}")
            return
        self.console.print(f"[bold]{title}[/]")
        start = time.monotonic()
        self._commands: list[str] = []
        result = function() or {}
        self.state[name] = {**result, "seconds": time.monotonic() - start, "commands": self._commands}
        self.state_file.write_text(json.dumps(self.state, indent=2))

    def run(self, command: list[str], log: str, total: int | None = None, pattern: str = "") -> str:
        """Runs one command, its output into `log`; shows a bar that advances with each match of `pattern`.

        Returns:
            the whole output. Raises InputError with the log's tail where the command fails.
        """
        self._commands.append(shlex.join(command))
        self.console.print(f"  [dim]$ {self._commands[-1]}[/]", soft_wrap=True, highlight=False)
        # More threads than cores left over make torch on small batches slower, not faster.
        env = os.environ | {"HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}
        env["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{env['PATH']}"
        lines = []
        columns = (SpinnerColumn(), BarColumn(), TextColumn("{task.completed}/{task.total}"))
        clock = (TimeElapsedColumn(), TimeRemainingColumn())
        with (
            self.path(log).open("w", buffering=1) as file,
            Progress(*columns, *clock, console=self.console, transient=True) as bar,
            subprocess.Popen(
                command,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                env=env,
                errors="replace",
            ) as process,
        ):
            task = bar.add_task("", total=total)
            for line in process.stdout:
                file.write(line)
                lines.append(line)
                if pattern and re.search(pattern, line):
                    bar.advance(task)
        if process.returncode != 0:
            tail = "".join(lines[-15:])
            raise InputError(f"the command above failed; the end of {self.path(log)} says:\n{tail}")
        return "".join(lines)

    def show(self, text: str, lines: int = 18) -> None:
        """Prints the last lines of a command's output."""
        for line in text.rstrip().splitlines()[-lines:]:
            self.console.print(line, highlight=False, soft_wrap=True, markup=False)

    # ------------------------------------------------------------ the stages

    def calibrate(self) -> dict:
        """Twin whose gel comes from one rest and one indentation image."""
        twin = self.path("twin")
        data = os.environ.get("PNEUTAC_DATA")
        real = Path(data) / "tactile" / "digit_nagoya" if data else None
        shutil.rmtree(twin, ignore_errors=True)
        self.run(["pneutac", "new", f"--twin={twin}", "--device=finger"], "new.log")
        command = ["pneutac", "calibrate", f"--twin={twin}", f"--out={self.path('calibration')}"]
        if real and real.is_dir():
            command.append(f"--recording={real}")
        self.show(self.run(command, "calibrate.log"))
        fidelity = "surrogate"
        if fits(builtin("perception"), "perception", Twin.load(twin)):
            self.run(["pneutac", "surrogate", f"--twin={twin}"], "surrogate.log")
        else:
            fidelity = "probe"
            self.console.print(
                "This gel has another size than the one whose network is shipped: the demo goes on without "
                f"networks (fidelity probe); `pneutac surrogate --twin={twin}` would train them."
            )
        return {"real": bool(real and real.is_dir()), "fidelity": fidelity}

    @property
    def fidelity(self) -> str:
        """How finger and gel deform in this demo's world."""
        return self.state["calibrate"]["fidelity"]

    def record(self) -> None:
        """One demonstration by lerobot-record in real time, the others unpaced by the same robot code."""
        from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
        from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
        from lerobot_robot_pneutac.teleoperators.config_pneutac_scripted import PneutacScriptedConfig
        from lerobot_robot_pneutac.teleoperators.pneutac_scripted import PneutacScripted
        from pneutac_datasets.demonstrations.record import record_episodes

        cfg, first, rest = self.cfg, self.path("recorded_1"), self.path("recorded_2")
        merged = self.path("demonstrations")
        for folder in (first, rest, merged):
            shutil.rmtree(folder, ignore_errors=True)
        self.run(
            [
                "lerobot-record",
                "--robot.type=pneutac_sim",
                "--robot.id=twin",
                f"--robot.twin={self.path('twin')}",
                f"--robot.fidelity={self.fidelity}",
                "--robot.task=switch",
                f"--robot.seed={cfg.seed}",
                "--teleop.type=pneutac_scripted",
                f"--teleop.seed={cfg.seed}",
                f"--teleop.episode_steps={DEMONSTRATION_S * FPS}",
                f"--dataset.repo_id=local/{first.name}",
                f"--dataset.root={first}",
                "--dataset.no_stamp=true",
                f"--dataset.single_task={TASK_TEXT}",
                f"--dataset.fps={FPS}",
                "--dataset.num_episodes=1",
                f"--dataset.episode_time_s={DEMONSTRATION_S}",
                "--dataset.reset_time_s=0",
                "--dataset.streaming_encoding=true",
                "--dataset.push_to_hub=false",
                "--play_sounds=false",
            ],
            "record.log",
        )
        robot = PneutacSim(
            PneutacSimConfig(
                id="twin",
                twin=self.path("twin"),
                fidelity=self.fidelity,
                task="switch",
                seed=cfg.seed + 1000,
            )
        )
        teleop = PneutacScripted(
            PneutacScriptedConfig(id="scripted", seed=cfg.seed + 1000, episode_steps=DEMONSTRATION_S * FPS)
        )
        record_episodes(robot, teleop, f"local/{rest.name}", rest, cfg.episodes - 1, TASK_TEXT, True)
        self.run(
            [
                "lerobot-edit-dataset",
                f"--new_repo_id=local/{merged.name}",
                f"--new_root={merged}",
                "--operation.type=merge",
                f"--operation.repo_ids=['local/{first.name}','local/{rest.name}']",
                f"--operation.roots=['{first}','{rest}']",
            ],
            "merge.log",
        )

    def augment(self) -> None:
        """Further demonstrations by time warping, mix-up and jitter."""
        from pneutac_datasets.demonstrations.naive import augment_naive

        cfg, source, out, both = self.cfg, "demonstrations", self.path("augmented"), self.path("training")
        for folder in (out, both):
            shutil.rmtree(folder, ignore_errors=True)
        augment_naive(self.path(source), f"local/{source}", out, "local/augmented", cfg.augmented, cfg.seed)
        self.run(
            [
                "lerobot-edit-dataset",
                "--new_repo_id=local/training",
                f"--new_root={both}",
                "--operation.type=merge",
                f"--operation.repo_ids=['local/{source}','local/augmented']",
                f"--operation.roots=['{self.path(source)}','{out}']",
            ],
            "merge_training.log",
        )

    def train(self) -> dict:
        """The paper's behaviour-cloning policy, by lerobot-train."""
        cfg, out = self.cfg, self.path("train")
        shutil.rmtree(out, ignore_errors=True)
        log = self.run(
            [
                "lerobot-train",
                "--policy.type=pneutac_bc",
                "--policy.device=cpu",
                "--dataset.repo_id=local/training",
                f"--dataset.root={self.path('training')}",
                f"--output_dir={out}",
                f"--steps={cfg.steps}",
                f"--batch_size={cfg.batch_size}",
                f"--seed={cfg.seed}",
                "--num_workers=2",
                f"--log_freq={max(1, cfg.steps // 50)}",
                "--save_freq=0",
                "--env_eval_freq=0",
                "--wandb.enable=false",
            ],
            "train.log",
            total=cfg.steps // max(1, cfg.steps // 50),
            pattern=r"\bloss:",
        )
        losses = [float(x) for x in re.findall(r"\bloss:([0-9.eE+-]+)", log)]
        return {"log_freq": max(1, cfg.steps // 50), "losses": losses}

    def evaluate(self) -> dict:
        """The policy on randomised starts, by lerobot-eval."""
        cfg, out = self.cfg, self.path("eval")
        shutil.rmtree(out, ignore_errors=True)
        self.run(
            [
                "lerobot-eval",
                f"--policy.path={self.path('train')}/checkpoints/last/pretrained_model",
                "--policy.device=cpu",
                "--env.type=pneutac",
                "--env.task=switch",
                f"--env.twin={self.path('twin')}",
                f"--env.fidelity={self.fidelity}",
                f"--eval.n_episodes={cfg.eval_episodes}",
                "--eval.batch_size=1",
                f"--seed={cfg.seed + 5000}",
                f"--output_dir={out}",
            ],
            "eval.log",
        )
        info = json.loads((out / "eval_info.json").read_text())
        return {"success_percent": info["overall"]["pc_success"], "episodes": cfg.eval_episodes}


def main(argv: list[str]) -> None:
    """Runs the demo; returns normally with the report's path and success rate printed."""
    cfg = parse_options(DemoConfig, argv)
    start = time.monotonic()
    demo = Demo(cfg)
    demo.stage("calibrate", "1/5  Calibrate the tactile sensor from two images", demo.calibrate)
    demo.stage("record", f"2/5  Record {cfg.episodes} demonstrations on the twin", demo.record)
    demo.stage("augment", f"3/5  Augment them with {cfg.augmented} more", demo.augment)
    demo.stage("train", "4/5  Train a policy with lerobot-train", demo.train)
    demo.stage("evaluate", "5/5  Evaluate it with lerobot-eval", demo.evaluate)
    report = write_report(cfg.out, demo.state)
    success = demo.state["evaluate"]["success_percent"]
    minutes = (time.monotonic() - start) / 60
    demo.console.print(
        f"The policy flipped the switch in [bold]{success:.0f} %[/] of {cfg.eval_episodes} randomised starts "
        f"({minutes:.1f} minutes). Report: {report}"
    )
