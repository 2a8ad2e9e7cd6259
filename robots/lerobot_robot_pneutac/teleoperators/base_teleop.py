"""What every teleoperator of this robot shares: its actions, no feedback, nothing to calibrate."""

from typing import Any

from lerobot.teleoperators import Teleoperator

from pneutac_sim.features import ACTION_NAMES


class BaseTeleop(Teleoperator):
    """A teleoperator that gives velocities and a pressure."""

    @property
    def action_features(self) -> dict[str, type]:
        """Velocities (m/s) and pressure (kPa)."""
        return dict.fromkeys(ACTION_NAMES, float)

    @property
    def feedback_features(self) -> dict:
        """None."""
        return {}

    @property
    def is_calibrated(self) -> bool:
        """Always true."""
        return True

    def calibrate(self) -> None:
        """Nothing to do."""

    def configure(self) -> None:
        """Nothing to do."""

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Nothing to feel."""
