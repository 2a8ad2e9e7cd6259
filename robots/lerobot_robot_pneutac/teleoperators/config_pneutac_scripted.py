"""Options of the teleoperator `pneutac_scripted`."""

from dataclasses import dataclass

from lerobot.teleoperators import TeleoperatorConfig

from lerobot_robot_pneutac.options import refuse_if


@TeleoperatorConfig.register_subclass("pneutac_scripted")
@dataclass(kw_only=True)
class PneutacScriptedConfig(TeleoperatorConfig):
    """A scripted expert in place of a person's hand.

    LeRobot tells a teleoperator nothing of episodes, so it counts its ticks: `episode_steps` of
    demonstration, then `reset_steps` of waiting. The defaults fit `--dataset.episode_time_s=14
    --dataset.reset_time_s=0`, at the robot's control rate; on a busy computer take 15 reset steps and
    `--dataset.reset_time_s=1`: ticks that are missed are then counted by the clock.

    Attributes:
        episode_steps: ticks of a demonstration, `episode_time_s * fps`; where left out, those of 14 s.
        reset_steps: ticks between demonstrations, `reset_time_s * fps`.
        seed: decides the variation between demonstrations.
    """

    episode_steps: int | None = None
    reset_steps: int = 0
    seed: int = 0

    def __post_init__(self):
        refuse_if(
            (self.episode_steps is not None and self.episode_steps < 1) or self.reset_steps < 0,
            f"--teleop.episode_steps is {self.episode_steps} and --teleop.reset_steps {self.reset_steps};"
            " the first must be at least 1 and the second at least 0.",
        )
