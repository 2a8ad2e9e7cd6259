"""The pipeline backwards: it bends its own model as told, and a finger that shares nothing with it three
times better than its statics alone; a measured bend corrects it, and a load is told apart."""

import mujoco
import numpy as np
import pytest

from lerobot_robot_pneutac.standin.world import RodBody, clamped
from pneutac_sim.errors import InputError
from pneutac_sim.finger.control import STEPS, BendController, bend_angle, bend_is_by, pressure_for
from pneutac_sim.finger.online import PressurePipeline
from pneutac_sim.twin import Twin, Value

HZ, NOISE_RAD = 20, 0.003
# What `pneutac calibrate` and `pneutac diagnose` made of three minutes of the stand-in's bench, seed 1.
STATIC = {"gain_rad_per_kpa": 0.015015, "gain_alpha": 0.13602, "gain_beta": 3.0, "rest_pressure_kpa": 10.0952}
FOUND = {
    "gain_rad_per_kpa": 0.016648,
    "gain_alpha": 0.0086,
    "gain_beta": 0.006,
    "rest_pressure_kpa": 7.0906,
    "pause_s": 1e4,
}
EFFECTS = {
    "dead_time": {"delay_s": 0.0481},
    "valve_slew": {
        "fill_rate_kpa_per_s": 33.97,
        "vent_rate_kpa_per_s": 7.68,
        "band_kpa": 1.166,
        "vent_growth": 2.112,
        "scale_kpa": 15.0,
    },
    "creep": {
        "weight_0_4s": 0.0505,
        "weight_1_3s": 0.0282,
        "weight_4s": 0.0529,
        "weight_13s": 0.0834,
        "weight_40s": 0.0,
        "weight_130s": 0.2289,
    },
    "base_tilt": {
        "pitch_rad": 0.0023,
        "yaw_rad": -0.0027,
        "roll_rad": 0.0022,
        "shift_x_mm": 0.096,
        "shift_y_mm": 0.35,
        "shift_z_mm": 0.323,
    },
    "loop(p)": {"weight": -0.0947, "scale_kpa": 15.0, "width_kpa": 3.4258},
    "flip(p)": {
        "weight": 0.0349,
        "scale_kpa": 15.0,
        "width_kpa": 1.8184,
        "centre_kpa": 7.3537,
        "slope_kpa": 3.5554,
    },
}


def twin_of(parameters, effects=()):
    twin = Twin.builtin()
    twin.parameters |= {k: Value(v) for k, v in parameters.items()}
    twin.effects = {e: {k: Value(v) for k, v in dict(effects)[e].items()} for e in dict(effects)}
    return twin


class Bench:
    """The stand-in's finger in its clamp."""

    def __init__(self, hz):
        self.model, self.hz = clamped(), hz
        self.model.opt.timestep = 1 / (hz * np.ceil(1 / (hz * self.model.opt.timestep)))
        self.data = mujoco.MjData(self.model)
        self.finger = RodBody(self.model, self.data)
        self.finger.advance(0.0, 1.0)

    def step(self, kpa):
        self.finger.advance(kpa, 1 / self.hz)
        mujoco.mj_kinematics(self.model, self.data)
        base = self.data.body("finger")
        place = base.xmat.reshape(3, 3).T @ (self.data.site("tip").xpos - base.xpos)
        return 2 * np.arctan2(place[2], place[0])

    def push(self, newton):
        base = self.data.body("finger").xmat.reshape(3, 3)
        self.data.xfrc_applied[self.model.site("tip").bodyid[0], :3] = base @ [0, 0, -newton]


def slow_sine(seconds, hz):
    t = np.arange(round(seconds * hz) + 1) / hz
    return 0.62 + 0.22 * (1 - np.cos(2 * np.pi * t / 12))


def minor_loops(seconds, hz):
    t = np.arange(round(seconds * hz) + 1) / hz
    return np.interp(
        t, [0, 3, 5, 8, 10, 13, 15, 18, 20, 24], [0.62, 1.0, 0.8, 1.05, 0.7, 0.9, 0.64, 0.9, 0.75, 1.05]
    )


@pytest.fixture(scope="module")
def found():
    return twin_of(FOUND, EFFECTS)


def test_looking_ahead_does_what_stepping_does(found):
    ahead, stepped = PressurePipeline(found), PressurePipeline(found)
    commands = np.array([3.0, 9.0, 9.0, 2.0, 12.0, 12.0])
    for kpa in (5.0, 8.0):
        for p in (ahead, stepped):
            p.place(p.step(kpa, 0.05), 0.05)
    for _ in range(2):  # and does nothing to the pipeline
        predicted = ahead.predict(commands, 0.05)
    one_by_one = [stepped.place(stepped.step(kpa, 0.05), 0.05) for kpa in commands]
    np.testing.assert_allclose(predicted, one_by_one, rtol=0, atol=1e-12)


@pytest.mark.parametrize("shape", [slow_sine, minor_loops])
def test_in_its_own_model_the_bend_is_as_asked(found, shape):
    wanted = shape(24, HZ)
    kpa, bend = pressure_for(found, wanted, 1 / HZ)
    after = slice(2 * HZ, None)  # from rest it has to get there first
    assert np.sqrt(np.mean((bend - wanted)[after] ** 2)) < 0.002 * np.ptp(wanted)
    assert kpa.min() >= 0 and kpa.max() <= 15


@pytest.mark.parametrize("shape", [pytest.param(slow_sine, marks=pytest.mark.nightly), minor_loops])
def test_another_finger_follows_three_times_better_once_its_effects_are_found(found, shape):
    wanted, errors = shape(24, HZ), []
    for twin in (twin_of(STATIC), found):
        bench = Bench(HZ)
        bend = np.array([bench.step(kpa) for kpa in pressure_for(twin, wanted, 1 / HZ)[0]])
        errors.append(np.sqrt(np.mean((bend - wanted)[2 * HZ :] ** 2)))
    assert errors[1] < errors[0] / 3


@pytest.mark.slow
@pytest.mark.nightly
def test_a_measured_bend_corrects_it_and_a_push_is_told_within_a_tenth_of_a_second(found):
    hz, rng = 50, np.random.default_rng(0)
    control, bench, errors, alarms = BendController(found, 1 / hz), Bench(hz), [], 0
    wanted = minor_loops(24, hz)
    t = np.arange(len(wanted)) / hz
    for i in range(60 * hz):  # a minute
        k = i % len(wanted)
        bend = bench.step(control.command(np.interp(t[k] - 1 / hz + control.plan_times_s, t, wanted)))
        control.observe(bend + NOISE_RAD * rng.standard_normal())
        alarms += control.loaded
        if k > 4 * hz:  # it has left the jump to the beginning behind
            errors.append(bend - wanted[k])
    free = Bench(hz)
    blind = np.array([free.step(kpa) for kpa in pressure_for(found, wanted, 1 / hz)[0]]) - wanted
    assert np.std(errors) < np.sqrt(np.mean(blind[4 * hz :] ** 2))
    assert alarms == 0
    told = None
    for k in range(-3 * hz, hz // 2):
        bench.push(np.clip(4.0 * k / hz, 0.0, 0.2))  # 0.2 N, as fast as a finger runs onto something
        control.observe(bench.step(control.command(wanted[-1])) + NOISE_RAD * rng.standard_normal())
        told = k / hz if control.loaded and told is None else told
    assert told is not None and told <= 0.1


def test_an_offset_is_learnt_and_driven_out(found):
    control, off = BendController(found, 1 / HZ), 0.05
    for _ in range(8 * HZ):
        control.command(0.8)
        model = control.predicted_rad - control.offset_rad
        control.observe(model + off)
    assert control.offset_rad == pytest.approx(off, abs=1e-3)
    assert model + off == pytest.approx(0.8, abs=2e-3)


def test_the_bend_is_what_the_twin_was_calibrated_by(found):
    arc = np.array([100 * np.sin(0.5) / 0.5, 0, 100 * (1 - np.cos(0.5)) / 0.5, 0.4, 0])
    assert bend_angle(arc) == pytest.approx(0.5) and bend_angle(arc, "angle") == 0.4
    assert bend_is_by(found) == "tip"
    found = found.copy()
    found.history = [
        {"version": 0, "change": "calibrated", "unit": "rad"},
        {"change": "gel", "unit": "levels"},
    ]
    assert bend_is_by(found) == "angle"


@pytest.mark.parametrize(
    ("bend", "sentence"),
    [
        ([0.6, 9.0], r"goes from 0.6 to 9 rad; between 0 and 15 kPa this finger reaches 0.\d+ to 1.\d+ rad"),
        ([0.6, np.nan], "one row of finite numbers"),
        ([], "one row of finite numbers"),
    ],
)
def test_a_bend_out_of_reach_is_refused(found, bend, sentence):
    with pytest.raises(InputError, match=sentence):
        pressure_for(found, np.array(bend), 0.05)


def test_bad_input_of_the_controller(found):
    with pytest.raises(InputError, match="'gel'; bend is commanded of a finger"):
        BendController(Twin(device="gel"), 0.05)
    with pytest.raises(InputError, match="dt_s=0 must be"):
        BendController(found, 0)
    control = BendController(found, 0.05)
    with pytest.raises(InputError, match="target bend is not a finite"):
        control.command(np.full(STEPS, np.nan))
    with pytest.raises(InputError, match="measured bend is nan"):
        control.observe(float("nan"))
