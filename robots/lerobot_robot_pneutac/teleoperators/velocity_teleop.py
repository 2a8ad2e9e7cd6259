"""Teleoperation by hand: keyboard, gamepad and 3D mouse, each a direction and a change of pressure.

LeRobot's own gamepad reads numbered axes, which mean different sticks on different pads, and no triggers as
axes; SDL's controller interface names them for every pad it knows.
"""

import logging
import time
from abc import abstractmethod
from typing import Any

import numpy as np
from lerobot.teleoperators.keyboard import KeyboardTeleop
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected
from lerobot.utils.errors import DeviceNotConnectedError

from lerobot_robot_pneutac.robots.base_robot import BEND_NAMES
from lerobot_robot_pneutac.teleoperators.base_teleop import (
    BaseTeleop,
    PneutacGamepadConfig,
    PneutacKeyboardConfig,
    PneutacSpacemouseConfig,
    VelocityTeleopConfig,
)
from pneutac_sim.features import action_names

logger = logging.getLogger(__name__)

BEND_S = 3.0  # from the smallest bend to the largest at full deflection
MAX_TICK_S = 0.2  # a slow tick changes the pressure by no more than this
# After `safety.VENT_S` without actions the robot is vented: no sudden return to the old pressure.
PAUSE_S = 0.9
# Key to direction (x, y, z) and pressure change. Reserved for lerobot-record: n, r, q, the arrows and Esc.
KEYS = {
    "w": (1, 0, 0, 0),
    "s": (-1, 0, 0, 0),
    "a": (0, 1, 0, 0),
    "d": (0, -1, 0, 0),
    "i": (0, 0, 1, 0),
    "k": (0, 0, -1, 0),
    "l": (0, 0, 0, 1),
    "j": (0, 0, 0, -1),
}
FULL = 32767  # SDL's axes are 16 bit numbers
MAX_REPORTS = 200  # per tick; the device sends about 125 a second


class VelocityTeleop(BaseTeleop):
    """Turns a direction and a pressure change into velocities (m/s) and a pressure (kPa).

    With nothing pressed the velocity is zero and the pressure held; a lost device gives the same and is
    reported once. The pressure starts at 0, also after a pause as long as that in which the robot vents, and
    nothing counts before everything was let go once: triggers can read half pressed until they are first
    moved.
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

        Raises DeviceNotConnectedError: it is not there; one sentence.
        """

    @abstractmethod
    def _read(self) -> tuple[np.ndarray, float]:
        """Direction (3,) in the base frame, x forwards, y to the left, z up; pressure change, -1 to 1.

        Raises DeviceNotConnectedError: the device is lost; one sentence.
        """

    @abstractmethod
    def _close(self) -> None:
        """Closes the device, also a lost one."""

    @property
    def is_connected(self) -> bool:
        return self._tick_s is not None

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Opens the device; raises DeviceNotConnectedError where it is not there."""
        self._open()
        self._held, self._lost, self._let_go = self._rest, False, None
        self._tick_s = time.monotonic()

    @check_if_not_connected
    def get_action(self) -> dict[str, Any]:
        """The action of the present deflections, within the limits."""
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

    @check_if_not_connected
    def disconnect(self) -> None:
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


class PneutacKeyboard(VelocityTeleop, KeyboardTeleop):
    """Moves while keys of `KEYS` are held; keys that oppose each other cancel."""

    config_class = PneutacKeyboardConfig
    name = "pneutac_keyboard"

    def _open(self) -> None:
        KeyboardTeleop.connect(self)
        if self.listener is None:
            raise DeviceNotConnectedError(
                "pneutac_keyboard cannot read held keys here: it needs an X11 session, Windows or macOS, not"
                " Wayland or a remote shell; use pneutac_gamepad."
            )

    def _read(self) -> tuple[np.ndarray, float]:
        if not self.listener.is_alive():
            raise DeviceNotConnectedError(
                "The keyboard can no longer be read: the arm is stopped and the pressure held; end the"
                " command and start it again."
            )
        self._drain_pressed_keys()
        held = [KEYS[key] for key, pressed in self.current_pressed.items() if pressed and key in KEYS]
        total = np.sum([(0, 0, 0, 0), *held], axis=0)
        return total[:3], total[3]

    def _close(self) -> None:
        self.listener.stop()
        self.current_pressed.clear()

    def _on_press(self, key) -> None:
        self.event_queue.put((_letter(key), True))

    def _on_release(self, key) -> None:
        # LeRobot's own also disconnects on Esc, which lerobot-record uses to stop and save.
        self.event_queue.put((_letter(key), False))


def _letter(key) -> str:
    """The key's letter; the same with Shift or Caps Lock, or a press could miss its release."""
    return (getattr(key, "char", None) or "").lower()


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
                "pneutac_gamepad needs pygame; uv pip install -e './robots[gamepad]' in PneuTac's folder."
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
                " uv pip install -e './robots[spacemouse]' in PneuTac's folder and"
                " apt install libhidapi-hidraw0."
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
