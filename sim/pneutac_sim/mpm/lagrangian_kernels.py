"""Kernels of the total-Lagrangian solver: forces of cells, motion of nodes.

[V] de Vaucorbeil, Nguyen, Hutchinson 2020, 'A total-Lagrangian material point method for solid mechanics
problems involving large deformations'. Splines are taken at rest once and for all, so a particle p is no more
than a quadrature point, and only nodes i have a state: displacement u_i and velocity v_i.

    F_p = 1 + sum_i u_i (x) grad w_ip          deformation gradient
    f_i = - sum_p V_p P(F_p) grad w_ip + ...   V_p volume at rest, P first Piola-Kirchhoff stress
    m_i v_i' = f_i + m_i g

A cell writes the forces on its 27 nodes into slots of its own; a node then adds up the slots that are its:
no two threads write to one place, so sums have one order and a result is the same whatever else ran.
"""

from pneutac_sim.mpm.rest_grid import SLOPE, WEIGHT
from pneutac_sim.mpm.runtime import ti
from pneutac_sim.mpm.state import (
    DT,
    GRAVITY,
    KEEP,
    LAM,
    LOAD,
    MU,
    RHO,
    inner,
    pick,
    place,
    slot,
    state,
    vector3,
)

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
