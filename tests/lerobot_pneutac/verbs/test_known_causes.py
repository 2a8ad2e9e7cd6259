"""No weight, mount or stretch is credited with what a body remembers; one that is there is found."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from generated import once, twin_of

from lerobot_pneutac import Recording, add
from lerobot_pneutac.study.body_base import doubt, size_by_run
from lerobot_pneutac.verbs import fit_body
from pneutac_datasets.generate.finger import generate
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.twin import Twin
from pneutac_truths import generate as simulate
from pneutac_truths import write
from pneutac_truths.programs import plan as drawn

pytestmark = pytest.mark.usefixtures("no_soft_body")
HZ = 10


def last_loaded(folder, effect, seed):
    """A session of six trials: in the fourth the base is flipped, in the last one a weight is logged."""
    return once(generate, effect, folder, seed, minutes=3.0, hz=HZ)


def several_loaded(folder, effect, seed):
    """Trials of many programs, a weight logged in every third."""
    rng = np.random.default_rng([seed, 2])
    plan = drawn(rng, 1, 3.0)
    n = len(plan.starts)
    conditions = {
        "gravity": np.tile([1.0, 0.0, 0.0], (n, 1)),
        "payload_g": 50.0 * rng.permutation(np.arange(n) % 3 == 0),
    }
    plan = replace(plan, row_s=1 / HZ, conditions=conditions)
    made = simulate("rod", effect, seed, plan=plan, strength=1.0, gauge=False, state_noise=False)
    joints = [made.meta["length_mm"] * (k + 0.5) / 4 for k in range(4)]
    meta = made.meta | {"spine_joint_positions_mm": joints, "notes": ""}
    samples = made.samples.drop(columns="time_sent_s", errors="ignore")
    return Recording(folder, meta, samples, "finger")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "effect", "seed", "cause"),
    [
        (last_loaded, ["creep"], 3, "payload"),
        pytest.param(last_loaded, ["fatigue"], 1, "gravity", marks=pytest.mark.nightly),
        pytest.param(last_loaded, ["leak"], 1, "base_tilt", marks=pytest.mark.nightly),
        (several_loaded, ["creep_fractional"], 1, ""),
    ],
)
def test_what_a_body_remembers_is_no_known_cause(make, effect, seed, cause, tmp_path):
    recording = make(tmp_path / "bench", effect, seed)
    result = fit_body.calibrate_body(twin_of(recording), recording)
    assert not {"payload", "gravity", "base_tilt"} & set(result.twin.effects)
    named = cause.replace("_", " ")
    assert any(f"{named} is left out" in f for f in result.findings) == bool(cause), result.findings


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "effect", "seed", "cause"),
    [
        (last_loaded, ["payload"], 1, "payload"),
        pytest.param(last_loaded, ["gravity"], 2, "gravity", marks=pytest.mark.nightly),
        pytest.param(last_loaded, ["creep", "payload"], 3, "payload", marks=pytest.mark.nightly),
        (several_loaded, ["creep_fractional", "payload"], 1, "payload"),
    ],
)
def test_a_known_cause_that_is_there_is_found(make, effect, seed, cause, tmp_path):
    recording = make(tmp_path / "bench", effect, seed)
    result = fit_body.calibrate_body(twin_of(recording), recording)
    assert cause in [c.name for c in result.causes] and cause in result.twin.effects


@pytest.mark.slow
def test_a_weight_named_by_the_user_must_stand_out_from_equal_trials(tmp_path):
    creeps = last_loaded(tmp_path / "creeps", ["creep"], 3)
    refused = add(twin_of(creeps), creeps, "payload")
    assert not refused.accepted
    hangs = last_loaded(tmp_path / "hangs", ["payload"], 1)
    assert add(twin_of(hangs), hangs, "payload").accepted


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "found"), [(20297, ["curvature_reading"]), (22511, [])])
def test_curvatures_of_an_arm_that_bends_far_are_read_off_the_arc(seed, found, tmp_path):
    truth = simulate("arm", [], seed, minutes=3.0)  # the first bends by 1.9 rad, the second by 1.0
    recording = Recording.load(write(truth, tmp_path / "bench"))
    result = fit_body.calibrate_body(Twin("arm", recording.length_mm), recording)
    assert [c.name for c in result.causes] == list(result.twin.effects) == found
    assert result.error["heldout"] < 1.03 * truth.noise_floor
    assert not found or result.without_causes > 1.15 * truth.noise_floor


@pytest.mark.nightly  # every day: what a body remembers is no known cause, above
@pytest.mark.slow
def test_a_weight_of_the_twin_that_creep_explains_goes_with_it(tmp_path):
    recording = last_loaded(tmp_path / "bench", ["creep"], 3)
    twin = twin_of(recording)
    twin.effects["payload"] = get_effect("payload").start(50.0)
    added = add(twin, recording, "creep")
    assert added.accepted and list(added.twin.effects) == ["creep"]
    assert any("payload of the twin hardly lowers the error" in f for f in added.findings)


def loaded(loads, drift, noise=0.02):
    """A tip that a weight moves by 0.1 mm a gram, and each trial by `drift` mm; residuals of that model."""
    rng, n = np.random.default_rng(0), 50
    table = {"trial": np.repeat(np.arange(len(loads)), n), "time_s": np.tile(np.arange(n) / HZ, len(loads))}
    table["payload_g"] = np.repeat(loads, n).astype(float)
    samples = pd.DataFrame(table)

    def predict(recording):
        return 0.1 * recording.samples[["payload_g"]].to_numpy()

    residual = np.repeat(drift, n)[:, None] + noise * rng.normal(size=(len(samples), 1))
    return Recording("bench", {}, samples, "finger"), predict, residual


@pytest.mark.parametrize(
    ("loads", "drift", "doubted"),
    [
        ([0, 0, 0, 0, 0, 50], [0.0] * 6, False),
        ([0, 0, 0, 0, 0, 50], [-2.0, 1.0, -1.5, 2.0, 1.0, 0.0], True),
        ([0, 50, 0, 50, 0, 50], [0.3, -0.3, 0.0, 0.3, -0.2, 0.0], False),
        ([0, 50, 0, 25, 0, 50], [3.0, -3.0, 2.0, 3.0, -4.0, 0.0], True),
        ([0, 50], [0.0, 0.0], False),
        ([0, 0, 0], [0.0] * 3, True),
    ],
)
def test_a_weight_must_stand_out_from_how_equal_trials_differ(loads, drift, doubted):
    recording, predict, residual = loaded(loads, drift)
    rows, equal = np.arange(len(residual)), np.ones(len(residual))
    assert bool(doubt("payload", recording, predict, residual, rows, 2 * equal, equal)) == doubted


def test_the_size_of_a_weight_is_measured_in_every_trial():
    recording, predict, residual = loaded([0, 20, 0, 50], [0.5, 0.0, -0.5, 0.0], noise=0.0)
    claimed, shown = size_by_run(recording, ["payload_g"], predict, residual, np.arange(len(residual)))
    assert claimed == pytest.approx([0.0, 2.0, 0.0, 5.0]) and shown == pytest.approx([0.5, 2.0, -0.5, 5.0])


def test_a_mount_must_lower_the_error_from_trial_to_trial():
    recording, predict, residual = loaded([0] * 6, [0.0] * 6)
    rows, squared = np.arange(len(residual)), np.ones(len(residual))
    in_one, in_all = squared.copy(), 1.5 + 0.1 * np.sin(rows)
    in_one[-50:] = 4.0
    assert "from trial to trial" in doubt("base_tilt", recording, predict, residual, rows, in_one, squared)
    assert doubt("base_tilt", recording, predict, residual, rows, in_all, squared) == ""


@pytest.mark.parametrize(("worse", "left_out"), [(1, False), (5, True)])
def test_runs_may_differ_much_in_how_far_they_show_a_stretch(worse, left_out):
    # Two of ten runs go to high pressures and show most of it, so that the mean over runs scatters.
    recording, predict, residual = loaded([0] * 10, [0.0] * 10)
    fall = np.array([3.0, 2.6, 0.7, 0.5, 0.3, 0.25, 0.2, 0.1, 0.09, 0.02])
    fall[-1 - worse : -1] *= -1
    rows, squared = np.arange(len(residual)), np.ones(len(residual))
    without = np.exp(np.repeat(fall, len(residual) // 10))
    assert bool(doubt("elongation", recording, predict, residual, rows, without, squared)) == left_out
