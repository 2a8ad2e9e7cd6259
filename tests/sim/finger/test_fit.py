"""Derivatives taken link by link against whole simulations."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.finger import BodyData, fit
from pneutac_sim.finger.fit import BY_IMAGES
from pneutac_sim.finger.inputs import Inputs
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.finger.problem import changes
from pneutac_sim.least_squares import minimise
from pneutac_sim.twin import Twin, Value
from pneutac_truths import generate, write


def blocks(n, size=200):
    return (np.arange(n) // size) % 3 > 0


@pytest.mark.parametrize(
    ("seed", "delay_s"), ((73, 0.020), (5, 0.075)), ids=("shorter than a sample", "longer")
)
def test_a_dead_time_without_any_lag_is_told_to_a_millisecond(tmp_path, seed, delay_s):
    """A rod that follows at once moves the error in jumps.

    Commands, delay and samples of the truth all lie on a grid of 5 ms, so that every delay within its last
    step looks alike; the middle of that step is told.
    """
    truth = generate("rod", ["dead_time"], seed, minutes=1.0, log_sent=True, gauge=False)
    r = Recording.load(write(truth, tmp_path / "r"))
    assert truth.effects["dead_time"]["size"] == pytest.approx(delay_s, abs=0.0025)
    f = fit(Twin("finger", r.length_mm), r, ["dead_time"], starts=2)
    assert f.twin.effects["dead_time"]["delay_s"].value == pytest.approx(delay_s - 0.0025, abs=0.001)
    assert f.train < 1.05 * truth.noise_floor


def test_a_delay_that_no_sample_tells_is_the_middle_of_what_is_possible(program, recording, with_effects):
    """Commands that are all sent just at a sample: a delay of up to a sample is seen at the next one."""
    truth = with_effects(Twin.builtin(), {"dead_time": {"delay_s": 0.071}})
    steps = program()
    steps["pressure_cmd_kpa"] = 6.0 * (np.arange(len(steps["time_s"])) // 40 % 2)
    steps["time_sent_s"] = steps["time_s"]
    r = recording(truth, steps, noise=0.1)
    dt = float(np.median(np.diff(r.samples["time_s"])))
    f = fit(Twin.builtin(), r, ["dead_time"], only=["dead_time"], starts=2)
    low, high = f.ci95["dead_time.delay_s"]
    assert low < 0.071 < high and high - low == pytest.approx(dt, rel=0.1)
    assert f.twin.effects["dead_time"]["delay_s"].value == pytest.approx((low + high) / 2, abs=0.01 * dt)


def test_air_that_swings_faster_than_half_the_record_rate_is_found_by_its_steps(tmp_path):
    """A period of 1.9 samples: logged times of commands give where in its swing each sample lies."""
    truth = generate("rod", ["line_second_order"], 7019, minutes=1.0, log_sent=True, gauge=False)
    r, air = Recording.load(write(truth, tmp_path / "r")), truth.effects["line_second_order"]
    assert air["size"] < 2 / 20
    found = fit(Twin("finger", r.length_mm), r, ["air_resonance"], starts=4).twin.effects["air_resonance"]
    assert found["frequency_rad_per_s"].value == pytest.approx(2 * np.pi / air["size"], rel=0.03)
    assert found["damping_ratio"].value == pytest.approx(air["damping"], abs=0.03)


def test_static_parameters_come_back_within_their_intervals(program, recording):
    truth = Twin.builtin()
    rec = recording(truth, program(), noise=0.1)
    f = fit(Twin(), rec, [], blocks(2400))
    for name in ("gain_rad_per_kpa", "gain_alpha", "gain_beta", "rest_pressure_kpa"):
        low, high = f.ci95[name]
        assert low <= truth.parameter(name) <= high
        assert f.twin.parameters[name].ci95 == f.ci95[name]
    assert f.train == pytest.approx(0.1 * np.sqrt(2), rel=0.05)
    assert f.heldout == pytest.approx(0.1 * np.sqrt(2), rel=0.1)
    assert f.unit == "mm" and not f.at_bound


CASES = {
    "valve_lag": {"fill_time_s": 0.4, "vent_time_s": 0.9},
    "orifice_flow": {"fill_rate_1_per_s": 0.6, "vent_rate_1_per_s": 0.3},
    "dead_time": {"delay_s": 0.37},
    "leak": {"leak_rate_1_per_s": 0.05},
    "sensor_offset": {"drift_kpa_per_s": 0.01},
    "gain_saturation": {"saturation_pressure_kpa": 14.0},
    "stiffening": {"linear_1_per_kpa": 0.04, "quadratic_1_per_kpa2": -0.001},
    "hysteresis": {"weight_2": 0.2, "weight_4": 0.3},
    "friction": {"coulomb_kpa": 0.6, "breakaway_kpa": 0.3},
    "creep": {"weight_0_4s": 0.0, "weight_4s": 0.3, "weight_40s": 0.2},
    "cyclic_softening": {"below_maximum": 0.2, "per_cycle": 0.2},
    "thermal": {"softening_1_per_k": 0.03},
    "gravity": {"body_mass_g": 60.0, "tip_mass_g": 25.0},
    "payload": {"share": 1.3},
    "elongation": {"strain_1_per_kpa": 0.01},
    "base_tilt": {"pitch_rad": 0.05, "shift_x_mm": 2.0},
    "camera_misalignment": {"pan_rad": 0.1, "shift_x_mm": 5.0},
}


@pytest.mark.parametrize("name", CASES)
def test_each_effect_is_fitted_down_to_the_noise(name, program, recording, with_effects):
    truth = with_effects(Twin.builtin(), {name: CASES[name]})
    rec = recording(truth, program(seed=3), noise=0.1)
    train = blocks(2400)
    static, f = fit(Twin(), rec, [], train), fit(Twin(), rec, [name], train)
    noise = 0.1 * np.sqrt(2)
    assert static.heldout > 1.5 * noise
    assert f.heldout < 1.15 * noise
    assert f.train < 1.06 * noise


def test_intervals_cover_the_truth_about_as_often_as_they_say(program, recording, with_effects):
    """With strongly correlated noise, where plain intervals would be several times too narrow."""
    truth = with_effects(Twin.builtin(), {"valve_lag": {}})
    table, hits, misses, rng = program(1200), [], [], np.random.default_rng(0)
    for _ in range(20):
        rec = recording(truth, table, noise=0.0)
        for c in ("tip_x_mm", "tip_z_mm"):
            e = rng.normal(size=1200)
            for i in range(1, 1200):
                e[i] += 0.9 * e[i - 1]
            rec.samples[c] += 0.1 * e
        f = fit(truth, rec, starts=1)
        assert f.confidence.rho == pytest.approx(0.9, abs=0.05)
        for name in ("rest_pressure_kpa", "valve_lag.fill_time_s", "valve_lag.vent_time_s"):
            low, high = f.ci95[name]
            true = truth.parameter(name) if "." not in name else 0.3
            hits.append(low <= true <= high)
            misses.append(2 * 1.96 * (0.5 * (low + high) - true) / (high - low))
    assert np.mean(hits) >= 0.9
    assert 0.4 < np.sqrt(np.mean(np.square(misses))) < 1.2  # neither far too wide nor too narrow


def test_a_parameter_at_its_bound_is_called_out(program, recording, with_effects):
    truth = with_effects(Twin.builtin(), {"dead_time": {"delay_s": 1.9}})
    f = fit(Twin.builtin(), recording(truth, program()), ["dead_time"])
    assert f.at_bound["dead_time.delay_s"] == "upper"


def test_what_the_recording_cannot_tell_is_held_and_named(program, recording):
    rec = recording(Twin.builtin(), program())
    f = fit(Twin.builtin(), rec, ["base_tilt"])
    assert {"base_tilt.yaw_rad", "base_tilt.roll_rad", "base_tilt.shift_y_mm"} <= set(f.not_identified)
    assert f.theta[f.pipeline.names.index("base_tilt.yaw_rad")] == 0.0
    angles = recording(Twin.builtin(), program(), columns=("bend_angle_rad",), noise=0.002)
    f = fit(Twin(), angles, [])
    assert set(f.not_identified) == {"gain_alpha", "gain_beta"}
    assert f.unit == "rad"
    assert f.twin.parameter("rest_pressure_kpa") == pytest.approx(10.7, rel=0.02)


def test_measured_pressure_is_fitted_by_the_pneumatics_alone(program, recording, with_effects):
    truth = with_effects(Twin.builtin(), {"valve_lag": {"fill_time_s": 0.5, "vent_time_s": 1.2}})
    rec = recording(truth, program(), columns=("tip_x_mm", "tip_z_mm", "pressure_kpa"), noise=0.05)
    f = fit(truth, BodyData.of(rec, truth, target="pressure"), ["valve_lag", "creep"])
    assert f.unit == "kPa"
    assert f.free_names == ["valve_lag.fill_time_s", "valve_lag.vent_time_s"]
    assert f.twin.effects["valve_lag"]["fill_time_s"].value == pytest.approx(0.5, rel=0.02)
    assert f.twin.effects["valve_lag"]["vent_time_s"].value == pytest.approx(1.2, rel=0.02)


def test_a_tip_does_not_change_what_photographs_told_of_the_joints(program, recording, with_effects):
    truth = with_effects(Twin.builtin(), {"stiffening": CASES["stiffening"]})
    rec = recording(truth, program(), noise=0.1)
    seen = Twin.builtin()
    seen.parameters["gain_alpha"] = Value(truth.parameter("gain_alpha") + 0.2)
    told = fit(seen, rec, ["stiffening"])
    seen.history = [{"version": 0, "change": BY_IMAGES}]
    held = fit(seen, rec, ["stiffening"])
    assert abs(told.twin.parameter("gain_alpha") - seen.parameter("gain_alpha")) > 0.1
    assert not {"gain_alpha", "gain_beta"} & set(held.free_names)
    assert held.twin.parameters["gain_alpha"] == seen.parameters["gain_alpha"]
    assert {"gain_rad_per_kpa", "stiffening.linear_1_per_kpa"} <= set(held.free_names)


def test_an_arm_is_fitted_from_its_curvatures_whichever_way_its_chambers_are_numbered(program, recording):
    for hand in (1.0, -1.0):
        truth = Twin(device="arm", length_mm=117.0)
        truth.parameters = {
            "gain_rad_per_kpa": Value(0.01),
            "chamber_angle_rad": Value(1.9),
            "chamber_2_gain": Value(1.1),
            "rest_pressure_y_kpa": Value(2.0),
            "chamber_handedness": Value(hand),
        }
        table = program(1200)
        for i in (1, 2, 3):
            table[f"pressure_cmd_{i}_kpa"] = np.roll(table["pressure_cmd_kpa"], 171 * i)
        del table["pressure_cmd_kpa"]
        rec = recording(truth, table, ("curvature_x_1_per_m", "curvature_y_1_per_m"), noise=0.02)
        f = fit(Twin(device="arm", length_mm=117.0), rec)
        assert f.train < 0.03 and f.unit == "1/m"
        assert f.twin.parameter("chamber_handedness") == hand
        assert np.cos(f.twin.parameter("chamber_angle_rad") - 1.9) > 0.999
        assert f.twin.parameter("chamber_2_gain") == pytest.approx(1.1, rel=0.02)


def test_a_single_segment_with_its_own_length_and_sign(program, recording):
    truth = Twin(length_mm=152.0, spine_joint_positions_mm=[38.0, 114.0])
    truth.parameters = {"gain_rad_per_kpa": Value(-0.02), "rest_pressure_kpa": Value(-1.0)}
    f = fit(Twin(length_mm=152.0, spine_joint_positions_mm=[38.0, 114.0]), recording(truth, program()))
    assert f.train < 0.3
    assert f.twin.parameter("gain_rad_per_kpa") == pytest.approx(-0.02, rel=0.02)


def test_a_constant_pressure_does_not_break_the_fit(program, recording):
    table = program()
    table["pressure_cmd_kpa"] = np.full(2400, 5.0)
    f = fit(Twin.builtin(), recording(Twin.builtin(), table), ["valve_lag"])
    assert np.isfinite(f.theta).all()
    assert {"rest_pressure_kpa", "valve_lag.fill_time_s"} <= set(f.not_identified)


def test_three_rows_are_enough_for_an_answer_that_claims_nothing(program, recording):
    rec = recording(Twin.builtin(), {k: v[[0, 100, 300]] for k, v in program().items()})
    f = fit(Twin(), rec)
    assert np.isfinite(f.theta).all() and np.isfinite(f.train) and np.isnan(f.heldout)


def test_too_few_samples_are_refused(program, recording):
    rec = recording(Twin.builtin(), program())
    train = np.zeros(2400, bool)
    train[:2] = True
    with pytest.raises(InputError, match="2 training samples for 10 parameters"):
        fit(Twin(), rec, ["creep"], train)


def test_minimise_finds_what_scipy_finds_with_active_bounds():
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=(200, 6)), rng.normal(size=200)

    def residual(v):
        return A @ v + 0.3 * np.sin(3 * (A @ v)) - b

    def jacobian(v):
        return (1 + 0.9 * np.cos(3 * (A @ v)))[:, None] * A

    ours = minimise(residual, jacobian, np.full(6, 0.4), steps=200, tolerance=1e-12)
    theirs = least_squares(residual, np.full(6, 0.4), jacobian, (0, 1), ftol=1e-14, xtol=1e-14, gtol=1e-14)
    assert ours.cost <= 2 * theirs.cost * (1 + 1e-6)
    assert (ours.v == 0).any()


EFFECTS = (
    ["base_tilt", "elongation"],
    ["dead_time", "valve_lag", "lag(p)", "play(p)", "base_tilt"],
    ["hysteresis", "power_law_memory(p)", "tip_z += x z"],
    ["lag(p)", "creep", "tracker_lag"],
    ["gravity", "lag(p)", "base_tilt"],
    ["gravity", "payload", "lag(p)", "elongation"],
    ["gravity", "creep", "lag(p)"],
    ["thermal", "gravity", "lag(p)"],
)
VALUES = {"base_tilt": {"pitch_rad": Value(0.1)}, "lag(p)": {"weight": Value(0.2)}}


def moved(device: str, effects: list[str], columns: list[str]):
    """Changes by small steps of all free parameters: by `changes`, and by whole simulations."""
    rng = np.random.default_rng(3)
    n, axes = 400, {"finger": [""], "arm": ["_1", "_2", "_3"]}[device]
    level = np.repeat(rng.uniform(0, 20, (n // 20, len(axes))), 20, axis=0)
    samples = {"trial": np.repeat([0, 1], n // 2), "time_s": np.arange(n) * 0.05}
    samples |= {f"pressure_cmd{a}_kpa": level[:, i] for i, a in enumerate(axes)}
    samples |= {"payload_g": np.repeat([0.0, 40.0], n // 2), "temperature_c": np.linspace(20.0, 30.0, n)}
    samples |= {f"gravity_{a}": np.full(n, g) for a, g in zip("xyz", (3.0, 0.0, -9.0), strict=True)}
    twin = Twin(device=device, parameters={"gain_rad_per_kpa": Value(0.01)})
    twin.effects = {e: VALUES.get(e, {}) for e in effects}
    inputs = Inputs.from_samples(samples, device).thin(np.arange(0, n, 3))
    model = Pipeline.of(twin, inputs)
    theta = model.theta(twin, 20.0)
    bounds = np.array([p.limits(20.0) for p in model.specs])
    free = np.flatnonzero(["handedness" not in name for name in model.names])
    step = 1e-6 * (bounds[free, 2] - bounds[free, 1])
    values = np.where(theta[free] + step < bounds[free, 2], theta[free] + step, theta[free] - step)
    run = model.run(inputs, theta)
    at, expected = model.outputs(run, columns), []
    for i, value in zip(free, values, strict=True):
        other = theta.copy()
        other[i] = value
        expected.append(model.outputs(model.run(inputs, other), columns) - at)
    got = changes(model, inputs, run, columns, free, values)
    return [model.names[i] for i in free], got, np.stack(expected, axis=2)


@pytest.mark.parametrize("device", ["finger", "arm"])
@pytest.mark.parametrize("effects", EFFECTS, ids="+".join)
def test_link_by_link_is_what_whole_simulations_give(device, effects):
    names, got, expected = moved(device, effects, ["tip_x_mm", "tip_z_mm", "bend_angle_rad"])
    for j, name in enumerate(names):
        size = np.abs(expected[:, :, j]).max()
        # loads are solved to a tolerance, which shows in steps that do nearly nothing
        assert np.abs(got[:, :, j] - expected[:, :, j]).max() <= 3e-3 * size + 1e-6, name
    assert sum(np.abs(expected[:, :, j]).max() > 1e-5 for j in range(len(names))) > len(names) / 2
