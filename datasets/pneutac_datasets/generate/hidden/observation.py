"""Hidden observation: how the marker is seen."""

import numpy as np
from scipy.spatial.transform import Rotation

from pneutac_datasets.generate.hidden.foreign import foreign


@foreign("base_tilt", "rigid motion of the mount that also flexes", "marker", nominal=2.0, largest=20.0)
def mount(tip, bench, size, rng):
    """The base is turned by `size` degrees and shifted; the mount gives way by a tenth more under load."""
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    shift = rng.normal(size=3) * 0.2 * size
    load = tip[:, 2] / max(np.abs(tip[:, 2]).max(), 1e-9)
    turn = Rotation.from_rotvec(np.radians(size) * (1 + 0.1 * load)[:, None] * axis)
    return turn.apply(tip) + shift


@foreign("camera_misalignment", "perspective of a camera out of place", "marker", nominal=3.0, largest=20.0)
def perspective(tip, bench, size, rng):
    """A camera looking along y, thought to be square to the bending plane, is out of place.

    It is turned by `size` degrees and moved, sideways and five times as far along its line of sight. The
    marker's place is read off at the distance that the camera was thought to have: a projective map.
    """
    length = bench.base["length_mm"]
    distance = length * rng.uniform(1.5, 2.5)
    centre = np.array([0.6 * length, 0.0, 0.3 * length])
    axis = rng.normal(size=3) * (1.0, 0.3, 1.0)  # roll about the line of sight alone would look like a tilt
    turned = Rotation.from_rotvec(np.radians(size) * axis / np.linalg.norm(axis)).apply(tip - centre)
    turned += 0.01 * size * length * rng.choice([-1.0, 1.0], 3) * (1.0, 5.0, 1.0)
    scale = distance / (distance + turned[:, 1])
    seen = centre + turned * np.stack([scale, np.zeros(len(tip)), scale], 1)
    seen[:, 1] = tip[:, 1]
    return seen
