"""What kernels of the total-Lagrangian solver share: one struct of numbers and flat arrays, and its indices.

On the CPU the component of a vector is the fastest index, on a GPU the cell or node is, so that neighbouring
threads read neighbouring numbers (`soa`, structure of arrays).
"""

import numpy as np

from pneutac_sim.mpm.body import RestGrid, Spine
from pneutac_sim.mpm.runtime import struct, ti

# Columns of `load`, one row a body. KEEP is the share of momentum that a substep leaves.
MU, LAM, RHO, DT, KEEP, GRAVITY, POSE = 0, 1, 2, 3, 4, 5, 8
SIZE, FRICTION, SPRING, RATE, DRIFT, LOAD = 20, 23, 24, 25, 26, 29
# Rows of `chain`, a hinge: origin, axis at rest. Rows of `lump`, a link: mass, centre, inertia about it, all
# of unit density. Rows of `pose`, a link: rotation, shift. Rows of `wrench` and `momentum`, a link: force,
# torque.
CHAIN, LUMP, POSE_OF, SIX = 6, 13, 12, 6

ROOM = 64  # pieces into which the CPU cuts a large body

floats = ti.types.ndarray(dtype=ti.f32, ndim=1)
ints = ti.types.ndarray(dtype=ti.i32, ndim=1)
arrays = ti.template()  # how a function takes an array

# B bodies of C cells, N nodes and S surface points, with H hinges. `State` is what a kernel declares, `state`
# what a function does.
State, state = struct(
    bodies=ti.i32,
    cells=ti.i32,
    nodes=ti.i32,
    points=ti.i32,
    hinges=ti.i32,
    carried=ti.i32,  # nodes that the links carry
    samples=ti.i32,  # along an edge of `table`
    dx=ti.f32,  # grid spacing, m
    load=floats,  # (B, LOAD) what acts, see above
    u=floats,  # (B, N, 3) displacement of the nodes, m
    v=floats,  # (B, N, 3) their velocity, m/s
    total=floats,  # (B, N, 3) force on them, N
    before=floats,  # (B, N, 3) the same a substep ago
    force=floats,  # (B, C + 1, 27, 3) of each cell on its nodes, N; the last cell's stay zero
    tensor=floats,  # (B, C or ROOM, 3, 24) gradient, then stress, of a cell's eight particles
    spot_cell=ints,  # (S,) cell of a surface point
    cell_nodes=ints,  # (C, 27)
    cell_mask=ints,  # (C,) bits: which of the eight particles exist
    slots=ints,  # (N, 27) cells whose forces a node adds up
    ghost=ints,  # (N,) node beyond the clamped side that mirrors this one, or -1
    role=ints,  # (N,) -1 free, -2 a ghost, else the link that carries it
    volume=floats,  # (N,) m3
    inertia=floats,  # (N,) m3 of material whose mass the node's motion has
    rest=floats,  # (N, 3) m
    start=ints,  # (C + 1,) first surface point of each cell
    spot=floats,  # (S, 3) surface points at rest, m
    weights=floats,  # (S, 3, 3) their splines along x, y, z
    shape=ints,  # (B,) of the indenter
    table=floats,  # its signed distances, m
    anchor=floats,  # (B, S, 5) where a point stuck, whether it touches, what the contact remembers (N)
    contact=floats,  # (B, S, 4) force (N) and depth (m)
    q=floats,  # (B, H) rad
    qd=floats,  # (B, H) rad/s
    drive=floats,  # (B, H, 3) target, stiffness, damping
    chain=floats,  # (H, CHAIN)
    lump=floats,  # (H + 1, LUMP)
    pose=floats,  # (B, H + 1, POSE_OF)
    wrench=floats,  # (B, H + 1, SIX)
    momentum=floats,  # (B, H + 1, SIX)
    work=floats,  # (B, H, H + 1) equations of the joints
    soft=floats,  # (B, H) torque of body and gravity on them, N m
    bound=ints,  # (carried,) nodes, link by link
    bound_link=ints,  # (carried,)
    bound_start=ints,  # (H + 2,) first of each link
)


@ti.func
def place(b, i, d, n, soa: ti.template()):
    """Index of component d of vector i among n of body b."""
    at = (b * n + i) * 3 + d
    if ti.static(soa):
        at = (b * 3 + d) * n + i
    return at


@ti.func
def vector(array: arrays, b, i, n, soa: ti.template()):
    """Vector i of body b."""
    return ti.Vector([array[place(b, i, d, n, soa)] for d in ti.static(range(3))])


@ti.func
def pick(table: arrays, i, a, n, soa: ti.template()):
    """Entry a of 27 of row i among n."""
    at = i * 27 + a
    if ti.static(soa):
        at = a * n + i
    return table[at]


@ti.func
def slot(b, c, a, d, cells, soa: ti.template()):
    """Index of the force of cell c on its node a; one more cell, number `cells`, stays zero."""
    at = ((b * (cells + 1) + c) * 27 + a) * 3 + d
    if ti.static(soa):
        at = ((b * 27 + a) * 3 + d) * (cells + 1) + c
    return at


@ti.func
def inner(b, t, d, e, room, soa: ti.template()):
    """Index of number e of 24 of component d: gradient, then stress, along x, y, z at 8 particles.

    A GPU has room for every cell, t being its number; the CPU, which does one cell after another, for one a
    thread, so that it stays in the cache.
    """
    at = ((b * room + t) * 3 + d) * 24 + e
    if ti.static(soa):
        at = ((b * 3 + d) * 24 + e) * room + t
    return at


@ti.func
def matrix9(array: arrays, at):
    """A 3 x 3 matrix, row by row, from index `at`."""
    return ti.Matrix([[array[at + 3 * i + j] for j in ti.static(range(3))] for i in ti.static(range(3))])


@ti.func
def vector3(array: arrays, at):
    """A vector from index `at`."""
    return ti.Vector([array[at + d] for d in ti.static(range(3))])


def contents(
    grid: RestGrid, spine: Spine | None, link: np.ndarray, load: np.ndarray, table: np.ndarray, soa: bool
) -> dict:
    """Everything in `State` for bodies at rest, arrays still on the host.

    With the link that carries each node, (N,), -1 for none, loads (B, LOAD), the indenter's table (n, n, n)
    of signed distances in m, and whether cells and nodes are the fastest index (`soa`).
    """
    b, n, c, s = len(load), len(grid.nodes), len(grid.cell_mask), len(grid.surface_cell)
    hinges = spine.hinges if spine else 0
    h, links = max(hinges, 1), hinges + 1
    bound = np.lexsort((np.arange(n), link))[(link < 0).sum() :]
    order = (lambda a: a.T) if soa else (lambda a: a)
    zeros = np.zeros
    numbers = {"bodies": b, "cells": c, "nodes": n, "points": s, "hinges": hinges, "carried": len(bound)}
    return numbers | {
        "samples": len(table), "dx": float(grid.dx), "load": load, "u": zeros((b, n, 3)),
        "v": zeros((b, n, 3)), "total": zeros((b, n, 3)), "before": zeros((b, n, 3)),
        "force": zeros((b, c + 1, 27, 3)), "tensor": zeros((b, c if soa else ROOM, 3, 24)),
        "spot_cell": grid.surface_cell, "cell_nodes": order(grid.cell_nodes), "cell_mask": grid.cell_mask,
        "slots": order(grid.slots), "ghost": grid.ghost,
        "role": np.where(link >= 0, link, np.where(grid.mirrored, -2, -1)).astype(np.int32),
        "volume": grid.volume, "inertia": grid.volume, "rest": grid.nodes, "start": grid.surface_start,
        "spot": grid.surface_points, "weights": grid.surface_weights, "shape": zeros(b, np.int32),
        "table": table, "anchor": zeros((b, s, 5)), "contact": zeros((b, s, 4)), "q": zeros((b, h)),
        "qd": zeros((b, h)), "drive": zeros((b, h, 3)), "chain": spine.chain if spine else zeros((1, CHAIN)),
        "lump": spine.lumps(grid, link) if spine else zeros((1, LUMP)),
        "pose": np.tile(np.concatenate([np.eye(3).ravel(), zeros(3)]), (b, links, 1)),
        "wrench": zeros((b, links, SIX)), "momentum": zeros((b, links, SIX)),
        "work": zeros((b, h, hinges + 1)), "soft": zeros((b, h)), "bound": bound.astype(np.int32),
        "bound_link": link[bound].astype(np.int32),
        "bound_start": np.searchsorted(link[bound], np.arange(links + 1)).astype(np.int32),
    }  # fmt: skip


def flat(a: np.ndarray) -> np.ndarray:
    """As the kernels hold it: one line of float32 or int32."""
    a = np.ascontiguousarray(a)
    return (a if a.dtype == np.int32 else a.astype(np.float32)).ravel()


def send(a: np.ndarray):
    """A copy on the device; one zero where there is nothing."""
    line = flat(a) if a.size else np.zeros(1, np.float32 if a.dtype != np.int32 else np.int32)
    out = ti.ndarray(dtype=ti.i32 if line.dtype == np.int32 else ti.f32, shape=(len(line),))
    out.from_numpy(line)
    return out
