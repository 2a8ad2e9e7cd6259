"""The two answers scored: weights come back from made-up causes, and reported shares are counted."""

import io

import numpy as np
from rich.console import Console

from pneutac_benchmarks.diagnosis.answers import fitted, show


def test_weights_come_back_from_answers_that_they_made():
    rng, true = np.random.default_rng(0), np.array([-1.0, 0.5, 1.5])
    X = np.column_stack([np.ones(20_000), rng.normal(2.0, 3.0, 20_000), rng.random(20_000) < 0.5])
    right = (rng.random(20_000) < 1 / (1 + np.exp(-X @ true))).astype(float)
    np.testing.assert_allclose(fitted(X, right), true, atol=0.1)


def test_recordings_and_causes_are_counted():
    def answer(ratio, explained, effects="creep_fractional", term="lag(p)"):
        cause = {"cause": "creep", "ranked": {"creep": 0.9}, "certain": True, "terms": [term]}
        return {
            "ratio": ratio, "explained": explained, "effects": effects, "truth": [effects], "causes": [cause]
        }  # fmt: skip

    printed = io.StringIO()
    answers = [answer(1.1, "fully"), answer(1.2, "mostly"), answer(1.6, "fully", "marker_slip")]
    show(answers, Console(file=printed, width=200))
    text = printed.getvalue()
    assert "1 of 2" in text  # of two recordings that end explained, and of two that were called so
    assert "1 of 1" in text  # without the marker that slipped between the days
    assert "2 of 3" in text and "3 causes; Brier score 0.277" in text
