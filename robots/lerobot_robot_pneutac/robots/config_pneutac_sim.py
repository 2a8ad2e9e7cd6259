"""Options of the robot `pneutac_sim`."""

from dataclasses import dataclass, field
from pathlib import Path

from lerobot.cameras import CameraConfig
from lerobot.robots import RobotConfig

from lerobot_robot_pneutac import options
from lerobot_robot_pneutac.options import refuse_if, station_of
from pneutac_sim.features import task_names

MOST_STARTS = 10_000  # each is simulated before the first episode


@RobotConfig.register_subclass("pneutac_sim")
@dataclass(kw_only=True)
class PneutacSimConfig(options.WorldOptions, options.SceneOptions, RobotConfig):
    """An arm, a Panda where no station names another, with the pneumatic finger and its gel, simulated."""

    # what stands in front: `switch`, `egg`, `card`, `fruit`, `cable`, `button`, or your own
    task: str = "switch"
    seed: int = 0  # decides the random start of every episode
    # folder of the finger's twin, or of an arm's of several chambers; default the built-in finger's. On the
    # stand-in, as on the real robot, only its gel's contact threshold and the size of its images are used.
    twin: Path | None = None
    standin: bool = False  # act on the stand-in for reality, which has a finger and a gel of its own
    # number of random starts that the demonstrations are to stand for: each episode begins at that one of
    # them which leaves the others nearest to a start that was done, as a person would spread a few
    # demonstrations; 0 takes random starts as they come
    spread: int = 0
    # actions command the finger's bend, `bend.pos` in rad, in place of the pressure; the twin finds the
    # pressure for it. On the stand-in it takes the twin that was calibrated to it.
    bend: bool = False
    # scene cameras, such as {front: {type: pneutac_scene, width: 320, height: 240}}
    cameras: dict[str, CameraConfig] = field(default_factory=dict)

    @property
    def joints(self) -> int:
        return self._where.joints

    @property
    def chambers(self) -> int:
        """Chambers of the finger; of the stand-in's own, one."""
        return 1 if self.standin else options.chambers_of("robot.twin", self.twin)

    @property
    def control_hz(self) -> int:
        return self._where.control_hz

    def __post_init__(self):
        super().__post_init__()
        options.check_choice("robot.task", self.task, task_names())
        refuse_if(
            self.standin
            and (self.fidelity, self.conditions, self.render, self.pressure_range_kpa)
            != ("surrogate", {}, "mesh", None),
            "--robot.standin=true has a finger and a gel of its own; leave --robot.fidelity,"
            " --robot.conditions, --robot.render and --robot.pressure_range_kpa out, or the stand-in.",
        )
        refuse_if(
            self.bend and self.standin and self.twin is None,
            "--robot.bend=true on the stand-in needs --robot.twin, the twin that was calibrated to it.",
        )
        if not self.standin:
            options.check_world("robot", self)
        else:  # of whose twin the sensor alone counts
            options.check_twin_folder("robot.twin", self.twin)
        if self.bend:
            options.check_finger("robot", self.twin, self.conditions)
            options.check_bend("robot", self.twin)
        options.check_range("--robot.seed", self.seed, 0)
        options.check_range("--robot.spread", self.spread, 0, MOST_STARTS)
        options.check_station("robot.station", self.station)
        self._where = station_of(self.station)
        for name, camera in self.cameras.items():
            refuse_if(
                camera.type != "pneutac_scene" or camera.fps not in (0, self.control_hz),
                f"--robot.cameras: '{name}' is of type {camera.type} at {camera.fps} fps; the simulated robot"
                f" has cameras of type pneutac_scene at {self.control_hz} fps.",
            )
        options.check_scene("robot", self.start_width, self.sizes)

    @property
    def sizes(self) -> dict[str, tuple[int, int]]:
        """Height and width of each camera's picture, px."""
        return {name: (int(c.height or 0), int(c.width or 0)) for name, c in self.cameras.items()}
