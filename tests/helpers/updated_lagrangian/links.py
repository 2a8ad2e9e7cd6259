"""The rigid links of the reference solver: which nodes lie across one (CPIC), and the motion of the hinges.

[M] as in `kernels`. A link has no momentum of its own but, each substep, that of all transfers that
cross it, so the hinges have the inertia of just this material.
"""

import numpy as np

from pneutac_sim.mpm.runtime import ti
from pneutac_sim.mpm.spine import Spine
from pneutac_sim.mpm.state import CHAIN, DT, KEEP, LOAD, POSE_OF, arrays, matrix9, vector3

NEAR = 0.02  # grid spacings


def strips(spine: Spine) -> np.ndarray:
    """(H + 1, 5) first x, last x, y, z, half width of each link at rest, m; see `side_of`.

    Between the two hinges of a joint lies a link without length.
    """
    joints = np.repeat(spine.joint_positions_m, spine.axes)
    ends = np.concatenate([[0.0], joints, [spine.length_m]])
    across = np.tile([spine.y_m, spine.z_m, spine.radius_m], (len(ends) - 1, 1))
    return np.column_stack([ends[:-1], ends[1:], across])


def skin_gradient(spine: Spine, q: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(B, P, 3, 3) of `Spine.skin`, by central differences."""
    step = 1e-4 * spine.length_m * np.eye(3)
    ends = [spine.skin(q, points + e) - spine.skin(q, points - e) for e in step]
    return np.stack(ends, -1) / (2 * step[0, 0])


@ti.func
def through(tag, side):
    """1 where a link lies between a particle and a node ([M]: they are incompatible), else 0."""
    return ti.cast(tag * side <= 0 and tag != 0, ti.i32)


@ti.func
def side_of(x, was, b, links, dx, strip: arrays, pose: arrays):
    """Tag of a node: 0 far from all links, else side (+1 or -1) times (number of the nearest link + 1).

    A node hard by a change of side or link keeps what it `was`: it would flip for ever at rest.
    `strip` has rows first x, last x, y, z, half width a link, at rest ([M], 'colored distance field').
    """
    tag, nearest = 0, 2.0 * dx
    for link in range(links):
        T = (b * links + link) * POSE_OF
        r = matrix9(pose, T).transpose() @ (x - vector3(pose, T + 9))
        beyond = ti.max(strip[link * 5] - r[0], r[0] - strip[link * 5 + 1], 0.0)
        above = r[2] - strip[link * 5 + 3]
        # Past the end of the first and of the last link there is nothing to be on a side of.
        end = (link == 0 and r[0] < strip[0]) or (link == links - 1 and r[0] > strip[link * 5 + 1])
        d = ti.sqrt(beyond * beyond + above * above)
        if ti.abs(was) == link + 1:
            d -= NEAR * dx
        if d < nearest and not end and ti.abs(r[1] - strip[link * 5 + 2]) <= strip[link * 5 + 4]:
            nearest = d
            upper = above >= 0.0
            if ti.abs(above) < NEAR * dx and was != 0:
                upper = was > 0
            tag = link + 1 if upper else -link - 1
    return tag


@ti.func
def lever(b, link, h, x, links, chain: arrays, pose: arrays):
    """Velocity of the place x on a link per unit rate of hinge h; nothing for hinges beyond the link."""
    T = (b * links + h) * POSE_OF
    R = matrix9(pose, T)
    arm = x - R @ vector3(chain, h * CHAIN) - vector3(pose, T + 9)
    return (R @ vector3(chain, h * CHAIN + 3)).cross(arm) * ti.cast(h < link, ti.f64)


@ti.func
def hinges_move(
    b, hinges, load: arrays, M: arrays, Q: arrays, momentum: arrays, q: arrays, qd: arrays, drive: arrays
):
    """Rates of the hinges one step on: (M + dt D + dt^2 K) q' = momentum + dt (Q + K (q_cmd - q))."""
    at, o, B = b * LOAD, b * hinges * hinges, b * hinges
    dt = load[at + DT]
    for i in range(hinges):
        K, D = drive[(B + i) * 3 + 1], drive[(B + i) * 3 + 2]
        qd[B + i] = momentum[B + i] * load[at + KEEP]
        qd[B + i] += dt * (Q[B + i] + K * (drive[(B + i) * 3] - q[B + i]))
        M[o + i * hinges + i] += dt * (D + dt * K)
    for i in range(hinges):  # elimination without pivots: M is positive definite
        for j in range(i + 1, hinges):
            c = M[o + j * hinges + i] / M[o + i * hinges + i]
            for k in range(i, hinges):
                M[o + j * hinges + k] -= c * M[o + i * hinges + k]
            qd[B + j] -= c * qd[B + i]
    for back in range(hinges):
        i = hinges - 1 - back
        for k in range(i + 1, hinges):
            qd[B + i] -= M[o + i * hinges + k] * qd[B + k]
        qd[B + i] /= M[o + i * hinges + i]
