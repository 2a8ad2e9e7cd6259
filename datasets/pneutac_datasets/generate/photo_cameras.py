"""Where the cameras of generated photographs stand, and where they stand after they were knocked."""

import numpy as np
from scipy.spatial.transform import Rotation

from pneutac_sim.splat.camera import Camera

WIDTH, HEIGHT = 640, 480
# Camera: the way it looks and the way up in the picture, base frame. Devices hang from their base.
VIEWS = {"front": (0, 1, 0), "back": (0, -1, 0), "side": (0, 0, -1)}
CAMERAS = {"finger": ("front", "back"), "arm": ("front", "back", "side")}


def place_camera(name: str, length_m: float, rng: np.random.Generator) -> Camera:
    """A camera of one of `VIEWS` in the base frame, placed by hand, so a few degrees off."""
    forward = np.array(VIEWS[name], float)
    down = np.array([1.0, 0.0, 0.0])
    turn = np.stack([np.cross(down, forward), down, forward])  # rows: right, down, forward
    turn = Rotation.from_euler("xyz", rng.uniform(-4, 4, 3), degrees=True).as_matrix() @ turn
    distance = 4 * length_m
    aim = length_m * np.array([0.5, 0.0, 0.0 if name == "side" else 0.22])
    extrinsics = np.eye(4)
    extrinsics[:3, :3] = turn
    extrinsics[:3, 3] = np.array([0, 0, distance]) - turn @ aim + rng.uniform(-0.01, 0.01, 3) * length_m
    focal = 0.8 * HEIGHT / length_m * distance
    intrinsics = np.array([[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1]])
    return Camera(intrinsics, extrinsics, WIDTH, HEIGHT)


def knocked(camera: Camera, turn_deg: float, shift_mm: float, rng: np.random.Generator) -> Camera:
    """The camera turned about its eye and shifted, in directions by chance."""

    def way(size):
        v = rng.normal(size=3)
        return size * v / np.linalg.norm(v)

    nominal = camera.extrinsics
    eye = -nominal[:3, :3].T @ nominal[:3, 3] + 1e-3 * way(shift_mm)
    extrinsics = np.eye(4)
    extrinsics[:3, :3] = Rotation.from_rotvec(np.radians(way(turn_deg))).as_matrix() @ nominal[:3, :3]
    extrinsics[:3, 3] = -extrinsics[:3, :3] @ eye
    return Camera(camera.intrinsics, extrinsics, camera.width, camera.height)
