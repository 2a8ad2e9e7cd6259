"""Static equilibrium of a continuous elastic rod: geometrically exact, solved by shooting from its base.

The rod is clamped at the base, curved and stretched by air in its chamber, and bent by dead loads. Forces and
moments are divided by the bending stiffness, so a moment has the unit 1/mm and a force 1/mm^2. Equations:
Antman, Nonlinear Problems of Elasticity, 2nd ed., ch. 8; shooting for soft robots: Till, Aloi and Rucker,
Int. J. Robotics Research 38 (2019) 723.

A wall in the tip's way: a compliant plane that may let go when pressed too hard.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

ELEMENTS = 80
# Bending over twisting stiffness; of a round, incompressible rod it is 1.5, of a chambered one less.
TWIST_COMPLIANCE = 1.3

# Columns of the rod's inputs per solve.
BEND_Z, BEND_Y, SET_Z, SET_Y, TWIST, STRETCH, SOFT = range(7)
WEIGHT = slice(7, 10)  # of the rod, 1/mm^2 per mm of length
BASE_TURN = slice(13, 16)  # rotation vector of the mount, rad
TIP_FORCE = slice(16, 19)  # other forces at the marker
COLUMNS = 19


@dataclass(frozen=True)
class Rod:
    """Geometry of one rod."""

    length_mm: float  # of the flexible part
    tip_mm: float  # length of the rigid tip piece behind it; the marker sits at its end
    shapes: np.ndarray  # (3, elements) curvature per radian of bend by air, of bend by memory, and of twist
    stretched: np.ndarray  # (elements,) strain per unit of stretch
    axial: float  # stretching compliance over bending compliance, mm^2

    @classmethod
    def of(cls, length_mm, tip_mm, start, end, taper, radius_mm, elements=ELEMENTS) -> "Rod":
        """A chamber from `start` to `end` (shares of the length) whose gain falls by `taper` along it.

        What the material remembers is spread over the whole length, more at the base.
        """
        s = (np.arange(elements) + 0.5) / elements
        edge = 0.02  # the chamber's ends are rounded
        inside = 0.5 * (np.tanh((s - start) / edge) - np.tanh((s - end) / edge))
        air = inside * (1 + taper * (0.5 - (s - start) / (end - start)))
        memory = inside * (1.3 - 0.6 * s) + 0.05
        h = length_mm / elements
        unit = [x / (x.sum() * h) for x in (air, memory, np.ones(elements))]
        return cls(length_mm, tip_mm, np.stack(unit), inside, radius_mm**2 / 4)

    def solve(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Marker positions (n, 3) in mm and tangents at the tip (n, 3), each row solved on from the last.

        Rows (n, COLUMNS) hold bends, stretch and loads. Raises ArithmeticError where one has no equilibrium
        near the one before (the loads are beyond buckling).
        """
        inputs = np.ascontiguousarray(inputs, float)
        h = self.length_mm / self.shapes.shape[1]
        tips, tangents, bad = _solve_rows(inputs, self.shapes, self.stretched, h, self.tip_mm, self.axial)
        if bad >= 0:
            raise ArithmeticError(f"The rod has no equilibrium in row {bad}; its loads are too large.")
        return tips, tangents


@njit(cache=True)
def _turn(R, v):
    """R exp(v): rotates the frame R (3, 3; columns are directors) by the vector v of its own axes."""
    a2 = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    if a2 < 1e-10:
        s, c = 1.0 - a2 / 6.0, 0.5 - a2 / 24.0
    else:
        a = math.sqrt(a2)
        s, c = math.sin(a) / a, (1.0 - math.cos(a)) / a2
    E = np.empty((3, 3))
    x, y, z = v
    E[0, 0] = 1.0 - c * (y * y + z * z)
    E[1, 1] = 1.0 - c * (x * x + z * z)
    E[2, 2] = 1.0 - c * (x * x + y * y)
    E[0, 1] = c * x * y - s * z
    E[1, 0] = c * x * y + s * z
    E[0, 2] = c * x * z + s * y
    E[2, 0] = c * x * z - s * y
    E[1, 2] = c * y * z - s * x
    E[2, 1] = c * y * z + s * x
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            out[i, j] = R[i, 0] * E[0, j] + R[i, 1] * E[1, j] + R[i, 2] * E[2, j]
    return out


@njit(cache=True)
def _sub_cross(m, a, b, f):
    m[0] -= f * (a[1] * b[2] - a[2] * b[1])
    m[1] -= f * (a[2] * b[0] - a[0] * b[2])
    m[2] -= f * (a[0] * b[1] - a[1] * b[0])


@njit(cache=True)
def _shoot(m0, u, shapes, stretched, h, tip_mm, axial, miss, tip, tangent):
    """Integrates from the base with moment `m0` (midpoint rule); fills what the moment at the tip misses."""
    n_el = shapes.shape[1]
    R, m = _turn(np.eye(3), u[13:16]), m0.copy()
    r, last = np.zeros(3), np.zeros(3)
    half, n, k, a = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for e in range(n_el):
        left = (n_el - e - 0.5) * h
        for i in range(3):
            n[i] = u[7 + i] * left + u[10 + i] + u[16 + i]
            half[i] = m[i]
        _sub_cross(half, R[:, 0], n, 0.5 * h)
        for j in range(3):
            a[j] = R[0, j] * half[0] + R[1, j] * half[1] + R[2, j] * half[2]
        # the frame is half an element further on by now
        b0 = a[0] - 0.5 * h * (last[1] * a[2] - last[2] * a[1])
        b1 = a[1] - 0.5 * h * (last[2] * a[0] - last[0] * a[2])
        b2 = a[2] - 0.5 * h * (last[0] * a[1] - last[1] * a[0])
        k[0] = u[4] * shapes[2, e] + u[6] * TWIST_COMPLIANCE * b0
        k[1] = -(u[0] * shapes[0, e] + u[2] * shapes[1, e]) + u[6] * b1
        k[2] = u[1] * shapes[0, e] + u[3] * shapes[1, e] + u[6] * b2
        last[:] = k
        R = _turn(R, 0.5 * h * k)
        pull = n[0] * R[0, 0] + n[1] * R[1, 0] + n[2] * R[2, 0]
        f = h * (1.0 + u[5] * stretched[e] + u[6] * axial * pull)
        for i in range(3):
            r[i] += f * R[i, 0]
        _sub_cross(m, R[:, 0], n, f)
        R = _turn(R, 0.5 * h * k)
    for i in range(3):
        tip[i] = r[i] + tip_mm * R[i, 0]
        tangent[i] = R[i, 0]
        n[i] = 0.5 * u[10 + i] + u[16 + i]  # the piece's weight acts at its middle, others at the marker
        miss[i] = m[i]
    _sub_cross(miss, R[:, 0], n, tip_mm)


@njit(cache=True)
def _solve_one(m0, J, u, shapes, stretched, h, tip_mm, axial, tip, tangent):
    """Newton on the base moment; J is reused from row to row and renewed when it no longer serves."""
    miss, other, t2, d2 = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    if not u[7:19].any():  # no load
        m0[:] = 0.0
        _shoot(m0, u, shapes, stretched, h, tip_mm, axial, miss, tip, tangent)
        return True
    _shoot(m0, u, shapes, stretched, h, tip_mm, axial, miss, tip, tangent)
    for trial in range(40):
        size = math.sqrt(miss[0] ** 2 + miss[1] ** 2 + miss[2] ** 2)
        if size < 1e-9:
            return True
        if not math.isfinite(size):
            return False
        if trial % 3 == 2 or J[0, 0] == 0.0:
            for j in range(3):
                shifted = m0.copy()
                shifted[j] += 1e-6
                _shoot(shifted, u, shapes, stretched, h, tip_mm, axial, other, t2, d2)
                for i in range(3):
                    J[i, j] = (other[i] - miss[i]) / 1e-6
        det = np.linalg.det(J)
        if det == 0.0 or not math.isfinite(det):
            return False
        m0 -= np.linalg.solve(J, miss)
        _shoot(m0, u, shapes, stretched, h, tip_mm, axial, miss, tip, tangent)
    return False


@njit(cache=True)
def _solve_rows(inputs, shapes, stretched, h, tip_mm, axial):
    n = len(inputs)
    tips, tangents = np.empty((n, 3)), np.empty((n, 3))
    m0, J = np.zeros(3), np.zeros((3, 3))
    for i in range(n):
        if i and (inputs[i] == inputs[i - 1]).all():
            tips[i], tangents[i] = tips[i - 1], tangents[i - 1]
            continue
        if not _solve_one(m0, J, inputs[i], shapes, stretched, h, tip_mm, axial, tips[i], tangents[i]):
            m0[:] = 0.0  # a jump between rows: start afresh, the load in steps
            u = inputs[i].copy()
            J[:] = 0.0
            ok = True
            for part in range(1, 9):
                u[7:13] = inputs[i, 7:13] * part / 8
                u[16:19] = inputs[i, 16:19] * part / 8
                ok = _solve_one(m0, J, u, shapes, stretched, h, tip_mm, axial, tips[i], tangents[i])
            if not ok:
                return tips, tangents, i
    return tips, tangents, -1


def against_wall(rod: Rod, inputs: np.ndarray, bend_rad: float, wall: dict) -> np.ndarray:
    """Marker (n, 3) of a rod that meets a wall across the plain device's path.

    The wall pushes back in proportion to how deep the tip is in it. Where it can let go, the tip passes once
    that push would hold it back by more than `lets_go` of the way, and is free until it has come back.
    """
    at, ahead, compliance, way = place(rod, bend_rad, wall)
    k = wall["stiffness"] / compliance
    free = rod.solve(inputs)[0]
    depth = (free - at) @ ahead
    push = k * np.clip(depth, 0, None) / (1 + wall["stiffness"])
    pushed, held = inputs.copy(), free
    touching = depth > 0
    for _ in range(12):
        pushed[:, TIP_FORCE] = -push[:, None] * ahead
        held = rod.solve(pushed)[0]
        miss = np.where(touching, k * ((held - at) @ ahead) - push, 0.0)
        push = np.clip(push + miss / (1 + wall["stiffness"]), 0, None)
        if np.abs(miss).max() < 1e-4 * k * way:
            break
    slips, past = push * compliance > wall["lets_go"] * way, np.zeros(len(depth), bool)
    for i in range(len(depth)):  # from where it slips until it is back in front
        past[i] = depth[i] > 0 and (slips[i] or (i > 0 and past[i - 1]))
    return np.where(past[:, None], free, held)


def place(rod: Rod, bend_rad: float, wall: dict) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Where a wall stands in the plain device's path.

    Returns a point of it (3,) in mm, the way ahead (3,) into it, the tip's compliance along that way in mm^3
    (force over bending stiffness) and the length of the path in mm.
    """
    probe = np.zeros((3, COLUMNS))
    probe[:, SOFT] = 1
    probe[:, BEND_Z] = bend_rad * (1 - wall["taken"] + np.array([-0.01, 0, 0.01]))
    path = rod.solve(probe)[0]
    at, along = path[1], path[2] - path[0]
    ahead = along / np.linalg.norm(along)
    little = 1e-3 / rod.length_mm**2
    probe[1, TIP_FORCE] = little * ahead
    compliance = (rod.solve(probe[1:2])[0][0] - at) @ ahead / little
    return at, ahead, float(compliance), float(50 * np.linalg.norm(along))
