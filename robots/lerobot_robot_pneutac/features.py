"""What robots of this plugin observe and take: one definition, so that datasets and policies fit all."""

from pneutac_sim.features import ACTION_NAMES, IMAGE_NAME, IMAGE_SHAPE, STATE_NAMES

POSE_NAMES = ("ee_x.pos", "ee_y.pos", "ee_z.pos", "pressure.pos")


class PneutacFeatures:
    """The features of a LeRobot robot with the finger; to be named before `Robot` among the bases."""

    name = "pneutac"

    @property
    def observation_features(self) -> dict[str, type | tuple]:
        """Every scalar of the state in order, then the tactile image."""
        return dict.fromkeys(STATE_NAMES, float) | {IMAGE_NAME: IMAGE_SHAPE}

    @property
    def action_features(self) -> dict[str, type]:
        """Velocities (m/s) and pressure (kPa)."""
        return dict.fromkeys(ACTION_NAMES, float)
