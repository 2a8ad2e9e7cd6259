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

# Columns of `load`, one row a body.
MU, LAM, RHO, DT, DAMPING, GRAVITY, POSE = 0, 1, 2, 3, 4, 5, 8
SIZE, FRICTION, SPRING, RATE, LOAD = 20, 23, 24, 25, 26
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
def first_piola(F, mu, lam):
    """Neo-Hookean stress mu (F - F^-T) + lambda ln(J) F^-T."""
    J = F.determinant()
    C = ti.Matrix.cols(
        [
            F[:, 1].cross(F[:, 2]),
            F[:, 2].cross(F[:, 0]),
            F[:, 0].cross(F[:, 1]),
        ]
    )
    return mu * F + C * ((lam * ti.log(J) - mu) / J)


@ti.func
def gradient(b, c, cells, nodes, dx, x: arrays, cell_nodes: arrays, soa: ti.template()):
    """Deformation gradients of the cell's eight particles: their columns 1, 2, 3 as three 3 x 8 matrices."""
    Fx, Fy, Fz = ti.Matrix.zero(ti.f32, 3, 8), ti.Matrix.zero(ti.f32, 3, 8), ti.Matrix.zero(ti.f32, 3, 8)
    for i in ti.static(range(3)):
        A, B, C = ti.Matrix.zero(ti.f32, 3, 4), ti.Matrix.zero(ti.f32, 3, 4), ti.Matrix.zero(ti.f32, 3, 4)
        for j in ti.static(range(3)):
            u = ti.Matrix.zero(ti.f32, 3, 3)
            for k in ti.static(range(3)):
                n = pick(cell_nodes, c, 9 * i + 3 * j + k, cells, soa)
                p = vector(x, b, n, nodes, soa)
                for d in ti.static(range(3)):
                    u[d, k] = p[d]
            for d, r in ti.static(ti.ndrange(3, 2)):
                w = W[r][0] * u[d, 0] + W[r][1] * u[d, 1] + W[r][2] * u[d, 2]
                s = D[r][0] * u[d, 0] + D[r][1] * u[d, 1] + D[r][2] * u[d, 2]
                for q in ti.static(range(2)):
                    A[d, 2 * q + r] += W[q][j] * w
                    B[d, 2 * q + r] += D[q][j] * w
                    C[d, 2 * q + r] += W[q][j] * s
        for d, o, r in ti.static(ti.ndrange(3, 2, 4)):
            Fx[d, 4 * o + r] += D[o][i] * A[d, r]
            Fy[d, 4 * o + r] += W[o][i] * B[d, r]
            Fz[d, 4 * o + r] += W[o][i] * C[d, r]
    return Fx / dx, Fy / dx, Fz / dx


@ti.func
def elastic(
    b,
    c,
    cells,
    nodes,
    dx,
    load: arrays,
    x: arrays,
    force: arrays,
    cell_nodes: arrays,
    cell_mask: arrays,
    soa: ti.template(),
):
    """Writes the elastic forces of one cell on its nodes, f_i = - sum_p V_p P_p grad w_ip."""
    mu, lam = load[b * LOAD + MU], load[b * LOAD + LAM]
    Px, Py, Pz = gradient(b, c, cells, nodes, dx, x, cell_nodes, soa)
    mask = cell_mask[c]
    for p in ti.static(range(8)):
        F = ti.Matrix([[Px[d, p], Py[d, p], Pz[d, p]] for d in ti.static(range(3))])
        # volume dx^3 / 8 over the dx of the spline's slope
        P = first_piola(F, mu, lam) * (-0.125 * dx * dx * ti.cast((mask >> p) & 1, ti.f32))
        for d in ti.static(range(3)):
            Px[d, p] = P[d, 0]
            Py[d, p] = P[d, 1]
            Pz[d, p] = P[d, 2]
    for i in ti.static(range(3)):
        A, B, C = ti.Matrix.zero(ti.f32, 3, 4), ti.Matrix.zero(ti.f32, 3, 4), ti.Matrix.zero(ti.f32, 3, 4)
        for d, r in ti.static(ti.ndrange(3, 4)):
            A[d, r] = D[0][i] * Px[d, r] + D[1][i] * Px[d, 4 + r]
            B[d, r] = W[0][i] * Py[d, r] + W[1][i] * Py[d, 4 + r]
            C[d, r] = W[0][i] * Pz[d, r] + W[1][i] * Pz[d, 4 + r]
        for j in ti.static(range(3)):
            w, s = ti.Matrix.zero(ti.f32, 3, 2), ti.Matrix.zero(ti.f32, 3, 2)
            for d, r in ti.static(ti.ndrange(3, 2)):
                w[d, r] = W[0][j] * A[d, r] + W[1][j] * A[d, 2 + r]
                w[d, r] += D[0][j] * B[d, r] + D[1][j] * B[d, 2 + r]
                s[d, r] = W[0][j] * C[d, r] + W[1][j] * C[d, 2 + r]
            for k, d in ti.static(ti.ndrange(3, 3)):
                f = W[0][k] * w[d, 0] + W[1][k] * w[d, 1] + D[0][k] * s[d, 0] + D[1][k] * s[d, 1]
                force[slot(b, c, 9 * i + 3 * j + k, d, cells, soa)] = f


@ti.func
def matrix9(array: arrays, at):
    """A 3 x 3 matrix, row by row, from index `at`."""
    return ti.Matrix([[array[at + 3 * i + j] for j in ti.static(range(3))] for i in ti.static(range(3))])


@ti.func
def vector3(array: arrays, at):
    """A vector from index `at`."""
    return ti.Vector([array[at + d] for d in ti.static(range(3))])


@ti.func
def surface(b, c, s, cells, nodes, x: arrays, cell_nodes: arrays, weights: arrays, soa: ti.template()):
    """Where surface point s of cell c is."""
    p = ti.Vector([0.0, 0.0, 0.0])
    for i, j in ti.ndrange(3, 3):
        wij = weights[s * 9 + i] * weights[s * 9 + 3 + j]
        for k in ti.static(range(3)):
            n = pick(cell_nodes, c, 9 * i + 3 * j + k, cells, soa)
            p += wij * weights[s * 9 + 6 + k] * vector(x, b, n, nodes, soa)
    return p


@ti.func
def depth(
    b, c, s, cells, nodes, load: arrays, x: arrays, cell_nodes: arrays, weights: arrays, shape: arrays,
    table: arrays, samples, soa: ti.template(),
):  # fmt: skip
    """Signed distance of a surface point from the indenter."""
    at = b * LOAD
    p = surface(b, c, s, cells, nodes, x, cell_nodes, weights, soa) - vector3(load, at + POSE + 9)
    local = matrix9(load, at + POSE).transpose() @ p
    return indenter.distance(shape[b], vector3(load, at + SIZE), local, table, samples)


@ti.func
def touch(
    b, c, cells, nodes, points, load: arrays, x: arrays, force: arrays, cell_nodes: arrays, start: arrays,
    weights: arrays, shape: arrays, table: arrays, samples, anchor: arrays, contact: arrays, soa:
    ti.template(),
):  # fmt: skip
    """Adds contact at the surface points of one cell.

    A point at depth g feels the normal force N = k g + m, whose part m grows with k g until nothing
    penetrates, and, by a spring of stiffness k from where it stuck, at most the friction mu_f N. `anchor`
    holds five numbers a point: the place where it stuck, in the indenter's frame, whether it touches, and
    m; `contact` four: its force and depth.
    """
    at = b * LOAD
    R, origin, size = matrix9(load, at + POSE), vector3(load, at + POSE + 9), vector3(load, at + SIZE)
    k = load[at + SPRING]
    for s in range(start[c], start[c + 1]):
        p = surface(b, c, s, cells, nodes, x, cell_nodes, weights, soa)
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
            for i, j in ti.ndrange(3, 3):
                wij = weights[s * 9 + i] * weights[s * 9 + 3 + j]
                for a, e in ti.static(ti.ndrange(3, 3)):
                    force[slot(b, c, 9 * i + 3 * j + a, e, cells, soa)] += wij * weights[s * 9 + 6 + a] * f[e]
        anchor[o + 3] = 1.0 if push > 0.0 else 0.0
        anchor[o + 4] = memory
        for e in ti.static(range(3)):
            contact[(b * points + s) * 4 + e] = f[e]
        contact[(b * points + s) * 4 + 3] = -d


@ti.func
def gather(b, n, cells, nodes, force: arrays, slots: arrays, soa: ti.template()):
    """Force on node n: the sum of its slots."""
    f = ti.Vector([0.0, 0.0, 0.0])
    for a in range(27):
        c = pick(slots, n, a, nodes, soa)
        for d in ti.static(range(3)):
            f[d] += force[slot(b, c, a, d, cells, soa)]
    return f


@ti.func
def move(
    b, n, cells, nodes, load: arrays, x: arrays, v: arrays, total: arrays, force: arrays, slots: arrays,
    ghost: arrays, role: arrays, volume: arrays, inertia: arrays, rest: arrays, soa: ti.template(),
):  # fmt: skip
    """One step of one node, symplectic Euler; `role`: -1 free, -2 a ghost, else the link that carries it."""
    if role[n] > -2:
        at = b * LOAD
        rho, dt = load[at + RHO], load[at + DT]
        f = gather(b, n, cells, nodes, force, slots, soa)
        m, weight = rho * inertia[n], rho * volume[n]
        g = ghost[n]
        if g >= 0:
            f -= gather(b, g, cells, nodes, force, slots, soa)
            weight -= rho * volume[g]
            m += rho * inertia[g]
        f += weight * vector3(load, at + GRAVITY)
        keep = ti.exp(-load[at + DAMPING] * dt)
        for d in ti.static(range(3)):
            i = place(b, n, d, nodes, soa)
            total[i] = f[d]
            if role[n] == -1:
                v[i] = keep * v[i] + dt * f[d] / m
                x[i] += dt * v[i]
                if g >= 0:
                    x[place(b, g, d, nodes, soa)] = rest[g * 3 + d] - (x[i] - rest[n * 3 + d])
