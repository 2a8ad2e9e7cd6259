"""`pneutac diagnose` on longer recordings, generated and real: the effects are named."""

import os
from pathlib import Path

import pytest
from generated import twin_of

from lerobot_pneutac.verbs.diagnose import diagnose
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.twin import Twin

pytestmark = pytest.mark.slow


def test_measured_pressure_tells_the_valve_from_the_body(bench):
    recording = bench("valve_lag")
    d = diagnose(twin_of(recording), recording, jobs=1)
    assert d.selected[0] in ("valve_lag", "orifice_flow") and d.study.measured
    assert "creep" not in d.selected
    assert d.outcome.pressure_error[1] < 0.5 * d.outcome.pressure_error[0]
    assert d.after["heldout"] < 0.6 * d.before["heldout"]


def test_a_disturbance_is_unknown_and_no_headline(bench):
    recording = bench("disturbance_base_bumps")
    d = diagnose(twin_of(recording), recording, jobs=1)
    assert d.verdict == "unknown_effect"
    assert "no known effect" in d.sentence


@pytest.mark.parametrize("effect", ["hysteresis", "gravity", "leak", "cyclic_softening"])
def test_hidden_effects_are_named_blindly(bench, effect):
    recording = bench(effect, minutes=10.0, seed=5002)
    d = diagnose(twin_of(recording), recording, jobs=1)
    assert d.verdict in ("missing_effect", "insufficient_form") and d.selected[0] == effect
    assert d.reduction[0] > 0.8


def real(name):
    root = os.environ.get("PNEUTAC_DATA")
    if not root or not (Path(root) / "soft" / name).is_dir():
        pytest.skip("PNEUTAC_DATA is unset: no real recordings here")
    return Recording.load(Path(root) / "soft" / name)


def test_real_segment_stiffens():
    recording = real("sopra_segment")
    d = diagnose(twin_of(recording), recording, jobs=1)
    assert "stiffening" in d.selected and d.after["heldout"] < 0.5 * d.before["heldout"]


@pytest.fixture(scope="module")
def fabric_segment():
    recording = real("asu_segment")
    return diagnose(Twin("finger", recording.length_mm), recording)


def test_real_segment_lag_and_creep_are_told_apart(fabric_segment):
    d = fabric_segment
    assert {"valve_lag", "orifice_flow"} & set(d.selected) and "creep" in d.selected
    assert d.outcome.pressure_error[1] < 0.5 * d.outcome.pressure_error[0]  # the air by itself
    assert d.reduction[1][0] > 0  # the whole interval: the error surely falls


def test_real_segment_error_is_halved(fabric_segment):
    assert fabric_segment.after["heldout"] < 0.5 * fabric_segment.before["heldout"]
