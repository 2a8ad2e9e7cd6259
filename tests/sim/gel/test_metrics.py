import numpy as np
import pytest

from pneutac_sim.gel import metrics


def test_rmse_and_psnr_of_a_known_error():
    a = np.full((4, 5, 3), 100.0)
    assert metrics.rmse(a, a + 2) == 2
    assert metrics.psnr(a, a + 2) == pytest.approx(20 * np.log10(255 / 2))
    assert metrics.psnr(a, a) == np.inf


def test_ncc_ignores_gain_and_offset_of_each_channel_but_sees_a_swap():
    rng = np.random.default_rng(0)
    a = rng.normal(size=(20, 20, 3))
    assert metrics.ncc(a, a * [2, 3, 0.5] + [10, -5, 100]) == pytest.approx(1)
    assert metrics.ncc(a, -a) == pytest.approx(-1)
    assert abs(metrics.ncc(a, a[..., ::-1])) < 0.5


def test_contact_scores_see_what_whole_frame_scores_hide():
    rng = np.random.default_rng(0)
    rest = np.broadcast_to(np.linspace(0, 200, 240)[None, :, None], (320, 240, 3))
    bump = 40 * metrics.disc(rest.shape, 100, 80, 20)[..., None] * rng.choice([-1, 1], (1, 1, 3))
    real = rest + bump
    nothing = metrics.score(rest, real, rest, 100, 80, 20)
    assert nothing.ncc > 0.97 and nothing.contact_dncc == 0
    assert nothing.contact_rmse == pytest.approx(20, rel=0.05), "the bump fills a quarter of the disc"
    right = metrics.score(rest + 0.9 * bump, real, rest, 100, 80, 20)
    assert right.contact_dncc == pytest.approx(1) and right.contact_rmse == pytest.approx(2, rel=0.05)


def test_a_wrong_balance_of_colours_counts_in_the_difference():
    rng = np.random.default_rng(0)
    rest, d = np.full((60, 60, 3), 100.0), rng.normal(size=(60, 60, 1)) * [10, 10, 10]
    tinted = metrics.score(rest + d * [1, -1, 1], rest + d, rest, 30, 30, 10)
    assert tinted.contact_dncc == pytest.approx(1 / 3, abs=0.05)
