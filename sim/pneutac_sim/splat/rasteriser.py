"""Renders Gaussians on the CPU: many colours of one geometry.

EWA splatting (Zwicker et al. 2001) with the conventions of 3D Gaussian splatting (Kerbl et al. 2023):
0.3 px^2 are added to both variances of a projected Gaussian, and it reaches as far as
alpha = opacity exp(-sigma) is at least 1/255.

Gives Gaussians the looks of a picture: colours by one linear solve, then colours and opacities by Adam.
"""

import gc
import math
from threading import Thread
from typing import NamedTuple

import numpy as np
from numba import config, njit

from pneutac_sim.errors import InputError, finite_array
from pneutac_sim.splat.camera import Camera, image_plane

TILE = 16
NEAR_M = 1e-3  # what lies nearer to the camera is left out
BLUR_PX2 = 0.3
LEAST_ALPHA = np.float32(1 / 255)


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def project(
    share, shares, means, covariances, opacities, reach, K, E, lens, largest_r2, size, splats, boxes, keys
):
    """Projects one share of the Gaussians, without the interpreter's lock.

    Of means (n, 3) m, covariances (n, 3, 3) m^2, opacities (n,) and `reach` (n,), the standard deviations at
    which alpha falls to 1/255, negative where it never rises, all float32; then the numbers of a `Camera`.
    Filled are

    - splats (n, 8) float32: x, y [px]; a, b, c with sigma / 8 = a dx^2 + b dx dy + c dy^2; opacity; first and
      last pixel row;
    - boxes (n, 4) int16: first and last tile column, first and last tile row; last < first off the image;
    - keys (n,) float32: depth.
    """
    width, height = size
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    # the linear map of a Gaussian far off the image is taken at most 15 % outside of it
    u_low, u_high = -(cx / fx + 0.15 * width / fx), (width - cx) / fx + 0.15 * width / fx
    v_low, v_high = -(cy / fy + 0.15 * height / fy), (height - cy) / fy + 0.15 * height / fy
    for i in range(len(means) * share // shares, len(means) * (share + 1) // shares):
        boxes[i, 0], boxes[i, 1] = 0, -1
        m0, m1, m2 = means[i, 0], means[i, 1], means[i, 2]
        z = E[2, 0] * m0 + E[2, 1] * m1 + E[2, 2] * m2 + E[2, 3]
        keys[i] = z
        if z < NEAR_M or reach[i] < 0:
            continue
        u = (E[0, 0] * m0 + E[0, 1] * m1 + E[0, 2] * m2 + E[0, 3]) / z
        v = (E[1, 0] * m0 + E[1, 1] * m1 + E[1, 2] * m2 + E[1, 3]) / z
        if u * u + v * v > largest_r2:
            continue
        x, y = image_plane(u, v, lens)
        x, y = fx * x + cx, fy * y + cy
        u, v = min(max(u, u_low), u_high), min(max(v, v_low), v_high)
        # Kerbl eq. 5: S2 = J W S W^T J^T. j and k are the rows of J W, W the world-to-camera rotation and J
        # the Jacobian of the pixel by the point, ((fx/z, 0, -fx u/z), (0, fy/z, -fy v/z)).
        p, q = fx / z, fy / z
        j0, j1, j2 = p * (E[0, 0] - u * E[2, 0]), p * (E[0, 1] - u * E[2, 1]), p * (E[0, 2] - u * E[2, 2])
        k0, k1, k2 = q * (E[1, 0] - v * E[2, 0]), q * (E[1, 1] - v * E[2, 1]), q * (E[1, 2] - v * E[2, 2])
        S = covariances[i]
        s0 = S[0, 0] * j0 + S[0, 1] * j1 + S[0, 2] * j2
        s1 = S[1, 0] * j0 + S[1, 1] * j1 + S[1, 2] * j2
        s2 = S[2, 0] * j0 + S[2, 1] * j1 + S[2, 2] * j2
        xx = s0 * j0 + s1 * j1 + s2 * j2 + BLUR_PX2
        xy = s0 * k0 + s1 * k1 + s2 * k2
        s0 = S[0, 0] * k0 + S[0, 1] * k1 + S[0, 2] * k2
        s1 = S[1, 0] * k0 + S[1, 1] * k1 + S[1, 2] * k2
        s2 = S[2, 0] * k0 + S[2, 1] * k1 + S[2, 2] * k2
        yy = s0 * k0 + s1 * k1 + s2 * k2 + BLUR_PX2
        # the ellipse of LEAST_ALPHA: half widths reach sqrt(variance)
        rx, ry = reach[i] * math.sqrt(xx), reach[i] * math.sqrt(yy)
        if not (x + rx > 0 and x - rx < width and y + ry > 0 and y - ry < height):
            continue
        first_x, last_x = max(math.ceil(x - rx - 0.5), 0), min(math.floor(x + rx - 0.5), width - 1)
        first_y, last_y = max(math.ceil(y - ry - 0.5), 0), min(math.floor(y + ry - 0.5), height - 1)
        if last_x < first_x or last_y < first_y:
            continue
        det = xx * yy - xy * xy
        # sigma = (x - mu)^T S2^-1 (x - mu) / 2, kept over 8 (see `rasteriser`)
        out = splats[i]
        out[0], out[1] = x, y
        out[2], out[3], out[4] = yy / det / 16, -xy / det / 8, xx / det / 16
        out[5], out[6], out[7] = opacities[i], first_y, last_y
        boxes[i, 0], boxes[i, 1] = first_x // TILE, last_x // TILE
        boxes[i, 2], boxes[i, 3] = first_y // TILE, last_y // TILE


@njit(cache=True, nogil=True)
def bin_tiles(boxes, bits, tiles_x, tiles):
    """Lists of Gaussians by tile, near to far: where each tile's starts, int64 (tiles + 1,), and they, int32.

    `boxes` (n, 4) as of `project`; `bits` (n,) uint32 are the bit patterns of the depths, which order as
    these do; equal ones keep their order.
    """
    n = len(boxes)
    counts = np.zeros((3, 2049), np.int64)  # radix sort: digits of 11, 11 and 10 bits
    starts = np.zeros(tiles + 1, np.int64)
    order, other = np.empty(n, np.int32), np.empty(n, np.int32)
    m = 0
    for i in range(n):
        if boxes[i, 1] < boxes[i, 0]:
            continue
        order[m] = i
        m += 1
        for d in range(3):
            counts[d, ((bits[i] >> np.uint32(11 * d)) & np.uint32(2047)) + 1] += 1
        for ty in range(boxes[i, 2], boxes[i, 3] + 1):
            for tx in range(boxes[i, 0], boxes[i, 1] + 1):
                starts[ty * tiles_x + tx + 1] += 1
    for d in range(3):
        place = counts[d]
        for k in range(2048):
            place[k + 1] += place[k]
        for k in range(m):
            i = order[k]
            digit = (bits[i] >> np.uint32(11 * d)) & np.uint32(2047)
            other[place[digit]] = i
            place[digit] += 1
        order, other = other, order
    for t in range(tiles):
        starts[t + 1] += starts[t]
    ids = np.empty(starts[tiles], np.int32)
    place = starts.copy()
    for k in range(m):
        i = order[k]
        for ty in range(boxes[i, 2], boxes[i, 3] + 1):
            for tx in range(boxes[i, 0], boxes[i, 1] + 1):
                t = ty * tiles_x + tx
                ids[place[t]] = i
                place[t] += 1
    return starts, ids


# Composites listed Gaussians front to back, tile by tile, and takes that back to colours and opacities.
#
#     C = sum_i c_i alpha_i T_i + T_end background, T_i = prod_{j<i} (1 - alpha_j)  (Kerbl et al. 2023, eq. 3)
#
# alpha = opacity exp(-sigma) is at most 0.999 and left out below 1/255; a pixel is finished before its
# transmittance falls to 1e-4 (as there).
#
# Every kernel takes (share, shares) and does that share of the tiles, without the interpreter's lock, so that
# plain threads divide the work. A Gaussian touches rows of a tile whole, 16 lanes, with alpha = 0 off the
# Gaussian: loops of a fixed length without branches become vector instructions.


LEAST_TRANSMITTANCE = np.float32(1e-4)
MOST_ALPHA = np.float32(0.999)
_ZERO, _HALF, _ONE = np.float32(0), np.float32(0.5), np.float32(1)

# exp(-t) on 0 <= t <= 0.75 (relative error 2e-7), then squared three times: exp(-sigma) for sigma up to 6,
# which is enough since alpha < 1/255 beyond sigma = 5.55.
_E0, _E1, _E2 = np.float32(0.99999988), np.float32(-0.99998954), np.float32(0.49984699)
_E3, _E4, _E5 = np.float32(-0.16582602), np.float32(0.03952204), np.float32(-0.005698701)
_FARTHEST = np.float32(0.75)


@njit(inline="always")
def _alpha(lane, x, bdy, cdy2, a, opacity):
    """Uncut alpha and exp(-sigma) at a lane of a row, dx = lane centre - x."""
    dx = np.float32(lane) + _HALF - x
    t = (a * dx + bdy) * dx + cdy2
    # t = sigma / 8; exp(-sigma) = exp(-t)^8
    t = t if t < _FARTHEST else _FARTHEST
    e = _E0 + t * (_E1 + t * (_E2 + t * (_E3 + t * (_E4 + t * _E5))))
    e = e * e
    e = e * e
    e = e * e
    return opacity * e, e


@njit(inline="always")
def _cut(raw):
    alpha = raw if raw < MOST_ALPHA else MOST_ALPHA
    return alpha if raw >= LEAST_ALPHA else _ZERO


@njit(inline="always")
def _begin(state, x0, y0, width, height):
    """Transmittance 1 in the first 16 columns of a tile's state (16 rows, lanes), -1 off the image; rest 0.

    A negative transmittance marks a finished pixel: it takes no more colour but keeps its magnitude.
    """
    for row in range(TILE):
        for lane in range(state.shape[1]):
            state[row, lane] = _ZERO
        for lane in range(TILE):
            state[row, lane] = _ONE if (y0 + row < height) & (x0 + lane < width) else -_ONE


@njit(inline="always")
def _finished(state):
    most = -_ONE
    for row in range(TILE):
        for lane in range(TILE):
            most = state[row, lane] if state[row, lane] > most else most
    return most < _ZERO


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def composite(share, shares, starts, ids, splats, colours, background, tiles_x, image, alpha):
    """Composites colours (n, 3) front to back into `image` (H, W, 3) and `alpha` (H, W), all float32."""
    height, width = alpha.shape
    state = np.empty((TILE, 4 * TILE), np.float32)  # transmittance, red, green, blue
    for tile in range(share, len(starts) - 1, shares):
        x0, y0 = tile % tiles_x * TILE, tile // tiles_x * TILE
        if starts[tile] == starts[tile + 1]:
            image[y0 : y0 + TILE, x0 : x0 + TILE] = background
            alpha[y0 : y0 + TILE, x0 : x0 + TILE] = _ZERO
            continue
        _begin(state, x0, y0, width, height)
        for k in range(starts[tile], starts[tile + 1]):
            if (k & 15) == 0 and _finished(state):
                break
            s = splats[ids[k]]
            x, y, a, b, c, opacity = s[0] - np.float32(x0), s[1] - np.float32(y0), s[2], s[3], s[4], s[5]
            red, green, blue = colours[ids[k], 0], colours[ids[k], 1], colours[ids[k], 2]
            first, last = max(np.int64(s[6]) - y0, 0), min(np.int64(s[7]) - y0, TILE - 1)
            for row in range(first, last + 1):
                dy = np.float32(row) + _HALF - y
                bdy, cdy2, line = b * dy, c * dy * dy, state[row]
                for lane in range(TILE):
                    raw, _ = _alpha(lane, x, bdy, cdy2, a, opacity)
                    w = _cut(raw) * line[lane]  # alpha_i T_i
                    left = line[lane] - w  # T_{i+1} = T_i (1 - alpha_i)
                    goes_on = left > LEAST_TRANSMITTANCE
                    w = w if goes_on else _ZERO
                    line[lane] = left if goes_on else -abs(line[lane])
                    line[lane + 16] += w * red
                    line[lane + 32] += w * green
                    line[lane + 48] += w * blue
        for row in range(min(TILE, height - y0)):
            for lane in range(min(TILE, width - x0)):
                t = abs(state[row, lane])
                alpha[y0 + row, x0 + lane] = _ONE - t
                for k in range(3):
                    image[y0 + row, x0 + lane, k] = state[row, lane + 16 * (k + 1)] + t * background[k]


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def pull_back(share, shares, starts, ids, splats, grad_image, shading, tiles_x, out):
    """Gradients by colour, added to `out` (n, 3), by the pixels' `grad_image` (H, W, 3).

    With `shading`, colours (n, 3), what `composite` made of them, `image` and `alpha`, and the gradient by
    coverage (H, W), `out` is (n, 4) with those by opacity: all is composited once more, near to far. With
    r = g . (what lies behind a Gaussian, background included), g the gradient by the pixel,
    dL/dalpha = T g . c - r / (1 - alpha); a gradient by coverage acts as a background of its negative. All
    are float32.
    """
    height, width = grad_image.shape[:2]
    state = np.empty((TILE, 5 * TILE), np.float32)  # transmittance, g, r
    sums = np.empty(4 * TILE, np.float32)
    for tile in range(share, len(starts) - 1, shares):
        if starts[tile] == starts[tile + 1]:
            continue
        x0, y0 = tile % tiles_x * TILE, tile // tiles_x * TILE
        _begin(state, x0, y0, width, height)
        for row in range(min(TILE, height - y0)):
            for lane in range(min(TILE, width - x0)):
                p, q = y0 + row, x0 + lane
                for k in range(3):
                    state[row, lane + 16 * (k + 1)] = grad_image[p, q, k]
                if shading is not None:
                    _, image, alpha, grad_alpha = shading
                    # r_0 = g . C - dL/dA T_end, all that lies behind the camera's plane
                    behind = -grad_alpha[p, q] * (_ONE - alpha[p, q])
                    for k in range(3):
                        behind += grad_image[p, q, k] * image[p, q, k]
                    state[row, lane + 64] = behind
        for k in range(starts[tile], starts[tile + 1]):
            if (k & 15) == 0 and _finished(state):
                break
            i = ids[k]
            s = splats[i]
            x, y, a, b, c, opacity = s[0] - np.float32(x0), s[1] - np.float32(y0), s[2], s[3], s[4], s[5]
            if shading is not None:
                red, green, blue = shading[0][i, 0], shading[0][i, 1], shading[0][i, 2]
            first, last = max(np.int64(s[6]) - y0, 0), min(np.int64(s[7]) - y0, TILE - 1)
            sums[:] = _ZERO
            for row in range(first, last + 1):
                dy = np.float32(row) + _HALF - y
                bdy, cdy2, line = b * dy, c * dy * dy, state[row]
                for lane in range(TILE):
                    raw, e = _alpha(lane, x, bdy, cdy2, a, opacity)
                    cut, before = _cut(raw), line[lane]
                    w = cut * before
                    left = before - w
                    goes_on = left > LEAST_TRANSMITTANCE
                    w = w if goes_on else _ZERO
                    line[lane] = left if goes_on else -abs(before)
                    if shading is not None:
                        g_colour = line[lane + 16] * red + line[lane + 32] * green + line[lane + 48] * blue
                        behind = line[lane + 64] - w * g_colour
                        line[lane + 64] = behind
                        # dL/dopacity = dL/dalpha exp(-sigma), zero where alpha is cut
                        slope = (before * g_colour - behind / (_ONE - cut)) * e
                        slope = slope if goes_on else _ZERO
                        slope = slope if raw >= LEAST_ALPHA else _ZERO
                        slope = slope if raw <= MOST_ALPHA else _ZERO
                        sums[lane + 48] += slope
                    sums[lane] += w * line[lane + 16]
                    sums[lane + 16] += w * line[lane + 32]
                    sums[lane + 32] += w * line[lane + 48]
            for column in range(out.shape[1]):
                total = _ZERO
                for lane in range(TILE):
                    total += sums[lane + 16 * column]
                out[i, column] += total


MOST_THREADS = 8  # starting more costs longer than they save on a picture of a few milliseconds


class Rendering(NamedTuple):
    """A picture of Gaussians."""

    image: np.ndarray  # (H, W, 3) float32, 0 to 1 where colours and background are
    alpha: np.ndarray  # coverage, (H, W) float32, 0 to 1: one minus the share of the background in a pixel


class Splats:
    """Gaussians projected, ordered by depth and listed by image tile, ready for any colours.

    The image is linear in colours: image = W colours + (1 - alpha) background. Means are (n, 3) m,
    covariances (n, 3, 3) m^2, symmetric, opacities (n,) 0 to 1; they and the camera are attributes, float32.

    Raises InputError: a shape is wrong, a number not finite or an opacity outside 0 to 1.
    """

    def __init__(self, camera: Camera, means, covariances, opacities):
        means = numbers("means", means, (-1, 3))
        n = len(means)
        covariances = numbers("covariances", covariances, (n, 3, 3))
        opacities = numbers("opacities", opacities, (n,))
        if n and not (opacities.min() >= 0 and opacities.max() <= 1):
            raise InputError("Opacities of Gaussians must lie between 0 and 1.")
        self.camera, self.means = camera, means
        self.covariances, self.opacities = covariances, opacities
        visible = opacities >= LEAST_ALPHA
        reach = np.sqrt(2 * np.log(255 * opacities, where=visible, out=np.zeros_like(opacities)).clip(0))
        reach[~visible] = -1
        splats, boxes = np.empty((n, 8), np.float32), np.empty((n, 4), np.int16)
        depth = np.empty(n, np.float32)
        size = (camera.width, camera.height)
        view = (camera.intrinsics, camera.extrinsics, camera.lens, camera.largest_r2, size)
        _share(project, means, covariances, opacities, reach, *view, splats, boxes, depth)
        self._tiles_x, tiles_y = -(-camera.width // TILE), -(-camera.height // TILE)
        tiles = self._tiles_x * tiles_y
        self._lists = (*bin_tiles(boxes, depth.view(np.uint32), self._tiles_x, tiles), splats)

    def __len__(self):
        return len(self._lists[2])

    def with_opacities(self, opacities: np.ndarray) -> "Splats":
        """The same Gaussians with other opacities (n,)."""
        return Splats(self.camera, self.means, self.covariances, opacities)

    def render(self, colours, background=(0.0, 0.0, 0.0)) -> Rendering:
        """The picture with colours (n, 3) on a background (3,).

        Raises InputError where a shape is wrong or a number not finite.
        """
        colours = numbers("colours", colours, (len(self), 3))
        background = numbers("background", background, (3,))
        h, w = self.camera.height, self.camera.width
        out = Rendering(np.empty((h, w, 3), np.float32), np.empty((h, w), np.float32))
        _share(composite, *self._lists, colours, background, self._tiles_x, *out)
        return out

    def transpose(self, image) -> np.ndarray:
        """W^T times an image (H, W, 3): the gradient by colours alone, (n, 3) float32; raises as `render`."""
        image = numbers("image", image, (self.camera.height, self.camera.width, 3))
        return self._pull_back(image, None, 3)

    def gradients(
        self, colours, background, grad_image, grad_alpha=None, rendering: Rendering | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gradients of a loss by colours (n, 3) and by opacities (n,), float32; raises as `render`.

        Of its gradient by the image (H, W, 3) and, unless None, by the coverage (H, W). Geometry, and which
        Gaussians a pixel takes, are held fixed. `rendering` is what `render` gave; rendered again where None.
        """
        h, w = self.camera.height, self.camera.width
        colours = numbers("colours", colours, (len(self), 3))
        grad_image = numbers("grad_image", grad_image, (h, w, 3))
        image, alpha = rendering or self.render(colours, background)
        if grad_alpha is None:
            grad_alpha = np.zeros((h, w), np.float32)
        grad_alpha = numbers("grad_alpha", grad_alpha, (h, w))
        out = self._pull_back(grad_image, (colours, image, alpha, grad_alpha), 4)
        return out[:, :3], out[:, 3]

    def _pull_back(self, grad_image: np.ndarray, shading: tuple | None, columns: int) -> np.ndarray:
        """Sum over threads of what they add to each Gaussian, (n, columns)."""
        out = np.zeros((_shares(), len(self), columns), np.float32)
        inputs = *self._lists, grad_image, shading, self._tiles_x
        _share(lambda k, n, *rest: pull_back(k, n, *rest, out[k]), *inputs)
        return out.sum(0)


def numbers(name: str, values, shape: tuple[int, ...]) -> np.ndarray:
    """`values` as contiguous float32 of `shape`, where -1 stands for any length.

    Raises InputError where the shape differs or a number is not finite.
    """
    return finite_array(f"The rasteriser's {name}", values, shape, np.float32)


def _shares() -> int:
    return min(config.NUMBA_NUM_THREADS, MOST_THREADS)


def _share(kernel, *inputs) -> None:
    """Runs kernel(share, shares, *inputs) for every share at once.

    Threads live for one call: no pool to break when a process forks or when two threads render. Garbage is
    not collected meanwhile: what a material point solver left on a GPU only the thread that made it may free.
    """
    n = _shares()
    others = [Thread(target=kernel, args=(k, n, *inputs)) for k in range(1, n)]
    collects = gc.isenabled()
    gc.disable()
    try:
        for thread in others:
            thread.start()
        kernel(0, n, *inputs)
        for thread in others:
            thread.join()
    finally:
        if collects:
            gc.enable()


RIDGE = 1e-3  # weight of one colour's prior against one fully covered pixel
LEARNING_RATE = 0.01  # of the paper


class Adam:
    """Adam (Kingma and Ba 2015) on one array of float32 or float64, changed in place."""

    def __init__(self, values: np.ndarray, rate: float = LEARNING_RATE):
        self.values, self._rate, self._steps = values, rate, 0
        self._mean, self._square = np.zeros_like(values), np.zeros_like(values)

    def step(self, gradient: np.ndarray) -> None:
        """One step down a gradient of the values' shape."""
        self._steps += 1
        # m <- b1 m + (1 - b1) g, v <- b2 v + (1 - b2) g^2, b1 = 0.9, b2 = 0.999; their bias is in the rate
        self._mean += 0.1 * (gradient - self._mean)
        self._square += 1e-3 * (gradient**2 - self._square)
        rate = self._rate * np.sqrt(1 - 0.999**self._steps) / (1 - 0.9**self._steps)
        self.values -= rate * self._mean / (np.sqrt(self._square) + 1e-8)


def solve_colours(
    splats: Splats, target: np.ndarray, background=(0.0, 0.0, 0.0), iterations: int = 30, ridge: float = RIDGE
) -> np.ndarray:
    """Colours (n, 3), float32, 0 to 1, that render best as a picture (H, W, 3), 0 to 1, opacities fixed.

    Minimises |W c + (1 - alpha) background - target|^2 + ridge |c - prior|^2 by conjugate gradients on the
    normal equations, scaled by the weight that each Gaussian has in the picture; 5 iterations get most of the
    way. The prior is the picture's colour at each Gaussian's centre, so that Gaussians hidden behind others
    get a likely colour.

    Raises InputError where a shape is wrong or a number not finite.
    """
    camera = splats.camera
    target = numbers("target", target, (camera.height, camera.width, 3))
    last = camera.width - 1, camera.height - 1
    pixels = np.floor(camera.project(splats.means)[0]).clip(0, last).astype(int)
    colours = target[pixels[:, 1], pixels[:, 0]]

    def normal(c):
        return splats.transpose(splats.render(c).image) + ridge * c

    # (W^T W + ridge) c = W^T (target - (1 - alpha) background) + ridge prior; Jacobi's preconditioner
    scale = 1 / (splats.transpose(splats.render(np.ones_like(colours)).image) + ridge)
    residual = splats.transpose(target - splats.render(colours, background).image)
    direction = step = scale * residual
    energy = np.sum(residual * step, 0, np.float64)
    for _ in range(iterations):
        if not energy.any():
            break
        bent = normal(direction)
        length = energy / np.maximum(np.sum(direction * bent, 0, np.float64), 1e-30)
        colours = colours + length.astype(np.float32) * direction
        residual = residual - length.astype(np.float32) * bent
        step = scale * residual
        energy, before = np.sum(residual * step, 0, np.float64), energy
        direction = step + (energy / np.maximum(before, 1e-30)).astype(np.float32) * direction
    return np.clip(colours, 0, 1)


def fit_looks(
    splats: Splats,
    target: np.ndarray,
    background=(0.0, 0.0, 0.0),
    iterations: int = 100,
    coverage: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Colours (n, 3) and opacities (n,), float32, that render best as a picture (H, W, 3), 0 to 1.

    `solve_colours`, then Adam on colours and on logits of opacities, at the paper's rate; those to start from
    are clipped to 0.01 to 0.99, and the best iteration is taken. `coverage` (H, W), 0 to 1, is what is
    wanted, such as a silhouette; free where None.

    Raises InputError: a shape is wrong or a number not finite.
    """
    camera = splats.camera
    target = numbers("target", target, (camera.height, camera.width, 3))
    if coverage is not None:
        coverage = numbers("coverage", coverage, (camera.height, camera.width))
    opacities = np.clip(splats.opacities, 0.01, 0.99)
    splats = splats.with_opacities(opacities)
    colours = Adam(solve_colours(splats, target, background))
    logits = Adam(np.log(opacities / (1 - opacities)))
    best = (np.inf, colours.values.copy(), opacities)
    for iteration in range(iterations + 1):
        rendering = splats.render(colours.values, background)
        loss, grad_image, grad_alpha = _difference(rendering, target, coverage)
        if loss < best[0]:
            best = (loss, colours.values.copy(), opacities)
        if iteration == iterations:
            break
        by_colours, by_opacities = splats.gradients(
            colours.values, background, grad_image, grad_alpha, rendering
        )
        colours.step(by_colours)
        np.clip(colours.values, 0, 1, out=colours.values)
        logits.step(by_opacities * opacities * (1 - opacities))  # d sigmoid(x) / dx = s (1 - s)
        opacities = np.clip(1 / (1 + np.exp(-logits.values)), 0.01, 0.99)
        splats = splats.with_opacities(opacities)
    return best[1:]


def _difference(rendering: Rendering, target, coverage):
    """L = sum |I - target|^2 + (alpha - coverage)^2, and half its gradients by I and alpha."""
    grad_image = rendering.image - target
    loss = float(np.vdot(grad_image, grad_image))
    if coverage is None:
        return loss, grad_image, None
    grad_alpha = rendering.alpha - coverage
    return loss + float(np.vdot(grad_alpha, grad_alpha)), grad_image, grad_alpha
