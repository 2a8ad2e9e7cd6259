"""Every law of the table against an answer of its own: closed forms, SciPy's solvers, areas of loops."""

import math

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.signal import lsim

from lerobot_pneutac.diagnosis.result import family_in
from pneutac_sim.effects import get_effect, in_order
from pneutac_sim.effects.laws import (
    TABLE,
    curvature,
    family,
    is_law,
    law,
    law_names,
    plain_name,
    starts,
)  # fmt: skip
from pneutac_sim.errors import InputError
from pneutac_sim.finger import Inputs, Pipeline
from pneutac_sim.twin import Twin, Value

P = 10.0
DT = 0.05


def act(name, p, dt=DT, conditions=None, weight=1.0, **constants):
    """What a law makes of a pressure; of weight 1, a memory that p is taken off replaces p."""
    values = {"weight": weight, "scale_kpa": P} | constants
    return law(name).apply(p, np.broadcast_to(dt, len(p)), values, conditions)


def stepped(to=P, seconds=20.0):
    """A step right after the first sample, then held: time since the step, pressure, time steps."""
    n = int(seconds / DT)
    dt = np.r_[math.inf, 1e-9, np.full(n, DT)]
    return np.r_[0.0, 0.0, DT * np.arange(1, n + 1)], np.r_[0.0, np.full(n + 1, to)], dt


def polyline(n=400, seed=0, knots=23):
    """Straight lines between random pressures, some held."""
    rng = np.random.default_rng(seed)
    levels = rng.uniform(0, P, knots)
    levels[5], levels[12] = levels[4], levels[11]
    return np.interp(np.linspace(0, knots - 1, n), np.arange(knots), levels)


def path(*corners, n=400):
    return np.concatenate([np.linspace(a, b, n) for a, b in zip(corners[:-1], corners[1:], strict=True)])


def area(x, y):
    return float(np.sum(0.5 * (y[1:] + y[:-1]) * np.diff(x)))


# ---------------------------------------------------------------- lags


@pytest.mark.parametrize("tau", [0.03, 0.4, 7.0])
def test_a_lag_follows_straight_lines_as_the_solved_equation_does(tau):
    p = polyline()
    t = DT * np.arange(len(p))
    exact = solve_ivp(
        lambda s, y: (np.interp(s, t, p) - y) / tau,
        (0, t[-1]),
        p[:1],
        t_eval=t,
        max_step=DT / 20,
        rtol=1e-9,
        atol=1e-9,
    )
    np.testing.assert_allclose(act("lag(p)", p, time_s=tau), exact.y[0], atol=2e-5)


# ---------------------------------------------------------------- power-law memory


@pytest.mark.parametrize("exponent", [-0.6, -0.9])
def test_between_its_lags_it_relaxes_by_the_power_law(exponent):
    t, p, dt = stepped(seconds=30.0)
    left = 1 - act("power_law_memory(p)", p, dt, exponent=exponent) / P
    between = (t > 0.5) & (t < 8.0)
    slope = np.polyfit(np.log(t[between]), np.log(left[between]), 1)[0]
    assert slope == pytest.approx(exponent, abs=0.08)


# ---------------------------------------------------------------- second order


@pytest.mark.parametrize(("omega", "zeta"), [(2.0, 0.1), (6.0, 0.05), (12.0, 0.3), (6.0, 1.0), (30.0, 1.5)])
def test_a_mode_follows_straight_lines_as_the_solved_equation_does(omega, zeta):
    p = polyline()
    t = DT * np.arange(len(p))
    A = np.array([[0.0, 1.0], [-(omega**2), -2 * zeta * omega]])
    exact = lsim((A, [[0.0], [omega**2]], [[1.0, 0.0]], 0.0), p, t, [p[0], 0.0])[1]
    y = act("mode(p)", p, frequency_rad_per_s=omega, damping_ratio=zeta)
    np.testing.assert_allclose(y, exact, atol=1e-11 * P)


def test_a_modes_step_of_any_length_is_exact():
    """A straight line by one step, by a thousand, and by steps so short that weights are series."""
    for omega, zeta in ((3.0, 0.2), (3.0, 1.0), (3.0, 3.0)):
        constants = {"frequency_rad_per_s": omega, "damping_ratio": zeta}
        ends = [
            act("mode(p)", np.linspace(0, P, n + 1), 2.0 / n, **constants)[-1] for n in (1, 1000, 100_000)
        ]
        np.testing.assert_allclose(ends, ends[0], rtol=1e-10)


# ---------------------------------------------------------------- loops


def test_a_plays_loop_has_its_area_at_any_pace():
    cycle = path(0, 8, 0)
    x = np.r_[cycle, cycle]
    y = act("play(p)", x, width_kpa=1.5)
    assert area(cycle, y[len(cycle) :]) == pytest.approx(-2 * 1.5 * (8 - 3), rel=1e-3)
    np.testing.assert_array_equal(act("play(p)", x, 7.0, width_kpa=1.5), y)
    y = act("play_two(p)", x, width_up_kpa=0.5, width_down_kpa=2.0)
    assert area(cycle, y[len(cycle) :]) == pytest.approx(-2.5 * (8 - 2.5), rel=1e-3)


def test_a_bouc_wen_loop_saturates_at_its_width_both_ways():
    x, width = path(0, 8, 0), 0.7
    z = act("loop(p)", x, width_kpa=width) - x
    assert z[399] == pytest.approx(width, rel=1e-3) and z[-1] == pytest.approx(-width, rel=1e-3)
    assert np.abs(z).max() <= width * (1 + 1e-9)
    at = np.searchsorted(x[:400], width)  # x as a function of z is an integral
    for k in (at // 2, at, 2 * at):
        assert quad(lambda u: width / (1 - u**1.3), 0, z[k] / width)[0] == pytest.approx(x[k], rel=0.06)
    once = act("loop(p)", x[::8], width_kpa=width) - x[::8]
    np.testing.assert_allclose(once, z[::8], atol=0.03 * width)


# ---------------------------------------------------------------- what is seen


def test_a_tracker_lags_in_all_it_sees():
    t, p, dt = stepped()
    y = law("tracker_lag").apply(p[:, None] * np.arange(1, 6), dt, {"time_s": 0.4})
    np.testing.assert_allclose(y[1:], P * (1 - np.exp(-t[1:, None] / 0.4)) * np.arange(1, 6), atol=1e-6)


# ---------------------------------------------------------------- of all laws


def case(name, n=400):
    """Signal, conditions and values of a law at its first start."""
    effect = law(name)
    x = np.stack([polyline(n, k) for k in range(3 if effect.stage == "drive" else 5)], axis=1)
    columns = {"temperature_c": np.linspace(15, 35, n), "gravity_y": np.linspace(-1, 1, n)}
    columns["payload_g"] = np.linspace(0, 50, n)
    columns["session_time_s"] = np.linspace(0, 20, n)
    columns["length_mm"] = np.full(n, 100.0)
    conditions = np.stack([columns[c] for c in effect.columns] or [np.zeros(n)], axis=1)
    values = {"weight": 0.5, "scale_kpa": P}
    constants = [p for p in effect.parameters if p.name not in values]
    start = starts(name)[0] or tuple(p.default for p in constants)
    values |= {p.name: s * P**p.range_power for p, s in zip(constants, start, strict=True)}
    return effect, x, conditions, {p.name: values[p.name] for p in effect.parameters}


@pytest.mark.parametrize("name", law_names())
def test_two_calls_with_the_state_equal_one(name):
    effect, x, c, values = case(name)
    dt = np.full(len(x), DT)
    dt[[0, 250]] = math.inf
    states = [np.zeros(effect.state_size(x.shape[1])) for _ in range(2)]
    whole = effect.apply(x, dt, values, c, states[0])
    parts = [effect.apply(x[s], dt[s], values, c[s], states[1]) for s in (slice(173), slice(173, None))]
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    np.testing.assert_array_equal(*states)
    assert not np.allclose(whole, x)


@pytest.mark.parametrize("name", TABLE)
def test_no_law_reads_beyond_its_own_constants(name):
    effect, x, c, values = case(name)
    out, dt = np.array(x), np.full(len(x), DT)
    theta = np.array([*values.values(), *np.full(8, np.nan)])
    effect.run(out, dt, theta, np.ascontiguousarray(c), np.zeros(effect.state_size(3)))
    assert np.isfinite(out).all()


# A dead band lets its input through in jumps, earlier where it looks more often; so does a maximum.
@pytest.mark.parametrize("name", [n for n in law_names() if n != "dead_band(p)"])
def test_twice_the_samples_of_straight_lines_change_nothing(name):
    effect, x, c, values = case(name, 401)
    fine = np.arange(0, 400.5, 0.5)
    line = lambda v: np.stack([np.interp(fine, np.arange(401), k) for k in v.T], axis=1)  # noqa: E731
    coarse = effect.apply(x, np.full(401, DT), values, c)
    twice = effect.apply(line(x), np.full(801, DT / 2), values, line(c))[::2]
    size = np.abs(coarse - x).max()
    worst = 0.05 if name.startswith(("mode", "loop", "p fading")) else 0.02
    assert np.abs(coarse - twice).max() < worst * size


@pytest.mark.parametrize("name", [n for n in law_names() if n not in ("held(p)", "p damage(p)")])
def test_what_has_rested_stays_at_rest(name):
    """At a constant pressure nothing changes with time, at whatever pace it is looked at."""
    effect, x, c, values = case(name)
    rest = np.broadcast_to(x[0], x.shape)
    still = np.broadcast_to(c[0], c.shape)
    for dt in (0.001, 0.1, 30.0):
        y = effect.apply(rest, np.full(len(x), dt), values, still)
        np.testing.assert_allclose(y, np.broadcast_to(y[0], y.shape), atol=1e-9)


@pytest.mark.parametrize(
    "name", [n for n, r in TABLE.items() if r.family in ("creep", "ringing", "leak", "rate")]
)
def test_a_long_rest_wipes_out_what_fades(name):
    effect, x, c, values = case(name)
    dt = np.full(len(x), DT)
    dt[200] = math.inf
    whole = effect.apply(x, dt, values, c)
    alone = effect.apply(x[200:], dt[200:], values, c[200:])
    np.testing.assert_allclose(whole[200:], alone, atol=1e-12)


def test_the_other_chambers_and_a_law_of_no_weight_do_not_matter():
    for name in TABLE:
        effect, x, c, values = case(name)
        dt = np.full(len(x), DT)
        if not effect.several:
            alone = effect.apply(x[:, 1], dt, values, c)
            np.testing.assert_array_equal(effect.apply(x, dt, values, c)[:, 1], alone, err_msg=name)
        nothing = effect.apply(x, dt, values | {"weight": 0.0}, c)
        np.testing.assert_array_equal(nothing, x, err_msg=name)


# ---------------------------------------------------------------- laws of a twin


LAWS = {
    "lag(p)": {"weight": 0.3, "time_s": 4.0},
    "lag(p) #2": {"weight": -0.2, "time_s": 0.3},
    "play(p)": {"weight": 0.4, "width_kpa": 0.8},
    "mode(p)": {"weight": 0.5, "frequency_rad_per_s": 9.0, "damping_ratio": 0.2},
    "lag(p; time moves with dT)": {"weight": 0.2, "time_s": 6.0, "times_per_10_k": 0.5},
}


def twin_with(laws, device="finger"):
    twin = Twin(device, parameters={"gain_rad_per_kpa": Value(0.011)})
    for name, values in laws.items():
        twin.effects[name] = law(name).start(P)
        for k, v in values.items():
            twin.effects[name][k].value = v
    return twin


def test_a_law_may_act_twice_and_statics_come_first():
    names = [e.name for e in in_order(["lag(p) #2", "creep", "lag(p)", "tracker_lag", "p^2", "stiffening"])]
    assert names == ["stiffening", "creep", "p^2", "lag(p)", "lag(p) #2", "tracker_lag"]
    flip = {"weight": 0.2, "scale_kpa": 60.0, "width_kpa": 5.0, "centre_kpa": 30.0, "slope_kpa": 20.0}
    assert "snap" not in law("flip(p)").as_cause(flip)
    assert family("lag(p) #2") == "creep" == family("power_law_memory(p)") and family("creep") == "creep"
    plain = [plain_name(n) for n in law_names()]
    assert len(set(plain)) == len(plain) and not any("(p" in n or "_" in n for n in plain)
    assert plain_name("play(p) #2") == "play between pressure and bend, second one"
    assert plain_name("valve_lag") == "valve lag"
    assert is_law("lag(p) #2") and not is_law("creep")


@pytest.mark.parametrize(
    ("name", "constants", "found"),
    [
        ("flip(p)", {"width_kpa": 5.0, "centre_kpa": 30.0, "slope_kpa": 3.0}, "snap"),
        ("flip(p)", {"width_kpa": 5.0, "centre_kpa": 30.0, "slope_kpa": 20.0}, "hysteresis"),
        ("flip(p)", {"width_kpa": 0.2, "centre_kpa": 50.0, "slope_kpa": 20.0}, "stiffening"),
        ("flip(p)", {"width_kpa": 0.2, "centre_kpa": 10.0, "slope_kpa": 20.0}, "gain_saturation"),
        ("flip(p)", {"width_kpa": 0.2, "centre_kpa": 10.0, "slope_kpa": 3.0}, "gain_saturation"),
        ("play(p)", {"width_kpa": 6.0}, "hysteresis"),
        ("play(p)", {"width_kpa": 40.0}, "cyclic_softening"),  # it moves on the first fill alone
        ("play(p)^3", {"width_kpa": 6.0}, "hysteresis"),
        ("play(p)^3", {"width_kpa": 0.2}, "stiffening"),
        ("power(p)", {"exponent": 2.0}, "stiffening"),
        ("power(p)", {"exponent": 0.5}, "gain_saturation"),
        ("tanh(p)", {"slope": 1.0}, "gain_saturation"),
        ("lag(p)", {"time_s": 5.0}, "creep"),
        ("lag(p)", {"time_s": 5.0, "weight": -0.2}, "relaxation"),
        ("lag(p)", {"time_s": 0.05}, "valve_lag"),
        ("lag(p)", {"time_s": 0.05, "weight": -0.2}, "overshoot"),
        ("lag(p^2)", {"time_s": 0.05}, "stiffening"),
        ("p lag(p^2)", {"time_s": 0.05, "weight": -0.2}, "gain_saturation"),
        ("power_law_memory(p)", {"exponent": 0.0, "weight": -0.2}, "relaxation"),
        ("held(p)", {"rate_1_per_s": 0.05}, "leak"),
        ("held(p)", {"rate_1_per_s": 0.05, "weight": -0.2}, "creep"),
        ("mode(p)", {"frequency_rad_per_s": 9.0, "damping_ratio": 0.3}, "ringing"),
        ("mode(p)", {"frequency_rad_per_s": 4.0, "damping_ratio": 0.84}, "creep"),
        ("mode(p)", {"frequency_rad_per_s": 40.0, "damping_ratio": 0.84}, "valve_lag"),
        ("air_resonance", {"frequency_rad_per_s": 9.0, "damping_ratio": 0.3}, "air_resonance"),
        ("air_resonance", {"frequency_rad_per_s": 9.0, "damping_ratio": 0.9}, "valve_lag"),
        ("p lag(|dp/dt|)", {"time_s": 60.0}, "self_heating"),
        ("p lag(|dp/dt|)", {"time_s": 5.0}, "cyclic_softening"),
        ("p lag(|dp/dt|)", {"time_s": 5.0, "weight": -0.2}, "rate"),
        ("valve_slew", {"band_kpa": 1.0, "vent_growth": 0.0}, "valve_slew"),
        ("valve_slew", {"band_kpa": 1.0, "vent_growth": 1.5}, "orifice_flow"),
    ],
)
def test_a_law_is_called_by_what_it_does_with_its_constants(name, constants, found):
    assert family(name, {"weight": 0.2, "scale_kpa": 60.0} | constants) == found


def test_a_law_is_kept_as_its_name_and_its_constants(tmp_path):
    twin = twin_with(LAWS)
    twin.parameters = Twin.builtin().parameters | twin.parameters
    text = (twin.save(tmp_path / "twin") / "twin.yaml").read_text()
    again = Twin.load(tmp_path / "twin")
    assert again.effects == twin.effects and "python" not in text and "lambda" not in text
    samples = {"trial": np.zeros(50, int), "time_s": DT * np.arange(50), "pressure_cmd_kpa": polyline(50)}
    inputs = Inputs.from_samples(samples | {"temperature_c": np.full(50, 30.0)})
    runs = [m.run(inputs, m.theta(t, P)).markers for t in (twin, again) for m in [Pipeline.of(t, inputs)]]
    np.testing.assert_array_equal(*runs)


@pytest.mark.parametrize(
    ("name", "meant"), [("lag(q)", r"lag\(p\)"), ("power_law_memory", "power_law_memory")]
)
def test_a_law_that_does_not_exist_is_refused_with_the_one_that_was_meant(tmp_path, name, meant):
    twin = Twin()
    twin.effects[name] = {"weight": Value(0.1)}
    with pytest.raises(InputError, match=f"twin.yaml: There is no effect '.*'; did you mean '{meant}") as e:
        Twin.load(twin.save(tmp_path / "twin"))
    assert "\n" not in str(e.value)


def test_nothing_that_came_with_a_twin_is_executed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = Twin().save(tmp_path / "twin")
    plain = (folder / "twin.yaml").read_text()
    code = "__import__('pathlib').Path('executed').touch()"
    for bad in (f'"{code}": {{}}', f'"lag({code})": {{}}', f'"lag(p) #{code}": {{weight: {{value: 0.1}}}}'):
        (folder / "twin.yaml").write_text(plain.replace("effects: {}", f"effects:\n  {bad}"))
        assert bad in (folder / "twin.yaml").read_text()
        with pytest.raises(InputError):
            get_effect(next(iter(Twin.load(folder).effects)))
    (folder / "twin.yaml").write_text(f'{plain}\nextra: !!python/object/apply:eval ["{code}"]\n')
    with pytest.raises(InputError, match="not valid YAML"):
        Twin.load(folder)
    assert not (tmp_path / "executed").exists()


def test_a_named_curve_bends_as_its_equation_does_next_to_a_law_that_states_the_range():
    """p (1 + a p) has the second difference P a / 2 over half the range."""
    values = {"linear_1_per_kpa": -0.004, "quadratic_1_per_kpa2": 0.0}
    assert curvature("stiffening", values, 60.0) == pytest.approx(-0.004 * 60 / 2)
    s = 30.0
    bent = s * (math.tanh(60 / s) - 2 * math.tanh(30 / s)) / 60
    assert curvature("gain_saturation", {"saturation_pressure_kpa": s}, 60.0) == pytest.approx(bent)
    twin = Twin("finger", 100.0, [50.0])
    twin.effects["stiffening"] = {k: Value(v) for k, v in values.items()}
    law = {"weight": 0.1, "scale_kpa": 60.0, "time_s": 5.0}
    twin.effects["lag(p)"] = {k: Value(v) for k, v in law.items()}
    assert family_in(twin, "stiffening") == "gain_saturation"
