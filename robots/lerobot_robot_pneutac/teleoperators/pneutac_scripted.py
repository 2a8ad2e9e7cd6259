"""The teleoperator `pneutac_scripted`: a closed-loop expert that sees the simulated world."""

import time
from typing import Any

import numpy as np
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim, connected_robot, need_simulated_robot
from lerobot_robot_pneutac.teleoperators.base_teleop import BaseTeleop
from lerobot_robot_pneutac.teleoperators.config_pneutac_scripted import PneutacScriptedConfig
from pneutac_sim.errors import InputError
from pneutac_sim.features import ACTION_NAMES, DEMONSTRATION_S, action_limits

clock = time.perf_counter


class PneutacScripted(BaseTeleop):
    """Demonstrates the task on the `pneutac_sim` robot of the same process.

    After `episode_steps` ticks and half of the `reset_steps` its action carries the key `reset`, which the
    robot takes as the person putting the object back and which datasets leave out. Where there are
    `reset_steps`, ticks that a busy computer misses are counted by the clock.
    """

    config_class = PneutacScriptedConfig
    name = "pneutac_scripted"

    def __init__(self, config: PneutacScriptedConfig):
        super().__init__(config)
        self.config = config
        self._rng: np.random.Generator | None = None

    @property
    def is_connected(self) -> bool:
        """Whether `connect` was called."""
        return self._rng is not None

    def connect(self, calibrate: bool = True) -> None:
        """Gets ready; the robot may be connected later, but before the first `get_action`.

        Raises:
            InputError: there is no simulated robot.
        """
        need_simulated_robot()
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f"{self} is already connected.")
        self._rng = np.random.default_rng(self.config.seed)
        self.begin()

    def begin(self) -> None:
        """Starts a new demonstration with the next action, whatever the tick."""
        self._tick: int | None = None

    def get_action(self) -> dict[str, Any]:
        """The expert's action for the world's present state, within the limits.

        Raises:
            InputError: no `pneutac_sim` robot is connected in this process, or it is told bends.
        """
        if not self.is_connected:
            raise DeviceNotConnectedError(f"{self} is not connected; call connect() first.")
        robot = connected_robot()
        steps, control_hz = self.steps(robot), robot.config.control_hz
        self._advance(steps, control_hz)
        if self._tick == 0:
            from pneutac_sim.world.expert import ScriptedExpert

            if robot.config.bend:
                raise InputError("pneutac_scripted gives pressures; leave --robot.bend out.")
            self._expert = ScriptedExpert(robot.world, self._rng)
        # Waiting is with the pressure off and the arm at rest.
        action = self._expert.action() if self._tick < steps else np.zeros(len(ACTION_NAMES))
        limits = action_limits(robot.world.pressure_range_kpa)
        values = np.clip(action, *limits).tolist()
        result: dict[str, Any] = dict(zip(ACTION_NAMES, values, strict=True))
        if not self._was_reset and self._tick >= steps - 1 + (self.config.reset_steps + 1) // 2:
            result["reset"] = self._was_reset = True
        return result

    def steps(self, robot: PneutacSim) -> int:
        """Ticks of a demonstration on a robot."""
        return self.config.episode_steps or DEMONSTRATION_S * robot.config.control_hz

    def _advance(self, steps: int, control_hz: int) -> None:
        now, cycle = clock(), steps + self.config.reset_steps
        if self._tick is not None:
            # Without a waiting time nothing separates the episodes but the count itself.
            due = int((now - self._start_s) * control_hz) if self.config.reset_steps else 0
            self._tick = max(self._tick + 1, due)
        if self._tick is None or self._tick >= cycle:
            self._tick, self._start_s, self._was_reset = 0, now, False

    def disconnect(self) -> None:
        """Lets go of the expert."""
        if not self.is_connected:
            raise DeviceNotConnectedError(f"{self} is not connected; call connect() first.")
        self._rng = self._expert = None
