"""What the keyboard, the gamepad and the 3D mouse have in common: a direction and a change of pressure."""

import logging
import time
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from lerobot.teleoperators import TeleoperatorConfig
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from lerobot_robot_pneutac.options import refuse_if
from lerobot_robot_pneutac.teleoperators.base_teleop import BaseTeleop
from pneutac_sim.features import ACTION_NAMES, MAX_PRESSURE_KPA, MAX_SPEED_M_S

logger = logging.getLogger(__name__)

MAX_TICK_S = 0.2  # a slow tick changes the pressure by no more than this
# After `safety.VENT_S` without actions the robot is vented: no sudden return to the old pressure.
PAUSE_S = 0.9


@dataclass(kw_only=True)
class VelocityTeleopConfig(TeleoperatorConfig):
    """How fast a person's hand may move the robot.

    Attributes:
        speed_m_s: speed of the flange at full deflection.
        pressure_rate_kpa_s: rate of the pressure set-point at full deflection.
        max_pressure_kpa: highest set-point; a finger of another range than the paper's needs another.
        min_pressure_kpa: lowest set-point, 0 or, for a finger bent by vacuum, below.
    """

    speed_m_s: float = 0.05
    pressure_rate_kpa_s: float = 5.0
    max_pressure_kpa: float = MAX_PRESSURE_KPA
    min_pressure_kpa: float = 0.0

    def __post_init__(self):
        refuse_if(
            not 0 < self.speed_m_s <= MAX_SPEED_M_S,
            f"--teleop.speed_m_s is {self.speed_m_s}; it must be above 0 and at most {MAX_SPEED_M_S}.",
        )
        low, high = self.min_pressure_kpa, self.max_pressure_kpa
        refuse_if(
            not -np.inf < low <= 0 <= high < np.inf or low == high,
            f"--teleop.max_pressure_kpa is {high} and --teleop.min_pressure_kpa {low}; the first must be 0 or"
            " above, the second 0 or below, and not both 0.",
        )
        refuse_if(
            not 0 < self.pressure_rate_kpa_s < np.inf,
            f"--teleop.pressure_rate_kpa_s is {self.pressure_rate_kpa_s}; it must be positive.",
        )


class VelocityTeleop(BaseTeleop):
    """Turns a direction and a pressure change into velocities (m/s) and a pressure (kPa).

    With nothing pressed the velocity is zero and the pressure held. A device that is lost while in use gives
    the same and is reported once. The pressure starts at 0, also after a pause as long as that in which the
    robot vents, and nothing counts before everything was let go once: triggers can read half pressed until
    they are first moved.
    """

    def __init__(self, config: VelocityTeleopConfig):
        super().__init__(config)
        self.config = config
        self._tick_s: float | None = None

    @abstractmethod
    def _open(self) -> None:
        """Opens the device.

        Raises:
            DeviceNotConnectedError: it is not there; one sentence.
        """

    @abstractmethod
    def _read(self) -> tuple[np.ndarray, float]:
        """Direction (3,) in the base frame, x forwards, y to the left, z up; pressure change, -1 to 1.

        Raises:
            DeviceNotConnectedError: the device is lost; one sentence.
        """

    @abstractmethod
    def _close(self) -> None:
        """Closes the device, also a lost one."""

    @property
    def is_connected(self) -> bool:
        """Whether `connect` was called."""
        return self._tick_s is not None

    def connect(self, calibrate: bool = True) -> None:
        """Opens the device.

        Raises:
            DeviceNotConnectedError: it is not there.
        """
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f"{self} is already connected.")
        self._open()
        self._pressure_kpa, self._lost, self._let_go = 0.0, False, None
        self._tick_s = time.monotonic()

    def get_action(self) -> dict[str, Any]:
        """The action of the present deflections, within the limits."""
        if not self.is_connected:
            raise DeviceNotConnectedError(f"{self} is not connected; call connect() first.")
        now_s = time.monotonic()
        tick_s, self._tick_s = now_s - self._tick_s, now_s
        if tick_s > PAUSE_S:
            self._pressure_kpa = 0.0
        direction, change = self._deflections()
        # Diagonals are not faster than the axes.
        velocity = self.config.speed_m_s * direction / max(1.0, float(np.linalg.norm(direction)))
        pressure = self._pressure_kpa + change * self.config.pressure_rate_kpa_s * min(tick_s, MAX_TICK_S)
        self._pressure_kpa = float(
            np.clip(pressure, self.config.min_pressure_kpa, self.config.max_pressure_kpa)
        )
        return dict(zip(ACTION_NAMES, [*velocity.tolist(), self._pressure_kpa], strict=True))

    def disconnect(self) -> None:
        """Lets go of the device."""
        if not self.is_connected:
            raise DeviceNotConnectedError(f"{self} is not connected; call connect() first.")
        self._tick_s = None
        self._close()

    def _deflections(self) -> tuple[np.ndarray, float]:
        if self._lost:
            return np.zeros(3), 0.0
        try:
            direction, change = self._read()
        except DeviceNotConnectedError as error:
            self._lost = True
            logger.error(str(error))
            return np.zeros(3), 0.0
        if not self._let_go:
            if np.any(direction) or change:
                if self._let_go is None:
                    logger.warning("%s moves the robot once everything on it was let go.", self.name)
                self._let_go = False
                return np.zeros(3), 0.0
            self._let_go = True
        return np.asarray(direction, float) + 0.0, float(np.clip(change, -1.0, 1.0))  # no negative zeros
