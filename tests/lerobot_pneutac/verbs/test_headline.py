"""Every verb counts the error of a recording alike."""

import numpy as np
import pandas as pd
import pytest

from lerobot_pneutac.verbs.compare import compare
from lerobot_pneutac.verbs.diagnose import diagnose
from lerobot_pneutac.verbs.fit_body import calibrate_body
from pneutac_datasets.recording.noise import headline
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.finger import quantities
from pneutac_sim.finger.data import BodyData, simulate
from pneutac_sim.twin import Twin


def arm_recording(folder, n=240, hz=10):
    """An arm whose recording has curvatures and joint angles, simulated by a twin, with noise."""
    rng = np.random.default_rng(0)
    twin = Twin("arm", 280.0)
    trial, time = np.arange(n) // 80, np.arange(n) % 80 / hz
    samples = {"trial": trial, "time_s": time}
    for i in range(3):
        level = rng.uniform(0, 20, n // 20)
        samples[f"pressure_cmd_{i + 1}_kpa"] = np.repeat(level, 20)
    columns = ["q_1_rad", "q_2_rad", "curvature_x_1_per_m", "curvature_y_1_per_m"]
    table = pd.DataFrame(samples | {c: np.zeros(n) for c in columns})
    made = Recording(folder, {"device": "arm", "length_mm": 280.0}, table, "arm")
    prediction = simulate(twin, made)
    order = [prediction.data.columns.index(c) for c in columns]
    noise = np.array([0.01, 0.01, 0.05, 0.05]) * rng.normal(size=(n, 4))
    table[columns] = prediction.model[:, order] + noise
    return Recording.load(made.write(folder)), twin


@pytest.mark.slow
def test_every_verb_counts_the_error_of_an_arm_with_curvature_and_angles_alike(tmp_path):
    """It used to be counted in rad by one half of the code and in 1/m by the other."""
    recording, twin = arm_recording(tmp_path / "arm")
    columns, unit = headline(recording)
    bench = BodyData.of(recording, twin)
    assert (list(bench.columns[: bench.counted]), bench.unit) == (columns, unit)

    calibrated = calibrate_body(twin, recording)
    assert calibrated.bench.unit == "1/m"
    compared = compare(calibrated.twin, recording)
    assert compared.unit == compared.noise.unit == "1/m"
    assert quantities.rms(compared.measured[:, :2] - compared.model[:, :2]) < 2 * compared.noise_floor
    diagnosis = diagnose(calibrated.twin, recording, jobs=1)
    assert diagnosis.study.unit == "1/m" and diagnosis.outcome.before.residual.shape == (len(recording), 2)
    assert diagnosis.verdict == "adequate"
