"""Hidden loads: what hangs on the finger; joint angles in, torque out, N m."""

import numpy as np

from pneutac_datasets.generate.hidden.foreign import foreign

GRAVITY = 9.81


@foreign("gravity", "weight spread along every link", "load", nominal=0.05, largest=1.0)
def distributed_weight(q, bench, size, rng):
    """`size` kg spread along the links, thicker at the base; ten points of each link pull on the joints."""
    joints = bench.joint_positions_m
    ends = np.append(joints, bench.base["length_mm"] / 1000)
    taper = rng.uniform(0.0, 0.5)
    arc = np.concatenate([np.linspace(a, b, 21)[1::2] for a, b in zip(ends[:-1], ends[1:], strict=True)])
    mass = 1 - taper * arc / ends[-1]
    mass *= size / mass.sum()
    return _torque(q, bench, arc, mass)


@foreign("payload", "lump hung below the tip", "load", nominal=1.0, largest=20.0)
def hung_payload(q, bench, size, rng):
    """The mass on record pulls at a hook beyond the tip, `size` times what the scale said."""
    arc = np.array([bench.base["length_mm"] / 1000 * rng.uniform(1.0, 1.1)])
    unit = _torque(q, bench, arc, np.array([1.0]))
    return unit * (size * bench.payload_g[bench.logged] / 1000)[:, None]


def _torque(q, bench, arc, mass):
    """Moment (m, 4), N m, of point masses at arc lengths (k,) about each joint, by virtual work."""
    joints = bench.joint_positions_m
    heading = np.cumsum(q, axis=1)
    c, s = np.cos(heading), np.sin(heading)
    ends = np.append(joints, np.inf)
    g = GRAVITY * bench.gravity[bench.logged]
    torque = np.zeros_like(q)
    # x, z of each joint, then of each mass as joint + rest of its link
    px = np.concatenate(
        [np.full((len(q), 1), joints[0]), joints[0] + np.cumsum(c[:, :-1] * np.diff(joints), 1)], 1
    )
    pz = np.concatenate([np.zeros((len(q), 1)), np.cumsum(s[:, :-1] * np.diff(joints), 1)], 1)
    for a, m in zip(arc, mass, strict=True):
        link = int(np.searchsorted(ends, a, side="right")) - 1
        x = px[:, link] + (a - joints[link]) * c[:, link]
        z = pz[:, link] + (a - joints[link]) * s[:, link]
        for n in range(link + 1):
            # turning joint n by +dq moves the mass by dq (-(z - pz), x - px)
            torque[:, n] += m * (-(z - pz[:, n]) * g[:, 0] + (x - px[:, n]) * g[:, 2])
    return torque
