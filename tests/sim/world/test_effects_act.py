"""Every effect acts in the world as on the bench: the finger in free air, and what is read of it.

Slow sweep, step and fast sine of the pressure through the world's finger give the tip path of the bench's
pipeline within 0.3 percent of the finger's length. Where an effect of the body moves the tip, so is the gel
moved; where it is measured only, the gel stays.
"""

from functools import cache

import numpy as np
import pytest
from installed import packages
from played import press_bar

from pneutac_sim.effects import body_effects, get_effect
from pneutac_sim.effects.registry import all_effects, sensor_effects
from pneutac_sim.errors import InputError
from pneutac_sim.finger import Inputs, Pipeline
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.twin import Twin, Value
from pneutac_sim.world.world import World

RISE_KPA = 5.0 * (1 - np.cos(np.pi * np.arange(91) / 90))  # in 6 s
SWEEP_KPA = np.concatenate([RISE_KPA, np.full(15, 10.0), RISE_KPA[::-1]])
STEP_KPA = np.repeat([0.0, 10.0], [5, 15])
SINE_KPA = 5.0 * (1 + np.cos(2 * np.pi * np.arange(31) / 15))  # of 1 Hz
FAST_KPA = np.concatenate([STEP_KPA, SINE_KPA])
CONDITIONS = {
    "temperature_c": 31.0,
    "payload_g": 20.0,
    "gravity_x": 0.6,
    "gravity_y": 0.48,
    "gravity_z": -0.64,
    "other_1_kpa": 4.0,
}
# Where the value with which a fit starts does nothing, or nothing slow.
SIZES = {
    "base_tilt": {"pitch_rad": 0.1, "yaw_rad": 0.05, "roll_rad": 0.03, "shift_y_mm": 2.0, "shift_z_mm": 5.0},
    "camera_misalignment": {"roll_rad": 0.05, "shift_x_mm": 10.0},
    "sensor_offset": {"offset_kpa": 1.0, "drift_kpa_per_s": 0.05},
    "leak": {"leak_rate_1_per_s": 0.004},  # what it loses in the plateau comes back at once, in a jump
}
NEAR = {"distance": 16.0, "elevation": 0.22}  # lights that are far or high make no such effect
LAWS = (
    "lag(p)",
    "p dT",
    "p exp(-t)",
    "tip_y += g_y",
    "bend += bend^2",
    "tracker_lag",
)
FOREIGN = """
from pneutac_sim.effects import BodyEffect, Parameter, kernel


@kernel
def run(x, dt, theta, conditions, state):
    for t in range(len(x)):
        x[t, 1] += theta[0] * conditions[t, 0] * x[t, 2]


EFFECT = BodyEffect(
    name="damp_side",
    stage="material",
    signal="markers",
    columns=("humidity",),
    parameters=(Parameter("share", "", default=0.1, lower=-1.0, upper=1.0),),
    run=run,
    summary="Damp makes your {device} bend sideways by {share:.2g} of its way.",
    experiment="Repeat a program on a damp day.",
)
"""


def with_effect(*names: str) -> Twin:
    twin = Twin.builtin()
    for name in names:
        twin.effects[name] = get_effect(name).start(15.0)
        twin.effects[name] |= {k: Value(v) for k, v in SIZES.get(name, {}).items()}
    return twin


def sweep(world: World, program=SWEEP_KPA) -> tuple[np.ndarray, np.ndarray]:
    """Markers (n, 5) and the middle of the gel (n, 3), m, over a program of pressures (n,) in kPa."""
    world.reset(0)
    read, gel = [world.markers], [world.gel_m - world.flange_m]
    for p in program[1:]:
        world.step([0.0, 0.0, 0.0, p])
        read.append(world.markers)
        gel.append(world.gel_m - world.flange_m)
    return np.array(read), np.array(gel)


def bench(twin: Twin, conditions: dict, program=SWEEP_KPA) -> np.ndarray:
    """Markers (n, 5) of the pipeline over the same."""
    n = len(program)
    samples = {"trial": np.zeros(n, int), "time_s": np.arange(n) / 15, "pressure_cmd_kpa": program}
    samples |= {name: np.full(n, value) for name, value in conditions.items()}
    inputs = Inputs.from_samples(samples, "finger", twin.length_mm, source="command", start="held")
    model = Pipeline.of(twin, inputs)
    assert not model.left_out
    return model.run(inputs, model.theta(twin)).markers


@cache
def plain():
    twin = Twin.builtin()
    return *sweep(World("switch", twin, touch="none")), bench(twin, {})


def apart_mm(a: np.ndarray, b: np.ndarray) -> float:
    """Largest distance of two tip paths."""
    return float(np.linalg.norm(a[:, :3] - b[:, :3], axis=1).max())


def check(twin: Twin, name: str, conditions: dict) -> None:
    world = World("switch", twin, touch="none", conditions=conditions)
    fast, _ = sweep(world, FAST_KPA)
    assert apart_mm(fast, bench(twin, conditions, FAST_KPA)) < 0.003 * twin.length_mm
    read, gel = sweep(world)
    measured = bench(twin, conditions)
    assert apart_mm(read, measured) < 0.003 * twin.length_mm
    np.testing.assert_allclose(read[:, 3:], measured[:, 3:], atol=5e-3)
    _, free, without = plain()
    size, moved = apart_mm(measured, without), 1e3 * np.linalg.norm(gel - free, axis=1).max()
    effect = get_effect(name)
    if effect.stage == "observation" and effect.signal == "markers":
        assert moved < 1e-3, "what is measured leaves the body alone"
    else:
        assert size > 0.05 and 0.4 * size < moved < 2.5 * size, (size, moved)


def test_the_plain_finger_moves_in_the_world_as_on_the_bench():
    read, _, measured = plain()
    assert apart_mm(read, measured) < 0.0015 * 110.0
    np.testing.assert_allclose(read[0], measured[0], atol=1e-3)


@pytest.mark.parametrize("name", [*(n for n, e in body_effects().items() if not e.several), *LAWS])
def test_an_effect_acts_in_the_world_as_on_the_bench(name):
    check(with_effect(name), name, CONDITIONS)


def test_an_effect_of_another_package_acts_in_the_world_as_on_the_bench(tmp_path, monkeypatch):
    with packages(tmp_path, monkeypatch, "effects", all_effects) as install:
        install("pneutac_damp_side", FOREIGN, {"damp_side": "pneutac_damp_side:EFFECT"})
        check(with_effect("damp_side"), "damp_side", {"humidity": 0.7})
        with pytest.raises(InputError, match="effect 'damp_side' needs the condition 'humidity'"):
            World("switch", with_effect("damp_side"), touch="none")


def test_the_network_bends_the_free_finger_as_the_bench_says():
    world = World("switch", touch="none", fidelity="surrogate")
    read, _ = sweep(world)
    assert apart_mm(read, plain()[2]) < 0.0015 * 110.0
    fast, _ = sweep(world, FAST_KPA)
    assert apart_mm(fast, bench(world.twin, {}, FAST_KPA)) < 0.003 * 110.0


# ---------------------------------------------------------------- conditions and sessions


def test_a_range_is_drawn_anew_for_each_episode_and_by_the_seed():
    world = World("switch", with_effect("thermal"), "none", conditions={"temperature_c": [20.0, 30.0]})

    def bends(seeds):
        out = []
        for seed in seeds:
            world.reset(seed)
            for _ in range(10):
                world.step([0.0, 0.0, 0.0, 10.0])
            out.append((world.conditions["temperature_c"], world.spine_rad.sum()))
        return np.array(out).T

    warmth, bend = bends([1, None, None, None, 1])
    assert warmth[0] == warmth[-1] and bend[0] == bend[-1]
    assert len(set(warmth[:4])) == 4 and ((warmth >= 20) & (warmth <= 30)).all()
    assert (np.diff(bend[np.argsort(warmth[:4])]) > 0).all(), "a warmer finger bends further"


def test_a_session_goes_on_without_a_seed_and_begins_with_one():
    world = World("switch", with_effect("cyclic_softening", "p exp(-t)"), "none")

    def run(seed):
        world.reset(seed)
        for p in (12.0, 0.0) * 10:
            world.step([0.0, 0.0, 0.0, p])
        world.step([0.0, 0.0, 0.0, 12.0])
        return world.spine_target_rad.sum()

    first, second, again = run(0), run(None), run(0)
    assert abs(second - first) > 1e-3 and again == first


def test_a_payload_bends_with_the_weight_that_the_world_knows():
    """The finger hangs along gravity, so a weight pulls the curled finger straight."""
    loaded = World("switch", with_effect("payload"), "none", conditions={"payload_g": 20.0})
    read, _ = sweep(loaded)
    down = {"payload_g": 20.0, "gravity_x": 1.0, "gravity_y": 0.0, "gravity_z": 0.0}
    assert apart_mm(read, bench(loaded.twin, down)) < 0.003 * 110.0
    assert (read[:, 3] < plain()[0][:, 3] - 0.02).all()


# ---------------------------------------------------------------- the gel


@pytest.mark.parametrize("name", [n for n, e in sensor_effects().items() if e.late is None])
def test_an_effect_of_the_gel_acts_in_the_worlds_image(name):
    """As in the gel's own model; one that tells of photographs (`of_session`) is no part of the sensor."""
    check_image(name)


def test_a_gel_that_creeps_shows_a_contact_that_is_over():
    world, bar = check_image("gel_creep", shows=False)
    world.data.time += 60.0
    world.touch.sense(world.data)
    held = world.touch.displacement_mm
    world.data.geom_xpos[bar] += 1.0
    world.data.time += 1.0
    world.touch.sense(world.data)
    assert not world.touch.depth_mm.any() and 0.05 < world.touch.left_mm.max() / held.max() < 0.5
    assert np.abs(world.touch.image.astype(int) - world.touch.sensor.rest_image).max() > 3
    world.data.time = 0.0
    world.touch.sense(world.data)
    assert (world.touch.image == world.touch.sensor.rest_image).all()


def check_image(name: str, shows: bool = True) -> tuple[World, int]:
    """Presses the switch's bar into the gel; returns the world and the bar."""
    twin = Twin.builtin()
    gel = GelModel.builtin()
    effect = get_effect(name)
    values = {p.name: p.default + 0.3 * (p.upper - p.default) for p in effect.parameters}
    values |= {p: NEAR[kind] for p in values for kind in NEAR if p.startswith(kind)}
    with_it = GelModel(gel.rest_image, gel.light, gel.depth_light, effects={name: values})
    without = GelModel(gel.rest_image, gel.light, gel.depth_light, effects={})
    with_it.into_twin(twin)
    world = World("switch", twin, touch="image")
    world.reset(0)
    bar = press_bar(world, 0.0057)
    depth = world.touch.depth_mm
    assert 0.5 < depth.max() < 1.5
    own, bare = (TactileSensor(g).image(depth).astype(int) for g in (with_it, without))
    assert np.abs(world.touch.image - own).max() <= 1
    assert (np.abs(own - bare).max() > 3) == (shows and not effect.of_session)
    return world, bar
