"""Kernels of the reference solver: one substep of MLS-MPM with rigid links cut into the grid.

[M] Hu et al. 2018, 'A moving least squares material point method with displacement discontinuity and two-way
rigid body coupling': MLS-MPM, and CPIC, which keeps apart the material on the two sides of a thin rigid body.
Letters are theirs: particles p have x, v, C (affine velocity), F; grid nodes i have mass m and momentum, then
velocity, u.

Every node has two layers: 0 takes what is on the node's own side of a link, 1 what comes through it. Layer 0
moves freely; layer 1 is the link's share of mass, momentum and force, and moves with the link.
"""

from pneutac_sim.mpm import indenter
from pneutac_sim.mpm import state as rows
from pneutac_sim.mpm.lagrangian_kernels import first_piola
from pneutac_sim.mpm.runtime import ti
from pneutac_sim.mpm.spine_kernels import bend
from pneutac_sim.mpm.state import LOAD, arrays, floats, ints, matrix9, vector3
from updated_lagrangian.links import hinges_move, lever, side_of, through

reals = ti.types.ndarray(dtype=ti.f64, ndim=1)
vectors = ti.types.ndarray(dtype=ti.types.vector(3, ti.f64), ndim=1)
matrices = ti.types.ndarray(dtype=ti.types.matrix(3, 3, ti.f64), ndim=1)
box = ti.types.vector(3, ti.i32)


@ti.func
def add(array: arrays, i, value, alone: ti.template()):
    """Adds to `array[i]`, atomically unless one thread does all."""
    if ti.static(alone):
        array[i] = array[i] + value
    else:
        array[i] += value


@ti.func
def where(n, origin, dx, low, size, clamp):
    """Place of node n of the box; beyond the clamped side, that of the node that it mirrors."""
    i = ti.Vector([n // (size[1] * size[2]), n // size[2] % size[1], n % size[2]]) + low
    for a in ti.static(range(3)):
        if a == clamp and i[a] < 1:
            i[a] = 1 - i[a]
    return origin + (ti.cast(i, ti.f64) - 0.5) * dx


@ti.func
def mirror(n, low, size, clamp):
    """Node of the box beyond the clamped side that mirrors node n; n if there is none; -1 for such a node."""
    i = ti.Vector([n // (size[1] * size[2]), n // size[2] % size[1], n % size[2]])
    out = n
    for a in ti.static(range(3)):
        if a == clamp:
            ghost = 1 - (i[a] + low[a]) - low[a]
            if i[a] + low[a] < 1:
                out = -1
            elif ghost >= 0:
                i[a] = ghost
                out = index(i, size)
    return out


@ti.func
def index(i, size):
    """Number of the node (i, j, k) of a box."""
    return (i[0] * size[1] + i[1]) * size[2] + i[2]


@ti.func
def stencil(x, origin, dx, low, size):
    """First of a particle's 27 nodes, and the particle's place from it in grid spacings."""
    first = ti.cast(ti.floor((x - origin) / dx), ti.i32)
    place = (x - origin) / dx - ti.cast(first, ti.f64) + 0.5
    # Only a particle that has outrun the box is moved here; it has diverged already.
    return ti.max(ti.min(first - low, size - 3), 0), place


@ti.func
def spline(f):
    """Quadratic splines, rows: nodes 0, 1, 2; columns: x, y, z."""
    return ti.Matrix.rows([0.5 * (1.5 - f) ** 2, 0.75 - (f - 1.0) ** 2, 0.5 * (f - 0.5) ** 2])


@ti.func
def touch(
    b, s, points, taken, x, load: arrays, shape: arrays, table: arrays, samples, anchor: arrays, contact:
    arrays,
):  # fmt: skip
    """Force of the indenter on surface point s at x; law and memory as in `lagrangian_steps.touch`."""
    at, o = b * LOAD, (b * points + s) * 5
    R, k = matrix9(load, at + rows.POSE), load[at + rows.SPRING]
    centre = vector3(load, at + rows.POSE + 9) + taken * vector3(load, at + rows.DRIFT)
    local = ti.cast(R.transpose() @ (x - centre), ti.f32)
    n4 = indenter.probe(shape[b], vector3(load, at + rows.SIZE), local, table, samples, 1e-5)
    d = n4[3]
    memory = ti.max(anchor[o + 4] - k * d * ti.min(load[at + rows.RATE] * load[at + rows.DT], 1.0), 0.0)
    push = memory - k * d
    f = ti.Vector([0.0, 0.0, 0.0])
    if push > 0.0:
        n = ti.Vector([n4[0], n4[1], n4[2]])
        slip = local - vector3(anchor, o) if anchor[o + 3] > 0.0 else ti.Vector([0.0, 0.0, 0.0])
        slip -= slip.dot(n) * n
        limit = push / k * load[at + rows.FRICTION]
        if slip.norm() > limit:
            slip *= limit / ti.max(slip.norm(), 1e-20)
        for e in ti.static(range(3)):
            anchor[o + e] = local[e] - slip[e]
        f = R @ (push * n - k * slip)
    anchor[o + 3] = 1.0 if push > 0.0 else 0.0
    anchor[o + 4] = memory
    for e in ti.static(range(3)):
        contact[(b * points + s) * 4 + e] = f[e]
    contact[(b * points + s) * 4 + 3] = -d
    return f


@ti.kernel
def substep(
    bodies: int, particles: int, nodes: int, points: int, hinges: int, samples: int, clamp: int, taken:
    int, dx: ti.f64, origin: ti.types.vector(3, ti.f64), low: box, size: box, alone: ti.template(),
    touching: ti.template(), load: floats, x: vectors, v: vectors, C: matrices, F: matrices, side: ints,
    m: reals, u: vectors, f: vectors, tag: ints, start: ints, normal: vectors, shape: ints, table:
    floats, anchor: floats, contact: floats, q: reals, qd: reals, drive: floats, chain: reals, strip:
    reals, pose: reals, M: reals, soft: reals, momentum: reals,
):  # fmt: skip
    """One substep; u holds the nodes' momentum, then their velocity."""
    links = hinges + 1
    for t in range(bodies * nodes):
        for layer in range(2):
            m[2 * t + layer] = 0.0
            u[2 * t + layer] = ti.Vector([0.0, 0.0, 0.0])
            f[2 * t + layer] = ti.Vector([0.0, 0.0, 0.0])
        if hinges > 0:
            at = where(t % nodes, origin, dx, low, size, clamp)
            tag[t] = side_of(at, tag[t], t // nodes, links, dx, strip, pose)
    for i in range(bodies * hinges * hinges):
        M[i] = 0.0
    for i in range(bodies * hinges):
        soft[i] = 0.0
        momentum[i] = 0.0

    if ti.static(alone):
        ti.loop_config(serialize=True)
    for t in range(bodies * particles):  # particles to grid
        b, p = t // particles, t % particles
        V = dx * dx * dx / 8.0
        mass = load[b * LOAD + rows.RHO] * V
        force = mass * vector3(load, b * LOAD + rows.GRAVITY)
        # Moment of the stress; times w (x_i - x_p) 4 / dx^2 it is the force on a node, [M] equation 16.
        Q = (
            -V
            * first_piola(
                F[t] - ti.Matrix.identity(ti.f64, 3), load[b * LOAD + rows.MU], load[b * LOAD + rows.LAM]
            )
            @ F[t].transpose()
        )
        if ti.static(touching):
            for s in range(start[p], start[p + 1]):
                r = F[t] @ normal[s] * (0.25 * dx)
                push = touch(b, s, points, taken, x[t] + r, load, shape, table, samples, anchor, contact)
                force += push
                Q += push.outer_product(r)
        first, place = stencil(x[t], origin, dx, low, size)
        w = spline(place)
        for i, j, k in ti.ndrange(3, 3, 3):
            n = b * nodes + index(first + ti.Vector([i, j, k]), size)
            d = (ti.Vector([i, j, k]) - place) * dx
            wip = w[i, 0] * w[j, 1] * w[k, 2]
            a = 2 * n + through(tag[n], side[p])
            add(m, a, wip * mass, alone)
            add(u, a, wip * mass * (v[t] + C[t] @ d), alone)  # APIC
            add(f, a, wip * (force + 4.0 / (dx * dx) * Q @ d), alone)

    for t in range(bodies * nodes):  # what moves freely
        b, n = t // nodes, t % nodes
        dt = load[b * LOAD + rows.DT]
        ghost = mirror(n, low, size, clamp)  # v = -v beyond the clamped side, so the side stands still
        if ghost != n and ghost >= 0:
            g = 2 * (b * nodes + ghost)
            m[2 * t] += m[g]
            u[2 * t] -= u[g]
            f[2 * t] -= f[g]
            f[g] = ti.Vector([0.0, 0.0, 0.0])
        if ghost >= 0 and m[2 * t] > 0.0:
            keep = load[b * LOAD + rows.KEEP]
            u[2 * t] = (keep * u[2 * t] + dt * f[2 * t]) / m[2 * t]
            if ghost != n:
                u[2 * (b * nodes + ghost)] = -u[2 * t]
                m[2 * (b * nodes + ghost)] = 0.0

    if hinges > 0:
        for t in range(bodies * nodes):  # the links' share, in the coordinates of the hinges
            b = t // nodes
            a, link = 2 * t + 1, ti.abs(tag[t]) - 1
            if m[a] > 0.0:
                at = where(t % nodes, origin, dx, low, size, clamp)
                for h in range(link):
                    J = lever(b, link, h, at, links, chain, pose)
                    momentum[b * hinges + h] += J.dot(u[a])
                    soft[b * hinges + h] += J.dot(f[a])
                    for g in range(link):
                        M[(b * hinges + h) * hinges + g] += m[a] * J.dot(
                            lever(b, link, g, at, links, chain, pose)
                        )
        for b in range(bodies):
            hinges_move(b, hinges, load, M, soft, momentum, q, qd, drive)
        for t in range(bodies * nodes):
            b = t // nodes
            a, link = 2 * t + 1, ti.abs(tag[t]) - 1
            u[a] = ti.Vector([0.0, 0.0, 0.0])
            if m[a] > 0.0:
                at = where(t % nodes, origin, dx, low, size, clamp)
                for h in range(link):
                    u[a] += qd[b * hinges + h] * lever(b, link, h, at, links, chain, pose)

    for t in range(bodies * particles):  # grid to particles
        b, p = t // particles, t % particles
        first, place = stencil(x[t], origin, dx, low, size)
        w = spline(place)
        velocity, B = ti.Vector([0.0, 0.0, 0.0], ti.f64), ti.Matrix.zero(ti.f64, 3, 3)
        for i, j, k in ti.ndrange(3, 3, 3):
            n = b * nodes + index(first + ti.Vector([i, j, k]), size)
            d = (ti.Vector([i, j, k]) - place) * dx
            vi = u[2 * n + through(tag[n], side[p])]
            velocity += w[i, 0] * w[j, 1] * w[k, 2] * vi
            B += w[i, 0] * w[j, 1] * w[k, 2] * vi.outer_product(d)
        dt = load[b * LOAD + rows.DT]
        v[t] = velocity
        C[t] = 4.0 / (dx * dx) * B
        F[t] += dt * C[t] @ F[t]  # [M]: the gradient of velocity is C
        x[t] += dt * velocity

    if hinges > 0:
        for b in range(bodies):
            for h in range(hinges):
                q[b * hinges + h] += load[b * LOAD + rows.DT] * qd[b * hinges + h]
            bend(b, hinges, q, chain, pose)


@ti.kernel
def depths(
    bodies: int, particles: int, points: int, samples: int, dx: ti.f64, load: floats, x: vectors, F: matrices,
    start: ints, normal: vectors, shape: ints, table: floats, contact: floats,
):  # fmt: skip
    """How deep each point of the surface lies in the indenter, without any force."""
    for t in range(bodies * particles):
        b, p = t // particles, t % particles
        at = b * LOAD
        for s in range(start[p], start[p + 1]):
            r = x[t] + F[t] @ normal[s] * (0.25 * dx) - vector3(load, at + rows.POSE + 9)
            local = ti.cast(matrix9(load, at + rows.POSE).transpose() @ r, ti.f32)
            d = indenter.distance(shape[b], vector3(load, at + rows.SIZE), local, table, samples)
            contact[(b * points + s) * 4 + 3] = -d
