"""Kernels of the total-Lagrangian solver: forces of cells, motion of nodes, motion of the spine.

Splines are taken at rest once and for all, so a particle is no more than a quadrature point and only nodes
have a state. A cell writes the forces on its 27 nodes into slots of its own; a node then adds up the slots
that are
its: no two threads write to one place, so sums have one order and a result is the same whatever ran beside
it.

Arrays are flat. On the CPU the component of a vector is the fastest index, on a GPU the cell or node is, so
that neighbouring threads read neighbouring numbers (`soa`).
"""

from pneutac_sim.mpm import indenter
from pneutac_sim.mpm.rest_grid import SLOPE, WEIGHT
from pneutac_sim.mpm.runtime import ti

# Columns of `load`, one row a body. KEEP is the share of momentum that a substep leaves.
MU, LAM, RHO, DT, KEEP, GRAVITY, POSE = 0, 1, 2, 3, 4, 5, 8
SIZE, FRICTION, SPRING, RATE, DRIFT, LOAD = 20, 23, 24, 25, 26, 29
LEAST_J = 0.2  # volume of a particle over that at rest, below which the material law is left
SPREAD_CPU = 512  # loops of up to so many iterations run on one thread

W = tuple(tuple(float(x) for x in row) for row in WEIGHT)
D = tuple(tuple(float(x) for x in row) for row in SLOPE)
floats = ti.types.ndarray(dtype=ti.f32, ndim=1)
arrays = ti.template()  # how a function takes an array
ints = ti.types.ndarray(dtype=ti.i32, ndim=1)


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
def first_piola(G, mu, lam):
    """Neo-Hookean stress mu (F - F^-T) + lambda ln(J) F^-T of the displacement gradient G = F - 1.

    With the cofactors C of F and j = J - 1, J F - C = G + G^T + (j - tr G) + j G - cof G has no difference
    of large numbers in it, so that small strains keep their digits. Between J = 1/2 and 2 the logarithm is
    its series in z = j / (2 + j), exact to float32 and several times faster. Below J = 1/5 the law goes on
    straight, so that a particle which is turned inside out for a moment finds back; no equilibrium with one
    is accepted.
    """
    cof = ti.Matrix.cols([G[:, 1].cross(G[:, 2]), G[:, 2].cross(G[:, 0]), G[:, 0].cross(G[:, 1])])
    one = ti.Matrix.identity(ti.f32, 3)
    tr = G.trace()
    beyond = cof.trace() + G[0, 0] * cof[0, 0] + G[1, 0] * cof[1, 0] + G[2, 0] * cof[2, 0]
    j = tr + beyond
    k = ti.max(j, LEAST_J - 1.0)
    z = k / (2.0 + k)
    y = z * z
    ln = 2.0 * z * (1.0 + y * (1 / 3 + y * (1 / 5 + y * (1 / 7 + y * (1 / 9 + y * (1 / 11))))))
    if not (k > -0.5 and k < 1.0):
        ln = ti.log(1.0 + k) + (j - k) / (1.0 + k)
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
def strain(
    b, c, t, d, room, cells, nodes, dx, u: arrays, tensor: arrays, cell_nodes: arrays, soa: ti.template()
):
    """Writes the gradient of displacement component d at the 8 particles of cell c.

    The particles lie symmetric about the cell's middle, so along each axis three nodes give an even and an
    odd part (`split`), and the 8 gradients are sums of products of these with all signs (`signs`): 0.6 of
    the operations of summing splines.
    """
    z, y, a = ti.Matrix.zero(ti.f32, 9, 3), ti.Matrix.zero(ti.f32, 3, 9), ti.Matrix.zero(ti.f32, 3, 9)
    for r in ti.static(range(9)):
        row = ti.Vector(
            [
                u[place(b, pick(cell_nodes, c, 3 * r + k, cells, soa), d, nodes, soa)]
                for k in ti.static(range(3))
            ]
        )
        line = split(row[0], row[1], row[2], 4.0 / dx)
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
        tensor[inner(b, t, d, p, room, soa)] = gx[p]
        tensor[inner(b, t, d, 8 + p, room, soa)] = gy[p]
        tensor[inner(b, t, d, 16 + p, room, soa)] = gz[p]


@ti.func
def stress(b, c, t, p, room, dx, load: arrays, tensor: arrays, cell_mask: arrays, soa: ti.template()):
    """Replaces the gradient at particle p of cell c by its stress, times what `spread` needs."""
    G = ti.Matrix.zero(ti.f32, 3, 3)
    for d, e in ti.static(ti.ndrange(3, 3)):
        G[d, e] = tensor[inner(b, t, d, 8 * e + p, room, soa)]
    # volume dx^3 / 8, slopes 4 / dx
    scale = -0.5 * dx * dx * ti.cast((cell_mask[c] >> p) & 1, ti.f32)
    P = first_piola(G, load[b * LOAD + MU], load[b * LOAD + LAM])
    for d, e in ti.static(ti.ndrange(3, 3)):
        tensor[inner(b, t, d, 8 * e + p, room, soa)] = scale * P[d, e]


@ti.func
def spread(
    b, c, t, d, room, cells, points, tensor: arrays, force: arrays, start: arrays, weights: arrays,
    contact: arrays, touching: ti.template(), soa: ti.template(),
):  # fmt: skip
    """Writes component d of the forces of cell c on its nodes, - sum_p V_p P_p grad w_ip plus contact."""
    z, y, a = ti.Matrix.zero(ti.f32, 9, 3), ti.Matrix.zero(ti.f32, 3, 9), ti.Matrix.zero(ti.f32, 3, 9)
    gx = adjoint_signs(ti.Vector([tensor[inner(b, t, d, p, room, soa)] for p in ti.static(range(8))]))
    gy = adjoint_signs(ti.Vector([tensor[inner(b, t, d, 8 + p, room, soa)] for p in ti.static(range(8))]))
    gz = adjoint_signs(ti.Vector([tensor[inner(b, t, d, 16 + p, room, soa)] for p in ti.static(range(8))]))
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
        for s in range(start[c], start[c + 1]):
            f = contact[(b * points + s) * 4 + d]
            if f != 0.0:
                for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
                    w = weights[s * 9 + i] * weights[s * 9 + 3 + j] * weights[s * 9 + 6 + k]
                    z[3 * i + j, k] += w * f
    for r, k in ti.static(ti.ndrange(9, 3)):
        force[slot(b, c, 3 * r + k, d, cells, soa)] = z[r, k]


@ti.func
def matrix9(array: arrays, at):
    """A 3 x 3 matrix, row by row, from index `at`."""
    return ti.Matrix([[array[at + 3 * i + j] for j in ti.static(range(3))] for i in ti.static(range(3))])


@ti.func
def vector3(array: arrays, at):
    """A vector from index `at`."""
    return ti.Vector([array[at + d] for d in ti.static(range(3))])


@ti.func
def surface(
    b, c, s, cells, nodes, u: arrays, spot: arrays, cell_nodes: arrays, weights: arrays,
    soa: ti.template(),
):  # fmt: skip
    """Where surface point s of cell c is."""
    p = vector3(spot, s * 3)
    for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
        w = weights[s * 9 + i] * weights[s * 9 + 3 + j] * weights[s * 9 + 6 + k]
        p += w * vector(u, b, pick(cell_nodes, c, 9 * i + 3 * j + k, cells, soa), nodes, soa)
    return p


@ti.func
def depth(
    b, c, s, cells, nodes, load: arrays, u: arrays, spot: arrays, cell_nodes: arrays, weights: arrays,
    shape: arrays, table: arrays, samples, soa: ti.template(),
):  # fmt: skip
    """Signed distance of a surface point from the indenter."""
    at = b * LOAD
    p = surface(b, c, s, cells, nodes, u, spot, cell_nodes, weights, soa) - vector3(load, at + POSE + 9)
    local = matrix9(load, at + POSE).transpose() @ p
    return indenter.distance(shape[b], vector3(load, at + SIZE), local, table, samples)


@ti.func
def touch(
    b, s, cells, nodes, points, dx, load: arrays, u: arrays, spot: arrays, cell_nodes: arrays,
    spot_cell: arrays, weights: arrays, shape: arrays, table: arrays, samples, anchor: arrays,
    contact: arrays, taken, soa: ti.template(),
):  # fmt: skip
    """Contact of surface point s.

    At depth g it feels the normal force N = k g + m, whose part m grows with k g until nothing penetrates,
    and, by a spring of stiffness k from where it stuck, at most the friction mu_f N. `anchor` holds five
    numbers a point: the place where it stuck, in the indenter's frame, whether it touches, and m; `contact`
    four: its force and depth. The indenter drifts from substep to substep; a point further than two cells
    from it is looked at every eighth substep.
    """
    here = (b * points + s) * 4
    if contact[here + 3] > -2.0 * dx or (taken + s) % 8 == 0:
        at = b * LOAD
        R, origin, size = matrix9(load, at + POSE), vector3(load, at + POSE + 9), vector3(load, at + SIZE)
        origin += ti.cast(taken, ti.f32) * vector3(load, at + DRIFT)
        k = load[at + SPRING]
        p = surface(b, spot_cell[s], s, cells, nodes, u, spot, cell_nodes, weights, soa)
        local = R.transpose() @ (p - origin)
        n4 = indenter.probe(shape[b], size, local, table, samples, 1e-5)
        d = n4[3]
        o = (b * points + s) * 5
        memory = ti.max(anchor[o + 4] - k * d * ti.min(load[at + RATE] * load[at + DT], 1.0), 0.0)
        push = memory - k * d
        f = ti.Vector([0.0, 0.0, 0.0])
        if push > 0.0:
            n = ti.Vector([n4[0], n4[1], n4[2]])
            stuck = vector3(anchor, o)
            if anchor[o + 3] == 0.0:
                stuck = local
            slip = local - stuck
            slip -= slip.dot(n) * n
            limit = push / k * load[at + FRICTION]
            if slip.norm() > limit:
                slip *= limit / ti.max(slip.norm(), 1e-20)
            stuck = local - slip
            for e in ti.static(range(3)):
                anchor[o + e] = stuck[e]
            f = R @ (push * n - k * slip)
        anchor[o + 3] = 1.0 if push > 0.0 else 0.0
        anchor[o + 4] = memory
        for e in ti.static(range(3)):
            contact[here + e] = f[e]
        contact[here + 3] = -d


@ti.func
def gather(b, n, cells, nodes, force: arrays, slots: arrays, soa: ti.template()):
    """Force on node n: the sum of its slots."""
    f = ti.Vector([0.0, 0.0, 0.0])
    for a in ti.static(range(27)):  # unrolled: the loads do not wait for each other
        c = pick(slots, n, a, nodes, soa)
        for d in ti.static(range(3)):
            f[d] += force[slot(b, c, a, d, cells, soa)]
    return f


@ti.func
def move(
    b, n, cells, nodes, load: arrays, u: arrays, v: arrays, total: arrays, before: arrays, force: arrays,
    slots: arrays, ghost: arrays, role: arrays, volume: arrays, inertia: arrays, soa: ti.template(),
):  # fmt: skip
    """One step of one node, symplectic Euler; `role`: -1 free, -2 a ghost, else the link that carries it."""
    if role[n] > -2:
        at = b * LOAD
        rho, dt = load[at + RHO], load[at + DT]
        g = ghost[n]
        f, m, weight = ti.Vector([0.0, 0.0, 0.0]), 0.0, 0.0
        for side in range(2 if g >= 0 else 1):
            at_node = n if side == 0 else g
            sign = 1.0 - 2.0 * side
            f += sign * gather(b, at_node, cells, nodes, force, slots, soa)
            weight += sign * rho * volume[at_node]
            m += rho * inertia[at_node]
        f += weight * vector3(load, at + GRAVITY)
        keep = load[at + KEEP]
        for d in ti.static(range(3)):
            i = place(b, n, d, nodes, soa)
            before[i] = total[i]
            total[i] = f[d]
            if role[n] == -1:
                v[i] = keep * v[i] + dt * f[d] / m
                u[i] += dt * v[i]
                if g >= 0:
                    u[place(b, g, d, nodes, soa)] = -u[i]
