"""Touch as data: displacement and force on a grid of points of the gel's face, in addition to the image.

The layout `[dx, dy, dz, Fx, Fy, Fz]` of each point is the one that LeRobot's own tactile module proposes
(huggingface/lerobot, pull requests 3175 and 4469, undecided). Frame: that of the gel, x along the image's
columns, y along its rows (downwards), z out of the sensor towards the object.
"""

import cv2
import mujoco
import numpy as np

from pneutac_sim.features import POINTS_SHAPE

POINT_NAMES = ("dx", "dy", "dz", "Fx", "Fy", "Fz")


def points_info(window_mm: tuple[float, float]) -> dict:
    """What a dataset says of them: layout, units, frame, and width and height of the window in mm."""
    return {
        "shape": list(POINTS_SHAPE),
        "axes": ["row", "column", "value"],
        "values": list(POINT_NAMES),
        "units": ["mm", "mm", "mm", "N", "N", "N"],
        "frame": "gel: x along image columns, y along image rows, z out of the sensor; force on the gel",
        "window_mm": list(window_mm),
        "shear": "dx and dy are 0: the gel's model has no shear",
    }


def tactile_points(world) -> np.ndarray:
    """The gel's face now, float32 `POINTS_SHAPE`: displacement in mm and force on the gel in N.

    dz is the mean over a point's cell, below 0 where the face is pressed in. The contact force of the last
    physics step is shared among the points as their imprints are, so that they sum to it; outside the window
    there are no points. An image's lag is not in them.

    Args:
        world: a `World` with touch, or the stand-in.
    """
    inwards = world.touch.displacement_mm.astype(np.float32)
    rows, columns, _ = POINTS_SHAPE
    cells = cv2.resize(inwards, (columns, rows), interpolation=cv2.INTER_AREA)
    points = np.zeros(POINTS_SHAPE, np.float32)
    points[..., 2] = -cells
    pressed = cells.clip(0)
    if pressed.any():
        share = pressed / pressed.sum()
        points[..., 3:] = share[..., None] * contact_force_n(world.model, world.data)
    return points


def contact_force_n(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Force (3,) on the gel's pad, N, in the gel's frame; z below 0 presses it in."""
    pad, total, force = model.geom("pad").id, np.zeros(3), np.zeros(6)
    for i in range(data.ncon):
        contact = data.contact[i]
        if pad in (contact.geom1, contact.geom2):
            mujoco.mj_contactForce(model, data, i, force)
            on_second = contact.frame.reshape(3, 3).T @ force[:3]  # MuJoCo's axes point to the second geom
            total += on_second if contact.geom2 == pad else -on_second
    return data.site("gel").xmat.reshape(3, 3).T @ total
