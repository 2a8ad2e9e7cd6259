"""The teleoperator `pneutac_scripted`: a closed-loop expert that sees the simulated world."""

from typing import Any, override

import numpy as np
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim, connected_robot, made_robot
from lerobot_robot_pneutac.teleoperators.base_teleop import BaseTeleop, PneutacScriptedConfig
from pneutac_sim.errors import InputError
from pneutac_sim.features import DEMONSTRATION_S, action_limits, action_names


class PneutacScripted(BaseTeleop):
    """Demonstrates the task on the `pneutac_sim` robot of the same process, once in every scene.

    Between the episodes that LeRobot announces it waits. Where none are announced, the action of a
    demonstration's last tick carries the key `reset`, which the robot takes as the person putting the object
    back and which datasets leave out.
    """

    config_class = PneutacScriptedConfig
    name = "pneutac_scripted"

    def __init__(self, config: PneutacScriptedConfig):
        super().__init__(config)
        self.config = config
        self._rng: np.random.Generator | None = None

    @property
    @override
    def action_features(self) -> dict[str, type]:
        """Those of the simulated robot of this process; of a finger of one chamber where there is none."""
        robot = made_robot()
        return dict.fromkeys(action_names(robot.chambers if robot else 1), float)

    @property
    def is_connected(self) -> bool:
        return self._rng is not None

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Gets ready; the robot may be connected later, but before the first `get_action`.

        Raises InputError: there is no simulated robot.
        """
        if made_robot() is None:
            raise InputError(
                "pneutac_scripted sees the simulated world, and there is no simulated robot here; use"
                " --robot.type=pneutac_sim, or another --teleop.type such as pneutac_keyboard."
            )
        self._rng = np.random.default_rng(self.config.seed)
        self._scene: tuple[PneutacSim, int] | None = None

    @check_if_not_connected
    def get_action(self) -> dict[str, Any]:
        """The expert's action for the world's present state, within the limits.

        Raises InputError: no `pneutac_sim` robot is connected in this process, or it takes bends.
        """
        robot = connected_robot()
        if robot.recording is False:  # waiting is with the pressure off and the arm at rest
            return dict.fromkeys(action_names(robot.chambers), 0.0)
        if self._scene != (scene := (robot, robot.scenes)):
            from pneutac_sim.world.expert import demonstrator

            if robot.config.bend:
                raise InputError("pneutac_scripted gives pressures; leave --robot.bend out.")
            if self.config.drag_mm:
                if not hasattr(robot.world.task, "drag_m"):
                    raise InputError(
                        f"The expert of the task '{robot.world.task.name}' does not drag; leave "
                        "--teleop.drag_mm out, or record the task 'button'."
                    )
                robot.world.task.drag_m = 1e-3 * self.config.drag_mm
            self._expert = demonstrator(robot.world, self._rng, self.config.person)
            self._scene, self._tick = scene, 0
        self._tick += 1
        limits = action_limits(robot.world.pressure_range_kpa, robot.chambers)
        values = np.clip(self._expert.action(), *limits).tolist()
        result: dict[str, Any] = dict(zip(action_names(robot.chambers), values, strict=True))
        if robot.recording is None and self._tick == self.steps(robot):
            result["reset"] = True
        return result

    def steps(self, robot: PneutacSim) -> int:
        """Number of control steps of a demonstration on a robot."""
        return self.config.episode_steps or DEMONSTRATION_S * robot.config.control_hz

    @check_if_not_connected
    def disconnect(self) -> None:
        self._rng = self._expert = self._scene = None
