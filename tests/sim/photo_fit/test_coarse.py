"""The warm start from silhouettes alone."""

import numpy as np
import pytest

from pneutac_sim.photo_fit.coarse import coarse_fit
from pneutac_sim.photo_fit.equilibria import Equilibria
from pneutac_sim.photo_fit.parameters import body_parameters
from pneutac_sim.twin import Twin


@pytest.mark.slow
def test_finds_the_bends_from_a_twin_that_knows_nothing(drawn):
    parameters = body_parameters(Twin("finger", 110.0), 14.0)
    start = coarse_fit(parameters, drawn.pressures, drawn.photographs, device="cpu")
    there = Equilibria(parameters, start.x, drawn.pressures, particles=800, device="cpu").first
    error = np.linalg.norm(there.tips[0] - drawn.equilibria.first.tips[0], axis=1)
    assert error.max() < 0.005 * 0.110
    # The fit has another lattice of particles than the photographs.
    assert start.x[0] == pytest.approx(drawn.truth[0], rel=0.03)  # gain
    assert start.x[3] == pytest.approx(drawn.truth[3], rel=0.03)  # rest pressure
    free = parameters.of_pose
    assert np.linalg.eigvalsh(start.hessian[np.ix_(free, free)])[0] > 0
    assert not start.hessian[~free].any()
