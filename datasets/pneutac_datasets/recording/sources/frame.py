"""From the frame of a measuring system into the frame of the finger's base."""

from dataclasses import dataclass

import numpy as np

from pneutac_datasets.recording.sources.tracks import Track
from pneutac_sim.errors import InputError

REST_SHARE = 0.05  # of the samples: those of the least pressure, at which the tip rests
LEAST_MOVE_MM = 2.0  # that the tip must move to find the bending plane
AXES = {
    f"{sign}{a}": s * np.eye(3)[i] for i, a in enumerate("xyz") for sign, s in (("", 1), ("+", 1), ("-", -1))
}


@dataclass(frozen=True)
class BaseFrame:
    """The base frame as seen by the measuring system.

    Attributes:
        rotation: (3, 3), its columns the base's axes.
        origin_mm: (3,).
    """

    rotation: np.ndarray
    origin_mm: np.ndarray

    def of(self, position_mm: np.ndarray) -> np.ndarray:
        """Positions (n, 3) in the base frame, mm."""
        return (position_mm - self.origin_mm) @ self.rotation


def axes_of(x: str, z: str) -> np.ndarray:
    """Axes of the base (3, 3), its columns, in a frame of which `x` and `z` name axes, such as `-y`.

    Raises:
        InputError: they are none, or not at right angles.
    """
    if x not in AXES or z not in AXES or AXES[x] @ AXES[z] != 0:
        raise InputError(f"base_x is '{x}' and base_z '{z}'; give two different ones of x, y, z, -x, -y, -z.")
    return np.stack([AXES[x], np.cross(AXES[z], AXES[x]), AXES[z]], 1)


def of_body(base: Track, x: str, z: str, offset_mm: np.ndarray) -> BaseFrame:
    """The base frame of a tracked body fixed at the base.

    Args:
        base: the body, which stands still.
        x: axis of the body along the straight finger, such as `z` or `-y`.
        z: axis of the body in the bending direction.
        offset_mm: from the body's origin to the finger's base, in the base frame.

    Raises:
        InputError: the axes are none, or not at right angles.
    """
    axes = axes_of(x, z)
    assert base.rotation is not None
    seen = np.isfinite(base.position_mm).all(1) & np.isfinite(base.rotation).all((1, 2))
    if not seen.any():
        raise InputError("The base body is never seen; choose another --base.")
    u, _, v = np.linalg.svd(base.rotation[seen].mean(0))
    mean = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
    rotation = mean @ axes
    return BaseFrame(rotation, np.median(base.position_mm[seen], 0) + rotation @ offset_mm)


def of_motion(base_mm: np.ndarray, tip_mm: np.ndarray, pressure_kpa: np.ndarray) -> BaseFrame:
    """The base frame where the base has a marker only: x to where the tip rests, z the way that it bends.

    Args:
        base_mm: (3,) the base's marker.
        tip_mm: (n, 3).
        pressure_kpa: (n,) commanded.

    Raises:
        InputError: the tip hardly moves.
    """
    seen = np.isfinite(tip_mm).all(1)
    tip, kpa = tip_mm[seen], np.abs(pressure_kpa[seen])
    if not len(tip):
        raise InputError("The tip is never seen; choose another --tip.")
    rest = np.median(tip[kpa <= np.quantile(kpa, REST_SHARE)], 0)
    x = (rest - base_mm) / np.linalg.norm(rest - base_mm)
    away = tip - rest
    across = away - np.outer(away @ x, x)
    if np.linalg.norm(across, axis=1).max() < LEAST_MOVE_MM:
        raise InputError(
            f"The tip moves less than {LEAST_MOVE_MM:g} mm, too little to find the bending direction."
        )
    z = np.linalg.svd(across, full_matrices=False)[2][0]
    z = (z - (z @ x) * x) / np.linalg.norm(z - (z @ x) * x)
    # Positive pressure bends towards +z.
    z *= np.sign((across @ z) @ (pressure_kpa[seen])) or 1.0
    return BaseFrame(np.stack([x, np.cross(z, x), z], 1), base_mm)
