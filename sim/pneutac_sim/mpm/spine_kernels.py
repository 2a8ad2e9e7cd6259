"""Kernels of the spine: a chain of hinges that carries nodes of the body and feels their forces.

The nodes of a link move with it as one rigid lump, so the joint feels just what the body does to these nodes
(virtual work): no coupling spring, no step size in the stiffness, action and reaction to rounding. Momentum
is kept a link and projected onto the joints at the new pose (Gauss' principle), which has the terms of
Coriolis in it; the controller's spring and damper are taken implicitly.
"""

from pneutac_sim.mpm.lagrangian_kernels import DAMPING, DT, LOAD, RHO, arrays, matrix9, place, vector, vector3
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
def project(
    b,
    hinges,
    load: arrays,
    q: arrays,
    qd: arrays,
    drive: arrays,
    chain: arrays,
    lump: arrays,
    pose: arrays,
    wrench: arrays,
    momentum: arrays,
    work: arrays,
    soft: arrays,
):
    """Joint velocities and angles one step on; `drive` has rows target, stiffness, damping a hinge.

    `soft` gets the torque of body and gravity about each hinge.
    """
    at = b * LOAD
    rho, dt = load[at + RHO], load[at + DT]
    keep = ti.exp(-load[at + DAMPING] * dt)
    links = hinges + 1
    size = hinges * (hinges + 1)  # matrix and right-hand side
    o = b * size
    for i in range(size):
        work[o + i] = 0.0
    for i in range(hinges):
        soft[b * hinges + i] = 0.0
    for link in range(1, links):
        R = matrix9(pose, (b * links + link) * POSE_OF)
        centre = R @ vector3(lump, link * LUMP + 1) + vector3(pose, (b * links + link) * POSE_OF + 9)
        m = rho * lump[link * LUMP]
        inertia = rho * (R @ matrix9(lump, link * LUMP + 4) @ R.transpose())
        w = (b * links + link) * SIX
        p = keep * vector3(momentum, w) + dt * vector3(wrench, w)
        a = keep * vector3(momentum, w + 3) + dt * vector3(wrench, w + 3)
        for i in range(link):
            Ti = (b * links + i) * POSE_OF
            axis_i = matrix9(pose, Ti) @ vector3(chain, i * CHAIN + 3)
            arm_i = axis_i.cross(
                centre - matrix9(pose, Ti) @ vector3(chain, i * CHAIN) - vector3(pose, Ti + 9)
            )
            work[o + hinges * hinges + i] += arm_i.dot(p) + axis_i.dot(a)
            soft[b * hinges + i] += arm_i.dot(vector3(wrench, w)) + axis_i.dot(vector3(wrench, w + 3))
            for j in range(i + 1):
                Tj = (b * links + j) * POSE_OF
                axis_j = matrix9(pose, Tj) @ vector3(chain, j * CHAIN + 3)
                arm_j = axis_j.cross(
                    centre - matrix9(pose, Tj) @ vector3(chain, j * CHAIN) - vector3(pose, Tj + 9)
                )
                work[o + i * hinges + j] += m * arm_i.dot(arm_j) + axis_i.dot(inertia @ axis_j)
    for i in range(hinges):
        d = (b * hinges + i) * 3
        stiffness, damping = drive[d + 1], drive[d + 2]
        work[o + hinges * hinges + i] += dt * stiffness * (drive[d] - q[b * hinges + i])
        work[o + i * hinges + i] += dt * (damping + dt * stiffness)
    for i in range(hinges):  # Cholesky, then two triangular solves, in place
        for j in range(i + 1):
            s = work[o + i * hinges + j]
            for k in range(j):
                s -= work[o + i * hinges + k] * work[o + j * hinges + k]
            work[o + i * hinges + j] = ti.sqrt(ti.max(s, 1e-30)) if i == j else s / work[o + j * hinges + j]
        s = work[o + hinges * hinges + i]
        for k in range(i):
            s -= work[o + i * hinges + k] * work[o + hinges * hinges + k]
        work[o + hinges * hinges + i] = s / work[o + i * hinges + i]
    for r in range(hinges):
        i = hinges - 1 - r
        s = work[o + hinges * hinges + i]
        for k in range(i + 1, hinges):
            s -= work[o + k * hinges + i] * work[o + hinges * hinges + k]
        work[o + hinges * hinges + i] = s / work[o + i * hinges + i]
        qd[b * hinges + i] = work[o + hinges * hinges + i]
    # Momentum of each link at the pose in which the velocities were found, then the new pose.
    for link in range(1, links):
        R = matrix9(pose, (b * links + link) * POSE_OF)
        centre = R @ vector3(lump, link * LUMP + 1) + vector3(pose, (b * links + link) * POSE_OF + 9)
        velocity, spin = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
        for i in range(link):
            Ti = (b * links + i) * POSE_OF
            axis = matrix9(pose, Ti) @ vector3(chain, i * CHAIN + 3)
            arm = centre - matrix9(pose, Ti) @ vector3(chain, i * CHAIN) - vector3(pose, Ti + 9)
            velocity += qd[b * hinges + i] * axis.cross(arm)
            spin += qd[b * hinges + i] * axis
        p = rho * lump[link * LUMP] * velocity
        a = rho * (R @ matrix9(lump, link * LUMP + 4) @ R.transpose()) @ spin
        for d in ti.static(range(3)):
            momentum[(b * links + link) * SIX + d] = p[d]
            momentum[(b * links + link) * SIX + 3 + d] = a[d]
    for i in range(hinges):
        q[b * hinges + i] += dt * qd[b * hinges + i]
    bend(b, hinges, q, chain, pose)


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
