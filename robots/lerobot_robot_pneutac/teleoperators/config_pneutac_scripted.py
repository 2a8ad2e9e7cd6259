"""Options of the teleoperator `pneutac_scripted`."""

from dataclasses import dataclass

from lerobot.teleoperators import TeleoperatorConfig

from lerobot_robot_pneutac.options import refuse_if

MOST_MM = 20.0  # farther the finger leaves the bar


@TeleoperatorConfig.register_subclass("pneutac_scripted")
@dataclass(kw_only=True)
class PneutacScriptedConfig(TeleoperatorConfig):
    """A scripted expert in place of a person's hand.

    It demonstrates the task once in every episode that LeRobot records, and waits in between.

    Attributes:
        episode_steps: ticks of a demonstration where no episodes are announced, as in `lerobot-teleoperate`;
            where left out, those of 14 s.
        seed: decides the variation between demonstrations.
        drag_mm: how far it drags the finger sideways along what it holds, before it lets go; in `button`
            alone.
    """

    episode_steps: int | None = None
    seed: int = 0
    drag_mm: float = 0.0

    def __post_init__(self):
        refuse_if(
            self.episode_steps is not None and self.episode_steps < 1,
            f"--teleop.episode_steps is {self.episode_steps}; it must be at least 1.",
        )
        refuse_if(
            not 0 <= self.drag_mm <= MOST_MM,
            f"--teleop.drag_mm is {self.drag_mm:g}; it must be between 0 and {MOST_MM:g}.",
        )
