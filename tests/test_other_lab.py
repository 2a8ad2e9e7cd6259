"""Another lab's finger, arm, sensor and task, from its bench to a policy, without a change here."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from installed import install

from pneutac_datasets.generate.gel import write_presses
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.features import AREA
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.probe import SPHERE
from pneutac_truths.light import Gel, reach_below

BIN, DOC = Path(sys.executable).parent, Path(__file__).parents[1] / "docs" / "how_to" / "add_a_task.md"


def package(folder: Path) -> Path:
    """The doorbell of the docs as an installer puts it."""
    code, project = (re.search(rf"```{k}\n(.*?)```", DOC.read_text(), re.S)[1] for k in ("python", "toml"))
    points = tomllib.loads(project)["project"]["entry-points"]["pneutac.tasks"]
    install(folder, "pneutac_doorbell", "tasks", points, code)
    return folder


def bench(folder: Path) -> Path:
    """A finger of 80 mm and six joints that bends by 0.45 rad at 60 kPa."""
    rng = np.random.default_rng(0)
    kpa = np.repeat(np.append([0.0, 59.6], rng.uniform(0, 60, 58)), 20)
    samples = {"trial": np.repeat(range(4), 300), "time_s": np.tile(np.arange(300) / 10, 4)}
    samples |= {"pressure_cmd_kpa": kpa, "bend_angle_rad": 0.2 + 0.0075 * kpa + rng.normal(0, 0.005, 1200)}
    joints = [80 * (i + 0.5) / 6 for i in range(6)]
    meta = {"device": "finger", "length_mm": 80.0, "spine_joint_positions_mm": joints}
    return Recording(folder, meta, pd.DataFrame(samples), "finger").write(folder)


def sensor(folder: Path) -> Path:
    """Balls of 3 mm pressed into a gel of 18.6 x 14 mm under a camera of 640 x 480 px."""
    window_mm, rng, photographs = (18.6, 13.95), np.random.default_rng(0), []
    gel = Gel((480, 640, 3), window_mm, modulus_kpa=120.0, dome_mm=60.0)
    for i in range(4):
        x, y, depth = (0.5, -0.4, 0.8) if i == 0 else rng.uniform((-6, -4, 0.4), (6, 4, 1.0))
        ball = [SPHERE], [[3.0, 0.0, 0.0]]
        touches = reach_below(*ball, np.array([x, y, 3.0]), np.eye(3), gel.xs_mm, gel.ys_mm) + gel.rest_mm
        moved, _ = gel.press(*ball, np.array([x, y, 3.0 - depth + touches.max()]), np.eye(3))
        image = gel.image(moved) + rng.normal(0, 1.5, gel.rest_image.shape)
        photographs.append((Press("sphere", 3.0, x, y, depth), image, {}))
    write_presses(folder, gel.rest_image, photographs, 640 / window_mm[0], "")
    return folder


def station(folder: Path) -> Path:
    """An arm of six joints in a URDF, and the file that says how it stands."""
    joints, parent, up = "", "base", 0.0
    for i, (axis, length) in enumerate(
        [("0 0 1", 0.35), ("0 1 0", 0.4), ("0 1 0", 0.2), ("0 0 1", 0.2), ("0 1 0", 0.0), ("0 0 1", 0.1)], 1
    ):
        joints += (
            f'<link name="l{i}"/><joint name="j{i}" type="revolute"><parent link="{parent}"/>'
            f'<child link="l{i}"/><origin xyz="0 0 {up}"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" effort="50" velocity="3"/></joint>'
        )
        parent, up = f"l{i}", length
    (folder / "lab6.urdf").write_text(
        f'<robot name="lab6"><link name="base"/>{joints}<link name="tool"/><joint name="tool" type="fixed">'
        f'<parent link="l6"/><child link="tool"/><origin xyz="0 0 {up}"/></joint></robot>'
    )
    file = folder / "station.yaml"
    arm = "{urdf: lab6.urdf, flange: tool, home_rad: [0, 0.491, 1.938, 0, 0.7126, 0]}"
    file.write_text(f"format: pneutac-station/1\narm: {arm}\n")
    return file


def facts(root: Path) -> dict:
    """`info.json` of a dataset."""
    return json.loads((root / "meta" / "info.json").read_text())


@pytest.mark.nightly
@pytest.mark.timeout(2400)  # busy cores; the augmentation takes most of it
def test_a_finger_of_60_kpa_an_arm_a_sensor_and_a_doorbell_go_from_the_bench_to_a_policy(tmp_path):
    env = os.environ | {"PYTHONPATH": str(package(tmp_path / "site")), "OMP_NUM_THREADS": "1"}
    env |= {"HF_HOME": str(tmp_path / "hf"), "HF_HUB_OFFLINE": "1"}

    def run(command: str) -> str:
        name, *options = command.split()
        done = subprocess.run([BIN / name, *options], cwd=tmp_path, env=env, text=True, capture_output=True)
        assert done.returncode == 0, f"{command}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
        return " ".join(done.stdout.split())

    bench(tmp_path / "bench")
    sensor(tmp_path / "gel")
    station(tmp_path)
    assert "recording goes from 0 to 60 kPa" in run("pneutac new --twin=twin --recording=bench")
    run("pneutac calibrate --twin=twin --recording=bench")
    run("pneutac calibrate --twin=twin --recording=gel")
    run("pneutac check bench gel twin")
    assert "station.yaml (station): good" in run("pneutac check station.yaml --twin=twin")
    finger = "twin=twin {0}.station=station.yaml {0}.fidelity=probe {0}.task=doorbell"
    robot = f"--robot.type=pneutac_sim --robot.id=lab --robot.{finger.format('--robot')}"
    kept = (
        "--dataset.no_stamp=true --dataset.fps=15 --dataset.reset_time_s=1 --dataset.video=false"
        " --dataset.push_to_hub=false --play_sounds=false"
    )
    record = f"lerobot-record {robot} --teleop.type=pneutac_scripted {kept}"
    record += " --dataset.episode_time_s=10 --dataset.single_task=ring"
    run(f"{record} --dataset.repo_id=local/bell --dataset.root=demos --dataset.num_episodes=2")
    run(
        f"{record} --dataset.repo_id=local/bells --dataset.root=further --dataset.num_episodes=8"
        " --robot.seed=1 --teleop.seed=1"
    )
    stats = json.loads((tmp_path / "demos" / "meta" / "stats.json").read_text())
    assert 15 < stats["action"]["max"][3] <= 60
    features = facts(tmp_path / "demos")["features"]
    assert features["observation.images.tactile"]["shape"] == [480, 640, 3]
    assert features["observation.state"]["shape"] == [18]  # six joints
    assert "demonstrations): good" in run("pneutac check demos --twin=twin")
    run(
        "pneutac augment --dataset.repo_id=local/bell --dataset.root=demos --output.repo_id=local/more"
        " --output.root=more --task=doorbell --twin=twin --station=station.yaml --fidelity=probe --episodes=2"
    )
    assert facts(tmp_path / "more")["total_episodes"] == 2
    run(
        "lerobot-edit-dataset --new_repo_id=local/all --new_root=all --operation.type=merge"
        " --operation.repo_ids=['local/bell','local/bells'] --operation.roots=['demos','further']"
    )
    assert facts(tmp_path / "all")["total_episodes"] == 10
    # LeRobot merges no dataset that states how late a person answers with one that does not
    run("python -m pneutac_datasets.demonstrations.pool --out=small demos further more")
    run(
        "lerobot-train --policy.type=pneutac_bc --policy.device=cpu --policy.previous_action_in_data=true"
        " --dataset.repo_id=local/small --dataset.root=small --output_dir=policy --steps=800 --batch_size=32"
        " --num_workers=0 --save_freq=0 --env_eval_freq=0 --wandb.enable=false"
    )
    policy = "--policy.path=policy/checkpoints/last/pretrained_model"
    run(
        f"lerobot-eval {policy} --policy.device=cpu --env.type=pneutac --env.{finger.format('--env')}"
        " --eval.n_episodes=10 --eval.batch_size=2 --output_dir=eval"
    )
    overall = json.loads((tmp_path / "eval" / "eval_info.json").read_text())["overall"]
    assert overall["n_episodes"] == 10
    assert overall["pc_success"] >= 60
    run(
        f"lerobot-rollout {policy} --strategy.type=episodic --device=cpu --fps=15 --task=ring {robot}"
        " --dataset.repo_id=local/rollout_bell --dataset.root=rollout --dataset.num_episodes=1"
        f" --dataset.episode_time_s=10 {kept}"
    )
    assert facts(tmp_path / "rollout")["features"] == features
    stats = json.loads((tmp_path / "rollout" / "meta" / "stats.json").read_text())
    assert (
        stats["action"]["max"][3] > 15 and stats["observation.state"]["max"][AREA] > 0
    )  # it has felt the bell
