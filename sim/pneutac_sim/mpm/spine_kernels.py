"""Kernels of the spine: a chain of hinges that carries nodes of the body and feels their forces.

The nodes of a link move with it as one rigid lump, so the joint feels just what the body does to these nodes
(virtual work): no coupling spring, no step size in the stiffness, action and reaction to rounding. Momentum
is computed per link and projected onto the joints at the new pose (Gauss' principle), which has the terms of
Coriolis in it; the controller's spring and damper are taken implicitly:

    (M + dt (D + dt K)) q'_new = J^T (p + dt w) + dt K (q_cmd - q),   q <- q + dt q'_new

with J the Jacobian of the links' motion, M = J^T diag(m, I) J, p and w their momenta and wrenches, K and D
the controller's stiffness and damping (Featherstone 2008, 'Rigid body dynamics algorithms', chapter 6).
"""

from pneutac_sim.mpm.runtime import ti
from pneutac_sim.mpm.state import (
    CHAIN,
    DT,
    KEEP,
    LOAD,
    LUMP,
    POSE_OF,
    RHO,
    SIX,
    arrays,
    matrix9,
    place,
    state,
    vector,
    vector3,
)


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
def step(b, lane, stride, data: state, soa: ti.template()):
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
