"""Kernels of the spine: a chain of hinges that carries nodes of the body and feels their forces.

The nodes of a link move with it as one rigid lump, so the joint feels just what the body does to these nodes
(virtual work): no coupling spring, no step size in the stiffness, action and reaction to rounding. Momentum
is kept a link and projected onto the joints at the new pose (Gauss' principle), which has the terms of
Coriolis in it; the controller's spring and damper are taken implicitly.
"""

from pneutac_sim.mpm.lagrangian_kernels import DT, KEEP, LOAD, RHO, arrays, matrix9, place, vector, vector3
from pneutac_sim.mpm.runtime import ti

# Rows of `chain`, a hinge: origin, axis at rest. Rows of `lump`, a link: mass, centre, inertia about it, all
# of unit density. Rows of `pose`, a link: rotation, shift. Rows of `wrench` and `momentum`, a link: force,
# torque.
CHAIN, LUMP, POSE_OF, SIX = 6, 13, 12, 6


@ti.func
def rotation(axis, angle):
    """Rodrigues' formula."""
    s, c = ti.sin(angle), ti.cos(angle)
    K = ti.Matrix([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return ti.Matrix.identity(ti.f32, 3) + s * K + (1.0 - c) * (K @ K)


@ti.func
def react(
    b,
    item,
    nodes,
    hinges,
    u: arrays,
    rest: arrays,
    total: arrays,
    bound: arrays,
    bound_start: arrays,
    pose: arrays,
    lump: arrays,
    wrench: arrays,
    soa: ti.template(),
):
    """Component `item` of the wrenches: force on a link, and its torque about the link's centre."""
    link, d = item // SIX, item % SIX
    t = (b * (hinges + 1) + link) * POSE_OF
    centre = matrix9(pose, t) @ vector3(lump, link * LUMP + 1) + vector3(pose, t + 9)
    sum_ = 0.0
    for k in range(bound_start[link], bound_start[link + 1]):
        f = vector(total, b, bound[k], nodes, soa)
        w = f
        if d > 2:
            w = (vector3(rest, bound[k] * 3) + vector(u, b, bound[k], nodes, soa) - centre).cross(f)
        e = d % 3
        sum_ += w[0] if e == 0 else (w[1] if e == 1 else w[2])
    wrench[(b * (hinges + 1) + link) * SIX + d] = sum_


@ti.func
def hinge(b, i, links, chain: arrays, pose: arrays):
    """Axis and origin of hinge i in the world, six numbers."""
    T = (b * links + i) * POSE_OF
    R = matrix9(pose, T)
    axis, origin = R @ vector3(chain, i * CHAIN + 3), R @ vector3(chain, i * CHAIN) + vector3(pose, T + 9)
    return ti.Vector([axis[0], axis[1], axis[2], origin[0], origin[1], origin[2]])


@ti.func
def centre_of(b, link, links, lump: arrays, pose: arrays):
    """Centre of a link's mass in the world."""
    T = (b * links + link) * POSE_OF
    return matrix9(pose, T) @ vector3(lump, link * LUMP + 1) + vector3(pose, T + 9)


@ti.func
def assemble(
    b, item, hinges, load: arrays, q: arrays, drive: arrays, chain: arrays, lump: arrays, pose: arrays,
    wrench: arrays, momentum: arrays, work: arrays, soft: arrays,
):  # fmt: skip
    """One entry of (M + dt (Kd + dt Kp)) q' = J^T (momentum + dt wrench) + dt Kp (q_cmd - q).

    Items are the H x H matrix (lower half) and then the right-hand side; `soft` gets the torque of body and
    gravity about each hinge.
    """
    at, links, o = b * LOAD, hinges + 1, b * hinges * (hinges + 1)
    rho, dt = load[at + RHO], load[at + DT]
    row = b * hinges * 3
    if item < hinges * hinges:
        i, j = item // hinges, item % hinges
        if j <= i:
            hi, hj = hinge(b, i, links, chain, pose), hinge(b, j, links, chain, pose)
            ai, aj = ti.Vector([hi[0], hi[1], hi[2]]), ti.Vector([hj[0], hj[1], hj[2]])
            m = 0.0
            for link in range(i + 1, links):
                c = centre_of(b, link, links, lump, pose)
                R = matrix9(pose, (b * links + link) * POSE_OF)
                arm_i = ai.cross(c - ti.Vector([hi[3], hi[4], hi[5]]))
                arm_j = aj.cross(c - ti.Vector([hj[3], hj[4], hj[5]]))
                turn = (R.transpose() @ ai).dot(matrix9(lump, link * LUMP + 4) @ (R.transpose() @ aj))
                m += rho * (lump[link * LUMP] * arm_i.dot(arm_j) + turn)
            if i == j:
                m += dt * (drive[row + 3 * i + 2] + dt * drive[row + 3 * i + 1])
            work[o + item] = m
    else:
        i = item - hinges * hinges
        hi = hinge(b, i, links, chain, pose)
        ai = ti.Vector([hi[0], hi[1], hi[2]])
        keep = load[at + KEEP]
        torque, drift = 0.0, 0.0
        for link in range(i + 1, links):
            arm = ai.cross(centre_of(b, link, links, lump, pose) - ti.Vector([hi[3], hi[4], hi[5]]))
            w = (b * links + link) * SIX
            torque += arm.dot(vector3(wrench, w)) + ai.dot(vector3(wrench, w + 3))
            drift += arm.dot(vector3(momentum, w)) + ai.dot(vector3(momentum, w + 3))
        soft[b * hinges + i] = torque
        push = drive[row + 3 * i + 1] * (drive[row + 3 * i] - q[b * hinges + i])
        work[o + item] = keep * drift + dt * (torque + push)


@ti.func
def solve(b, hinges, work: arrays, qd: arrays):
    """Joint velocities: Cholesky and two triangular solves, in place."""
    o = b * hinges * (hinges + 1)
    r = o + hinges * hinges
    for i in range(hinges):
        for j in range(i + 1):
            s = work[o + i * hinges + j]
            for k in range(j):
                s -= work[o + i * hinges + k] * work[o + j * hinges + k]
            work[o + i * hinges + j] = ti.sqrt(ti.max(s, 1e-30)) if i == j else s / work[o + j * hinges + j]
        s = work[r + i]
        for k in range(i):
            s -= work[o + i * hinges + k] * work[r + k]
        work[r + i] = s / work[o + i * hinges + i]
    for up in range(hinges):
        i = hinges - 1 - up
        s = work[r + i]
        for k in range(i + 1, hinges):
            s -= work[o + k * hinges + i] * work[r + k]
        work[r + i] = s / work[o + i * hinges + i]
        qd[b * hinges + i] = work[r + i]


@ti.func
def push_on(
    b, link, hinges, load: arrays, qd: arrays, chain: arrays, lump: arrays, pose: arrays,
    momentum: arrays,
):  # fmt: skip
    """Momentum of a link at the pose for which the velocities were found."""
    links = hinges + 1
    R, c = matrix9(pose, (b * links + link) * POSE_OF), centre_of(b, link, links, lump, pose)
    velocity, spin = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
    for i in range(link):
        h = hinge(b, i, links, chain, pose)
        axis = ti.Vector([h[0], h[1], h[2]])
        velocity += qd[b * hinges + i] * axis.cross(c - ti.Vector([h[3], h[4], h[5]]))
        spin += qd[b * hinges + i] * axis
    rho = load[b * LOAD + RHO]
    p = rho * lump[link * LUMP] * velocity
    a = rho * (R @ (matrix9(lump, link * LUMP + 4) @ (R.transpose() @ spin)))
    for d in ti.static(range(3)):
        momentum[(b * links + link) * SIX + d] = p[d]
        momentum[(b * links + link) * SIX + 3 + d] = a[d]


@ti.func
def step(
    b, lane, stride, nodes, hinges, carried, load: arrays, u: arrays, rest: arrays, total: arrays,
    q: arrays, qd: arrays, drive: arrays, chain: arrays, lump: arrays, pose: arrays, wrench: arrays,
    momentum: arrays, work: arrays, soft: arrays, bound: arrays, bound_link: arrays, bound_start: arrays,
    soa: ti.template(),
):  # fmt: skip
    """One substep of a spine and the nodes that it carries, by the lanes of a block or by one thread."""
    i = lane
    while i < (hinges + 1) * SIX:
        react(b, i, nodes, hinges, u, rest, total, bound, bound_start, pose, lump, wrench, soa)
        i += stride
    wait(soa)
    i = lane
    while i < hinges * (hinges + 1):
        assemble(b, i, hinges, load, q, drive, chain, lump, pose, wrench, momentum, work, soft)
        i += stride
    wait(soa)
    if lane == 0:
        solve(b, hinges, work, qd)
    wait(soa)
    i = lane
    while i < hinges:
        push_on(b, i + 1, hinges, load, qd, chain, lump, pose, momentum)
        q[b * hinges + i] += load[b * LOAD + DT] * qd[b * hinges + i]
        i += stride
    wait(soa)
    if lane == 0:
        bend(b, hinges, q, chain, pose)
    wait(soa)
    i = lane
    while i < carried:
        carry(b, i, nodes, hinges, u, bound, bound_link, rest, pose, soa)
        i += stride
    wait(soa)


@ti.func
def wait(soa: ti.template()):
    """On a GPU: all lanes of the block meet here."""
    if ti.static(soa):
        ti.simt.block.sync()


@ti.func
def meet(b, first, blocks, turn, gate: arrays, soa: ti.template()):
    """On a GPU: all blocks of body b meet here for the `turn`-th time; `first` is true on one lane a block.

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
    """Writes the pose of every link from the joint angles."""
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
def carry(
    b,
    k,
    nodes,
    hinges,
    u: arrays,
    bound: arrays,
    bound_link: arrays,
    rest: arrays,
    pose: arrays,
    soa: ti.template(),
):
    """Puts one bound node where its link is."""
    n = bound[k]
    T = (b * (hinges + 1) + bound_link[k]) * POSE_OF
    p = vector3(rest, n * 3)
    p = matrix9(pose, T) @ p + vector3(pose, T + 9) - p
    for d in ti.static(range(3)):
        u[place(b, n, d, nodes, soa)] = p[d]
