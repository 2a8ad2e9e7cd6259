import gymnasium
import numpy as np
import pytest

import pneutac_sim  # noqa: F401
from pneutac_sim.errors import InputError
from pneutac_sim.features import STATE_NAMES
from pneutac_sim.finger.inputs import Inputs
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.twin import Twin
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.experts.motion import SEARCH_KPA, VENTED_KPA
from pneutac_sim.world.standin import CREEP, LATE_COMMANDS, StandinWorld, standin_twin
from pneutac_sim.world.standin_touch import NOISE_LEVELS
from pneutac_sim.world.world import DT, World

EE = slice(STATE_NAMES.index("ee_x.pos"), STATE_NAMES.index("ee_z.pos") + 1)


@pytest.fixture(scope="module")
def world():
    return StandinWorld("switch")


def touched(world, steps=45, seed=3):
    """Goes ahead until something is felt; returns the observations."""
    out = [world.reset(seed)]
    expert = ScriptedExpert(world, np.random.default_rng(seed))
    for _ in range(steps):
        out.append(world.step(expert.action()))
    return out


def test_the_seed_decides_everything(world):
    first, again, other = (touched(world, seed=s) for s in (3, 3, 4))
    for a, b in zip(first, again, strict=True):
        assert (a.state == b.state).all() and (a.tactile == b.tactile).all()
    assert (first[0].state != other[0].state).any()
    assert (first[0].tactile != other[0].tactile).any()


def test_a_command_acts_late(world):
    world.reset(0)
    before = world.flange_m
    world.step([0.1, 0.0, 0.0, 5.0])
    assert world.command == pytest.approx([0.1, 0.0, 0.0, 5.0])
    assert np.linalg.norm(world.flange_m - before) < 1e-4
    assert LATE_COMMANDS == 1
    world.step([0.0, 0.0, 0.0, 0.0])
    world.step([0.0, 0.0, 0.0, 0.0])
    assert world.flange_m[0] - before[0] == pytest.approx(0.1 * DT, rel=0.2)


def test_an_image_comes_a_step_late_and_scalars_with_it(world):
    world.reset(4)
    expert = ScriptedExpert(world, np.random.default_rng(4))
    felt, shown = [], []
    for _ in range(60):
        o = world.step(expert.action())
        felt.append(world.sensor.contact_from_depth(world.touch.depth_mm).pixels)
        shown.append(int(world.touch.pixels))
        assert np.expm1(o.state[STATE_NAMES.index("contact_pixels.pos")]) == pytest.approx(
            shown[-1], rel=1e-3
        )
    felt, shown = np.array(felt, float), np.array(shown, float)
    assert felt.max() > 500
    assert np.abs(shown[1:] - felt[:-1]).mean() < 0.3 * np.abs(shown - felt).mean()


def test_readings_are_noisy_by_as_much_as_stated(world):
    world.reset(0)
    o = [world.step([0, 0, 0, 5.0]) for _ in range(60)][20:]
    pressure = np.array([x.state[-1] for x in o])
    assert np.diff(pressure).std() / np.sqrt(2) == pytest.approx(0.1, rel=0.4)
    assert np.array([x.state[EE] for x in o]).std(0).max() < 1e-3
    images = np.array([x.tactile for x in o[:8]], float)
    assert (images[1:] - images[:-1]).std() / np.sqrt(2) == pytest.approx(NOISE_LEVELS, rel=0.25)
    assert max(x.state[STATE_NAMES.index("contact_area.pos")] for x in o) < 1e-3  # noise is no contact


def test_the_finger_lags_and_creeps(world):
    world.reset(0)
    angle = []
    for _ in range(150):
        world.step([0, 0, 0, 12.0])
        angle.append(world.spine_rad.sum())
    late = sum(CREEP.values()) / (1 + sum(CREEP.values()))
    end = 4 * world.twin.parameter("gain_rad_per_kpa") * 12.0 + angle[0]
    share = (np.array(angle) - angle[0]) / (end - angle[0])
    assert share[round(0.2 / DT)] < 0.4  # the valve
    assert 1 - 1.1 * late < share[round(1.4 / DT)] < 0.97  # the pressure is there, the bend is not
    assert share[-1] > 0.97


def test_a_twin_without_the_effects_is_off_by_millimetres():
    t = np.arange(600) / 15
    command = np.where((t % 12) < 6, 12.0, 2.0)
    samples = {"trial": np.zeros(600, int), "time_s": t, "pressure_cmd_kpa": command}
    inputs = Inputs.from_samples(samples)

    def tip(twin):
        return Pipeline.of(twin).run(inputs, Pipeline.of(twin).theta(twin)).markers[:, :3]

    true = standin_twin()
    plain = true.copy()
    plain.effects = {}
    assert np.sqrt(np.square(tip(true) - tip(plain)).sum(1).mean()) > 3.0
    assert np.sqrt(np.square(tip(true) - tip(Twin.builtin())).sum(1).mean()) > 3.0


def test_the_gel_is_another_than_the_twins(world):
    twin = World("switch")
    d = np.zeros((80, 59), np.float32)
    d[30:50, 20:40] = 0.6
    rest = np.abs(world.sensor.rest_image.astype(int) - twin.sensor.rest_image).mean()
    assert rest > 5
    mine, other = (w.sensor.image(d).astype(int) - w.sensor.rest_image for w in (world, twin))
    assert np.abs(mine - other).mean() > 1.0


def test_the_expert_succeeds_more_often_than_not():
    world, done = StandinWorld("card", touch="none"), []
    for seed in range(4):
        world.reset(seed)
        expert = ScriptedExpert(world, np.random.default_rng(seed))
        for _ in range(120):
            world.step(expert.action())
            if world.success:
                break
        done.append(world.success)
    assert sum(done) >= 3


def test_area_alone_is_that_of_the_image():
    image, area = StandinWorld("switch"), StandinWorld("switch", touch="area")
    a, b = touched(image), touched(area)
    assert b[-1].tactile is None
    for x, y in zip(a, b, strict=True):
        assert x.state == pytest.approx(y.state)


def test_environments_are_registered():
    env = gymnasium.make("pneutac_standin/card")
    observation, _ = env.reset(seed=2)
    assert env.observation_space.contains(observation)
    observation, _, _, _, info = env.step(np.zeros(4, np.float32))
    assert env.observation_space.contains(observation)
    assert set(info) == {"is_success", "failure", "clipped", "out_of_range"}
    assert isinstance(env.unwrapped.world, StandinWorld)
    env.close()


def test_bad_options_are_named():
    with pytest.raises(InputError, match="'foam'; it must be one of layer, mpm"):
        StandinWorld("switch", gel="foam")


def test_the_camera_shows_the_wall_along_which_the_expert_slides_up():
    """A flat wall presses the gel alike everywhere; what no image shows cannot be learnt from images."""
    world = StandinWorld("egg")
    shown, free = [], []
    for seed in (1, 3, 4):
        rest = world.reset(seed).tactile.astype(float)
        expert, o = ScriptedExpert(world, np.random.default_rng(seed)), None
        for _ in range(40):
            action = expert.action()
            if o is not None and VENTED_KPA < action[3] < SEARCH_KPA:
                change = (o.tactile - rest).reshape(80, 4, 60, 4, 3).mean((1, 3))
                if world.press_mm < 0.02 and action[0] > 0.05:
                    free.append(np.abs(change).max())
                elif action[2] > 0.04 and world.press_mm > 0.2:
                    shown.append(np.abs(change).max())
            o = world.step(action)
            if world.success or world.failure:
                break
    assert len(shown) > 10 and len(free) > 10
    assert np.percentile(shown, 10) > 2 * max(free)
