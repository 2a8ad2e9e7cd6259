"""`pneutac benchmark rates`: whether LeRobot's commands hold their rate on the stand-in, by the clock."""

import importlib.util
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

from pneutac_sim.errors import InputError, check_between, check_least
from pneutac_sim.features import RATES_HZ

COMMANDS = ("record", "record_streaming", "replay", "rollout", "remote")
START_S = 180  # in which a command has begun, imports included
# As robots log it: of a run without episodes, and of a recorded one.
RATE = re.compile(r"(?:actions came|ran) at ([\d.]+) Hz.*?\((\d+) late, the longest pause ([\d.]+) s\)")
STANDIN = ("--robot.type=pneutac_sim", "--robot.standin=true", "--robot.task=card")
DRY = (
    "--robot.type=pneutac",
    "--robot.arm.type=simulated",
    "--robot.pressure.type=simulated",
    "--robot.digit.type=digit_generated",
)
ROBOTS = {"standin": STANDIN, "dry": DRY}


@dataclass
class BenchmarkRatesConfig:
    """Options of `pneutac benchmark rates`.

    Attributes:
        hz: control rates.
        commands: of `record` (PNG files), `record_streaming` (video, encoded meanwhile), `replay`, `rollout`
            and `remote` (LeRobot's policy server and robot client).
        robot: `standin`, or `dry`: the real robot's code with simulated parts, which cannot be recorded.
        seconds: of a run.
        runs: of each command at each rate.
        out: folder for `result.json` and what the commands print.
    """

    hz: list[int] = field(default_factory=lambda: [15, 30, 60])
    commands: list[str] = field(default_factory=lambda: list(COMMANDS))
    robot: str = "standin"
    seconds: int = 20
    runs: int = 1
    out: Path = Path("outputs/rates")

    def __post_init__(self):
        check_least(1, runs=self.runs, seconds=self.seconds - 1)
        for hz in self.hz or (0,):
            check_between(*RATES_HZ, "Hz", hz=hz)
        if unknown := [c for c in self.commands if c not in COMMANDS]:
            raise InputError(f"commands has {', '.join(unknown)}; there are {', '.join(COMMANDS)}.")
        if "remote" in self.commands and importlib.util.find_spec("grpc") is None:
            raise InputError(
                "commands has remote, which needs gRPC; pip install 'lerobot[async]', or give"
                ' --commands="[record,record_streaming,replay,rollout]".'
            )
        if self.robot not in ROBOTS:
            raise InputError(f"robot is '{self.robot}'; give one of {', '.join(ROBOTS)}.")
        if self.robot == "dry" and any(c.startswith("record") for c in self.commands):
            raise InputError(
                'robot is dry, which nobody teleoperates; give --commands="[replay,rollout,remote]".'
            )


class Rates:
    """Commands at one control rate, in a folder with a demonstration and two untrained policies.

    Args:
        folder: is emptied.
        hz: control rate.
        config: of the benchmark.
    """

    def __init__(self, folder: Path, hz: int, config: BenchmarkRatesConfig):
        self._folder, self._hz, self._seconds = folder.resolve(), hz, config.seconds
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        station = self._folder / "station.yaml"
        station.write_text(f"format: pneutac-station/1\ncontrol_hz: {hz}\n")
        self._robot = (
            *ROBOTS[config.robot],
            f"--robot.station={station}",
            "--robot.id=rates",
            f"--robot.calibration_dir={self._folder}",
        )
        self._demos = ("--dataset.repo_id=local/demos", f"--dataset.root={self._folder / 'demos'}")
        _prepare(self._folder)

    def record(self, *images: str) -> str:
        """What lerobot-record prints; by default its frames are PNG files, as on the tutorial's page."""
        root = Path(tempfile.mkdtemp(dir=self._folder)) / "recorded"
        return self._run(
            "lerobot_record",
            "--teleop.type=pneutac_scripted",
            "--dataset.repo_id=local/recorded",
            f"--dataset.root={root}",
            "--dataset.no_stamp=true",
            "--dataset.single_task=swipe the card",
            f"--dataset.fps={self._hz}",
            "--dataset.num_episodes=1",
            f"--dataset.episode_time_s={self._seconds}",
            "--dataset.reset_time_s=0",
            "--dataset.push_to_hub=false",
            "--play_sounds=false",
            *(images or ("--dataset.video=false",)),
        )

    def record_streaming(self) -> str:
        """The same with images that one thread encodes to video during the episode."""
        return self.record("--dataset.streaming_encoding=true", "--dataset.encoder_threads=1")

    def replay(self) -> str:
        """What lerobot-replay prints."""
        return self._run("lerobot_replay", *self._demos, "--dataset.episode=0", "--play_sounds=false")

    def rollout(self) -> str:
        """What lerobot-rollout prints, with `pneutac_bc`."""
        return self._run(
            "lerobot_rollout",
            "--strategy.type=base",
            "--device=cpu",
            f"--fps={self._hz}",
            f"--duration={self._seconds}",
            "--task=swipe the card",
            f"--policy.path={self._folder / 'pneutac_bc'}",
            "--play_sounds=false",
        )

    def remote(self) -> str:
        """What LeRobot's robot client prints, with ACT on a policy server of the same computer."""
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        where = ("--host=127.0.0.1", f"--port={port}", f"--fps={self._hz}")
        server, _ = self._start("async_inference.policy_server", *where)
        try:
            _wait(server, lambda: _answers(port), "the policy server")
            client, output = self._start(
                "async_inference.robot_client",
                *self._robot,
                f"--server_address=127.0.0.1:{port}",
                "--policy_type=act",
                f"--pretrained_name_or_path={self._folder / 'act'}",
                "--actions_per_chunk=30",
                f"--fps={self._hz}",
                "--task=swipe the card",
            )
            _wait(client, lambda: "Action receiving thread" in output.read_text(), "the robot client")
            time.sleep(self._seconds)
            client.send_signal(signal.SIGINT)  # as Ctrl-C, by which it ends
            client.wait(START_S)
        finally:
            server.kill()
            server.wait()
        return output.read_text()

    def _run(self, script: str, *options: str) -> str:
        process, output = self._start(f"scripts.{script}", *self._robot, *options)
        if process.wait() != 0:
            raise InputError(f"{script} failed; {output} has what it printed.")
        return output.read_text()

    def _start(self, module: str, *options: str) -> tuple[subprocess.Popen, Path]:
        file, name = tempfile.mkstemp(".txt", module.rpartition(".")[2] + "_", self._folder)
        environment = os.environ | {"HF_HUB_OFFLINE": "1"}
        command = [sys.executable, "-m", f"lerobot.{module}", *options]
        with os.fdopen(file, "w") as out:
            process = subprocess.Popen(command, stdout=out, stderr=out, cwd=self._folder, env=environment)
        return process, Path(name)


def _answers(port: int) -> bool:
    with socket.socket() as caller:
        return caller.connect_ex(("127.0.0.1", port)) == 0


def _wait(process: subprocess.Popen, ready, what: str) -> None:
    until = time.monotonic() + START_S
    while not ready():
        if process.poll() is not None or time.monotonic() > until:
            process.kill()
            raise InputError(f"{what} did not start; the folder of --out has what it printed.")
        time.sleep(0.2)


def _prepare(folder: Path) -> None:
    """A demonstration, and policies with random weights: `pneutac_bc`, and ACT with a chunk of 30."""
    from lerobot.datasets import LeRobotDatasetMetadata
    from lerobot.policies import make_policy, make_pre_post_processors
    from lerobot.policies.act.configuration_act import ACTConfig

    from lerobot_robot_pneutac.policy.configuration_pneutac_bc import PneutacBCConfig
    from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
    from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
    from lerobot_robot_pneutac.teleoperators.base_teleop import PneutacScriptedConfig
    from lerobot_robot_pneutac.teleoperators.pneutac_scripted import PneutacScripted
    from pneutac_datasets.demonstrations.record import record_episodes

    own = {"calibration_dir": folder}
    scene = {"task": "card", "standin": True, "seed": 1, "station": folder / "station.yaml"}
    robot = PneutacSim(PneutacSimConfig(id="rates", **scene, **own))
    teleop = PneutacScripted(PneutacScriptedConfig(id="rates", seed=1, **own))
    record_episodes(robot, teleop, "local/demos", folder / "demos", 1, "swipe the card", False)
    meta = LeRobotDatasetMetadata("local/demos", folder / "demos")
    act = {"chunk_size": 30, "n_action_steps": 30, "pretrained_backbone_weights": None}
    for name, config in (
        ("pneutac_bc", PneutacBCConfig(device="cpu", push_to_hub=False)),
        ("act", ACTConfig(device="cpu", push_to_hub=False, **act)),
    ):
        policy = make_policy(config, ds_meta=meta)
        policy.save_pretrained(folder / name)
        for processor in make_pre_post_processors(policy.config, dataset_stats=meta.stats):
            processor.save_pretrained(folder / name)


def benchmark_rates(config: BenchmarkRatesConfig) -> None:
    """Runs every command at every rate; prints and writes a table."""
    from rich.console import Console
    from rich.markdown import Markdown

    from lerobot_pneutac.reports.page import write_result
    from pneutac_benchmarks.tables import markdown

    console, rows = Console(), []
    for hz in config.hz:
        rates = Rates(config.out / f"{hz}_hz", hz, config)
        for command in config.commands:
            for run in range(config.runs):
                found = RATE.findall(getattr(rates, command)())
                if not found:
                    raise InputError(f"{command} at {hz} Hz ran for less than a second; see {config.out}.")
                achieved, late, longest = found[-1]
                row = {"command": command, "hz": hz, "run": run, "achieved_hz": float(achieved)}
                rows.append(row | {"late": int(late), "longest_s": float(longest)})
                console.print(rows[-1])
    cores = len(os.sched_getaffinity(0))
    text = markdown(
        ("command", "Hz", "reached, Hz", "off", "late", "longest pause, s"),
        [
            (
                r["command"],
                str(r["hz"]),
                f"{r['achieved_hz']:.2f}",
                f"{r['achieved_hz'] / r['hz'] - 1:+.1%}",
                str(r["late"]),
                f"{r['longest_s']:.2f}",
            )
            for r in rows
        ],
    )
    console.print(Markdown("\n".join([f"{config.robot}, {cores} cores.", "", *text])))
    write_result(config.out, {"robot": config.robot, "cores": cores, "seconds": config.seconds, "rows": rows})
