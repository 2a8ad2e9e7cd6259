"""What every robot of this plugin shares: one definition, so that datasets and policies fit all."""

import logging
import math
from abc import abstractmethod
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from lerobot.robots import Robot
from lerobot.utils.decorators import check_if_not_connected

from pneutac_sim import features
from pneutac_sim.errors import InputError
from pneutac_sim.features import IMAGE_NAME, VELOCITY_NAMES, pressure_names, state_names
from pneutac_sim.finger.control import BendController
from pneutac_sim.twin import Twin

BEND_NAMES = (*VELOCITY_NAMES, "bend.pos")  # rad, in place of the pressure

logger = logging.getLogger(__name__)


class BaseRobot(Robot):
    """A robot with the finger; its features are those of every other, and it needs no calibration.

    The rest image of a real gel is taken again on every connect; a twin is calibrated by `pneutac calibrate`.
    """

    name = "pneutac"

    @property
    @abstractmethod
    def image_shape(self) -> tuple[int, int, int]:
        """Height, width and channels of the tactile image."""

    @property
    def chambers(self) -> int:
        """Chambers of the finger; one where the options name no others."""
        return getattr(self.config, "chambers", 1)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the state's scalars, as many as arm has joints and finger chambers for."""
        return state_names(self.config.joints, self.chambers)

    @property
    def observation_features(self) -> dict[str, type | tuple]:
        """Every scalar of the state in order, then the tactile image."""
        return dict.fromkeys(self.state_names, float) | {IMAGE_NAME: self.image_shape}

    @property
    def action_features(self) -> dict[str, type]:
        """Velocities (m/s) and pressures (kPa), with `--robot.bend=true` bend (rad)."""
        return dict.fromkeys(BEND_NAMES if self.config.bend else features.action_names(self.chambers), float)

    @check_if_not_connected
    def send_action(self, action: dict[str, Any]) -> dict[str, float]:
        """Carries an action out as far as the limits allow; returns what was carried out.

        Raises:
            HardwareFault: a part failed, a limit is broken, or many actions in a row were refused.
            InputError: keys are missing, or a value is no number.
        """
        try:
            names = action_names(action, self.config.bend, self.chambers)
            values = np.array([_number(action, name) for name in names])
        except InputError:
            self._misled()
            raise
        if names == BEND_NAMES:
            values[3] = self._bend.pressure_kpa(values[3])
        pose = names == pose_names(self.chambers)
        if not pose:
            self._hooks.acted()
        done = self._carry_out(values, pose)
        sent = dict(zip(features.action_names(self.chambers), np.asarray(done, float).tolist(), strict=True))
        if names == BEND_NAMES:
            sent = {name: sent.get(name, float(action[name])) for name in BEND_NAMES}
        return sent

    @abstractmethod
    def _carry_out(self, values: np.ndarray, pose: bool) -> np.ndarray:
        """One control step by velocities, or towards a pose, m, and pressures; the action (3 + chambers,)."""

    def _misled(self) -> None:
        """What came was no action."""

    @property
    def is_calibrated(self) -> bool:
        return True

    def calibrate(self) -> None:
        pass

    def configure(self) -> None:
        pass

    def announced(self, begins: bool) -> None:
        """LeRobot says that the recording of an episode begins, or has ended; here nothing depends on it."""

    @property
    def outcome(self) -> str | None:
        """How the last episode ended: `pace.DONE` or why it failed; None where the robot cannot tell."""
        return None


def pose_names(chambers: int = 1) -> tuple[str, ...]:
    """Names of a pose, which commands places in place of velocities."""
    return ("ee_x.pos", "ee_y.pos", "ee_z.pos", *pressure_names(chambers))


def action_names(keys: Iterable[str], bend: bool = False, chambers: int = 1) -> tuple[str, ...]:
    """Which names an action goes by: `features.action_names`, those with the bend, or the pose's.

    Raises InputError: none of them, or a bend where `--robot.bend` is false.
    """
    own, pose = features.action_names(chambers), pose_names(chambers)
    for names in (own, BEND_NAMES, pose):
        if set(names) <= set(keys):
            if names == BEND_NAMES and not bend:
                raise InputError("The action has 'bend.pos'; give --robot.bend=true and the finger's twin.")
            return names
    if chambers > 1 and "pressure.pos" in keys:
        raise InputError(
            f"The action has one pressure and the finger {chambers} chambers; by hand give"
            " --teleop.chamber_shares, as in [1,0,0.5]; a policy must be of such demonstrations."
        )
    raise InputError(
        f"The action has the keys {', '.join(keys)}; the robot takes {', '.join(own)}, or the pose"
        f" {', '.join(pose)}."
    )


def _number(action: dict[str, Any], name: str) -> float:
    try:
        return float(action[name])
    except OverflowError:  # a whole number beyond all floats
        return math.inf
    except (TypeError, ValueError):
        raise InputError(f"The action's '{name}' is {action[name]!r}; it must be a number.") from None


class BendCommands:
    """Turns commanded bends into pressures by the twin, and goes along with what was sent.

    Takes the finger's calibrated twin, the conditions of its effects and the duration of a control step;
    raises InputError as `BendController`.
    """

    def __init__(self, twin: Twin, conditions: Mapping[str, float], dt_s: float):
        self._control = BendController(twin, dt_s, conditions)
        self._warned = False

    def pressure_kpa(self, bend_rad: float) -> float:
        """What to command now; NaN for a bend that is no number, which the robot refuses like every NaN.

        A bend out of the finger's reach is brought as near as it goes, with one warning.
        """
        if not np.isfinite(bend_rad):
            return float("nan")
        low, high = self._control.reach_rad
        if not low <= bend_rad <= high and not self._warned:
            self._warned = True
            text = "A bend of %.3g rad is out of reach, %.3g to %.3g; it goes as far as it can."
            logger.warning(text, bend_rad, low, high)
        return self._control.plan(bend_rad)

    def sent(self, pressure_kpa: float) -> None:
        """One control step has begun, with this pressure commanded."""
        self._control.follow(pressure_kpa)
