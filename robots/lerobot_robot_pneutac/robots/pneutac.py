"""The robot `pneutac`: arm, pressure controller and tactile camera behind LeRobot's Robot interface."""

import logging
from typing import Any

import numpy as np
from lerobot.cameras import make_cameras_from_configs
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from lerobot_robot_pneutac.cameras.tactile import LiveCamera, Tactile
from lerobot_robot_pneutac.hardware.safety import Guard, within
from lerobot_robot_pneutac.robots.base_robot import BaseRobot, BendCommands
from lerobot_robot_pneutac.robots.config_pneutac import PneutacConfig
from lerobot_robot_pneutac.robots.episode_hooks import EpisodeHooks
from pneutac_sim.errors import InputError
from pneutac_sim.features import ACTION_HIGH, ACTION_LOW, IMAGE_NAME
from pneutac_sim.gel.model import GelModel
from pneutac_sim.twin import Twin

LET_GO_S = 3.0  # a part that takes longer to let go is left behind

logger = logging.getLogger(__name__)


class Pneutac(BaseRobot):
    """The real robot; its features are those of `pneutac_sim`, and so are its datasets and policies.

    An action is a dict of `features.action_names`, with `--robot.bend=true` with `bend.pos` in place of the
    pressure; a pose, as lerobot-rollout sends it between episodes, moves the arm towards that pose. Every
    action passes the `guard`, while connected; see `Guard` for limits and faults.
    """

    config_class = PneutacConfig

    def __init__(self, config: PneutacConfig):
        super().__init__(config)
        self.config = config
        self.guard: Guard | None = None
        self._hooks = EpisodeHooks(config.control_hz, self)
        self._arm = config.arm.make()
        self._pressure = config.pressure.make()
        self.cameras = make_cameras_from_configs({IMAGE_NAME: config.digit} | config.cameras)
        gel = GelModel.from_twin(Twin.load(config.twin)) if config.twin else None
        self._tactile = Tactile(self.cameras[IMAGE_NAME], config.threshold_levels(), self.image_shape, gel)
        self._scene = {name: LiveCamera(self.cameras[name], name) for name in config.cameras}

    @property
    def image_shape(self) -> tuple[int, int, int]:
        """Height, width and channels of the tactile image, as the camera's options say."""
        return self.config.digit.height, self.config.digit.width, 3

    @property
    def observation_features(self) -> dict[str, type | tuple]:
        """Those of every robot of the plugin, then other cameras."""
        extra = {name: (c.height, c.width, 3) for name, c in self.config.cameras.items()}
        return super().observation_features | extra

    @property
    def is_connected(self) -> bool:
        """Whether `connect` succeeded; also after a fault, until `disconnect`."""
        return self.guard is not None

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Connects every part; the chamber is vented, the arm rests, and the gel must be free of contact.

        Raises:
            HardwareFault: a part does not answer; those that did are let go again.
            InputError: `limits.pressure_kpa` is above what the controller takes.
        """
        self._hooks.connect()
        if self.config.bend:
            dt_s = 1 / self.config.control_hz
            self._bend = BendCommands(Twin.load(self.config.twin), self.config.conditions, dt_s)
        try:
            self._pressure.connect()
            self._pressure.vent()
            highest, lowest = self._pressure.max_kpa.min(), self._pressure.min_kpa.max()
            if highest < self.config.limits.pressure_kpa:
                raise InputError(
                    f"limits.pressure_kpa is {self.config.limits.pressure_kpa:g}, but the pressure controller"
                    f" takes {highest:g} kPa at most; give"
                    f" --robot.limits.pressure_kpa={highest:g} or a higher max_kpa."
                )
            if lowest > self.config.limits.vacuum_kpa:
                raise InputError(
                    f"limits.vacuum_kpa is {self.config.limits.vacuum_kpa:g}, but the pressure controller"
                    f" goes down to {lowest:g} kPa; give --robot.limits.vacuum_kpa={lowest:g}, or a"
                    " controller with a vacuum pump."
                )
            self._arm.connect()
            self._tactile.connect()
            for name in self.config.cameras:
                self.cameras[name].connect()
            guard = Guard(self._arm, self._pressure, self.config.limits)
            guard.look()
        except BaseException:
            self._let_go()
            raise
        self.guard = guard
        guard.start()

    @check_if_not_connected
    def get_observation(self) -> dict[str, Any]:
        """State (floats) and images; raises HardwareFault, and everything halts, where a part fails."""
        guard = self.guard
        self._hooks.observed()
        arm, kpa = guard.look()
        with guard.failing("reading the cameras"):
            image = self._tactile.read()
            contact = self._tactile.contact(image)
            extra = {name: camera.latest() for name, camera in self._scene.items()}
        values = [
            *arm.joints_rad, *arm.joints_rad_s, *arm.flange_m, contact.area, contact.log_pixels, *kpa
        ]  # fmt: skip
        state = {name: float(v) for name, v in zip(self.state_names, values, strict=True)}
        return state | {IMAGE_NAME: image} | extra

    def _carry_out(self, values: np.ndarray, pose: bool) -> np.ndarray:
        if pose:
            velocity = (values[:3] - self.guard.look()[0].flange_m) * self.config.control_hz
            # Far away is no fault of a pose, infinitely far is.
            near = np.clip(velocity, ACTION_LOW[:3], ACTION_HIGH[:3])
            values[:3] = np.where(np.isfinite(velocity), near, velocity)
        done = self.guard.act(values)
        if self.config.bend:
            self._bend.sent(float(done[3]))
        return done

    def _misled(self) -> None:
        self.guard.halt()

    @check_if_not_connected
    def disconnect(self) -> None:
        """Stops the arm, vents the chamber and lets every part go; never fails on a part."""
        guard = self.guard
        try:
            guard.close()
        finally:
            self.guard = None
            self._let_go()

    def _let_go(self) -> None:
        """Disconnects all that was connected; one part's trouble does not keep the next one."""
        self._hooks.disconnect()
        for part in (self._pressure, self._arm, *self.cameras.values()):
            try:
                if getattr(part, "is_connected", True):
                    within(LET_GO_S, "It", part.disconnect)
            except Exception as e:
                logger.error("Letting go of %s: %s", type(part).__name__, e)
