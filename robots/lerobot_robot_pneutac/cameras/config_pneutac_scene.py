"""Options of the camera `pneutac_scene`."""

from dataclasses import dataclass

from lerobot.cameras import CameraConfig

from pneutac_sim.features import CAMERA_SHAPE


@CameraConfig.register_subclass("pneutac_scene")
@dataclass(kw_only=True)
class PneutacSceneConfig(CameraConfig):
    """A camera beside the simulated robot, which draws what it sees; its name says where it stands.

    Attributes:
        fps: where left out, the rate at which the world moves on; there is no other.
        width: columns of the picture, px.
        height: rows of the picture, px.
    """

    fps: int = 0
    width: int = CAMERA_SHAPE[1]
    height: int = CAMERA_SHAPE[0]
