"""How likely a finding is right: it falls with what is left, and weights come back from made-up answers."""

import numpy as np

from belief import fitted
from lerobot_pneutac.diagnosis.verdict import calibrated_confidence, features


def test_what_explains_less_is_less_likely_right_and_a_verdict_of_sufficient_form_more():
    told = [calibrated_confidence(error, 0.9, True) for error in (1.0, 1.2, 2.0, 5.0)]
    assert all(a > b for a, b in zip(told, told[1:], strict=False)) and 0 < told[-1] < told[0] < 1
    assert calibrated_confidence(1.1, 0.9, True) > calibrated_confidence(1.1, 0.9, False)
    assert calibrated_confidence(1.1, 0.9, True) > calibrated_confidence(1.1, 0.3, True)
    assert calibrated_confidence(0.9, 1.0, True) == calibrated_confidence(1.0, 1.0, True) < 1


def test_weights_come_back_from_answers_that_they_made():
    rng, true = np.random.default_rng(0), np.array([-0.5, -2.0, 0.5, 1.5])
    X = features(np.exp(rng.exponential(0.5, 20_000)), rng.random(20_000), rng.random(20_000) < 0.5)
    right = (rng.random(20_000) < 1 / (1 + np.exp(-true @ X))).astype(float)
    np.testing.assert_allclose(fitted(X, right, np.ones(20_000)), true, atol=0.15)
