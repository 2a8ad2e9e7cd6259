"""PneuTac's tasks for LeRobot's EnvHub: upload this folder, and `lerobot.envs.make_env("you/name")` finds it.

The package must be installed where it runs. Change what stands here to publish tasks or a finger of your own.
"""

from lerobot_robot_pneutac.env import PneutacEnvConfig

TASKS = ("switch",)  # of `pneutac_sim.features.task_names()`; one environment each
SHARED = (
    "episode_length",
    "cameras",
    "observation_height",
    "observation_width",
    "randomise_look",
    "tactile_points",
)


def make_env(n_envs: int = 1, use_async_envs: bool = False, cfg=None) -> dict:
    """The environments as LeRobot's evaluation takes them, `{"pneutac": {task number: vector environment}}`.

    A sub-environment that is done starts again in the same step, and its last `info` is in `final_info`.

    Args:
        n_envs: sub-environments of each.
        use_async_envs: each in a process of its own.
        cfg: options such as those of `--env.type=pneutac_hub`; None for what stands here.
    """
    kwargs = {} if cfg is None else {k: getattr(cfg, k) for k in SHARED}
    tasks = TASKS if cfg is None or cfg.task is None else (cfg.task,)
    made = (PneutacEnvConfig(task=task, **kwargs).create_envs(n_envs, use_async_envs) for task in tasks)
    return {"pneutac": {number: each["pneutac"][0] for number, each in enumerate(made)}}
