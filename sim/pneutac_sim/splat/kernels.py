"""Projects Gaussians into the image plane and lists them by image tile, near to far.

EWA splatting (Zwicker et al. 2001) with the conventions of 3D Gaussian splatting (Kerbl et al. 2023):
0.3 px^2 are added to both variances of a projected Gaussian, and it reaches as far as
alpha = opacity exp(-sigma) is at least 1/255.
"""

import math

import numpy as np
from numba import njit

TILE = 16
NEAR_M = 1e-3  # what lies nearer to the camera is left out
BLUR_PX2 = 0.3
LEAST_ALPHA = np.float32(1 / 255)


@njit(inline="always")
def _image_plane(u, v, lens):
    """OpenCV's distortion of a point (u, v) at unit depth."""
    k1, k2, p1, p2, k3 = lens[0], lens[1], lens[2], lens[3], lens[4]
    # x = u (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 u v + p2 (r^2 + 2 u^2), y alike (Brown 1966)
    r2 = u * u + v * v
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    x = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)
    y = v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v
    return x, y


@njit(cache=True)
def project_points(points, K, E, lens, pixels, depth):
    """Writes pixels (n, 2) and depth (n,) of points (n, 3)."""
    for i in range(len(points)):
        a, b, c = points[i]
        z = E[2, 0] * a + E[2, 1] * b + E[2, 2] * c + E[2, 3]
        depth[i] = z
        z = z if abs(z) > 1e-12 else 1e-12
        u = (E[0, 0] * a + E[0, 1] * b + E[0, 2] * c + E[0, 3]) / z
        v = (E[1, 0] * a + E[1, 1] * b + E[1, 2] * c + E[1, 3]) / z
        x, y = _image_plane(u, v, lens)
        pixels[i, 0] = K[0, 0] * x + K[0, 2]
        pixels[i, 1] = K[1, 1] * y + K[1, 2]


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
        x, y = _image_plane(u, v, lens)
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
