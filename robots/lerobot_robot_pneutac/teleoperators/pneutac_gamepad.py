"""The teleoperator `pneutac_gamepad`: sticks and triggers of a gamepad, through SDL.

LeRobot's own gamepad reads numbered axes, which mean different sticks on different pads, and no triggers as
axes; SDL's controller interface names them for every pad it knows.
"""

import numpy as np
from lerobot.utils.errors import DeviceNotConnectedError

from lerobot_robot_pneutac.teleoperators.config_pneutac_gamepad import PneutacGamepadConfig
from lerobot_robot_pneutac.teleoperators.velocity_teleop import VelocityTeleop

FULL = 32767  # SDL's axes are 16 bit numbers


class PneutacGamepad(VelocityTeleop):
    """Left stick x and y, right stick up and down, right trigger inflates, left trigger lets air out."""

    config_class = PneutacGamepadConfig
    name = "pneutac_gamepad"

    def _open(self) -> None:
        try:
            import pygame
            from pygame._sdl2 import controller
        except ImportError as error:
            raise DeviceNotConnectedError(
                "pneutac_gamepad needs pygame; uv pip install -e '.[gamepad]' in PneuTac's folder."
            ) from error
        self._pygame, self._controller = pygame, controller
        controller.init()
        pads = [i for i in range(controller.get_count()) if controller.is_controller(i)]
        if not pads:
            controller.quit()
            raise DeviceNotConnectedError("No gamepad was found; plug one in and start again.")
        self._pad = controller.Controller(pads[0])

    def _read(self) -> tuple[np.ndarray, float]:
        self._controller.update()
        if not self._pad.attached():
            raise DeviceNotConnectedError(
                "The gamepad was unplugged: the arm is stopped and the pressure held; plug it in and start"
                " the command again."
            )
        # SDL counts sticks to the right and down.
        direction = [-self._axis("LEFTY"), -self._axis("LEFTX"), -self._axis("RIGHTY")]
        return np.array(direction), self._axis("TRIGGERRIGHT") - self._axis("TRIGGERLEFT")

    def _close(self) -> None:
        self._pad.quit()
        self._controller.quit()

    def _axis(self, name: str) -> float:
        """Deflection from -1 to 1, growing from zero at the dead zone's edge."""
        axis = getattr(self._pygame, f"CONTROLLER_AXIS_{name}")
        value = max(-1.0, self._pad.get_axis(axis) / FULL)
        beyond = max(0.0, abs(value) - self.config.dead_zone)
        return float(np.sign(value)) * beyond / (1 - self.config.dead_zone)
