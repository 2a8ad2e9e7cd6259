"""What every robot of this plugin shares: one definition, so that datasets and policies fit all."""

from abc import abstractmethod
from collections.abc import Iterable

from lerobot.robots import Robot

from pneutac_sim.errors import InputError
from pneutac_sim.features import ACTION_NAMES, IMAGE_NAME, state_names

BEND_NAMES = (*ACTION_NAMES[:3], "bend.pos")  # rad, in place of the pressure
POSE_NAMES = ("ee_x.pos", "ee_y.pos", "ee_z.pos", "pressure.pos")


class BaseRobot(Robot):
    """A robot with the finger; its features are those of every other, and it needs no calibration.

    The rest image of a real gel is taken anew on every connect; a twin is calibrated by `pneutac calibrate`.
    """

    name = "pneutac"

    @property
    @abstractmethod
    def image_shape(self) -> tuple[int, int, int]:
        """Height, width and channels of the tactile image."""

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the state's scalars, as many as the arm has joints for."""
        return state_names(self.config.joints)

    @property
    def observation_features(self) -> dict[str, type | tuple]:
        """Every scalar of the state in order, then the tactile image."""
        return dict.fromkeys(self.state_names, float) | {IMAGE_NAME: self.image_shape}

    @property
    def action_features(self) -> dict[str, type]:
        """Velocities (m/s) and pressure (kPa), with `--robot.bend=true` bend (rad)."""
        return dict.fromkeys(BEND_NAMES if self.config.bend else ACTION_NAMES, float)

    @property
    def is_calibrated(self) -> bool:
        """Always true."""
        return True

    def calibrate(self) -> None:
        """Nothing to do."""

    def configure(self) -> None:
        """Nothing to do."""

    def announced(self, begins: bool) -> None:
        """LeRobot says that the recording of an episode begins, or has ended; here nothing depends on it."""


def action_names(keys: Iterable[str], bend: bool = False) -> tuple[str, ...]:
    """Which names an action goes by: `features.ACTION_NAMES`, those with the bend, or the pose's.

    Raises:
        InputError: none of them, or a bend where `--robot.bend` is false.
    """
    for names in (ACTION_NAMES, BEND_NAMES, POSE_NAMES):
        if set(names) <= set(keys):
            if names == BEND_NAMES and not bend:
                raise InputError("The action has 'bend.pos'; give --robot.bend=true and the finger's twin.")
            return names
    raise InputError(
        f"The action has the keys {', '.join(keys)}; the robot takes {', '.join(ACTION_NAMES)}, or the pose"
        f" {', '.join(POSE_NAMES)}."
    )
