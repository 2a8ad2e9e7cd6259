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
from lerobot_robot_pneutac.robots.base_robot import BEND_NAMES
from lerobot_robot_pneutac.teleoperators.base_teleop import BaseTeleop
from pneutac_sim.features import CHAMBERS, MAX_PRESSURE_KPA, MAX_SPEED_M_S, action_names

logger = logging.getLogger(__name__)

BEND_S = 3.0  # from the smallest bend to the largest at full deflection
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
        bend_range_rad: smallest and largest bend, such as [0.5, 1.2]; the person's hand then changes the bend
            and not the pressure, from the smallest on, for a robot with `--robot.bend=true`.
        chamber_shares: shares of the set-point that each of several chambers gets, such as [1, 0, 0.5]; left
            out for a finger of one chamber.
    """

    speed_m_s: float = 0.05
    pressure_rate_kpa_s: float = 5.0
    max_pressure_kpa: float = MAX_PRESSURE_KPA
    min_pressure_kpa: float = 0.0
    bend_range_rad: tuple[float, float] | None = None
    chamber_shares: list[float] | None = None

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
        given = self.bend_range_rad
        refuse_if(
            given is not None and not -np.inf < given[0] < given[1] < np.inf,
            f"--teleop.bend_range_rad is {given}; give the smaller bend first, as in [0.5,1.2].",
        )
        shares, several = self.chamber_shares, max(CHAMBERS.values())
        refuse_if(
            shares is not None
            and (len(shares) != several or not all(0 <= s <= 1 for s in shares) or not any(shares)),
            f"--teleop.chamber_shares is {shares}; give {several} numbers from 0 to 1, as in [1,0,0.5].",
        )
        refuse_if(
            shares is not None and given is not None,
            "--teleop.bend_range_rad is for one chamber; leave it out, or --teleop.chamber_shares.",
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
        if config.bend_range_rad is None:
            self._low, self._high = config.min_pressure_kpa, config.max_pressure_kpa
            self._rest, self._rate = 0.0, config.pressure_rate_kpa_s
        else:
            self._low, self._high = config.bend_range_rad
            self._rest, self._rate = self._low, (self._high - self._low) / BEND_S

    @property
    def action_features(self) -> dict[str, type]:
        """Velocities (m/s) and pressures (kPa), with `bend_range_rad` bend (rad)."""
        own = action_names(len(self.config.chamber_shares or [1]))
        return dict.fromkeys(own if self.config.bend_range_rad is None else BEND_NAMES, float)

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
        self._held, self._lost, self._let_go = self._rest, False, None
        self._tick_s = time.monotonic()

    def get_action(self) -> dict[str, Any]:
        """The action of the present deflections, within the limits."""
        if not self.is_connected:
            raise DeviceNotConnectedError(f"{self} is not connected; call connect() first.")
        now_s = time.monotonic()
        tick_s, self._tick_s = now_s - self._tick_s, now_s
        if tick_s > PAUSE_S:
            self._held = self._rest
        direction, change = self._deflections()
        # Diagonals are not faster than the axes.
        velocity = self.config.speed_m_s * direction / max(1.0, float(np.linalg.norm(direction)))
        held = self._held + change * self._rate * min(tick_s, MAX_TICK_S)
        self._held = float(np.clip(held, self._low, self._high))
        held = [share * self._held for share in self.config.chamber_shares or [1]]
        return dict(zip(self.action_features, [*velocity.tolist(), *held], strict=True))

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
