"""Options of the teleoperators, and what they share; importing this starts no device's library."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig

from lerobot_robot_pneutac.options import check_range, refuse_if
from pneutac_sim.features import ACTION_NAMES, CHAMBERS, MAX_PRESSURE_KPA, MAX_SPEED_M_S

MOST_MM = 20.0  # farther the finger leaves the bar


@dataclass(kw_only=True)
class VelocityTeleopConfig(TeleoperatorConfig):
    """How fast a person's hand may move the robot."""

    speed_m_s: float = 0.05  # speed of the flange at full deflection
    pressure_rate_kpa_s: float = 5.0  # rate of the pressure set-point at full deflection
    # highest set-point; a finger of another range than the paper's needs another
    max_pressure_kpa: float = MAX_PRESSURE_KPA
    min_pressure_kpa: float = 0.0  # lowest set-point, 0 or, for a finger bent by vacuum, below
    # smallest and largest bend, such as [0.5, 1.2]; the person's hand then changes the bend and not the
    # pressure, from the smallest on, for a robot with `--robot.bend=true`
    bend_range_rad: tuple[float, float] | None = None
    # shares of the set-point that each of several chambers gets, such as [1, 0, 0.5]; left out for a finger
    # of one chamber
    chamber_shares: list[float] | None = None

    def __post_init__(self):
        check_range("--teleop.speed_m_s", self.speed_m_s, 0, MAX_SPEED_M_S, "(]")
        check_range("--teleop.pressure_rate_kpa_s", self.pressure_rate_kpa_s, 0, ends="()")
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


@TeleoperatorConfig.register_subclass("pneutac_keyboard")
@dataclass(kw_only=True)
class PneutacKeyboardConfig(VelocityTeleopConfig):
    """Held keys move the robot; docs/how_to/teleoperation.md has the key map."""


@TeleoperatorConfig.register_subclass("pneutac_gamepad")
@dataclass(kw_only=True)
class PneutacGamepadConfig(VelocityTeleopConfig):
    """Sticks move the robot, triggers the pressure; docs/how_to/teleoperation.md has the map."""

    dead_zone: float = 0.1  # share of a stick's or trigger's travel that counts as rest

    def __post_init__(self):
        super().__post_init__()
        check_range("--teleop.dead_zone", self.dead_zone, 0, 1, "[)")


@TeleoperatorConfig.register_subclass("pneutac_spacemouse")
@dataclass(kw_only=True)
class PneutacSpacemouseConfig(VelocityTeleopConfig):
    """A 3Dconnexion SpaceMouse; docs/how_to/teleoperation.md has the map."""


@TeleoperatorConfig.register_subclass("pneutac_scripted")
@dataclass(kw_only=True)
class PneutacScriptedConfig(TeleoperatorConfig):
    """A scripted expert in place of a person's hand.

    It demonstrates the task once in every episode that LeRobot records, and waits in between.
    """

    # ticks of a demonstration where no episodes are announced, as in `lerobot-teleoperate`; if omitted, those
    # of 14 s
    episode_steps: int | None = None
    seed: int = 0  # decides the variation between demonstrations
    # how late, uneven and imprecise it acts: 0 as scripted, 1 as a modelled person at a joystick
    person: float = 0.0
    # how far it drags the finger sideways along what it holds, before it lets go; in `button` alone
    drag_mm: float = 0.0

    def __post_init__(self):
        check_range("--teleop.episode_steps", self.episode_steps, 1)
        check_range("--teleop.seed", self.seed, 0)
        check_range("--teleop.person", self.person, 0, 1)
        check_range("--teleop.drag_mm", self.drag_mm, 0, MOST_MM)


class BaseTeleop(Teleoperator):
    """A teleoperator that gives velocities and a pressure."""

    @property
    def action_features(self) -> dict[str, type]:
        """Velocities (m/s) and pressure (kPa)."""
        return dict.fromkeys(ACTION_NAMES, float)

    @property
    def feedback_features(self) -> dict:
        return {}

    @property
    def is_calibrated(self) -> bool:
        return True

    def calibrate(self) -> None:
        pass

    def configure(self) -> None:
        pass

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        pass
