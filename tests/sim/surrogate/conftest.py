"""An action network by formula, and a small collection of motions of the full finger."""

import numpy as np
import pytest

from pneutac_sim.surrogate.finger import fingerprint
from pneutac_sim.surrogate.network import HIDDEN, ActionNetwork
from pneutac_sim.surrogate.skeleton import Skeleton
from pneutac_sim.twin import Twin


@pytest.fixture(scope="session")
def network():
    """A network with random weights for the built-in finger, torques of about 0.05 N m."""
    rng, n = np.random.default_rng(0), 4
    shapes = ((2 * n + 1, HIDDEN), HIDDEN, (HIDDEN, HIDDEN), HIDDEN, (HIDDEN, n), n)
    rods = np.array([0.02, 0.016, 0.01, 0.005])
    r = np.tril(np.ones((n, n))) * (0.025 + 0j)
    r[np.diag_indices(n)] = 0.0125 + 0.002j
    return ActionNetwork(
        layers=tuple((rng.normal(size=s) / 8).astype(np.float32) for s in shapes),
        slope=rng.normal(size=(9, n)) * 0.002,
        mean=rng.normal(size=9) * 0.1,
        scale=np.array([0.2] * 4 + [2.0] * 4 + [5.0]),
        torque_mean=rng.normal(size=n) * 0.02,
        torque_scale=np.full(n, 0.05),
        low=np.array([-0.1] * 4 + [-3.0] * 4 + [0.0]),
        high=np.array([0.6] * 4 + [3.0] * 4 + [15.0]),
        drive=np.array([0.01114, 10.7]),
        skeleton=Skeleton(
            (rods[:, None, None] * np.einsum("ki,kj->kij", r.conj(), r)).sum(0), rods * 5e-5, 20.0, 0.01, 60.0
        ),
        fingerprint=fingerprint(Twin.builtin()),
    )
