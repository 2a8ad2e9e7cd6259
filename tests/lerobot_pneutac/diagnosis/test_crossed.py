"""Errors on folds that a fit did not see, from one fit, against fits without each fold."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import lsq_linear

from lerobot_pneutac.diagnosis.thresholds import FAR
from lerobot_pneutac.study.body_model import BodyFitter, BodyModel, InputModel
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.twin import Twin

N, F, D = 300, 4, 2


def linear(weight, held=()):
    """A linear model of two columns, fitted by ridge regression; `held`: parameters at a bound."""
    rng = np.random.default_rng(0)
    A = rng.normal(size=(N * D, F))
    y = A @ np.array([0.4, 0.5, 0.6, 0.5]) + 0.2 * rng.normal(size=N * D)
    centre, W = np.full(F, 0.5), weight * np.eye(F)
    use = [j for j in range(F) if j not in held]

    def fit(rows):
        v, u = np.zeros(F), np.ix_(use, use)
        H = A[rows].T @ A[rows] + W
        v[use] = np.linalg.solve(H[u], (A[rows].T @ y[rows] + W @ centre)[use])
        return v

    every = np.arange(N * D)
    v = fit(every)
    model = BodyModel(
        structure=None, pipeline=None, theta=v, free=np.arange(F), v=v, residual=(A @ v - y).reshape(N, D),
        slope=lambda: A, weight=W, pull=W @ (v - centre), counted=1, bounds=SimpleNamespace(),
    )  # fmt: skip
    return model, fit, A, y


@pytest.mark.parametrize(("weight", "held"), [(0.0, ()), (25.0, ()), (0.0, (2,))])
def test_crossed_equals_explicit_refits_of_a_linear_model(weight, held):
    model, fit, A, y = linear(weight, held)
    fold = np.arange(N) // 20 % 5
    cv_squared = model.cv_squared(fold)
    for k in range(5):
        v = fit(np.flatnonzero(np.repeat(fold != k, D)))
        apart = ((A @ v - y).reshape(N, D)[:, 0] ** 2)[fold == k]
        np.testing.assert_allclose(cv_squared[fold == k], apart, rtol=1e-4, atol=1e-8)


@pytest.mark.parametrize("bounded", [4, 3])
def test_of_numbers_that_only_their_sum_tells_none_leaves_its_bounds(bounded):
    """Two columns are nearly alike: without a fold they would go far apart, each to undo the other.

    What a trial has of its own comes after the device's numbers and has no bounds.
    """
    model, _, A, _ = linear(0.0)
    A[:, 1] = A[:, 0] + 0.002 * A[:, 1]
    v, noise = np.array([0.4, 0.9, 0.6, 0.5]), 0.2 * np.random.default_rng(1).normal(size=N * D)
    r = noise - A @ np.linalg.lstsq(A, noise, rcond=None)[0]  # so v is the best of all rows
    fold = np.arange(N) // 20 % 5
    cv_squared = replace(model, v=v[:bounded], residual=r.reshape(N, D), slope=lambda: A).cv_squared(fold)
    for k in range(5):
        rows = np.repeat(fold != k, D)
        within = np.clip([v - FAR, v + FAR], 0, 1)
        within[:, bounded:] = [[-np.inf], [np.inf]]
        apart = A @ lsq_linear(A[rows], (A @ v - r)[rows], within).x - (A @ v - r)
        expected = (apart.reshape(N, D)[fold == k, 0] ** 2).mean()
        np.testing.assert_allclose(cv_squared[fold == k].mean(), expected, rtol=1e-3)


def test_rows_of_no_fold_stay_out_and_count_nothing():
    model, fit, A, y = linear(0.0)
    fold = np.where(np.arange(N) < 200, -1, 0)
    cv_squared = model.cv_squared(fold)
    assert not cv_squared[:200].any()
    v = fit(np.flatnonzero(np.repeat(fold < 0, D)))
    np.testing.assert_allclose(
        cv_squared[200:], (A @ v - y).reshape(N, D)[200:, 0] ** 2, rtol=1e-4, atol=1e-8
    )


def test_without_a_free_parameter_nothing_moves():
    model, *_ = linear(0.0, held=range(F))
    np.testing.assert_array_equal(model.cv_squared(np.arange(N) % 5), model.residual[:, 0] ** 2)


def test_a_recording_is_read_though_another_thread_empties_what_was_read(tmp_path):
    class Emptied(dict):
        def __setitem__(self, key, value):
            super().__setitem__(key, value)
            self.clear()

    t = np.arange(50) / 10
    table = pd.DataFrame({"trial": 0, "time_s": t, "pressure_cmd_kpa": t, "tip_x_mm": 100.0, "tip_z_mm": t})
    recording = Recording(tmp_path, {"length_mm": 110.0}, table, "finger")
    fitter = BodyFitter(recording, Twin.builtin(), np.arange(50))
    fitter._data = Emptied()
    np.testing.assert_array_equal(fitter.data(InputModel()).measured[:, 1], t)
