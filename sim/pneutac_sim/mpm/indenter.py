"""Rigid indenters: signed distance in their own frame, negative inside, and the contact law.

Contact is a stiff spring between each point of the body's surface and the indenter, with Coulomb friction by
a second spring from where the point first stuck: at rest nothing creeps, and what the body feels the indenter
feels with the opposite sign.

An indenter of any form for the material points: its signed distance on a cube.
"""

import numpy as np

from pneutac_sim.gel.indenter import AnyFigure
from pneutac_sim.mpm.runtime import ti

SHAPES = ("none", "sphere", "cylinder", "cube", "cone", "edge", "mesh")
NONE, SPHERE, CYLINDER, CUBE, CONE, EDGE, MESH = range(len(SHAPES))


@ti.func
def _box(p, half):
    q = ti.abs(p) - half
    outside = ti.max(q, ti.Vector([0.0, 0.0, 0.0]))
    return outside.norm() + ti.min(ti.max(q[0], q[1], q[2]), 0.0)


@ti.func
def _mesh(p, table: ti.template(), cells: int, half):
    """Trilinear look-up in a cube of `cells`^3 samples over [-half, half]; outside it, the distance to it."""
    edge = ti.min(ti.max(p, -half), half)
    g = (edge / half + 1.0) * 0.5 * (cells - 1)
    i = ti.min(ti.cast(ti.floor(g), ti.i32), cells - 2)
    f = g - ti.cast(i, ti.f32)
    d = 0.0
    for a, b, c in ti.static(ti.ndrange(2, 2, 2)):
        w = (f[0] if a else 1.0 - f[0]) * (f[1] if b else 1.0 - f[1]) * (f[2] if c else 1.0 - f[2])
        d += w * table[((i[0] + a) * cells + i[1] + b) * cells + i[2] + c]
    return d + (p - edge).norm()


@ti.func
def distance(shape: int, size, p, table: ti.template(), cells: int):
    """Signed distance (m) of the point `p` (m, in the indenter's frame, whose tip lies at the origin).

    The indenter extends towards +z. Sizes (m): sphere: radius; cylinder (its flat end down), cone (its point
    down): radius, height; cube: half edges; edge (a roof with a right angle, ridge along y): half length
    along y, height; mesh: half the edge of its table.
    """
    d = 1e9
    if shape == SPHERE:
        d = (p - ti.Vector([0.0, 0.0, size[0]])).norm() - size[0]
    elif shape == CYLINDER:
        r = ti.sqrt(p[0] * p[0] + p[1] * p[1]) - size[0]
        z = ti.abs(p[2] - 0.5 * size[1]) - 0.5 * size[1]
        d = ti.sqrt(ti.max(r, 0.0) ** 2 + ti.max(z, 0.0) ** 2) + ti.min(ti.max(r, z), 0.0)
    elif shape == CUBE:
        d = _box(p - ti.Vector([0.0, 0.0, size[2]]), size)
    elif shape == CONE:
        # Distance to the flank in the plane of axis and point; the base is far above what is indented.
        length = ti.sqrt(size[0] * size[0] + size[1] * size[1])
        r = ti.sqrt(p[0] * p[0] + p[1] * p[1])
        along = (r * size[0] + p[2] * size[1]) / length
        d = (r * size[1] - p[2] * size[0]) / length
        if along < 0.0:
            d = ti.sqrt(r * r + p[2] * p[2])
        d = ti.max(d, p[2] - size[1])
    elif shape == EDGE:
        d = ti.max((ti.abs(p[0]) - p[2]) * 0.70710678, ti.abs(p[1]) - size[1], p[2] - size[2])
    elif shape == MESH:
        d = _mesh(p, table, cells, size[0])
    return d


@ti.func
def probe(shape: int, size, p, table: ti.template(), cells: int, step: float):
    """Outward unit normal, by central differences over `step` m, and signed distance, as one vector of four.

    Further than 30 um outside the indenter the normal is zero.
    """
    out = ti.Vector([0.0, 0.0, 0.0, 0.0])
    # One loop instead of seven calls: each call would be compiled in full.
    evaluations = 7
    e = 0
    while e < evaluations:
        at = p
        sign = 1.0 - 2.0 * (e % 2)
        for a in ti.static(range(3)):
            if (e + 1) // 2 == a + 1:
                at[a] += sign * step
        d = distance(shape, size, at, table, cells)
        if e == 0:
            out[3] = d
            if d > 3e-5:
                evaluations = 1
        for a in ti.static(range(3)):
            if (e + 1) // 2 == a + 1:
                out[a] += sign * d
        e += 1
    length = ti.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    if length > 0.0:
        for a in ti.static(range(3)):
            out[a] /= length
    return out


SAMPLES = 49  # along each edge of the cube
BELOW = 0.4  # of half its edge lies below the figure's lowest point


def half_edge_m(figure: AnyFigure) -> float:
    """Half the edge of the cube around a figure's tip, m."""
    return 1.25e-3 * figure.reach_mm


def centre_m(figure: AnyFigure) -> np.ndarray:
    """(3,) of the cube, from the figure's tip."""
    return np.array([0.0, 0.0, (1 - BELOW) * half_edge_m(figure)])


def distances_m(figure: AnyFigure) -> np.ndarray:
    """(n, n, n) signed distances over the cube: the table of `TotalLagrangian` for the indenter `mesh`."""
    line = np.linspace(-1, 1, SAMPLES) * half_edge_m(figure)
    points = np.stack(np.meshgrid(line, line, line, indexing="ij"), -1) + centre_m(figure)
    return 1e-3 * figure.distance_mm(1e3 * points.reshape(-1, 3)).reshape(points.shape[:3])
