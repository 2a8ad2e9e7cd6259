import numpy as np
import pytest

from pneutac_sim.effects import body_effects
from pneutac_sim.errors import InputError
from pneutac_sim.finger import Inputs, Pipeline, PressurePipeline
from pneutac_sim.finger.online import ManyPipelines
from pneutac_sim.finger.stages import forward_kinematics, joint_command
from pneutac_sim.twin import PAPER_FINGER, Twin, Value

ALL = list(body_effects())


def simulate(twin, inputs, effects=None, reuse=None):
    model = Pipeline.of(twin, inputs, effects)
    return model, model.run(inputs, model.theta(twin, inputs.pressure_range_kpa), reuse)


def test_without_effects_it_is_the_papers_finger(program):
    inputs = Inputs.from_samples(program(400))
    _, run = simulate(Twin.builtin(), inputs)
    p = PAPER_FINGER
    q = joint_command(
        inputs.pressure_kpa[:, 0],
        p["gain_rad_per_kpa"],
        p["gain_alpha"],
        p["gain_beta"],
        p["rest_pressure_kpa"],
        4,
    )
    tip, bend = forward_kinematics(q, np.array([13.75, 41.25, 68.75, 96.25]), 110.0)
    np.testing.assert_allclose(run.joints, q)
    np.testing.assert_allclose(run.markers[:, [0, 2]], tip)
    np.testing.assert_allclose(run.markers[:, 3], bend)


@pytest.mark.parametrize("device", ["finger", "arm"])
def test_body_effects_at_their_neutral_point_change_nothing(program, device):
    table = program(600)
    for i in range(3):
        table[f"pressure_cmd_{i + 1}_kpa"] = np.roll(table["pressure_cmd_kpa"], 60 * i)
    twin = Twin(device=device)
    inputs = Inputs.from_samples(table, device)
    _, bare = simulate(twin, inputs)
    model = Pipeline.of(twin, inputs, ALL)
    theta = model.neutral(model.theta(twin, inputs.pressure_range_kpa), ALL)
    np.testing.assert_array_equal(model.run(inputs, theta).markers, bare.markers)


@pytest.mark.parametrize("device", ["finger", "arm"])
def test_step_by_step_equals_the_whole_recording(program, with_effects, device):
    """On a uniform grid, with every effect and condition: joints, pressure and what is read of the tip."""
    table = program(300)
    n = len(table["time_s"])
    table["trial"], table["time_s"] = np.zeros(n, int), np.arange(n) / 20
    chambers = ["pressure_cmd_kpa"] if device == "finger" else [f"pressure_cmd_{i}_kpa" for i in (1, 2, 3)]
    for i, c in enumerate(chambers):
        table[c] = np.roll(table["pressure_cmd_kpa"], 40 * i)
        table[c][0] = 2.0
    table = {k: v for k, v in table.items() if device == "finger" or k != "pressure_cmd_kpa"}
    table["below_kpa"] = np.linspace(0.0, 5.0, n)
    twin = with_effects(
        Twin(device=device, parameters={"gain_rad_per_kpa": Value(0.011)}), dict.fromkeys(ALL, {})
    )
    _, run = simulate(twin, Inputs.from_samples(table, device, 110.0, start="held"))
    names = ["below_kpa", "temperature_c", "payload_g", "gravity_x", "gravity_y", "gravity_z"]

    def conditions(k):
        return {name: float(table[name][k]) for name in names}

    online = PressurePipeline(twin, conditions(0))
    online.reset(2.0)
    joints = [online.rest()]
    read, pressures = [online.read(online.place(joints[0], 0.05), 0.05)], [online.pressure_kpa]
    for k in range(1, n):
        online.set_conditions(conditions(k))
        joints.append(online.step(np.array([table[c][k] for c in chambers]), 0.05))
        read.append(online.read(online.place(joints[k], 0.05), 0.05))
        pressures.append(online.pressure_kpa)
    np.testing.assert_allclose([q.ravel() for q in joints], run.joints, rtol=0, atol=2e-5)
    np.testing.assert_allclose(read, run.markers, rtol=0, atol=2e-3)
    np.testing.assert_allclose(pressures, run.pressure_kpa, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "given", "asked"),
    [
        ("thermal", {"payload_g": 20.0}, "temperature_c"),
        ("payload", {"payload_g": 20.0, "gravity_x": 1.0}, "gravity_y"),
        ("crosstalk", {}, "other_1_kpa"),
        ("p dT", {}, "temperature_c"),
    ],
)
def test_online_an_effect_without_its_condition_is_refused_by_name(with_effects, name, given, asked):
    twin = with_effects(Twin.builtin(), {name: {}})
    with pytest.raises(InputError) as refused:
        PressurePipeline(twin, given)
    assert str(refused.value) == (
        f"The twin's effect '{name}' needs the condition '{asked}'; give it, as in conditions={{{asked}: "
        "NUMBER}."
    )


def test_online_a_condition_that_is_no_number_is_refused(with_effects):
    with pytest.raises(InputError, match="conditions has temperature_c: nan; give a finite number"):
        PressurePipeline(with_effects(Twin.builtin(), {"thermal": {}}), {"temperature_c": np.nan})


def test_online_a_session_goes_on_over_trials_as_in_a_recording(with_effects):
    """Session time and cycles go on from trial to trial, creep is wiped out by the rest between them."""
    effects = {"cyclic_softening": {}, "creep": {}, "p exp(-t)": {}}
    twin = with_effects(Twin.builtin(), effects)
    time_s, swing = 0.1 * np.arange(60), 6.0 * (1 - np.cos(0.3 * np.arange(60)))
    trials = {"trial": np.repeat([0, 1], 60), "time_s": np.tile(time_s, 2)}
    inputs = Inputs.from_samples(trials | {"pressure_cmd_kpa": np.tile(swing, 2)}, start="held")
    model = Pipeline.of(twin, inputs)
    bench = model.run(inputs, model.theta(twin)).joints
    online, found = PressurePipeline(twin), []
    for trial in range(2):
        online.reset(0.0, same_session=trial > 0)
        found += [online.rest(), *(online.step(p, 0.1) for p in swing[1:])]
    np.testing.assert_allclose(found, bench, atol=1e-9)
    assert np.abs(bench[:60] - bench[60:]).max() > 1e-3
    online.reset(0.0)
    again = [online.rest(), *(online.step(p, 0.1) for p in swing[1:])]
    np.testing.assert_allclose(again, bench[:60], atol=1e-9)


LAWS = ["p play(p)", "power_law_memory(p)", "play(p)", "loop(p)"]


@pytest.mark.parametrize("name", [*(n for n in ALL if body_effects()[n].signal == "pressure"), *LAWS])
def test_many_devices_together_move_as_each_alone(with_effects, name):
    """Also where one begins again while the others go on, and where each has a pipeline of its own."""
    twin = with_effects(Twin.builtin(), {"dead_time": {"delay_s": 0.05}} | {name: {}})
    one = PressurePipeline(twin, dict.fromkeys(("temperature_c", "other_1_kpa", "other_2_kpa"), 21.0))
    many, rng = ManyPipelines(one, 3), np.random.default_rng(0)
    alone = [one.copy() for _ in range(3)]
    for t in range(30):
        if t == 12:
            many.restart(np.array([1]))
            alone[1] = one.copy()
        commands = rng.uniform(0.0, 15.0, (3, 1))
        joints = [a.step(c, 0.07) for a, c in zip(alone, commands, strict=True)]
        np.testing.assert_allclose(many.step(commands, 0.07), joints, atol=1e-12)
        np.testing.assert_allclose(many.pressure_kpa, [a.pressure_kpa for a in alone], atol=1e-12)


@pytest.mark.parametrize("name", [*(n for n in ALL if body_effects()[n].signal == "pressure"), *LAWS])
def test_devices_go_on_from_what_others_remember(with_effects, name):
    """One waits while another goes on, and devices elsewhere take over what both remember."""
    twin = with_effects(Twin.builtin(), {"dead_time": {"delay_s": 0.2}} | {name: {}})
    one = PressurePipeline(twin, dict.fromkeys(("temperature_c", "other_1_kpa", "other_2_kpa"), 21.0))
    (many, others), alone = (ManyPipelines(one, n, forked=True) for n in (2, 3)), [one.copy(), one.copy()]
    for t, commands in enumerate(np.random.default_rng(0).uniform(0.0, 15.0, (20, 2, 1))):
        stays = many.states([1])
        many.step(commands, 0.07)
        alone[0].step(commands[0], 0.07)
        if t % 2:
            many.resume([1], stays)
        else:
            alone[1].step(commands[1], 0.07)
    others.step(np.full((3, 1), 9.0), 0.07)  # whatever they did before
    others.resume([2, 0], many.states([0, 1]))
    for command in np.linspace(15.0, 0.0, 6):
        joints = [a.step(command, 0.07) for a in alone]
        np.testing.assert_allclose(many.step(np.full((2, 1), command), 0.07), joints, atol=1e-12)
        np.testing.assert_allclose(others.step(np.full((3, 1), command), 0.07)[[2, 0]], joints, atol=1e-12)


def test_reused_links_give_the_same_run(program):
    inputs = Inputs.from_samples(program(600))
    twin = Twin.builtin()
    model, before = simulate(twin, inputs, ALL[:15])
    for j in range(len(model.names)):
        theta = before.theta.copy()
        theta[j] = 1.01 * theta[j] + 1e-3
        np.testing.assert_array_equal(
            model.run(inputs, theta, reuse=before).markers, model.run(inputs, theta).markers
        )


def test_trials_do_not_influence_each_other_except_by_what_the_material_remembers(program):
    table = program(1600)
    forget = ["dead_time", "leak", "valve_lag", "orifice_flow", "creep", "gravity"]
    alone = {k: v[table["trial"] == 1] for k, v in table.items()}
    whole, one = Inputs.from_samples(table), Inputs.from_samples(alone)
    a = simulate(Twin.builtin(), whole, forget)[1].markers[table["trial"] == 1]
    np.testing.assert_allclose(simulate(Twin.builtin(), one, forget)[1].markers, a, atol=1e-4)
    softened = simulate(Twin.builtin(), whole, ["cyclic_softening"])[1].markers[table["trial"] == 1]
    assert np.abs(simulate(Twin.builtin(), one, ["cyclic_softening"])[1].markers - softened).max() > 0.1


def test_measured_pressure_replaces_the_pneumatics(program):
    table = program(600)
    table["pressure_kpa"] = 0.5 * table["pressure_cmd_kpa"]
    half = dict(table, pressure_cmd_kpa=table["pressure_kpa"])
    half.pop("pressure_kpa")
    model, run = simulate(Twin.builtin(), Inputs.from_samples(table), ["valve_lag", "creep"])
    assert "valve_lag" in model.left_out
    _, expected = simulate(Twin.builtin(), Inputs.from_samples(half), ["creep"])
    np.testing.assert_allclose(run.markers, expected.markers)


def test_an_effect_without_its_columns_is_left_out_and_named(program):
    table = program(200)
    del table["temperature_c"]
    model, _ = simulate(Twin.builtin(), Inputs.from_samples(table), ["thermal", "crosstalk"])
    assert "temperature_c" in model.left_out["thermal"] and "crosstalk" in model.left_out


def test_a_payload_creeps_like_a_pressure(program):
    """Hung at once, a weight sinks by the same late share that a pressure step has."""
    n = 2400
    table = {
        "trial": np.zeros(n, int),
        "time_s": np.arange(n) / 20,
        "pressure_cmd_kpa": np.full(n, 2.0),
        "gravity_x": np.zeros(n),
        "gravity_y": np.zeros(n),
        "gravity_z": np.full(n, -1.0),
        "payload_g": np.where(np.arange(n) < 100, 0.0, 30.0),
    }
    twin = Twin.builtin()
    inputs = Inputs.from_samples(table)
    model = Pipeline.of(twin, inputs, ["payload", "creep"])
    theta = model.theta(twin, 2.0)
    weight = model.names.index("creep.weight_4s")
    theta[[i for i, s in enumerate(model.names) if s.startswith("creep")]] = 0.0
    theta[weight] = 0.5
    tip = model.run(inputs, theta).joints.sum(axis=1)
    final, jump, before = tip[-1], tip[101], tip[90]
    assert (jump - before) / (final - before) == pytest.approx(1 / 1.5, abs=0.03)


def test_an_arm_bends_towards_the_chamber_that_is_pressed():
    twin = Twin(device="arm", length_mm=117.0)
    twin.parameters["gain_rad_per_kpa"] = Value(0.02)
    p = 10.0 * np.eye(3)
    table = {"trial": np.arange(3), "time_s": np.zeros(3)}
    table |= {f"pressure_cmd_{i + 1}_kpa": p[:, i] for i in range(3)}
    _, run = simulate(twin, Inputs.from_samples(table, "arm", 117.0))
    z, y = run.markers[:, 2], run.markers[:, 1]
    direction = np.degrees(np.arctan2(y, z)) % 360
    np.testing.assert_allclose(direction, [0, 120, 240], atol=1e-9)
    np.testing.assert_allclose(np.hypot(y, z), np.hypot(y, z)[0])
    model = Pipeline.of(twin)
    curvature = model.outputs(run, ["curvature_x_1_per_m", "curvature_y_1_per_m"])
    np.testing.assert_allclose(np.linalg.norm(curvature, axis=1), 6 * 0.02 * 10 / 0.117)
    equal = {k: (v if k in ("trial", "time_s") else np.full(3, 10.0)) for k, v in table.items()}
    _, run = simulate(twin, Inputs.from_samples(equal, "arm", 117.0))
    np.testing.assert_allclose(run.markers[:, :3], [[117.0, 0, 0]] * 3, atol=1e-9)
    twin.parameters["chamber_2_turn_rad"] = Value(np.radians(12.0))
    _, run = simulate(twin, Inputs.from_samples(table, "arm", 117.0))
    direction = np.degrees(np.arctan2(run.markers[:, 1], run.markers[:, 2])) % 360
    np.testing.assert_allclose(direction, [0, 132, 240], atol=1e-9)


def test_bad_twins_and_columns_are_refused(program):
    twin = Twin.builtin()
    twin.effects["creep"] = {"weight_9s": Value(0.1)}
    with pytest.raises(InputError, match="unknown parameter 'weight_9s'; did you mean 'weight_4s'"):
        Pipeline.of(twin).theta(twin)
    with pytest.raises(InputError, match="'gel' has no pressure chambers"):
        PressurePipeline(Twin(device="gel"))
    model, run = simulate(Twin.builtin(), Inputs.from_samples(program(100)))
    with pytest.raises(InputError, match="no output 'tip_w_mm'"):
        model.outputs(run, ["tip_w_mm"])


@pytest.mark.parametrize(
    ("effects", "late"),
    [(["valve_lag", "gravity"], False), (["creep", "base_tilt"], True), (["lag(p)", "tracker_lag"], True)],
)
def test_early_thinning_gives_what_running_all_rows_gives(program, with_effects, effects, late):
    """What remembers nothing is run at the wanted samples alone."""
    twin = with_effects(Twin.builtin(), dict.fromkeys(effects, {}))
    inputs = Inputs.from_samples(program(1600), start=2.0)
    keep = np.sort(np.random.default_rng(0).permutation(1600)[:200])
    model, whole = simulate(twin, inputs)
    _, thin = simulate(twin, inputs.thin(keep))
    assert (model.thins_at > model.drive) == late
    assert len(thin.markers) == 200 and len(whole.markers) == 1600
    assert len(thin.signals[model.thins_at]) == len(inputs.dt_s) > 1600
    assert all(len(s) == 200 for s in thin.signals[model.thins_at + 1 :])
    for name in ("markers", "joints", "pressure_kpa"):
        # loads are solved from the sample before, to a tolerance
        np.testing.assert_allclose(getattr(thin, name), getattr(whole, name)[keep], atol=1e-5)


@pytest.mark.parametrize("device", ["finger", "arm"])
def test_a_free_profile_bends_one_joint_alone(device):
    samples = {"trial": np.zeros(30, int), "time_s": np.arange(30) / 10}
    samples |= {f"pressure_cmd_{i}_kpa": np.linspace(i, 12, 30) for i in (1, 2, 3)}
    samples["pressure_cmd_kpa"] = np.linspace(0, 12, 30)
    twin = Twin(device=device, parameters={"gain_rad_per_kpa": Value(0.02)})
    inputs = Inputs.from_samples(samples, device)
    _, before = simulate(twin, inputs)
    axes = 1 if device == "finger" else 2
    for n in (1, 3):
        own = twin.copy()
        own.parameters[f"bend_{n}"] = Value(0.5)
        _, after = simulate(own, inputs)
        ratio = np.ones(before.joints.shape[1])
        ratio[(n - 1) * axes : n * axes] = 1.5
        np.testing.assert_allclose(after.joints, before.joints * ratio, atol=1e-12)


def test_a_curl_is_shared_by_the_joints_and_has_no_stress(program, with_effects):
    inputs = Inputs.from_samples(program(300))
    _, before = simulate(Twin.builtin(), inputs)
    curled = Twin.builtin()
    curled.parameters["curl_rad"] = Value(0.8)
    _, after = simulate(curled, inputs)
    np.testing.assert_allclose(after.joints - before.joints, 0.8 / 4, atol=1e-12)
    creeping = [with_effects(t, {"creep": {}}) for t in (Twin.builtin(), curled)]
    (_, a), (_, b) = (simulate(t, inputs) for t in creeping)
    np.testing.assert_allclose(b.joints - a.joints, 0.8 / 4, atol=1e-12)


def test_without_a_recorded_temperature_a_law_acts_as_at_its_reference(program):
    """Creep that warmth speeds up is creep still, and not left out of what was fitted with it."""
    table, name = dict(program(400)), "lag(p; time moves with dT)"
    table["temperature_c"] = np.full(400, 23.0)
    logged = Inputs.from_samples(table)
    del table["temperature_c"]
    unlogged = Inputs.from_samples(table)
    twin = Twin.builtin()
    (_, known), (model, assumed), (_, bare) = (
        simulate(twin, inputs, effects)
        for inputs, effects in ((logged, [name]), (unlogged, [name]), (unlogged, []))
    )
    np.testing.assert_array_equal(assumed.markers, known.markers)
    assert np.abs(assumed.markers - bare.markers).max() > 0.01
    assert model.left_out == {name: "the recording has no column temperature_c"}


@pytest.mark.parametrize(("delay_s", "share"), [(0.1, 0.3), (0.05, 0.3), (0.03, 0.9), (0.16, 0.5)])
def test_a_delayed_step_that_comes_between_two_rows_fills_a_slow_valve_from_then_on(delay_s, share):
    """Closed form of a first-order lag; a row that took the delayed step as its own missed 7 to 10 %."""
    n, tau_s, step_kpa = 40, 0.25, 40.0
    t = 0.1 * np.arange(n)
    command = np.where(np.arange(n) >= 10, step_kpa, 0.0)
    table = {"trial": np.zeros(n, int), "time_s": t, "pressure_cmd_kpa": command}
    twin, inputs = Twin.builtin(), Inputs.from_samples(table, switch=share)
    model = Pipeline.of(twin, inputs, ["dead_time", "valve_lag"])
    theta = model.theta(twin, step_kpa)
    for name, value in {"dead_time.delay_s": delay_s, "valve_lag.fill_time_s": tau_s}.items():
        theta[model.names.index(name)] = value
    since = np.maximum(t - (t[9] + 0.1 * share + delay_s), 0)
    seen = model.run(inputs, theta).pressure_kpa.ravel()
    assert np.abs(seen - step_kpa * (1 - np.exp(-since / tau_s))).max() < 0.02 * step_kpa
