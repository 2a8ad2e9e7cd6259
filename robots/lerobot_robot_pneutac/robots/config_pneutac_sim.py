"""Options of the robot `pneutac_sim`."""

from dataclasses import dataclass
from pathlib import Path

from lerobot.robots import RobotConfig

from lerobot_robot_pneutac.options import check_choice, check_twin_folder, refuse_if
from pneutac_sim.features import FIDELITIES, TASK_NAMES


@RobotConfig.register_subclass("pneutac_sim")
@dataclass(kw_only=True)
class PneutacSimConfig(RobotConfig):
    """A Panda with the pneumatic finger and its gel, simulated.

    Attributes:
        task: what stands in front of the robot: `switch`, `egg` or `card`.
        seed: decides the random start of every episode.
        twin: folder of the finger's twin; default the built-in one.
        fidelity: how finger and gel deform: `surrogate`, by networks; `mpm`, by full material points;
            `probe`, by formulas.
        standin: act on the stand-in for reality, which has a finger and a gel of its own.
    """

    task: str = "switch"
    seed: int = 0
    twin: Path | None = None
    fidelity: str = "surrogate"
    standin: bool = False

    def __post_init__(self):
        super().__post_init__()
        check_choice("robot.task", self.task, TASK_NAMES)
        check_choice("robot.fidelity", self.fidelity, FIDELITIES)
        check_twin_folder("robot.twin", self.twin)
        refuse_if(
            self.standin and (self.twin is not None or self.fidelity != "surrogate"),
            "--robot.standin=true has a finger and a gel of its own; leave --robot.twin and"
            " --robot.fidelity out, or the stand-in.",
        )
