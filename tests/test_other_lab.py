"""Another lab's finger and task, from its bench to a policy, by commands and without a change here."""

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

from pneutac_datasets.recording.recording import Recording

BIN, DOC = Path(sys.executable).parent, Path(__file__).parents[1] / "docs" / "how_to" / "add_a_task.md"


def package(folder: Path) -> Path:
    """The doorbell of the docs as an installer puts it."""
    (folder / "pneutac_doorbell-0.1.0.dist-info").mkdir(parents=True)
    code, project = (re.search(rf"```{k}\n(.*?)```", DOC.read_text(), re.S)[1] for k in ("python", "toml"))
    (folder / "pneutac_doorbell.py").write_text(code)
    points = tomllib.loads(project)["project"]["entry-points"]["pneutac.tasks"]
    lines = ["[pneutac.tasks]", *(f"{k} = {v}" for k, v in points.items())]
    info = folder / "pneutac_doorbell-0.1.0.dist-info"
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: pneutac-doorbell\nVersion: 0.1.0\n")
    return folder


def bench(folder: Path) -> Path:
    """A finger of 80 mm and six joints that bends by 0.45 rad at 60 kPa."""
    rng = np.random.default_rng(0)
    kpa = np.repeat(np.append([0.0, 59.6], rng.uniform(0, 60, 58)), 20)
    samples = pd.DataFrame(
        {
            "trial": np.repeat(range(4), 300),
            "time_s": np.tile(np.arange(300) / 10, 4),
            "pressure_cmd_kpa": kpa,
            "bend_angle_rad": 0.2 + 0.0075 * kpa + rng.normal(0, 0.005, 1200),
        }
    )
    joints = [80 * (i + 0.5) / 6 for i in range(6)]
    meta = {"device": "finger", "length_mm": 80.0, "spine_joint_positions_mm": joints}
    return Recording(folder, meta, samples, "finger").write(folder)


@pytest.mark.nightly
def test_a_finger_of_60_kpa_and_a_doorbell_go_from_the_bench_to_a_policy(tmp_path):
    env = os.environ | {"PYTHONPATH": str(package(tmp_path / "site")), "OMP_NUM_THREADS": "1"}
    env |= {"HF_HOME": str(tmp_path / "hf"), "HF_HUB_OFFLINE": "1"}

    def run(command: str) -> str:
        name, *options = command.split()
        done = subprocess.run([BIN / name, *options], cwd=tmp_path, env=env, text=True, capture_output=True)
        assert done.returncode == 0, f"{command}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
        return " ".join(done.stdout.split())

    bench(tmp_path / "bench")
    assert "measured from 0 to 60 kPa" in run("pneutac new --twin=twin --recording=bench")
    run("pneutac calibrate --twin=twin --recording=bench")
    run("pneutac check bench twin")
    finger = "twin=twin {0}.fidelity=probe {0}.task=doorbell"
    run(
        f"lerobot-record --robot.type=pneutac_sim --robot.id=lab --robot.{finger.format('--robot')}"
        " --teleop.type=pneutac_scripted --dataset.repo_id=local/bell --dataset.root=demos"
        " --dataset.no_stamp=true --dataset.fps=15 --dataset.single_task=ring --dataset.num_episodes=2"
        " --dataset.episode_time_s=14 --teleop.reset_steps=15"
        " --dataset.reset_time_s=1 --dataset.video=false --dataset.push_to_hub=false --play_sounds=false"
    )
    stats = json.loads((tmp_path / "demos" / "meta" / "stats.json").read_text())
    assert 15 < stats["action"]["max"][3] <= 60
    assert "demonstrations): good" in run("pneutac check demos --twin=twin")
    run(
        "lerobot-train --policy.type=pneutac_bc --policy.device=cpu --dataset.repo_id=local/bell"
        " --dataset.root=demos --output_dir=policy --steps=150 --batch_size=16 --num_workers=0"
        " --save_freq=0 --env_eval_freq=0 --wandb.enable=false"
    )
    run(
        "lerobot-eval --policy.path=policy/checkpoints/last/pretrained_model --policy.device=cpu"
        f" --env.type=pneutac --env.{finger.format('--env')} --env.episode_length=90"
        " --eval.n_episodes=3 --eval.batch_size=1 --output_dir=eval"
    )
    result = json.loads((tmp_path / "eval" / "eval_info.json").read_text())
    assert result["overall"]["pc_success"] > 50  # 100 when it was written
