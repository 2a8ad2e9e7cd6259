"""What the camera behind the gel sees of its coated face: light of three LEDs, ray by ray.

Each LED shines from where it sits: inverse square, Lambert's cosine, a glossy lobe about the half vector
(Blinn, SIGGRAPH (1977)) and a shadow where the ray to it passes behind the face, softened by the size of the
LED. What the gel scatters many times comes evenly from everywhere. The lens darkens its corners by the fourth
power of the cosine; the chip saturates.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numba import njit

MARCH_MM = 0.35  # between points of a ray at which it may be in shadow


@dataclass(frozen=True)
class Lamps:
    """Light and lens of one sensor; millimetres in the gel's frame, z out of the sensor.

    Attributes:
        places: (lamps, 3) of the LEDs.
        colours: (lamps, 3) how much red, green and blue of each the chip sees.
        scattered: (3,) light from everywhere.
        gloss: share of the glossy lobe, and its exponent.
        camera_mm: how far below the face the lens sits.
        softness: width of a shadow's edge over the distance from what casts it.
    """

    places: np.ndarray = field(
        default_factory=lambda: np.array([[-8.5, 0.5, -3.4], [8.8, -2.0, -3.1], [-0.8, 10.8, -3.8]])
    )
    colours: np.ndarray = field(
        default_factory=lambda: np.array([[84.0, 9.0, 9.0], [8.0, 78.0, 12.0], [5.0, 16.0, 92.0]])
    )
    scattered: np.ndarray = field(default_factory=lambda: np.array([0.14, 0.19, 0.23]))
    gloss: tuple[float, float] = (0.25, 12.0)
    camera_mm: float = 21.0
    softness: float = 0.16


def light(z_mm: np.ndarray, xs_mm: np.ndarray, ys_mm: np.ndarray, lamps: Lamps) -> np.ndarray:
    """Levels (rows, columns, 3), 0 to 255, of a face whose height is z (rows, columns) over x and y, mm."""
    dy, dx = np.gradient(z_mm, ys_mm, xs_mm)
    gloss, sharp = lamps.gloss
    seen = np.empty((*z_mm.shape, 3))
    _shine(
        z_mm, dx, dy, xs_mm, ys_mm, lamps.places, lamps.colours, gloss, sharp, lamps.camera_mm,
        lamps.softness, seen,
    )  # fmt: skip
    away = (xs_mm[None, :] ** 2 + ys_mm[:, None] ** 2) / lamps.camera_mm**2
    dark = (1 + away) ** -2.0  # cos^4
    return 255 * (1 - np.exp(-(seen + lamps.scattered) * dark[..., None]))


@njit(cache=True)
def _height(z, x, y, x0, y0, step_x, step_y):
    """Bilinear interpolation; the rim continues outside."""
    j = min(max((x - x0) / step_x, 0.0), z.shape[1] - 1.000001)
    i = min(max((y - y0) / step_y, 0.0), z.shape[0] - 1.000001)
    a, b = int(i), int(j)
    u, v = i - a, j - b
    upper = z[a, b] * (1 - v) + z[a, b + 1] * v
    return upper * (1 - u) + (z[a + 1, b] * (1 - v) + z[a + 1, b + 1] * v) * u


@njit(cache=True)
def _lit(z, x, y, h, ray, far, softness, x0, y0, step_x, step_y):
    """Share of a lamp that is seen from a point of the face: 1, or less where the face is in between."""
    share, t = 1.0, MARCH_MM
    while t < far:
        px, py = x + t * ray[0], y + t * ray[1]
        if px < x0 or py < y0 or px > -x0 or py > -y0:  # out of the window, whose middle is the origin
            break
        room = _height(z, px, py, x0, y0, step_x, step_y) - (h + t * ray[2])
        share = min(share, 0.5 + room / (softness * t))
        if share <= 0.0:
            return 0.0
        t += MARCH_MM
    return share


@njit(cache=True)
def _shine(z, dx, dy, xs, ys, places, colours, gloss, sharp, camera, softness, out):
    out[:] = 0.0
    x0, y0, step_x, step_y = xs[0], ys[0], xs[1] - xs[0], ys[1] - ys[0]
    ray, half = np.empty(3), np.empty(3)
    for i in range(len(ys)):
        for j in range(len(xs)):
            x, y, h = xs[j], ys[i], z[i, j]
            size = math.sqrt(1.0 + dx[i, j] ** 2 + dy[i, j] ** 2)
            nx, ny, nz = dx[i, j] / size, dy[i, j] / size, -1.0 / size  # into the sensor
            look = math.sqrt(x * x + y * y + (camera + h) ** 2)
            for k in range(len(places)):
                ray[0], ray[1], ray[2] = places[k, 0] - x, places[k, 1] - y, places[k, 2] - h
                far = math.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2)
                ray /= far
                cosine = nx * ray[0] + ny * ray[1] + nz * ray[2]
                if cosine <= 0.0:
                    continue
                half[0], half[1], half[2] = ray[0] - x / look, ray[1] - y / look, ray[2] - (camera + h) / look
                length = math.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)
                shine = max((nx * half[0] + ny * half[1] + nz * half[2]) / length, 0.0) ** sharp
                power = (cosine + gloss * shine) / far**2
                power *= _lit(z, x, y, h, ray, far, softness, x0, y0, step_x, step_y)
                for c in range(3):
                    out[i, j, c] += power * colours[k, c]
