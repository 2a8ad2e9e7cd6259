"""`pneutac diagnose` on longer recordings, generated and real: the effects are named.

`pneutac diagnose` where trials differ: for a reason that is on record, or by a zero of their own.

`pneutac diagnose` on poor recordings: what it says it cannot tell, and what to record next.
"""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from generated import twin_of
from verbs import verb

from lerobot_pneutac.diagnosis.design import separations
from lerobot_pneutac.diagnosis.search import Steps
from lerobot_pneutac.study import study_of
from lerobot_pneutac.study.pair import same_body
from lerobot_pneutac.verbs.diagnose import diagnose
from lerobot_pneutac.verbs.new import new_twin
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.laws import family
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin, Value
from pneutac_truths import generate, write

pytestmark = pytest.mark.slow


def families(d):
    return [family(name) for name in d.selected]


AIR = {"valve_lag", "orifice_flow", "valve_slew", "air_resonance", "dead_time"}


def test_measured_pressure_tells_the_valve_from_the_body(bench):
    recording = bench("valve_lag")
    d = diagnose(twin_of(recording), recording, jobs=1)
    assert d.study.measured and d.selected and set(families(d)) & AIR and "creep" not in families(d)
    assert d.after["heldout"] < 0.6 * d.before["heldout"] and d.outcome.evidence.after < 1.3


@pytest.mark.nightly  # every day: the verdict of given errors, in test_verdict
def test_a_disturbance_is_unknown_and_no_headline(bench):
    """A declared noise tells it from a slow noise of the tracker."""
    recording = bench("clock_jitter")
    recording.meta["noise"] = {f"tip_{a}_mm": 0.25 for a in "xyz"}
    d = diagnose(twin_of(recording), recording, jobs=1)
    assert d.verdict == "unknown_effect" and not d.selected
    assert "no known effect" in d.sentence


def found(truth, folder, seed=12):
    recording = Recording.load(write(generate("rod", [truth], seed), folder / "day"))
    return diagnose(Twin("finger", recording.length_mm), recording, jobs=1, seed=seed)


@pytest.mark.nightly
def test_zeros_of_trials_do_not_swallow_weight_and_payload(tmp_path):
    """They are constant in each trial, so zeros explain them as well until a trial is left out."""
    d = found("gravity_and_payload", tmp_path)
    assert {"gravity", "payload"} <= set(d.selected)
    assert d.after["heldout"] < 0.4 * d.before["heldout"]


def test_a_marker_that_slips_is_told_with_its_moment_and_fitted_down_to_the_noise(tmp_path):
    truth = generate("rod", ["marker_slip"], 12)
    recording = Recording.load(write(truth, tmp_path / "day"))
    study = study_of(Twin("finger", recording.length_mm), recording, 12)
    left = study.refits((), Steps(None)).before.residual
    at = int(np.linalg.norm(np.diff(truth.pose - truth.true_pose, axis=0), axis=1).argmax()) + 1
    (finding,) = [f for f in study.findings if "slipped" in f]
    row = int(finding.partition("rows from ")[2].split()[0])
    assert abs(row - 1 - at) <= 2
    assert np.sqrt((left**2).sum(1).mean()) < 1.2 * truth.noise_floor


@pytest.mark.nightly
def test_a_marker_that_slips_is_no_law(tmp_path):
    d = found("marker_slip", tmp_path)
    assert [f for f in d.study.findings if "slipped" in f]
    assert (d.verdict, d.selected) == ("adequate", [])
    assert d.after["heldout"] < 1.2 * generate("rod", ["marker_slip"], 12).noise_floor


@pytest.mark.nightly
def test_six_effects_at_once_make_no_marker_slip(tmp_path):
    """A model that knows nothing yet leaves jumps of half the travel, one of which suits what comes later."""
    d = found("device", tmp_path, 19)
    assert not [f for f in d.study.findings if "slipped" in f]
    assert d.after["heldout"] < 0.2 * d.before["heldout"]


@pytest.mark.nightly
def test_a_mount_that_is_knocked_is_told_with_its_moment_and_only_one_side_is_judged(tmp_path):
    d = found("mount_knock", tmp_path, 19)
    (finding,) = [f for f in d.study.findings if "changed permanently" in f]
    truth = generate("rod", ["mount_knock"], 19)
    away = np.linalg.norm(truth.pose - truth.true_pose, axis=1)
    kept = int(finding.partition("Only the ")[2].split()[0])
    assert "after it" in finding and abs(len(away) - kept - np.argmax(away > 3)) < 40
    assert d.after["heldout"] < 1.2 * truth.noise_floor


@pytest.mark.nightly
def test_a_body_driven_by_the_gauge_is_not_taken_where_nothing_is_known_of_the_air(tmp_path):
    """The gauge shows how the supply sags; its law is not among those of the air, but among the body's."""
    d = found("supply_sag", tmp_path, 19)
    assert d.outcome.base_model["driven_by"] == "command"
    assert d.after["heldout"] < 0.4 * d.before["heldout"]


def test_a_short_recording_is_ambiguous_and_says_what_to_record(bench):
    recording = bench("creep", seed=5003)
    short = recording.keep(np.arange(len(recording)) < 40)
    d = diagnose(twin_of(recording), short, jobs=1)
    assert d.verdict == "ambiguous"
    assert "too short" in d.sentence and "ten minutes" in d.next_experiment


@pytest.mark.nightly  # every day: a short recording is ambiguous, above
def test_constant_pressure_is_ambiguous(bench):
    recording = bench("none")
    still = recording.keep(np.arange(len(recording)) < 600)
    still.samples["pressure_cmd_kpa"] = 20.0
    still.samples["pressure_kpa"] = 20.0
    d = diagnose(twin_of(recording), still, jobs=1)
    assert d.verdict == "ambiguous" and "the commanded pressure never moves" in d.sentence
    assert (
        "does not move either" in " ".join(d.study.caveats(d.outcome)) and "ten minutes" in d.next_experiment
    )


def test_too_few_rows_to_fit_name_the_file_and_what_to_record(bench, tmp_path):
    recording = bench("none")
    recording.keep(np.arange(len(recording)) < 3).write(tmp_path / "three")
    twin = new_twin("finger", recording).save(tmp_path / "twin")
    wanted = r"three/samples\.csv has 3 rows, .* at least \d+ .*; record ten minutes with steps"
    with pytest.raises(InputError, match=wanted) as e:
        verb("diagnose", twin=twin, recording=tmp_path / "three")
    least = int(re.search(r"at least (\d+)", str(e.value))[1])
    d = diagnose(twin_of(recording), recording.keep(np.arange(len(recording)) < least), jobs=1)
    assert d.verdict == "ambiguous"


def test_pressures_far_above_the_calibrated_are_noted(bench, tmp_path):
    recording = bench("none")
    twin = twin_of(recording)
    twin.parameters = {"gain_rad_per_kpa": Value(0.01, (0.009, 0.011))}
    twin.save(tmp_path / "twin")
    for factor, noted in ((1.0, False), (25.0, True)):
        other = recording.keep(np.ones(len(recording), bool))
        other.samples[["pressure_cmd_kpa", "pressure_kpa"]] *= factor
        folder = other.write(tmp_path / f"times_{factor:g}")
        warnings = same_body(twin, Recording.load(folder), "diagnose").warnings
        assert any("pascal" in w for w in warnings) == noted


def test_effects_without_their_column_are_listed_with_the_remedy(bench):
    recording = bench("none")
    poor = Recording(
        recording.folder, recording.meta, recording.samples.drop(columns=["temperature_c"]), "finger"
    )
    study = study_of(twin_of(recording), poor, 0)
    assert "record column temperature_c" in next(u.reason for u in study.untested if u.name == "thermal")
    after = SimpleNamespace(twin=Twin.builtin())
    air, body = (SimpleNamespace(selected=[e], after=after) for e in ("valve_lag", "creep"))
    assert not study.caveats(air)  # ramps only: there is no step whose instant could be fitted
    study.recording.samples["pressure_cmd_kpa"] = 20.0 * (np.arange(len(poor.samples)) // 50 % 2)
    assert "together with valve lag: what takes less" in " ".join(study.caveats(air))
    assert "together with" not in " ".join(study.caveats(body))
    valve = SimpleNamespace(effects=("valve_lag",))
    assert study.where(valve) == "where the times of commands are not logged"
    study.recording.samples["time_sent_s"] = study.recording.samples["time_s"]
    assert "together with" not in " ".join(study.caveats(air))
    for times, said in (
        (3.0, "where the times of commands are logged (without them 3 times the noise)"),
        (1.1, ""),
    ):

        def left(twin, recording, times=times):
            assert "time_sent_s" not in recording.samples
            return np.full((len(recording), 1), times * study.noise.floor)

        study.residual = left
        assert study.where(SimpleNamespace(effects=("valve_lag",), twin=None)) == said


def test_the_proposed_experiment_separates_the_rivals(bench):
    """Stiffening and saturation agree where they were fitted and part above it."""
    recording = bench("none")
    top = recording.column("pressure_cmd_kpa").max()
    twin = twin_of(recording)
    twin.parameters = {
        "gain_rad_per_kpa": Value(0.006), "gain_alpha": Value(0.0), "gain_beta": Value(0.2),
        "rest_pressure_kpa": Value(5.0), "joint_stiffness_nm_per_rad": Value(0.458),
    }  # fmt: skip
    a, b = twin.copy(), twin.copy()
    a.effects = {"gain_saturation": {"saturation_pressure_kpa": Value(1.2 * top)}}
    b.effects = {
        "stiffening": {
            "linear_1_per_kpa": Value(0.0),
            "quadratic_1_per_kpa2": Value(-1 / (3 * (1.2 * top) ** 2)),  # tanh to third order
        }
    }
    found = separations(recording, a, b, 0.5, ("gain_saturation", "stiffening"))
    assert found[0].name == "higher" and found[0].score > 3 * np.median([s.score for s in found])


def test_measuring_pressure_is_proposed_for_lag_against_creep(bench):
    recording = bench("none")
    blind = Recording(
        recording.folder, recording.meta, recording.samples.drop(columns=["pressure_kpa"]), "finger"
    )
    a, b = twin_of(recording), twin_of(recording)
    a.effects = {"valve_lag": {"fill_time_s": Value(0.5), "vent_time_s": Value(0.8)}}
    b.effects = {"creep": {}}
    found = separations(blind, a, b, 0.5, ("valve_lag", "creep"))
    assert found[0].name.startswith("log the measured pressure")
