"""Scores of known pictures; the objective at the truth and away from it; what photographs can tell.

The warm start from silhouettes alone.
"""

import numpy as np
import pytest

from pneutac_sim.photo_fit.objective import Equilibria, Objective, body_parameters, score
from pneutac_sim.photo_fit.search import coarse_fit, confidence
from pneutac_sim.splat.rasteriser import Rendering
from pneutac_sim.twin import Twin


def test_score_of_known_squares():
    mask, alpha = np.zeros((20, 20), bool), np.zeros((20, 20), np.float32)
    mask[:10, :10], alpha[:10, 5:15] = True, 0.9
    rendering = Rendering(np.repeat(alpha[..., None], 3, 2) / 0.9 * np.float32(0.5), alpha)
    image = np.full((20, 20, 3), 255, np.uint8)
    appearance, iou, rmse = score(rendering.image, rendering.alpha > 0.5, image, mask)
    assert iou == pytest.approx(50 / 150)
    assert appearance == pytest.approx(0.5 * 1 + 0.5 * 0.5)  # half missing, half of half the brightness
    assert rmse == pytest.approx(255 * np.sqrt((1 + 0.25 + 0.25) / 3), rel=1e-5)


def test_objective_is_least_at_the_truth(drawn):
    objective = Objective(drawn.equilibria, drawn.photographs, drawn.looks)
    pose = drawn.parameters.of_pose
    moves = np.diag(drawn.parameters.step)[pose]
    values = objective(np.concatenate([drawn.truth[None], drawn.truth + moves, drawn.truth - moves]))
    assert values[0] < 0.01
    assert (values[1:] > 5 * values[0]).all()
    at_truth = drawn.equilibria.first.positions[0]
    assert np.abs(objective.best - at_truth).max() < 2e-4


def test_silhouettes_tell_the_pose_and_not_the_modulus(drawn):
    objective = Objective(drawn.equilibria, drawn.photographs, drawn.looks)
    away = drawn.truth + 0.1 * drawn.parameters.step  # some misfit, as real photographs have
    found = confidence(objective, away)
    assert "gain_rad_per_kpa" not in found.not_identified
    assert "rest_pressure_kpa" not in found.not_identified
    relative = found.sd / drawn.parameters.prior_sd
    of = dict(zip(drawn.parameters.names, relative, strict=True))
    assert of["youngs_modulus_mpa"] > 10 * of["gain_rad_per_kpa"]
    low, high = found.ci95["youngs_modulus_mpa"]
    assert 0.2 <= low < 0.945 < high <= 4.0


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
