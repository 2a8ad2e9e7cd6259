"""LeRobot's default processing around `pneutac_bc`: batching, device, and no normalisation."""

from lerobot.processor import make_default_pre_post_processors

from lerobot_robot_pneutac.policy.configuration_pneutac_bc import PneutacBCConfig


def make_pneutac_bc_pre_post_processors(config: PneutacBCConfig, dataset_stats: dict | None = None):
    """The pipelines before and after the policy; the statistics are only carried along in its files."""
    return make_default_pre_post_processors(config, dataset_stats, normalizer_device=config.device)
