"""The warm start from silhouettes alone."""

import numpy as np
import pytest

from pneutac_sim.photo_fit.coarse import coarse_fit, reduced, thin
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


def test_thinning_keeps_what_a_smooth_picture_weighs():
    y, x = np.mgrid[:200, :200]
    smooth = np.exp(-((x - 90.0) ** 2 + (y - 110.0) ** 2) / (2 * 30.0**2)).astype(np.float32)
    whole, few = np.square(smooth).sum(), np.square(thin(smooth, 4.0)).sum()
    assert thin(smooth, 4.0).shape == (50, 50)
    assert abs(few / whole - 1) < 0.05


def test_reduced_photographs_show_points_in_the_same_place(drawn):
    large = drawn.photographs[0]
    small = reduced(large)
    points = drawn.equilibria.first.positions[0, 0]
    a, b = large.camera.project(points)[0], small.camera.project(points)[0]
    scale = np.array([small.camera.width / large.camera.width, small.camera.height / large.camera.height])
    assert np.allclose(a * scale, b)
    assert abs(small.mask.mean() - large.mask.mean()) < 1e-3
