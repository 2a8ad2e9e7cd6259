"""Where cameras stand in a world's scene, as a lab has them around its robot."""

import numpy as np

from pneutac_sim.errors import InputError

# Where each stands and what it looks at, metres: in the arm's base frame, `wrist` in the flange's, whose z
# points along the finger; the finger bends towards (x, -y) there.
_STANDS = {
    "front": ((1.02, 0.22, 0.42), (0.50, 0.0, 0.10), (0, 0, 1), 45),
    "side": ((0.50, -0.62, 0.30), (0.50, 0.0, 0.12), (0, 0, 1), 45),
    "wrist": ((0.062, -0.062, 0.0), (0.028, -0.028, 0.14), (1, -1, 0), 75),
}
SCENE_CAMERAS = tuple(_STANDS)
LARGEST = (960, 1280)  # what the scene's offscreen buffer takes


def fixed() -> str:
    """MJCF of the cameras around the robot."""
    return "".join(_mjcf(name) for name in SCENE_CAMERAS if name != "wrist")


def on_flange() -> str:
    """MJCF of the camera that the flange carries."""
    return _mjcf("wrist")


def _mjcf(name: str) -> str:
    place, aim, up, fovy = _STANDS[name]
    back = np.subtract(place, aim) / np.linalg.norm(np.subtract(place, aim))
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    axes = np.concatenate([right, np.cross(back, right)]).round(6)
    return (
        f'<camera name="{name}" pos="{" ".join(map(str, place))}" fovy="{fovy}"'
        f' xyaxes="{" ".join(map(str, axes))}"/>'
    )


def check_camera(name: str, size: tuple[int, int]) -> None:
    """Raises InputError where there is no such camera, or none of that height and width in px."""
    if name not in SCENE_CAMERAS:
        raise InputError(f"There is no camera '{name}' in the scene; choose of {', '.join(SCENE_CAMERAS)}.")
    if not (1 <= size[0] <= LARGEST[0] and 1 <= size[1] <= LARGEST[1]):
        raise InputError(
            f"The camera '{name}' is {size[1]} px wide and {size[0]} px high; it may have up to"
            f" {LARGEST[1]} x {LARGEST[0]}."
        )
