"""Options of the robot `pneutac_sim`."""

from dataclasses import dataclass
from pathlib import Path

from draccus.utils import DecodingError
from lerobot.robots import RobotConfig

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
        # LeRobot's commands print a DecodingError as one line and hide any other error's text.
        super().__post_init__()
        if self.task not in TASK_NAMES:
            raise DecodingError(
                (), f"--robot.task is '{self.task}'; it must be one of {', '.join(TASK_NAMES)}."
            )
        if self.fidelity not in FIDELITIES:
            raise DecodingError(
                (), f"--robot.fidelity is '{self.fidelity}'; it must be one of {', '.join(FIDELITIES)}."
            )
        if self.twin is not None and not (Path(self.twin) / "twin.yaml").is_file():
            raise DecodingError(
                (), f"--robot.twin is '{self.twin}', which holds no twin.yaml; give a twin's folder."
            )
        if self.standin and (self.twin is not None or self.fidelity != "surrogate"):
            raise DecodingError(
                (),
                "--robot.standin=true has a finger and a gel of its own; leave --robot.twin and"
                " --robot.fidelity out, or the stand-in.",
            )
