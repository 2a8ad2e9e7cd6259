"""How strong imprints are, against those that a twin was fitted to."""

import numpy as np
import pytest

from lerobot_pneutac.diagnosis.thresholds import STRENGTH_DIFFERS
from lerobot_pneutac.study.demonstration_fit import STIFFNESS, TYPICAL, Strength
from pneutac_sim.twin import Twin

GAINS = np.array([0.7, 0.8, 0.75, 0.85, 0.0, 0.78, 0.74])  # an episode without an imprint decides nothing


def strength(share=1.0, twin=None):
    """Of a finger that presses with a share of the force."""
    return Strength.of(share**TYPICAL * GAINS, 1.1, twin or Twin.builtin())


def test_a_softer_finger_is_told_with_its_force():
    known, twin = strength(), Twin.builtin()
    for share in (0.7, 1.4):
        seen = strength(share)
        assert seen.log_ratio(known) == pytest.approx(TYPICAL * np.log(share), abs=1e-9)
        stiff = seen.pressing(twin, known).parameters[STIFFNESS]
        assert stiff.value == pytest.approx(share * twin.parameter(STIFFNESS))
        assert stiff.ci95[0] < stiff.value < stiff.ci95[1]
    assert strength(np.exp(-0.9 * STRENGTH_DIFFERS / TYPICAL)).log_ratio(known) == 0


def test_a_corrected_twin_is_not_corrected_again():
    known, twin = strength(), Twin.builtin()
    softer = strength(0.7).pressing(twin, known)
    share = softer.parameter(STIFFNESS) / twin.parameter(STIFFNESS)
    gains = 0.7**TYPICAL * GAINS / share**known.growth  # its replays press with less force
    assert Strength.of(gains, known.growth, softer).log_ratio(known) == 0


def test_few_episodes_that_differ_much_tell_nothing():
    wide = Strength.of(0.7**TYPICAL * np.array([0.2, 0.8, 3.0]), 1.1, Twin.builtin())
    assert wide.log_ratio(strength()) == 0
