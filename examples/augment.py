"""Demonstrations from demonstrations: two are recorded, four more are made from them, elsewhere."""

from pathlib import Path

from lerobot_pneutac.verbs.augment import AugmentConfig, DatasetRef, augment
from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
from lerobot_robot_pneutac.teleoperators.base_teleop import PneutacScriptedConfig
from lerobot_robot_pneutac.teleoperators.pneutac_scripted import PneutacScripted
from pneutac_datasets.demonstrations.record import record_episodes

if __name__ == "__main__":  # workers import this file
    robot = PneutacSim(PneutacSimConfig(id="twin", task="switch"))
    operator = PneutacScripted(PneutacScriptedConfig(episode_steps=300))
    demos = Path("outputs/augment/demos")
    record_episodes(robot, operator, "local/demos", demos, 2, "flip the switch", use_videos=False)

    config = AugmentConfig(
        dataset=DatasetRef("local/demos", demos),
        output=DatasetRef("local/more", Path("outputs/augment/more")),
        task="switch",
        episodes=4,
    )
    result = augment(config, lambda text, done, total: print(f"{text}: {done} of {total}"))
    print(f"kept {result.share:.0%} of the variants")
