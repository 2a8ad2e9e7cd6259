"""`pneutac diagnose` on poor recordings: what it says it cannot tell, and what to record next."""

import re

import numpy as np
import pytest
from generated import twin_of

from lerobot_pneutac.cli import run_verb
from lerobot_pneutac.diagnosis.experiment import separations
from lerobot_pneutac.study import study_of
from lerobot_pneutac.study.pair import same_body
from lerobot_pneutac.verbs.diagnose import diagnose
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Value

pytestmark = pytest.mark.slow


def test_a_short_recording_is_ambiguous_and_says_what_to_record(bench):
    recording = bench("creep")
    short = recording.keep(np.arange(len(recording)) < 40)
    d = diagnose(twin_of(recording), short, jobs=1)
    assert d.verdict == "ambiguous"
    assert "too short" in d.sentence and "ten minutes" in d.next_experiment


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
    still.samples["pressure_kpa"] = recording.samples["pressure_kpa"][:600]
    d = diagnose(twin_of(recording), still, jobs=1)
    assert d.verdict == "ambiguous"
    said = " ".join([d.sentence, *d.study.caveats(d.outcome)])
    assert "the commanded pressure never moves" in said and "measured pressure moves" in said
    assert "not measured" not in said


def test_too_few_rows_to_fit_name_the_file_and_what_to_record(bench, tmp_path):
    recording = bench("none")
    recording.keep(np.arange(len(recording)) < 3).write(tmp_path / "three")
    twin = twin_of(recording).save(tmp_path / "twin")
    wanted = r"three/samples\.csv has 3 rows, .* at least \d+ .*; record ten minutes with steps"
    with pytest.raises(InputError, match=wanted) as e:
        run_verb("diagnose", [f"--twin={twin}", f"--recording={tmp_path / 'three'}"])
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
    untested = study_of(twin_of(recording), poor, 0).untested
    assert "record column temperature_c" in next(u.reason for u in untested if u.name == "thermal")


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
