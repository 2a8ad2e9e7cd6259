"""The teleoperator `pneutac_keyboard`: held keys, through LeRobot's own keyboard listener."""

import numpy as np
from lerobot.teleoperators.keyboard import KeyboardTeleop
from lerobot.utils.errors import DeviceNotConnectedError

from lerobot_robot_pneutac.teleoperators.config_pneutac_keyboard import PneutacKeyboardConfig
from lerobot_robot_pneutac.teleoperators.velocity_teleop import VelocityTeleop

# Key to direction (x, y, z) and pressure change. Kept free for lerobot-record: n, r, q, the arrows and Esc.
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
