"""The picture of a finger or an arm: skin, spine, joints, the tip and where it went."""

import numpy as np
import viser

from lerobot_pneutac.studio.colours import BASE, JOINTS, MEASURED, SKIN, SPINE, TRAIL, rgb
from lerobot_pneutac.studio.live import Shape, Skin
from lerobot_pneutac.studio.solid import Solid
from pneutac_sim.twin import Twin

UNIT = 0.01  # of the scene, in mm^-1: a decimetre
TRAIL_POINTS = 200
NARROW = 0.6  # width over height of a picture into which the body fits


class BodyScene:
    """What is drawn of a body.

    Args:
        server: the viewer.
        twin: gives its sizes.
    """

    def __init__(self, server: viser.ViserServer, twin: Twin):
        self._server, self._length = server, twin.length_mm
        self._joints = np.array(twin.spine_joint_positions_mm)
        scene, skin = server.scene, Skin.of(twin)
        scene.set_up_direction("-x")  # it hangs
        size = UNIT * twin.length_mm
        server.initial_camera.position = (0.45 * size, -2.1 * size, 0.9 * size)
        server.initial_camera.look_at = (0.5 * size, 0.0, 0.25 * size)
        server.initial_camera.up = (-1.0, 0.0, 0.0)
        server.initial_camera.fov = np.radians(45)
        server.on_client_connect(_keep_in_view)
        width = UNIT * float(np.ptp(skin.vertices_mm[:, 2]))
        scene.add_box("/base", color=BASE, dimensions=(0.4 * width, 1.5 * width, 1.5 * width),
                      position=(-0.2 * width, 0.0, 0.0))  # fmt: skip
        # sent again as it moves: a skinned mesh of viser 1.1.1 breaks the page when the server restarts
        self._carried = skin
        self._skin = scene.add_mesh_simple(
            "/skin",
            (UNIT * skin.vertices_mm).astype(np.float32),
            skin.faces,
            color=SKIN,
            opacity=0.55,
            side="double",
        )
        straight = np.zeros((len(self._joints) + 2, 3))
        straight[1:-1, 0], straight[-1, 0] = self._joints, self._length
        self._spine = scene.add_line_segments(
            "/spine", _segments(UNIT * straight), SPINE, thickness=0.08 * width
        )
        self._dots = scene.add_point_cloud(
            "/joints", (UNIT * straight[1:-1]).astype(np.float32), JOINTS, point_size=0.14 * width,
            point_shape="circle", precision="float32",
        )  # fmt: skip
        self._tip = scene.add_icosphere("/tip", radius=0.13 * width, color=TRAIL)
        self._measured = scene.add_icosphere(
            "/measured tip", radius=0.13 * width, color=rgb(MEASURED), visible=False
        )
        self._trail = scene.add_line_segments(
            "/tip's path", np.zeros((1, 2, 3), np.float32), TRAIL, thickness=2.0, thickness_units="screen"
        )
        self._path: list[np.ndarray] = []
        self._solid = None

    def show(self, shape: Shape, measured_mm: np.ndarray | None = None) -> None:
        """Draws a shape, and the measured tip (3,), if there is one."""
        with self._server.atomic():
            self._skin.vertices = (UNIT * self._carried.carried_mm(shape, self._joints)).astype(np.float32)
            spine = UNIT * shape.spine_mm(self._length, self._joints)
            self._spine.points = _segments(spine)
            self._dots.points = spine[1:-1].astype(np.float32)
            self._tip.position = UNIT * shape.markers[:3]
            self._measured.visible = measured_mm is not None
            if measured_mm is not None:
                self._measured.position = UNIT * measured_mm
            self._path = [*self._path[1 - TRAIL_POINTS :], UNIT * shape.markers[:3]]
            if len(self._path) > 1:
                self._trail.points = _segments(np.array(self._path))

    def show_solid(self, solid: Solid, splats: bool) -> None:
        """A body of material points, or of its Gaussians, in place of the skin, until `hide_solid`."""
        self.hide_solid()
        self._skin.visible = False
        if splats:
            g, metre = solid.splats, 1e3 * UNIT
            self._solid = self._server.scene.add_gaussian_splats(
                "/material points", metre * g.means, metre**2 * g.covariances(), g.colours,
                g.opacities[:, None],
            )  # fmt: skip
            return
        self._solid = self._server.scene.add_point_cloud(
            "/material points", (UNIT * solid.points_mm).astype(np.float32), solid.colours, point_size=0.02,
            point_shape="circle", precision="float32",
        )  # fmt: skip

    def hide_solid(self) -> None:
        if self._solid is not None:
            self._solid.remove()
            self._solid, self._skin.visible = None, True

    def forget_path(self) -> None:
        """The tip's path starts again."""
        self._path = []
        self._trail.points = np.zeros((1, 2, 3), np.float32)


def _keep_in_view(client: viser.ClientHandle) -> None:
    """Moves the camera of a browser away where its picture is narrower than the body with its arrows."""
    farther = 1.0

    def changed(camera: viser.CameraHandle) -> None:
        nonlocal farther
        by, farther = max(1.0, NARROW / camera.aspect) / farther, max(1.0, NARROW / camera.aspect)
        if abs(by - 1) > 0.02:
            camera.position = camera.look_at + (camera.position - camera.look_at) * by

    client.camera.on_update(changed)


def _segments(points: np.ndarray) -> np.ndarray:
    """(n - 1, 2, 3) of the line through (n, 3)."""
    return np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
