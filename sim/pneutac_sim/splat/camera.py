"""Pinhole camera with OpenCV's lens distortion."""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numba import njit

from pneutac_sim.errors import InputError, finite_array


@dataclass(frozen=True)
class Camera:
    """One camera. Pixel (row i, column j) has its centre at (x, y) = (j + 0.5, i + 0.5)."""

    intrinsics: np.ndarray  # (3, 3) pixels, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
    extrinsics: np.ndarray  # (4, 4) world to camera in OpenCV's axes (x right, y down, z forward), metres
    width: int  # of the image, pixels
    height: int  # of the image, pixels
    # OpenCV's k1, k2, p1, p2, k3, or fewer of them; empty for a pure pinhole
    distortion: tuple[float, ...] = ()
    # squared distance from the axis, at unit depth, up to which the distortion is one-to-one; what lies
    # farther out is never visible. Found from `distortion`.
    largest_r2: float = field(init=False, repr=False)

    def __post_init__(self):
        for name, shape in (("intrinsics", (3, 3)), ("extrinsics", (4, 4))):
            matrix = finite_array(f"The camera's {name}", getattr(self, name), shape).copy()
            matrix.flags.writeable = False
            object.__setattr__(self, name, matrix)
        K, E = self.intrinsics, self.extrinsics
        if min(K[0, 0], K[1, 1]) <= 0 or K[0, 1] or K[1, 0] or not np.array_equal(K[2], [0, 0, 1]):
            raise InputError(
                "The camera's intrinsics must read [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0."
            )
        R = E[:3, :3]
        if np.abs(R @ R.T - np.eye(3)).max() > 1e-4 or np.linalg.det(R) < 0 or any(E[3] != [0, 0, 0, 1]):
            raise InputError("The camera's extrinsics must be a rotation and a shift, with 0 0 0 1 below.")
        for name in ("width", "height"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 1 <= value <= 16384:
                raise InputError(f"The camera's {name} is {value!r}; it must be 1 to 16384 whole pixels.")
        try:
            lens = np.array(self.distortion, np.float64)
        except (TypeError, ValueError):
            lens = np.full(1, np.nan)
        if lens.ndim != 1 or len(lens) not in (0, 4, 5) or not np.isfinite(lens).all():
            raise InputError("The camera's distortion must be k1, k2, p1, p2 and perhaps k3: finite numbers.")
        object.__setattr__(self, "distortion", tuple(lens.tolist()))
        k1, k2, _, _, k3 = self.lens
        # d/dr of r (1 + k1 r^2 + k2 r^4 + k3 r^6) falls to zero at the first positive root
        roots = np.roots([7 * k3, 5 * k2, 3 * k1, 1])
        positive = roots.real[(np.abs(roots.imag) < 1e-12) & (roots.real > 0)]
        object.__setattr__(self, "largest_r2", float(positive.min(initial=np.inf)))

    @property
    def lens(self) -> np.ndarray:
        """k1, k2, p1, p2, k3, float64 (5,)."""
        full = np.zeros(5)
        full[: len(self.distortion)] = self.distortion
        return full

    @classmethod
    def look_at(cls, eye, target, up, fov_y_deg: float, width: int, height: int) -> "Camera":
        """A camera at `eye` (3,) m that sees `target` (3,) m in the middle, with `up` (3,) upwards.

        Raises InputError: `eye` is `target`, `up` lies along the view, or the angle is not in 0 to 180
        degrees.
        """
        eye, target, up = (np.asarray(v, np.float64) for v in (eye, target, up))
        if not 0 < fov_y_deg < 180:
            raise InputError(f"The camera's fov_y_deg is {fov_y_deg}; it must lie between 0 and 180.")
        forward = target - eye
        right = np.cross(forward, up)
        if not np.linalg.norm(right) > 1e-9 * np.linalg.norm(forward) * np.linalg.norm(up):
            raise InputError("The camera's eye, target and up must not lie on one line.")
        forward /= np.linalg.norm(forward)
        right /= np.linalg.norm(right)
        E = np.eye(4)
        E[:3, :3] = right, np.cross(forward, right), forward
        E[:3, 3] = -E[:3, :3] @ eye
        f = height / 2 / np.tan(np.radians(fov_y_deg) / 2)
        return cls(np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]]), E, width, height)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (n, 2) as (x, y) and depths (n,) in metres of points (n, 3) in metres, float64.

        Pixels of points with a depth of 0 or less mean nothing.

        Raises InputError where `points` has another shape or is not finite.
        """
        points = np.ascontiguousarray(points, np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise InputError("Points to project must be finite numbers of shape (n, 3).")
        R, t = self.extrinsics[:3, :3], self.extrinsics[:3, 3]
        if not len(points):
            return np.empty((0, 2)), np.empty(0)
        pixels, _ = cv2.projectPoints(points, cv2.Rodrigues(R)[0], t, self.intrinsics, self.lens)
        return pixels[:, 0], points @ R[2] + t[2]


@njit(inline="always")
def image_plane(u, v, lens):
    """OpenCV's distortion of a point (u, v) at unit depth."""
    k1, k2, p1, p2, k3 = lens[0], lens[1], lens[2], lens[3], lens[4]
    # x = u (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 u v + p2 (r^2 + 2 u^2), y alike (Brown 1966)
    r2 = u * u + v * v
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    x = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)
    y = v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v
    return x, y
