"""Probe grid: how deep objects lie below the resting gel surface, straight from contact geometry.

Gel frame: x along image columns, y along image rows (downwards), z out of the sensor towards the object,
origin in the middle of the gel window on the resting surface. At every grid point a line along z meets each
shape in an interval; its lower end below z = 0 is the depth, closed form for every shape but a mesh, whose
triangles are gone through. Grid points are the centres of equal cells, so that row i and column j sit at
pixel ((j + .5) W / 59, (i + .5) H / 80).
"""

import math

import numpy as np
from numba import njit

ROWS, COLS = 80, 59
WINDOW_MM = (12.0, 16.0)  # visible gel of a DIGIT at 240 x 320 pixels: about 20 px/mm (18.6 to 21.1 measured)
THICKNESS_MM = 2.5

# MuJoCo's geom type numbers and size conventions (radius; radius, half length; half extents).
SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX = 2, 3, 4, 5, 6
MESH = 7  # size = number of its first triangle, how many it has, m from its origin to its farthest corner
CONE = 100  # apex at local -z; size = base radius, half height
KINDS = (SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH, CONE)
NO_TRIANGLES = np.zeros((0, 3, 3))
_FAR = 1e9
_RIM = 1e-9  # by which a triangle is larger than it is, so that none slips between two
_FAST = {"nnan", "nsz", "arcp", "contract"}  # lets min, max and selections vectorise
_ORIGIN, _UPRIGHT = np.zeros(3), np.eye(3)


def probe_grid(
    kinds,
    sizes,
    positions,
    rotations,
    gel_position=_ORIGIN,
    gel_rotation=_UPRIGHT,
    window_mm: tuple[float, float] = WINDOW_MM,
    thickness_mm: float = THICKNESS_MM,
    shape: tuple[int, int] = (ROWS, COLS),
    triangles: np.ndarray = NO_TRIANGLES,
) -> np.ndarray:
    """Depth of objects below the resting gel surface.

    Args:
        kinds: (n,) shape numbers, MuJoCo's `geom_type` or `CONE`.
        sizes: (n, 3) m, MuJoCo's `geom_size`; of a `MESH` see there.
        positions: (n, 3) m, shape centres in the world, MuJoCo's `geom_xpos`.
        rotations: (n, 3, 3) or (n, 9), shape-to-world, MuJoCo's `geom_xmat`.
        gel_position: (3,) m, gel frame's origin in the world.
        gel_rotation: (3, 3) or (9,), gel-to-world.
        window_mm: width (columns) and height (rows) of the gel window.
        thickness_mm: gel thickness; depth is clipped there, and what lies wholly behind it does not count.
        shape: rows and columns of the grid.
        triangles: (m, 3, 3) m, corners of all meshes' triangles, each in its shape's frame.

    Returns:
        Depth in mm, float32, `shape`: the maximum over objects, zero where nothing touches.

    Raises ValueError: a shape number is unknown.
    """
    state = [[np.reshape(x, shape)] for x, shape in ((positions, (-1, 3)), (rotations, (-1, 9)))]
    state += [np.reshape(gel_position, (1, 3)), np.reshape(gel_rotation, (1, 9))]
    out = np.zeros((1, *shape), np.float32)
    return probe_grids(kinds, sizes, *state, window_mm, thickness_mm, out, triangles)[0]


def probe_grids(
    kinds,
    sizes,
    positions,
    rotations,
    gel_positions,
    gel_rotations,
    window_mm,
    thickness_mm,
    out: np.ndarray,
    triangles: np.ndarray = NO_TRIANGLES,
) -> np.ndarray:
    """`probe_grid` of the same shapes in B states, into the first B grids of `out`, which are returned.

    Positions are (B, n, 3) and rotations (B, n, 9), gel positions (B, 3) and gel rotations (B, 9); `out` is
    float32 (B or more, rows, columns). Raises ValueError as `probe_grid`.
    """
    count, n = np.shape(positions)[:2]
    known = _probe(
        np.asarray(kinds, np.int64).reshape(-1),
        np.asarray(sizes, np.float64).reshape(-1, 3),
        np.asarray(positions, np.float64),
        np.asarray(rotations, np.float64).reshape(count, n, 3, 3),
        np.asarray(gel_positions, np.float64),
        np.asarray(gel_rotations, np.float64).reshape(count, 3, 3),
        (window_mm[0] * 1e-3, window_mm[1] * 1e-3, thickness_mm * 1e-3),
        triangles,
        out,
    )
    if not known:
        raise ValueError(f"a probe grid knows shapes {KINDS} (MuJoCo geom types and CONE); got {list(kinds)}")
    return out[:count]


# Each span gives the interval of t where the line o + d t (shape frame, |d| = 1, s = size) is inside the
# shape, empty where lo > hi. They have no branches, so that the loop over grid points vectorises.


@njit(inline="always")
def _roots(a, b, c):
    """Ordered roots of a t^2 + 2 b t + c, a > 0; an empty interval where there are none."""
    q = b * b - a * c
    r = math.sqrt(max(q, 0.0)) / a
    m = -b / a
    return (m - r if q >= 0.0 else _FAR), (m + r if q >= 0.0 else -_FAR)


@njit(inline="always")
def _slab(o, d, h):
    """Interval of t with |o + d t| <= h; `d` must not be zero (see the caller)."""
    t1, t2 = (-h - o) / d, (h - o) / d
    return min(t1, t2), max(t1, t2)


@njit
def _sphere(s, ox, oy, oz, dx, dy, dz):
    return _roots(1.0, ox * dx + oy * dy + oz * dz, ox * ox + oy * oy + oz * oz - s[0] * s[0])


@njit
def _ellipsoid(s, ox, oy, oz, dx, dy, dz):
    ux, uy, uz = ox / s[0], oy / s[1], oz / s[2]
    vx, vy, vz = dx / s[0], dy / s[1], dz / s[2]
    v2 = vx * vx + vy * vy + vz * vz
    return _roots(v2, ux * vx + uy * vy + uz * vz, ux * ux + uy * uy + uz * uz - 1.0)


@njit
def _box(s, ox, oy, oz, dx, dy, dz):
    l1, h1 = _slab(ox, dx, s[0])
    l2, h2 = _slab(oy, dy, s[1])
    l3, h3 = _slab(oz, dz, s[2])
    return max(l1, max(l2, l3)), min(h1, min(h2, h3))


@njit
def _cylinder(s, ox, oy, oz, dx, dy, dz):
    l1, h1 = _roots(dx * dx + dy * dy, ox * dx + oy * dy, ox * ox + oy * oy - s[0] * s[0])
    l2, h2 = _slab(oz, dz, s[1])
    return max(l1, l2), min(h1, h2)


@njit
def _capsule(s, ox, oy, oz, dx, dy, dz):
    """The line enters and leaves through the sphere about the axis point nearest to the tube's hit."""
    lo, hi = _roots(dx * dx + dy * dy, ox * dx + oy * dy, ox * ox + oy * oy - s[0] * s[0])
    b, c = ox * dx + oy * dy + oz * dz, ox * ox + oy * oy - s[0] * s[0]
    z1 = min(max(oz + lo * dz, -s[1]), s[1])
    z2 = min(max(oz + hi * dz, -s[1]), s[1])
    l1, _ = _roots(1.0, b - z1 * dz, c + (oz - z1) * (oz - z1))
    _, h2 = _roots(1.0, b - z2 * dz, c + (oz - z2) * (oz - z2))
    return max(l1, lo), min(h2, hi)


@njit
def _cone(s, ox, oy, oz, dx, dy, dz):
    lo, hi = _slab(oz, dz, s[1])  # keeps the upper nappe alone
    k = (s[0] / (2.0 * s[1])) ** 2
    z = oz + s[1]  # measured from the apex
    a = dx * dx + dy * dy - k * dz * dz
    a = a if abs(a) > 1e-9 else -1e-9
    b = ox * dx + oy * dy - k * z * dz
    q = b * b - a * (ox * ox + oy * oy - k * z * z)
    r = math.sqrt(max(q, 0.0))
    t1, t2 = min((-b - r) / a, (-b + r) / a), max((-b - r) / a, (-b + r) / a)
    if a > 0.0:  # a line flatter than the cone's side
        lo, hi = max(lo, t1), min(hi, t2)
    elif dz > 0.0:  # steeper: the roots bound the gap between the two nappes
        lo = max(lo, t2)
    else:
        hi = min(hi, t1)
    return (lo if q >= 0.0 else _FAR), hi


@njit(inline="always")
def _nonzero(x):
    return x if abs(x) > 1e-9 else 1e-9


@njit(inline="always")
def _deeper(depth, lo, hi, thickness):
    """The larger of a depth [mm] and that of an interval [m]."""
    d = np.float32(min(-lo, thickness) * 1e3)
    touches = (lo <= hi) & (hi > -thickness)
    return max(depth, d if touches else np.float32(0.0))


@njit(fastmath=_FAST)
def _sweep(kind, size, c, R, ex, ey, width, height, thickness, depth):
    """Raises `depth` [mm] where the shape with centre c and rotation R (gel frame) lies deeper.

    One function for all kinds, each with a loop of its own along the rows: one for each kind would take six
    times as long to compile.
    """
    rows, cols = depth.shape
    sx, sy = width / cols, height / rows
    j0 = max(0, int(math.floor((c[0] - ex + width / 2) / sx)))
    j1 = min(cols, int(math.ceil((c[0] + ex + width / 2) / sx)) + 1)
    i0 = max(0, int(math.floor((c[1] - ey + height / 2) / sy)))
    i1 = min(rows, int(math.ceil((c[1] + ey + height / 2) / sy)) + 1)
    # the gel's z axis in the shape's frame, never zero so that no slab divides by it
    dx, dy, dz = _nonzero(R[2, 0]), _nonzero(R[2, 1]), _nonzero(R[2, 2])
    ax, ay, az = R[0, 0] * sx, R[0, 1] * sx, R[0, 2] * sx
    x0 = 0.5 * sx - width / 2 - c[0]
    for i in range(i0, i1):
        y0 = (i + 0.5) * sy - height / 2 - c[1]
        bx = R[0, 0] * x0 + R[1, 0] * y0 - R[2, 0] * c[2]
        by = R[0, 1] * x0 + R[1, 1] * y0 - R[2, 1] * c[2]
        bz = R[0, 2] * x0 + R[1, 2] * y0 - R[2, 2] * c[2]
        row = depth[i]
        if kind == SPHERE:
            for j in range(j0, j1):
                lo, hi = _sphere(size, bx + ax * j, by + ay * j, bz + az * j, dx, dy, dz)
                row[j] = _deeper(row[j], lo, hi, thickness)
        elif kind == BOX:
            for j in range(j0, j1):
                lo, hi = _box(size, bx + ax * j, by + ay * j, bz + az * j, dx, dy, dz)
                row[j] = _deeper(row[j], lo, hi, thickness)
        elif kind == CAPSULE:
            for j in range(j0, j1):
                lo, hi = _capsule(size, bx + ax * j, by + ay * j, bz + az * j, dx, dy, dz)
                row[j] = _deeper(row[j], lo, hi, thickness)
        elif kind == CYLINDER:
            for j in range(j0, j1):
                lo, hi = _cylinder(size, bx + ax * j, by + ay * j, bz + az * j, dx, dy, dz)
                row[j] = _deeper(row[j], lo, hi, thickness)
        elif kind == ELLIPSOID:
            for j in range(j0, j1):
                lo, hi = _ellipsoid(size, bx + ax * j, by + ay * j, bz + az * j, dx, dy, dz)
                row[j] = _deeper(row[j], lo, hi, thickness)
        else:
            for j in range(j0, j1):
                lo, hi = _cone(size, bx + ax * j, by + ay * j, bz + az * j, dx, dy, dz)
                row[j] = _deeper(row[j], lo, hi, thickness)


@njit
def _sweep_mesh(triangles, c, R, width, height, thickness, depth):
    """Raises `depth` [mm] where the mesh of these triangles (shape frame) lies deeper."""
    rows, cols = depth.shape
    low, high = np.empty(depth.shape), np.empty(depth.shape)
    for i in range(rows):
        for j in range(cols):
            low[i, j], high[i, j] = _FAR, -_FAR
    at = np.empty((3, 3))  # a triangle's corners: columns and rows from the first grid point, z
    u, v = np.empty(3), np.empty(3)
    for t in range(len(triangles)):
        for k in range(3):
            x, y, z = triangles[t, k]
            at[k, 0] = (R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + c[0] + width / 2) * cols / width - 0.5
            at[k, 1] = (R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + c[1] + height / 2) * rows / height - 0.5
            at[k, 2] = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + c[2]
        left, right = min(at[0, 0], at[1, 0], at[2, 0]), max(at[0, 0], at[1, 0], at[2, 0])
        top, bottom = min(at[0, 1], at[1, 1], at[2, 1]), max(at[0, 1], at[1, 1], at[2, 1])
        j0, j1 = max(math.ceil(left), 0), min(math.floor(right), cols - 1)
        i0, i1 = max(math.ceil(top), 0), min(math.floor(bottom), rows - 1)
        for k in range(3):
            u[k], v[k] = at[1, k] - at[0, k], at[2, k] - at[0, k]
        area = u[0] * v[1] - u[1] * v[0]
        if abs(area) < 1e-9:  # seen edge on
            continue
        # barycentric coordinates grow along a row by dp and dq
        dp, dq, dz = v[1] / area, -u[1] / area, (u[2] * v[1] - u[1] * v[2]) / area
        for i in range(i0, i1 + 1):
            x, y = -at[0, 0], i - at[0, 1]
            p, q = (x * v[1] - y * v[0]) / area, (u[0] * y - u[1] * x) / area
            first, last = float(j0), float(j1)
            for value, slope in ((p, dp), (q, dq), (1 - p - q, -dp - dq)):
                if slope > 0:
                    first = max(first, math.ceil((-_RIM - value) / slope))
                elif slope < 0:
                    last = min(last, math.floor((-_RIM - value) / slope))
                elif value < -_RIM:
                    last = -1.0
            z = at[0, 2] + p * u[2] + q * v[2]
            if first <= last:
                for j in range(int(first), int(last) + 1):
                    low[i, j], high[i, j] = min(low[i, j], z + j * dz), max(high[i, j], z + j * dz)
    for i in range(rows):
        for j in range(cols):
            if high[i, j] > -thickness:
                depth[i, j] = max(depth[i, j], np.float32(min(-low[i, j], thickness) * 1e3))


@njit(cache=True)
def _probe(kinds, sizes, positions, rotations, gel_positions, gel_rotations, gel, triangles, out):
    """Fills grids [mm] (B or more, rows, columns) with the maximum over shapes, all inputs in metres.

    Returns whether every shape was known. Products of matrices are loops, which compile faster than `@`.
    """
    width, height, thickness = gel
    c, R = np.empty(3), np.empty((3, 3))
    for b in range(len(positions)):
        depth, G = out[b], gel_rotations[b]
        for i in range(depth.shape[0]):
            for j in range(depth.shape[1]):
                depth[i, j] = 0.0
        for k in range(len(kinds)):
            kind, s = kinds[k], sizes[k]
            if kind != CONE and not (SPHERE <= kind <= MESH):
                return False
            for i in range(3):
                c[i] = 0.0
                for m in range(3):
                    c[i] += G[m, i] * (positions[b, k, m] - gel_positions[b, m])
                for j in range(3):
                    R[i, j] = 0.0
                    for m in range(3):
                        R[i, j] += G[m, i] * rotations[b, k, m, j]
            if kind == SPHERE or kind == CAPSULE:  # half extents along the shape's axes, then along the gel's
                e0, e1, e2, e3 = 0.0, 0.0, (s[1] if kind == CAPSULE else 0.0), s[0]
            elif kind == CYLINDER or kind == CONE:
                e0, e1, e2, e3 = s[0], s[0], s[1], 0.0
            elif kind == MESH:
                e0, e1, e2, e3 = 0.0, 0.0, 0.0, s[2]
            else:
                e0, e1, e2, e3 = s[0], s[1], s[2], 0.0
            ex = abs(R[0, 0]) * e0 + abs(R[0, 1]) * e1 + abs(R[0, 2]) * e2 + e3
            ey = abs(R[1, 0]) * e0 + abs(R[1, 1]) * e1 + abs(R[1, 2]) * e2 + e3
            ez = abs(R[2, 0]) * e0 + abs(R[2, 1]) * e1 + abs(R[2, 2]) * e2 + e3
            if c[2] - ez > 0.0 or c[2] + ez < -thickness:
                continue
            if kind != MESH:
                _sweep(kind, s, c, R, ex, ey, width, height, thickness, depth)
            elif abs(c[0]) - ex < width / 2 and abs(c[1]) - ey < height / 2:
                own = triangles[int(s[0]) : int(s[0] + s[1])]
                _sweep_mesh(own, c, R, width, height, thickness, depth)
    return True
