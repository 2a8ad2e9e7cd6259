"""The tables of bodies, drawn and calibrated: what is measured, what is left out, what is written."""

import numpy as np
import pytest

from pneutac_benchmarks.body.looks import rmse
from pneutac_benchmarks.body.options import BenchmarkBodyConfig
from pneutac_sim.errors import InputError

pytestmark = pytest.mark.slow


def test_error_counts_both_silhouettes_and_nothing_else():
    photograph = np.full((4, 4, 3), 200, np.uint8)
    mask = np.zeros((4, 4), bool)
    mask[0, :2] = True
    image, alpha = np.zeros((4, 4, 3)), np.zeros((4, 4))
    image[0, 1:3], alpha[0, 1:3] = 190 / 255, 1.0
    # missed: 200 levels; right but for 10 levels; drawn where there is nothing: 190 levels
    assert rmse(image, alpha, photograph, mask) == pytest.approx(np.sqrt((200**2 + 10**2 + 190**2) / 3))
    assert rmse(np.zeros_like(image), np.zeros_like(alpha), photograph, mask) == pytest.approx(200)


def test_bad_options_are_named():
    with pytest.raises(InputError, match="^step_kpa is 0; it must be above 0"):
        BenchmarkBodyConfig(step_kpa=0)
    with pytest.raises(InputError, match="^bodies is 0; it must be 1"):
        BenchmarkBodyConfig(bodies=0)
    with pytest.raises(InputError, match="^part is 'shapes'; it must be one of looks, shape, all"):
        BenchmarkBodyConfig(part="shapes")
    with pytest.raises(InputError, match="give at least one"):
        BenchmarkBodyConfig(fingers=0, arms=0, hidden=0)
