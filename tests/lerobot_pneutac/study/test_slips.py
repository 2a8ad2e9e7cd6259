"""A marker that slips, found in a residual: where, and by how much."""

import numpy as np
import pytest

from lerobot_pneutac.study.data_breaks import find_slip

TRIAL = np.arange(6000) // 750
RESTS = np.zeros((6000, 3))  # a prediction
NOISE, SHIFT = 0.4, np.array([1.5, 0.0, -2.0])
DRIFT = np.array([0.0, 0.3, 0.5])  # over the recording; part of it is taken for the shift


@pytest.fixture
def world():
    """A residual with a drift and a memory that no parameter explains, and a Jacobian of one parameter."""
    rng = np.random.default_rng(3)
    t = np.arange(6000) * 0.05
    drive = np.repeat(rng.uniform(0, 1, 300), 20)
    slow = np.convolve(drive, np.exp(-t / 4) * 0.05 / 4)[: len(t)]
    residual = np.outer(slow - 0.5 * drive, [0.6, 0.1, 1.0]) + np.outer(t / t[-1], DRIFT)
    residual += rng.normal(0, NOISE / np.sqrt(3), (len(t), 3))
    rows = np.flatnonzero(rng.random(len(t)) < 0.4)
    return residual, rows, np.outer(drive, [0.6, 0.1, 1.0])[rows].reshape(-1, 1)


@pytest.mark.parametrize("at", [1504, 2980, 4000])
def test_a_slip_is_found_to_a_sample_and_to_a_quarter(world, at):
    residual, rows, jacobian = world
    residual[at:] += SHIFT
    found, shift = find_slip(residual, RESTS, TRIAL, rows, jacobian, NOISE)
    assert abs(found - at) <= 1
    assert np.linalg.norm(shift - SHIFT) < 0.25 * np.linalg.norm(SHIFT)


def test_what_drifts_remembers_or_comes_back_is_no_slip(world):
    residual, rows, jacobian = world
    assert find_slip(residual, RESTS, TRIAL, rows, jacobian, NOISE) is None
    residual[2000:2300] += 2 * SHIFT
    assert find_slip(residual, RESTS, TRIAL, rows, jacobian, NOISE) is None


def test_what_moves_there_over_several_samples_is_no_slip(world):
    """So do unknown physics: in a trial of a higher pressure the residual goes to another place."""
    residual, rows, jacobian = world
    residual += np.outer(np.clip((np.arange(len(residual)) - 2980) / 4, 0, 1), SHIFT)
    assert find_slip(residual, RESTS, TRIAL, rows, jacobian, NOISE) is None


def test_where_the_body_moves_farther_a_residual_may_jump_for_another_reason(world):
    """A warm-up or self-heating that the model does not know makes every step of the command too large."""
    residual, rows, jacobian = world
    residual[2980:] += SHIFT
    steps = np.outer(np.arange(6000) >= 2980, 10 * SHIFT)
    assert find_slip(residual, 0.05 * steps, TRIAL, rows, jacobian, NOISE) is not None
    assert find_slip(residual, steps, TRIAL, rows, jacobian, NOISE) is None


def test_between_two_trials_it_may_be_a_payload(world):
    residual, rows, jacobian = world
    residual[3000:] += SHIFT
    assert find_slip(residual, RESTS, TRIAL, rows, jacobian, NOISE) is None
