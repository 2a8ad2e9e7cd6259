"""A domed gel with a coated face, pressed by rigid objects and seen by a camera behind it.

It shares nothing with the gel of a twin.

Frictionless contact of an elastic half-space with a rigid object, on a grid of equal rectangles.

Each rectangle carries an even pressure, whose displacements Love gave (Phil. Trans. R. Soc. A 228 (1929) 377;
Johnson, Contact Mechanics (1985) eq. 3.25); they superpose by FFT without wrapping round. Pressures that push
and touch, or neither, come by conjugate gradients (Polonsky and Keer, Wear 231 (1999) 206).

How far rigid objects reach below a plane, by marching along parallel rays to their distance fields.

Distances: Hart, The Visual Computer 12 (1996) 527 (sphere tracing); shapes and sizes as MuJoCo numbers them.

What the camera behind the gel sees of its coated face: light of three LEDs, ray by ray.

Each LED shines from where it sits: inverse square, Lambert's cosine, a glossy lobe about the half vector
(Blinn, SIGGRAPH (1977)) and a shadow where the ray to it passes behind the face, softened by the size of the
LED. What the gel scatters many times comes evenly from everywhere. The lens darkens its corners by the fourth
power of the cosine; the chip saturates.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from scipy.fft import irfft2, next_fast_len, rfft2

MARCH_MM = 0.35  # between points of a ray at which it may be in shadow


@dataclass(frozen=True)
class Lamps:
    """Light and lens of one sensor; millimetres in the gel's frame, z out of the sensor."""

    # (lamps, 3) of the LEDs
    places: np.ndarray = (-8.5, 0.5, -3.4), (8.8, -2.0, -3.1), (-0.8, 10.8, -3.8)
    # (lamps, 3) how much red, green and blue of each the chip sees
    colours: np.ndarray = (84.0, 9.0, 9.0), (8.0, 78.0, 12.0), (5.0, 16.0, 92.0)
    scattered: tuple[float, float, float] = 0.14, 0.19, 0.23  # light from everywhere
    gloss: tuple[float, float] = (0.25, 12.0)  # share of the glossy lobe, and its exponent
    camera_mm: float = 21.0  # how far below the face the lens sits
    softness: float = 0.16  # width of a shadow's edge over the distance from what casts it


def light(z_mm: np.ndarray, xs_mm: np.ndarray, ys_mm: np.ndarray, lamps: Lamps) -> np.ndarray:
    """Levels (rows, columns, 3), 0 to 255, of a face whose height is z (rows, columns) over x and y, mm."""
    dy, dx = np.gradient(z_mm, ys_mm, xs_mm)
    seen, leds = np.empty((*z_mm.shape, 3)), (np.array(lamps.places), np.array(lamps.colours))
    _shine(z_mm, dx, dy, xs_mm, ys_mm, *leds, *lamps.gloss, lamps.camera_mm, lamps.softness, seen)
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


SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX = 2, 3, 4, 5, 6
REACH_MM = 3.0  # rays start this far below the plane
NEAR_MM = 2e-3
MARCHES = 80


@njit(cache=True)
def _distance(kind, s, x, y, z):
    """From a point in the shape's frame to its surface, or less; negative inside. All in mm."""
    if kind == SPHERE:
        return math.sqrt(x * x + y * y + z * z) - s[0]
    if kind == CAPSULE:
        along = min(max(z, -s[1]), s[1])
        return math.sqrt(x * x + y * y + (z - along) ** 2) - s[0]
    if kind == ELLIPSOID:
        k = math.sqrt((x / s[0]) ** 2 + (y / s[1]) ** 2 + (z / s[2]) ** 2)
        g = math.sqrt((x / s[0] ** 2) ** 2 + (y / s[1] ** 2) ** 2 + (z / s[2] ** 2) ** 2)
        return k * (k - 1.0) / max(g, 1e-12)
    if kind == CYLINDER:
        a, b = math.sqrt(x * x + y * y) - s[0], abs(z) - s[1]
        return min(max(a, b), 0.0) + math.hypot(max(a, 0.0), max(b, 0.0))
    a, b, c = abs(x) - s[0], abs(y) - s[1], abs(z) - s[2]
    out = math.sqrt(max(a, 0.0) ** 2 + max(b, 0.0) ** 2 + max(c, 0.0) ** 2)
    return min(max(a, max(b, c)), 0.0) + out


@njit(cache=True)
def _march(kinds, sizes, places, turns, xs, ys, out):
    for k in range(len(kinds)):
        R, c = turns[k], places[k]
        for i in range(len(ys)):
            for j in range(len(xs)):
                px, py, z = xs[j] - c[0], ys[i] - c[1], -REACH_MM
                for _ in range(MARCHES):
                    pz = z - c[2]
                    x = R[0, 0] * px + R[1, 0] * py + R[2, 0] * pz
                    y = R[0, 1] * px + R[1, 1] * py + R[2, 1] * pz
                    d = _distance(kinds[k], sizes[k], x, y, R[0, 2] * px + R[1, 2] * py + R[2, 2] * pz)
                    z += d
                    if d < NEAR_MM or z > REACH_MM:
                        break
                out[i, j] = max(out[i, j], -z)


def reach_below(kinds, sizes_mm, places_mm, turns, xs_mm: np.ndarray, ys_mm: np.ndarray) -> np.ndarray:
    """How far n objects reach below the plane z = 0, mm, at most `REACH_MM`; negative where they end above.

    Of shape numbers (n,), sizes (n, 3), centres (n, 3) and rotations (n, 3, 3) to the plane's frame, on a
    grid of columns and rows.
    """
    out = np.full((len(ys_mm), len(xs_mm)), -REACH_MM)
    kinds, turns = np.asarray(kinds, np.int64), np.asarray(turns, float).reshape(-1, 3, 3)
    sizes, places = (np.asarray(x, float).reshape(-1, 3) for x in (sizes_mm, places_mm))
    _march(kinds, sizes, places, turns, xs_mm, ys_mm, out)
    return out


TOLERANCE = 2e-3  # of the deepest point
STEPS = 60
LEAST_MM = 1e-9  # shallower is no contact: its squares would vanish in the arithmetic


class HalfSpace:
    """The surface of a half-space of modulus E / (1 - nu^2) under rigid objects, in cells of a grid."""

    def __init__(self, modulus_kpa: float, cell_mm: tuple[float, float], shape: tuple[int, int]):
        self._shape, self._area = shape, cell_mm[0] * cell_mm[1]
        self._padded = tuple(next_fast_len(2 * n - 1, real=True) for n in shape)
        y, x = (np.fft.fftfreq(n, 1 / n) * c for n, c in zip(self._padded, cell_mm[::-1], strict=True))
        given = love(x[None, :], y[:, None], cell_mm[0] / 2, cell_mm[1] / 2)
        self._spectrum = rfft2(given / (np.pi * modulus_kpa))
        self._last = np.zeros(shape)

    def displaced(self, pressure_kpa: np.ndarray) -> np.ndarray:
        """Displacement (rows, columns) into the body, mm, under pressures."""
        rows, columns = self._shape
        u = irfft2(rfft2(pressure_kpa, self._padded) * self._spectrum, self._padded)
        return u[:rows, :columns]

    def press(self, below_mm: np.ndarray) -> tuple[np.ndarray, float]:
        """Displacement (rows, columns) in mm by a rigid object, and the force in N.

        `below_mm` (rows, columns) is how far its surface lies below the resting one; negative above it.
        """
        inside = below_mm > LEAST_MM
        if not inside.any():
            self._last = np.zeros(self._shape)
            return np.zeros(self._shape), 0.0
        p = np.where(inside, np.maximum(self._last, 1e-3), 0.0)  # the last contact is near
        way, before, small = np.zeros(self._shape), 1.0, TOLERANCE * below_mm.max()
        u, carry = self.displaced(p), 0.0
        for _ in range(STEPS):
            miss, held = below_mm - u, p > 0
            size = float(np.square(miss[held]).sum())
            way = np.where(held, miss + carry * size / before * way, 0.0)
            answer = self.displaced(way)
            bears = float(answer[held] @ way[held])
            if not bears > 0:  # a step too far let go everywhere: start again, without the last contact
                p, carry = np.where(inside, 1e-3, 0.0), 0.0
                u = self.displaced(p)
                continue
            length = float(miss[held] @ way[held]) / bears
            p = np.maximum(p + length * way, 0.0)
            fresh = (p == 0) & (miss > small)
            p[fresh] = length * miss[fresh]
            carry, before = 0.0 if fresh.any() else 1.0, size
            u = self.displaced(p)
            if (below_mm - u).max() < small and np.abs((below_mm - u)[p > 0]).max() < small:
                break
        self._last = p
        return u, 1e-3 * self._area * float(p.sum())  # kPa mm^2 are mN


def love(x, y, a: float, b: float) -> np.ndarray:
    """Pi E* u / p at (x, y) under an even pressure p on a rectangle 2a by 2b, mm."""

    def corner(s, t):
        along, across = (np.maximum(np.abs(v), 1e-12) for v in (s, t))
        return s * np.arcsinh(t / along) + t * np.arcsinh(s / across)

    return corner(x + a, y + b) - corner(x - a, y + b) - corner(x + a, y - b) + corner(x - a, y - b)


class Gel:
    """One sensor, whose modulus is E / (1 - nu^2).

    Its face bulges by a large radius `dome_mm`, so a plane meets it as a ball does (Hertz 1882; Johnson,
    Contact Mechanics (1985) ch. 4). `rest_image` is uint8 (H, W, 3) without contact, `rest_mm` (rows,
    columns) the height of the resting face over x (columns,) and y (rows,), `xs_mm`, `ys_mm`.
    """

    shape = (64, 48)  # rows and columns of contact and light

    def __init__(
        self,
        image_shape: tuple[int, int, int] = (320, 240, 3),
        window_mm: tuple[float, float] = (12.0, 16.0),
        modulus_kpa: float = 130.0,
        dome_mm: float = 35.0,
        lamps: Lamps | None = None,
    ):
        rows, columns = self.shape
        self._size, self.modulus_kpa, self.dome_mm = image_shape[1::-1], modulus_kpa, dome_mm
        cell = window_mm[0] / columns, window_mm[1] / rows
        self.xs_mm = (np.arange(columns) + 0.5 - columns / 2) * cell[0]
        self.ys_mm = (np.arange(rows) + 0.5 - rows / 2) * cell[1]
        self.rest_mm = -(self.xs_mm[None, :] ** 2 + self.ys_mm[:, None] ** 2) / (2 * dome_mm)
        self._body = HalfSpace(modulus_kpa, cell, self.shape)
        self._lamps = lamps or Lamps()
        blotches = np.random.default_rng(7).standard_normal(image_shape[:2])
        blotches = cv2.GaussianBlur(blotches, (0, 0), 12.0)  # of about a millimetre
        self._paint = (1 + 0.02 * blotches / blotches.std())[..., None]  # what the coat reflects
        self.rest_image = self.image(np.zeros(self.shape))

    def press(self, kinds, sizes_mm, places_mm, turns, left_mm=0.0) -> tuple[np.ndarray, float]:
        """Displacement (rows, columns) of the face in mm and the force in N under objects, see `reach_below`.

        `left_mm` (rows, columns) is displacement that is left of what came before.
        """
        reach = reach_below(kinds, sizes_mm, places_mm, turns, self.xs_mm, self.ys_mm)
        moved, force = self._body.press(reach + self.rest_mm - left_mm)
        return left_mm + moved, force

    def image(self, displacement_mm: np.ndarray) -> np.ndarray:
        """Picture uint8 (H, W, 3) of a displaced face."""
        levels = light(self.rest_mm - displacement_mm, self.xs_mm, self.ys_mm, self._lamps)
        large = cv2.resize(levels, self._size, interpolation=cv2.INTER_CUBIC)
        return np.clip(large * self._paint, 0, 255).round().astype(np.uint8)

    def force_n(self, depth_mm: float) -> float:
        """Force of a plane that is pressed in by a depth: 4/3 E* sqrt(R d^3), Hertz."""
        return 4 / 3 * 1e-3 * self.modulus_kpa * np.sqrt(self.dome_mm * max(depth_mm, 0.0) ** 3)
