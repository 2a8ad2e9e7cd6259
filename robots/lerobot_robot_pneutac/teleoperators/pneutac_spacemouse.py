"""The teleoperator `pneutac_spacemouse`: a 3Dconnexion SpaceMouse, through pyspacemouse."""

import numpy as np
from lerobot.utils.errors import DeviceNotConnectedError

from lerobot_robot_pneutac.teleoperators.config_pneutac_spacemouse import PneutacSpacemouseConfig
from lerobot_robot_pneutac.teleoperators.velocity_teleop import VelocityTeleop

MAX_REPORTS = 200  # per tick; the device sends about 125 a second


class PneutacSpacemouse(VelocityTeleop):
    """The cap's three translations move; the second button inflates, the first lets air out."""

    config_class = PneutacSpacemouseConfig
    name = "pneutac_spacemouse"

    def _open(self) -> None:
        try:
            import pyspacemouse
            from easyhid import HIDException
        except (ImportError, OSError) as error:  # OSError: the system's libhidapi is missing
            raise DeviceNotConnectedError(
                "pneutac_spacemouse needs pyspacemouse and the system's hidapi library; install them with"
                " uv pip install -e '.[spacemouse]' in PneuTac's folder, and apt install libhidapi-hidraw0."
            ) from error
        self._lost_error = HIDException
        try:
            self._mouse = pyspacemouse.open(axis_convention=pyspacemouse.AxisConvention.ROS)
        except RuntimeError as error:
            raise DeviceNotConnectedError(
                f"No SpaceMouse can be opened ({error}); plug one in and let your user read its"
                " hidraw device."
            ) from error

    def _read(self) -> tuple[np.ndarray, float]:
        try:
            state = self._newest()
        except self._lost_error as error:
            raise DeviceNotConnectedError(
                "The SpaceMouse was unplugged: the arm is stopped and the pressure held; plug it in and start"
                " the command again."
            ) from error
        first, second = state.buttons[0], state.buttons[1]
        return np.array([state.x, state.y, state.z]), second - first

    def _close(self) -> None:
        self._mouse.close()

    def _newest(self):
        """The state after every waiting report: one read takes one report."""
        time_s = None
        for _ in range(MAX_REPORTS):
            state = self._mouse.read()
            if state.t == time_s:
                break
            time_s = state.t
        return state
