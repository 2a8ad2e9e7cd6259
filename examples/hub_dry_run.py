"""A dataset and a policy in folders that can be pushed to the Hub as they are: `make hub-dry-run`.

By default so small that the policy is poor: `--episodes=100 --steps=8000` for a better one.
"""

import argparse
import shutil
import subprocess
import sys
from pathlib import Path

from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
from lerobot_robot_pneutac.teleoperators.base_teleop import PneutacScriptedConfig
from lerobot_robot_pneutac.teleoperators.pneutac_scripted import PneutacScripted
from pneutac_datasets.demonstrations.card import write_card
from pneutac_datasets.demonstrations.record import SIMULATED, record_episodes

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--name", default="you/pneutac_switch", help="of dataset and policy on the Hub")
parser.add_argument("--licence", default="apache-2.0")
parser.add_argument("--episodes", type=int, default=5)
parser.add_argument("--steps", type=int, default=200)
options = parser.parse_args()

out = Path("outputs/hub")
dataset, policy, training = out / "dataset", out / "policy", out / "training"
if out.exists():
    sys.exit(f"{out} exists; move or delete it first.")
out.mkdir(parents=True)

robot = PneutacSim(PneutacSimConfig(id="hub", task="switch", seed=1))
teleop = PneutacScripted(PneutacScriptedConfig(id="hub", seed=1))
record_episodes(robot, teleop, options.name, dataset, options.episodes, "Flip the toggle switch.", True)
write_card(dataset, options.licence, SIMULATED)

train = f"""--policy.type=pneutac_bc --policy.device=cpu --policy.push_to_hub=false
 --policy.license={options.licence} --dataset.repo_id={options.name} --dataset.root={dataset}
 --output_dir={training} --steps={options.steps} --batch_size=16 --num_workers=0 --save_freq=0
 --env_eval_freq=0 --wandb.enable=false"""
subprocess.run([sys.executable, "-m", "lerobot.scripts.lerobot_train", *train.split()], check=True)
shutil.copytree(training / "checkpoints" / "last" / "pretrained_model", policy)
shutil.rmtree(training)

print(f"{out} has what these commands would push:")
print(f"hf upload {options.name} {dataset} --repo-type=dataset")
print(f"hf upload {options.name}_policy {policy}")
