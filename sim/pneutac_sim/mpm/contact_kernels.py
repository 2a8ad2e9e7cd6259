"""Contact of a body's surface with a rigid indenter: a spring with memory, and Coulomb friction."""

from pneutac_sim.mpm import indenter
from pneutac_sim.mpm.runtime import ti
from pneutac_sim.mpm.state import (
    DRIFT,
    DT,
    FRICTION,
    LOAD,
    POSE,
    RATE,
    SIZE,
    SPRING,
    matrix9,
    pick,
    state,
    vector,
    vector3,
)


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
