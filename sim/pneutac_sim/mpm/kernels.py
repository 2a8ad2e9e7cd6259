"""Kernels of the total-Lagrangian solver: forces of cells, motion of nodes, spine and contact.

[V] de Vaucorbeil, Nguyen, Hutchinson 2020, 'A total-Lagrangian material point method for solid mechanics
problems involving large deformations'. Splines are taken at rest once and for all, so a particle p is no more
than a quadrature point, and only nodes i have a state: displacement u_i and velocity v_i.

    F_p = 1 + sum_i u_i (x) grad w_ip          deformation gradient
    f_i = - sum_p V_p P(F_p) grad w_ip + ...   V_p volume at rest, P first Piola-Kirchhoff stress
    m_i v_i' = f_i + m_i g

A cell writes the forces on its 27 nodes into slots of its own; a node then adds up the slots that are its:
no two threads write to one place, so sums have one order and a result is the same whatever else ran.

One substep is cells, nodes, spine. `within` does all substeps of a body with one thread (CPU) or one block
(GPU), for many or small bodies; `across` does one substep of all cells side by side, for a large body.

Kernels of the spine: a chain of hinges that carries nodes of the body and feels their forces.

The nodes of a link move with it as one rigid lump, so the joint feels just what the body does to these nodes
(virtual work): no coupling spring, no step size in the stiffness, action and reaction to rounding. Momentum
is computed per link and projected onto the joints at the new pose (Gauss' principle), which has the terms of
Coriolis in it; the controller's spring and damper are taken implicitly:

    (M + dt (D + dt K)) q'_new = J^T (p + dt w) + dt K (q_cmd - q),   q <- q + dt q'_new

with J the Jacobian of the links' motion, M = J^T diag(m, I) J, p and w their momenta and wrenches, K and D
the controller's stiffness and damping (Featherstone 2008, 'Rigid body dynamics algorithms', chapter 6).

What kernels of the total-Lagrangian solver share: one struct of numbers and flat arrays, and its indices.

On the CPU the component of a vector is the fastest index, on a GPU the cell or node is, so that neighbouring
threads read neighbouring numbers (`soa`, structure of arrays).
"""

import numpy as np

from pneutac_sim.mpm import indenter
from pneutac_sim.mpm.body import SLOPE, WEIGHT, RestGrid, Spine
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


LEAST_J = 0.2  # volume of a particle over that at rest, below which the material law is left
SPREAD_CPU = 512  # loops of up to so many iterations run on one thread

W = tuple(tuple(float(x) for x in row) for row in WEIGHT)
D = tuple(tuple(float(x) for x in row) for row in SLOPE)


@ti.func
def first_piola(G, mu, lam):
    """Neo-Hookean stress P = mu (F - F^-T) + lambda ln(J) F^-T of the displacement gradient G = F - 1.

    The slope of W = mu/2 (tr F^T F - 3) - mu ln J + lambda/2 (ln J)^2 (Bonet, Wood 2008, 'Nonlinear continuum
    mechanics for finite element analysis', section 6.4.3), which the paper's simulator has. With the
    cofactors C of F and j = J - 1, J F - C = G + G^T + (j - tr G) + j G - cof G has no difference of large
    numbers in it, so that small strains keep their digits. Between J = 1/2 and 2 the logarithm is its series
    in z = j / (2 + j), exact to float32 and several times faster. Below J = 1/5 the law goes on straight, so
    that a particle which is turned inside out for a moment finds back; no equilibrium with one is accepted.
    """
    cof = ti.Matrix.cols([G[:, 1].cross(G[:, 2]), G[:, 2].cross(G[:, 0]), G[:, 0].cross(G[:, 1])])
    one = ti.Matrix.identity(ti.f32, 3)
    # j = J - 1 = tr G + tr cof G + det G
    tr = G.trace()
    beyond = cof.trace() + G[0, 0] * cof[0, 0] + G[1, 0] * cof[1, 0] + G[2, 0] * cof[2, 0]
    j = tr + beyond
    k = ti.max(j, LEAST_J - 1.0)
    # ln(1 + k) = 2 (z + z^3 / 3 + z^5 / 5 + ...)
    z = k / (2.0 + k)
    y = z * z
    ln = 2.0 * z * (1.0 + y * (1 / 3 + y * (1 / 5 + y * (1 / 7 + y * (1 / 9 + y * (1 / 11))))))
    if not (k > -0.5 and k < 1.0):
        ln = ti.log(1.0 + k) + (j - k) / (1.0 + k)
    # P = (mu (J F - C) + lambda ln(J) C) / J, C = J F^-T = (1 + tr G) 1 - G^T + cof G
    shear = G + G.transpose() + beyond * one + j * G - cof + (k - j) * (one + G)
    return (mu * shear + (lam * ln) * ((1.0 + tr) * one - G.transpose() + cof)) * (1.0 / (1.0 + k))


@ti.func
def split(u0, u1, u2, k):
    """Even and odd part of the spline over three nodes in a row, times k.

    P is the mean and T half the difference of its values at the row's two particles, Q half the difference of
    its slopes over 4; half their sum over 4 is T again.
    """
    s = u0 + u2
    return ti.Vector([k * (0.6875 * u1 + 0.15625 * s), k * 0.125 * (u2 - u0), k * (0.0625 * s - 0.125 * u1)])


@ti.func
def join(P, T, Q):
    """Adjoint of `split`: from the three to the three nodes."""
    h, g = 0.15625 * P + 0.0625 * Q, 0.125 * T
    return ti.Vector([h - g, 0.6875 * P - 0.125 * Q, h + g])


@ti.func
def signs(a):
    """(8,) sums of the 8 numbers, entry 4 i + 2 j + k, with all products of signs."""
    b, c, d = ti.Vector.zero(ti.f32, 8), ti.Vector.zero(ti.f32, 8), ti.Vector.zero(ti.f32, 8)
    for i in ti.static(range(4)):
        b[2 * i], b[2 * i + 1] = a[2 * i] - a[2 * i + 1], a[2 * i] + a[2 * i + 1]
    for i in ti.static((0, 1, 4, 5)):
        c[i], c[i + 2] = b[i] - b[i + 2], b[i] + b[i + 2]
    for i in ti.static(range(4)):
        d[i], d[i + 4] = c[i] - c[i + 4], c[i] + c[i + 4]
    return d


@ti.func
def adjoint_signs(a):
    """Adjoint of `signs`."""
    b, c, d = ti.Vector.zero(ti.f32, 8), ti.Vector.zero(ti.f32, 8), ti.Vector.zero(ti.f32, 8)
    for i in ti.static(range(4)):
        b[2 * i], b[2 * i + 1] = a[2 * i] + a[2 * i + 1], a[2 * i + 1] - a[2 * i]
    for i in ti.static((0, 1, 4, 5)):
        c[i], c[i + 2] = b[i] + b[i + 2], b[i + 2] - b[i]
    for i in ti.static(range(4)):
        d[i], d[i + 4] = c[i] + c[i + 4], c[i + 4] - c[i]
    return d


@ti.func
def strain(b, c, t, d, room, data: state, soa: ti.template()):
    """Writes row d of G_p = sum_i u_i (x) grad w_ip at the 8 particles of cell c.

    The particles lie symmetric about the cell's middle, so along each axis three nodes give an even and an
    odd part (`split`), and the 8 gradients are sums of products of these with all signs (`signs`): 0.6 of
    the operations of summing splines.
    """
    z, y, a = ti.Matrix.zero(ti.f32, 9, 3), ti.Matrix.zero(ti.f32, 3, 9), ti.Matrix.zero(ti.f32, 3, 9)
    for r in ti.static(range(9)):
        row = ti.Vector(
            [
                data.u[place(b, pick(data.cell_nodes, c, 3 * r + k, data.cells, soa), d, data.nodes, soa)]
                for k in ti.static(range(3))
            ]
        )
        line = split(row[0], row[1], row[2], 4.0 / data.dx)
        for e in ti.static(range(3)):
            z[r, e] = line[e]
    for i, e in ti.static(ti.ndrange(3, 3)):
        line = split(z[3 * i, e], z[3 * i + 1, e], z[3 * i + 2, e], 1.0)
        for g in ti.static(range(3)):
            y[i, 3 * g + e] = line[g]
    for r in ti.static(range(9)):
        line = split(y[0, r], y[1, r], y[2, r], 1.0)
        for g in ti.static(range(3)):
            a[g, r] = line[g]
    # along the axis of the slope T, Q; along the others P, T
    gx = signs(ti.Vector([a[1 + i, 3 * j + k] for i, j, k in ti.static(ti.ndrange(2, 2, 2))]))
    gy = signs(ti.Vector([a[i, 3 * (1 + j) + k] for i, j, k in ti.static(ti.ndrange(2, 2, 2))]))
    gz = signs(ti.Vector([a[i, 3 * j + 1 + k] for i, j, k in ti.static(ti.ndrange(2, 2, 2))]))
    for p in ti.static(range(8)):
        data.tensor[inner(b, t, d, p, room, soa)] = gx[p]
        data.tensor[inner(b, t, d, 8 + p, room, soa)] = gy[p]
        data.tensor[inner(b, t, d, 16 + p, room, soa)] = gz[p]


@ti.func
def stress(b, c, t, p, room, data: state, soa: ti.template()):
    """Replaces the gradient at particle p of cell c by -V_p P, times what `spread` needs."""
    G = ti.Matrix.zero(ti.f32, 3, 3)
    for d, e in ti.static(ti.ndrange(3, 3)):
        G[d, e] = data.tensor[inner(b, t, d, 8 * e + p, room, soa)]
    # volume dx^3 / 8, slopes 4 / dx
    scale = -0.5 * data.dx * data.dx * ti.cast((data.cell_mask[c] >> p) & 1, ti.f32)
    P = first_piola(G, data.load[b * LOAD + MU], data.load[b * LOAD + LAM])
    for d, e in ti.static(ti.ndrange(3, 3)):
        data.tensor[inner(b, t, d, 8 * e + p, room, soa)] = scale * P[d, e]


@ti.func
def spread(b, c, t, d, room, data: state, touching: ti.template(), soa: ti.template()):
    """Writes component d of f_i = - sum_p V_p P_p grad w_ip + sum_s w_is f_s, s the surface points of c."""
    z, y, a = ti.Matrix.zero(ti.f32, 9, 3), ti.Matrix.zero(ti.f32, 3, 9), ti.Matrix.zero(ti.f32, 3, 9)
    gx = adjoint_signs(ti.Vector([data.tensor[inner(b, t, d, p, room, soa)] for p in ti.static(range(8))]))
    gy = adjoint_signs(
        ti.Vector([data.tensor[inner(b, t, d, 8 + p, room, soa)] for p in ti.static(range(8))])
    )
    gz = adjoint_signs(
        ti.Vector([data.tensor[inner(b, t, d, 16 + p, room, soa)] for p in ti.static(range(8))])
    )
    for i, j, k in ti.static(ti.ndrange(2, 2, 2)):
        a[1 + i, 3 * j + k] += gx[4 * i + 2 * j + k]
        a[i, 3 * (1 + j) + k] += gy[4 * i + 2 * j + k]
        a[i, 3 * j + 1 + k] += gz[4 * i + 2 * j + k]
    for r in ti.static(range(9)):
        line = join(a[0, r], a[1, r], a[2, r])
        for i in ti.static(range(3)):
            y[i, r] = line[i]
    for i, e in ti.static(ti.ndrange(3, 3)):
        line = join(y[i, e], y[i, 3 + e], y[i, 6 + e])
        for j in ti.static(range(3)):
            z[3 * i + j, e] = line[j]
    for r in ti.static(range(9)):
        line = join(z[r, 0], z[r, 1], z[r, 2])
        for k in ti.static(range(3)):
            z[r, k] = line[k]
    if ti.static(touching):
        for s in range(data.start[c], data.start[c + 1]):
            f = data.contact[(b * data.points + s) * 4 + d]
            if f != 0.0:
                for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
                    w = data.weights[s * 9 + i] * data.weights[s * 9 + 3 + j] * data.weights[s * 9 + 6 + k]
                    z[3 * i + j, k] += w * f
    for r, k in ti.static(ti.ndrange(9, 3)):
        data.force[slot(b, c, 3 * r + k, d, data.cells, soa)] = z[r, k]


@ti.func
def gather(b, n, data: state, soa: ti.template()):
    """Force on node n: the sum of its slots."""
    f = ti.Vector([0.0, 0.0, 0.0])
    for a in ti.static(range(27)):  # unrolled: the loads do not wait for each other
        c = pick(data.slots, n, a, data.nodes, soa)
        for d in ti.static(range(3)):
            f[d] += data.force[slot(b, c, a, d, data.cells, soa)]
    return f


@ti.func
def move(b, n, data: state, soa: ti.template()):
    """One step of one node, symplectic Euler: v <- exp(-c dt) v + dt f / m, then u <- u + dt v.

    A node at the clamped side has a ghost beyond it that moves the opposite way, u_g = -u_n, so the two share
    f = f_n - f_g and m = m_n + m_g.
    """
    if data.role[n] > -2:
        at = b * LOAD
        rho, dt = data.load[at + RHO], data.load[at + DT]
        g = data.ghost[n]
        f, m, weight = ti.Vector([0.0, 0.0, 0.0]), 0.0, 0.0
        for side in range(2 if g >= 0 else 1):
            at_node = n if side == 0 else g
            sign = 1.0 - 2.0 * side
            f += sign * gather(b, at_node, data, soa)
            weight += sign * rho * data.volume[at_node]
            m += rho * data.inertia[at_node]
        f += weight * vector3(data.load, at + GRAVITY)
        keep = data.load[at + KEEP]
        for d in ti.static(range(3)):
            i = place(b, n, d, data.nodes, soa)
            data.before[i] = data.total[i]
            data.total[i] = f[d]
            if data.role[n] == -1:
                data.v[i] = keep * data.v[i] + dt * f[d] / m
                data.u[i] += dt * data.v[i]
                if g >= 0:
                    data.u[place(b, g, d, data.nodes, soa)] = -data.u[i]


@ti.func
def surface(b, c, s, data: state, soa: ti.template()):
    """Where surface point s of cell c is: x_s = X_s + sum_i w_is u_i."""
    p = vector3(data.spot, s * 3)
    for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
        w = data.weights[s * 9 + i] * data.weights[s * 9 + 3 + j] * data.weights[s * 9 + 6 + k]
        n = pick(data.cell_nodes, c, 9 * i + 3 * j + k, data.cells, soa)
        p += w * vector(data.u, b, n, data.nodes, soa)
    return p


@ti.func
def signed_distance(b, c, s, data: state, soa: ti.template()):
    """Signed distance of surface point s from the indenter, m; negative inside."""
    at = b * LOAD
    p = surface(b, c, s, data, soa) - vector3(data.load, at + POSE + 9)
    local = matrix9(data.load, at + POSE).transpose() @ p
    return indenter.distance(data.shape[b], vector3(data.load, at + SIZE), local, data.table, data.samples)


@ti.func
def touch(b, s, taken, data: state, soa: ti.template()):
    """Force on surface point s after `taken` substeps.

    At signed distance d it feels the normal force N = m - k d, whose part m' = -c k d grows until nothing
    penetrates (an augmented Lagrangian, Hestenes 1969), and, by a spring of stiffness k from where it stuck,
    at most the friction mu_f N (Coulomb, by return mapping). `anchor` holds five numbers a point: the place
    where it stuck, in the indenter's frame, whether it touches, and m; `contact` four: its force and depth.
    The indenter drifts from substep to substep; a point further than two cells from it is looked at every
    eighth substep.
    """
    here = (b * data.points + s) * 4
    if data.contact[here + 3] > -2.0 * data.dx or (taken + s) % 8 == 0:
        at = b * LOAD
        R, size = matrix9(data.load, at + POSE), vector3(data.load, at + SIZE)
        origin = vector3(data.load, at + POSE + 9)
        origin += ti.cast(taken, ti.f32) * vector3(data.load, at + DRIFT)
        k = data.load[at + SPRING]
        p = surface(b, data.spot_cell[s], s, data, soa)
        local = R.transpose() @ (p - origin)
        n4 = indenter.probe(data.shape[b], size, local, data.table, data.samples, 1e-5)
        d = n4[3]
        o = (b * data.points + s) * 5
        # m <- max(m - c dt k d, 0)
        rate = ti.min(data.load[at + RATE] * data.load[at + DT], 1.0)
        memory = ti.max(data.anchor[o + 4] - k * d * rate, 0.0)
        push = memory - k * d  # N
        f = ti.Vector([0.0, 0.0, 0.0])
        if push > 0.0:
            n = ti.Vector([n4[0], n4[1], n4[2]])
            stuck = vector3(data.anchor, o)
            if data.anchor[o + 3] == 0.0:
                stuck = local
            slip = local - stuck
            slip -= slip.dot(n) * n
            limit = push / k * data.load[at + FRICTION]  # |k slip| <= mu_f N
            if slip.norm() > limit:
                slip *= limit / ti.max(slip.norm(), 1e-20)
            stuck = local - slip
            for e in ti.static(range(3)):
                data.anchor[o + e] = stuck[e]
            f = R @ (push * n - k * slip)
        data.anchor[o + 3] = 1.0 if push > 0.0 else 0.0
        data.anchor[o + 4] = memory
        for e in ti.static(range(3)):
            data.contact[here + e] = f[e]
        data.contact[here + 3] = -d


GPU_LANES = 256


@ti.func
def cell(b, c, t, room, data: state, touching: ti.template(), soa: ti.template()):
    """All particles of one cell, by one thread."""
    for d in range(3):
        strain(b, c, t, d, room, data, soa)
    for p in range(8):
        stress(b, c, t, p, room, data, soa)
    for d in range(3):
        spread(b, c, t, d, room, data, touching, soa)


@ti.kernel
def within(
    taken: int, substeps: int, blocks: int, gate: ints, data: State, soa: ti.template(),
    touching: ti.template(),
):  # fmt: skip
    """All substeps of each body by one thread (CPU) or some blocks (GPU), whose `gate` (B,) must be zero."""
    spread = SPREAD_CPU
    stride = 1
    if ti.static(soa):
        spread = GPU_LANES * blocks
        stride = spread
        ti.loop_config(block_dim=GPU_LANES)
    for t in range(data.bodies * spread):
        b, lane = t // spread, t % spread
        turn, first = 0, lane % GPU_LANES == 0
        if ti.static(soa) or lane == 0:
            for step in range(substeps):
                if ti.static(touching):
                    i = lane
                    while i < data.points:
                        touch(b, i, taken + step, data, soa)
                        i += stride
                # On a GPU all gradients, all stresses, all forces; on the CPU one cell after another, which
                # stays in its cache.
                if ti.static(soa):
                    i = lane
                    while i < 3 * data.cells:
                        strain(b, i % data.cells, i % data.cells, i // data.cells, data.cells, data, soa)
                        i += stride
                    turn += 1
                    body_barrier(b, first, blocks, turn, gate, soa)
                    i = lane
                    while i < 8 * data.cells:
                        stress(b, i % data.cells, i % data.cells, i // data.cells, data.cells, data, soa)
                        i += stride
                    turn += 1
                    body_barrier(b, first, blocks, turn, gate, soa)
                    i = lane
                    while i < 3 * data.cells:
                        c, d = i % data.cells, i // data.cells
                        spread(b, c, c, d, data.cells, data, touching, soa)
                        i += stride
                    turn += 1
                    body_barrier(b, first, blocks, turn, gate, soa)
                else:
                    for c in range(data.cells):
                        cell(b, c, 0, ROOM, data, touching, soa)
                n = lane
                while n < data.nodes:
                    move(b, n, data, soa)
                    n += stride
                turn += 1
                body_barrier(b, first, blocks, turn, gate, soa)
                if data.hinges > 0:
                    if lane < GPU_LANES:
                        spine_step(b, lane, ti.min(stride, GPU_LANES), data, soa)
                    turn += 1
                    body_barrier(b, first, blocks, turn, gate, soa)


@ti.kernel
def across(taken: int, data: State, touching: ti.template()):
    """One substep on the CPU, cells and then nodes side by side, the one after `taken`."""
    if ti.static(touching):
        for t in range(data.bodies * data.points):
            touch(t // data.points, t % data.points, taken, data, False)
    for task in range(ROOM * SPREAD_CPU):
        if task % SPREAD_CPU == 0:
            t = task // SPREAD_CPU
            for i in range(t * data.bodies * data.cells // ROOM, (t + 1) * data.bodies * data.cells // ROOM):
                cell(i // data.cells, i % data.cells, t, ROOM, data, touching, False)
    for t in range(data.bodies * data.nodes):
        move(t // data.nodes, t % data.nodes, data, False)
    if data.hinges > 0:
        for t in range(data.bodies * SPREAD_CPU):
            if t % SPREAD_CPU == 0:
                spine_step(t // SPREAD_CPU, 0, 1, data, False)


@ti.kernel
def pose(data: State, soa: ti.template()):
    """Links, and the nodes that they carry, where the joint angles put them."""
    for b in range(data.bodies):
        bend(b, data.hinges, data.q, data.chain, data.pose)
        for k in range(data.carried):
            carry(b, k, data, soa)


@ti.kernel
def measure(data: State, sums: floats, soa: ti.template()):
    """Per body (B, 4): sum |f|^2 on free nodes, sum m v^2, - sum v . df, sum |f|^2 from outside.

    For a motion v ~ sin(w t) the third is w^2 dt times the second (Rayleigh's quotient), as df = - K v dt.
    """
    for i in range(data.bodies * 4):
        sums[i] = 0.0
    for t in range(data.bodies * data.nodes):
        b, n = t // data.nodes, t % data.nodes
        rho = data.load[b * LOAD + RHO]
        f2, w, k, g2 = 0.0, 0.0, 0.0, 0.0
        for d in ti.static(range(3)):
            i = place(b, n, d, data.nodes, soa)
            f2 += data.total[i] * data.total[i]
            w += data.v[i] * data.v[i] * rho * data.inertia[n]
            k -= data.v[i] * (data.total[i] - data.before[i])
            g2 += (rho * data.volume[n] * data.load[b * LOAD + GRAVITY + d]) ** 2
        if data.role[n] == -1:
            sums[b * 4] += f2
            sums[b * 4 + 1] += w
            sums[b * 4 + 2] += k
            sums[b * 4 + 3] += g2
        elif data.role[n] >= 0:
            sums[b * 4 + 3] += f2
    for t in range(data.bodies * data.points):
        for d in ti.static(range(3)):
            sums[t // data.points * 4 + 3] += data.contact[t * 4 + d] ** 2


@ti.kernel
def overlap(data: State, soa: ti.template()):
    """Depth of every surface point, without any force."""
    for t in range(data.bodies * data.cells):
        b, c = t // data.cells, t % data.cells
        for s in range(data.start[c], data.start[c + 1]):
            data.contact[(b * data.points + s) * 4 + 3] = -signed_distance(b, c, s, data, soa)


@ti.kernel
def particles(count: int, data: State, soa: ti.template(), particle_cell: ints, local: ints, out: floats):
    """Twelve numbers a particle: displacement sum_i w_ip u_i, gradient 1 + sum_i u_i (x) grad w_ip."""
    for t in range(data.bodies * count):
        b, p = t // count, t % count
        c = particle_cell[p]
        at = ti.Vector([0.0, 0.0, 0.0])
        G = ti.Matrix.identity(ti.f32, 3)
        side = ti.Vector([(local[p] >> 2) & 1, (local[p] >> 1) & 1, local[p] & 1])
        w, s = ti.Matrix.zero(ti.f32, 3, 3), ti.Matrix.zero(ti.f32, 3, 3)
        for d, i in ti.static(ti.ndrange(3, 3)):
            w[d, i] = W[1][i] if side[d] == 1 else W[0][i]
            s[d, i] = D[1][i] if side[d] == 1 else D[0][i]
        for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
            n = pick(data.cell_nodes, c, 9 * i + 3 * j + k, data.cells, soa)
            move = vector(data.u, b, n, data.nodes, soa)
            at += w[0, i] * w[1, j] * w[2, k] * move
            slope = ti.Vector(
                [s[0, i] * w[1, j] * w[2, k], w[0, i] * s[1, j] * w[2, k], w[0, i] * w[1, j] * s[2, k]]
            )
            G += move.outer_product(slope) / data.dx
        for d in ti.static(range(3)):
            out[t * 12 + d] = at[d]
            for e in ti.static(range(3)):
                out[t * 12 + 3 + 3 * d + e] = G[d, e]


@ti.func
def rotation(axis, angle):
    """Rodrigues' formula R = 1 + sin(angle) K + (1 - cos(angle)) K^2, K x = axis x x."""
    s, c = ti.sin(angle), ti.cos(angle)
    K = ti.Matrix([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return ti.Matrix.identity(ti.f32, 3) + s * K + (1.0 - c) * (K @ K)


@ti.func
def centre_of(b, link, data: state):
    """Centre of a link's mass in the world."""
    T = (b * (data.hinges + 1) + link) * POSE_OF
    return matrix9(data.pose, T) @ vector3(data.lump, link * LUMP + 1) + vector3(data.pose, T + 9)


@ti.func
def hinge(b, i, data: state):
    """Axis and origin of hinge i in the world, six numbers."""
    T = (b * (data.hinges + 1) + i) * POSE_OF
    R = matrix9(data.pose, T)
    axis = R @ vector3(data.chain, i * CHAIN + 3)
    origin = R @ vector3(data.chain, i * CHAIN) + vector3(data.pose, T + 9)
    return ti.Vector([axis[0], axis[1], axis[2], origin[0], origin[1], origin[2]])


@ti.func
def react(b, item, data: state, soa: ti.template()):
    """Component `item` of the wrenches: force f = sum_i f_i on a link, torque sum_i (x_i - centre) x f_i."""
    link, d = item // SIX, item % SIX
    centre = centre_of(b, link, data)
    sum_ = 0.0
    for k in range(data.bound_start[link], data.bound_start[link + 1]):
        n = data.bound[k]
        f = vector(data.total, b, n, data.nodes, soa)
        w = f
        if d > 2:
            w = (vector3(data.rest, n * 3) + vector(data.u, b, n, data.nodes, soa) - centre).cross(f)
        e = d % 3
        sum_ += w[0] if e == 0 else (w[1] if e == 1 else w[2])
    data.wrench[(b * (data.hinges + 1) + link) * SIX + d] = sum_


@ti.func
def assemble(b, item, data: state):
    """One entry of (M + dt (D + dt K)) q' = J^T (momentum + dt wrench) + dt K (q_cmd - q).

    Items are the H x H matrix (lower half) and then the right-hand side; `soft` gets the torque of body and
    gravity about each hinge.
    """
    hinges = data.hinges
    at, links, o = b * LOAD, hinges + 1, b * hinges * (hinges + 1)
    rho, dt = data.load[at + RHO], data.load[at + DT]
    row = b * hinges * 3
    if item < hinges * hinges:
        i, j = item // hinges, item % hinges
        if j <= i:
            hi, hj = hinge(b, i, data), hinge(b, j, data)
            ai, aj = ti.Vector([hi[0], hi[1], hi[2]]), ti.Vector([hj[0], hj[1], hj[2]])
            m = 0.0
            # M_ij = sum over links beyond both hinges of m (a_i x r_i) . (a_j x r_j) + a_i . R I R^T a_j
            for link in range(i + 1, links):
                c = centre_of(b, link, data)
                R = matrix9(data.pose, (b * links + link) * POSE_OF)
                arm_i = ai.cross(c - ti.Vector([hi[3], hi[4], hi[5]]))
                arm_j = aj.cross(c - ti.Vector([hj[3], hj[4], hj[5]]))
                turn = (R.transpose() @ ai).dot(matrix9(data.lump, link * LUMP + 4) @ (R.transpose() @ aj))
                m += rho * (data.lump[link * LUMP] * arm_i.dot(arm_j) + turn)
            if i == j:
                m += dt * (data.drive[row + 3 * i + 2] + dt * data.drive[row + 3 * i + 1])
            data.work[o + item] = m
    else:
        i = item - hinges * hinges
        hi = hinge(b, i, data)
        ai = ti.Vector([hi[0], hi[1], hi[2]])
        keep = data.load[at + KEEP]
        torque, drift = 0.0, 0.0
        # J_i^T (f, t) = (a_i x r_i) . f + a_i . t
        for link in range(i + 1, links):
            arm = ai.cross(centre_of(b, link, data) - ti.Vector([hi[3], hi[4], hi[5]]))
            w = (b * links + link) * SIX
            torque += arm.dot(vector3(data.wrench, w)) + ai.dot(vector3(data.wrench, w + 3))
            drift += arm.dot(vector3(data.momentum, w)) + ai.dot(vector3(data.momentum, w + 3))
        data.soft[b * hinges + i] = torque
        push = data.drive[row + 3 * i + 1] * (data.drive[row + 3 * i] - data.q[b * hinges + i])
        data.work[o + item] = keep * drift + dt * (torque + push)


@ti.func
def solve(b, data: state):
    """Joint velocities: Cholesky and two triangular solves, in place."""
    hinges = data.hinges
    o = b * hinges * (hinges + 1)
    r = o + hinges * hinges
    for i in range(hinges):
        for j in range(i + 1):
            s = data.work[o + i * hinges + j]
            for k in range(j):
                s -= data.work[o + i * hinges + k] * data.work[o + j * hinges + k]
            if i == j:
                data.work[o + i * hinges + j] = ti.sqrt(ti.max(s, 1e-30))
            else:
                data.work[o + i * hinges + j] = s / data.work[o + j * hinges + j]
        s = data.work[r + i]
        for k in range(i):
            s -= data.work[o + i * hinges + k] * data.work[r + k]
        data.work[r + i] = s / data.work[o + i * hinges + i]
    for up in range(hinges):
        i = hinges - 1 - up
        s = data.work[r + i]
        for k in range(i + 1, hinges):
            s -= data.work[o + k * hinges + i] * data.work[r + k]
        data.work[r + i] = s / data.work[o + i * hinges + i]
        data.qd[b * hinges + i] = data.work[r + i]


@ti.func
def push_on(b, link, data: state):
    """Momentum (m v, R I R^T w) of a link at the pose for which the velocities were found."""
    hinges, links = data.hinges, data.hinges + 1
    R, c = matrix9(data.pose, (b * links + link) * POSE_OF), centre_of(b, link, data)
    velocity, spin = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
    for i in range(link):
        h = hinge(b, i, data)
        axis = ti.Vector([h[0], h[1], h[2]])
        velocity += data.qd[b * hinges + i] * axis.cross(c - ti.Vector([h[3], h[4], h[5]]))
        spin += data.qd[b * hinges + i] * axis
    rho = data.load[b * LOAD + RHO]
    p = rho * data.lump[link * LUMP] * velocity
    a = rho * (R @ (matrix9(data.lump, link * LUMP + 4) @ (R.transpose() @ spin)))
    for d in ti.static(range(3)):
        data.momentum[(b * links + link) * SIX + d] = p[d]
        data.momentum[(b * links + link) * SIX + 3 + d] = a[d]


@ti.func
def spine_step(b, lane, stride, data: state, soa: ti.template()):
    """One substep of a spine and the nodes that it carries, by the lanes of a block or by one thread."""
    hinges = data.hinges
    i = lane
    while i < (hinges + 1) * SIX:
        react(b, i, data, soa)
        i += stride
    block_barrier(soa)
    i = lane
    while i < hinges * (hinges + 1):
        assemble(b, i, data)
        i += stride
    block_barrier(soa)
    if lane == 0:
        solve(b, data)
    block_barrier(soa)
    i = lane
    while i < hinges:
        push_on(b, i + 1, data)
        data.q[b * hinges + i] += data.load[b * LOAD + DT] * data.qd[b * hinges + i]
        i += stride
    block_barrier(soa)
    if lane == 0:
        bend(b, hinges, data.q, data.chain, data.pose)
    block_barrier(soa)
    i = lane
    while i < data.carried:
        carry(b, i, data, soa)
        i += stride
    block_barrier(soa)


@ti.func
def block_barrier(soa: ti.template()):
    """On a GPU: the lanes of the block wait for each other."""
    if ti.static(soa):
        ti.simt.block.sync()


@ti.func
def body_barrier(b, first, blocks, turn, gate: arrays, soa: ti.template()):
    """On a GPU: the blocks of body b wait for each other, the `turn`-th time; `first`: one lane a block.

    All blocks of a launch are resident at once, so none waits for one that has not begun.
    """
    if ti.static(soa):
        ti.simt.block.sync()
        if blocks > 1:
            if first:
                ti.simt.grid.memfence()
                ti.atomic_add(gate[b], 1)
                while ti.atomic_add(gate[b], 0) < turn * blocks:
                    pass
                ti.simt.grid.memfence()
            ti.simt.block.sync()


@ti.func
def bend(b, hinges, q: arrays, chain: arrays, pose: arrays):
    """Writes the links' poses: T_{i+1} = T_i Trans(o_i) Rot(a_i, q_i) Trans(-o_i), o origin and a axis."""
    links = hinges + 1
    for i in range(hinges):
        T = (b * links + i) * POSE_OF
        R, shift = matrix9(pose, T), vector3(pose, T + 9)
        origin = vector3(chain, i * CHAIN)
        turn = rotation(vector3(chain, i * CHAIN + 3), q[b * hinges + i])
        here = R @ origin + shift
        R = R @ turn
        shift = here - R @ origin
        for a, c in ti.static(ti.ndrange(3, 3)):
            pose[T + POSE_OF + 3 * a + c] = R[a, c]
        for a in ti.static(range(3)):
            pose[T + POSE_OF + 9 + a] = shift[a]


@ti.func
def carry(b, k, data: state, soa: ti.template()):
    """Puts one bound node where its link is: u = R X + t - X."""
    n = data.bound[k]
    T = (b * (data.hinges + 1) + data.bound_link[k]) * POSE_OF
    p = vector3(data.rest, n * 3)
    p = matrix9(data.pose, T) @ p + vector3(data.pose, T + 9) - p
    for d in ti.static(range(3)):
        data.u[place(b, n, d, data.nodes, soa)] = p[d]
