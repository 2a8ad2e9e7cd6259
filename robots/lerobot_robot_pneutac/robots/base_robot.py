"""What every robot of this plugin shares: one definition, so that datasets and policies fit all."""

from abc import abstractmethod
from collections.abc import Iterable

from lerobot.robots import Robot

from pneutac_sim import features
from pneutac_sim.errors import InputError
from pneutac_sim.features import IMAGE_NAME, VELOCITY_NAMES, pressure_names, state_names

BEND_NAMES = (*VELOCITY_NAMES, "bend.pos")  # rad, in place of the pressure


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

    Raises:
        InputError: none of them, or a bend where `--robot.bend` is false.
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
