import sys
import types

import gymnasium
import numpy as np
import pytest
from played import succeeds

import lerobot_robot_pneutac.standin  # noqa: F401
from lerobot_robot_pneutac.standin.world import (
    CONTACT_THRESHOLD,
    DOME_MM,
    GEL_KPA,
    LATE_COMMANDS,
    PARTS,
    CameraNoise,
    StandinWorld,
    contact_pixels,
    gel_force_n,
    new_rod,
)
from pneutac_sim.errors import InputError
from pneutac_sim.features import EE, STATE_NAMES
from pneutac_sim.gel.contact import contact_area, quieted
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.station import Station

DT = Station().dt_s

OURS = ("effects", "finger", "gel", "mpm", "splat", "surrogate")


@pytest.fixture(scope="module")
def world():
    return StandinWorld("card")


def touched(world, steps=40, seed=3):
    """Goes ahead until something is felt; returns the observations."""
    out = [world.reset(seed)]
    expert = ScriptedExpert(world, np.random.default_rng(seed))
    for _ in range(steps):
        out.append(world.step(expert.action()))
    return out


def test_nothing_of_the_twins_finger_gel_and_effects_is_called(world, monkeypatch):
    """What the contract of imports says of the code, at run time: every function of theirs raises."""

    def refuse(*args, **kwargs):
        raise AssertionError("the stand-in called the twin's physics")

    modules = [
        m for name, m in sys.modules.items() if name.startswith(tuple(f"pneutac_sim.{k}" for k in OURS))
    ]
    assert modules
    for module in modules:
        for name, thing in list(vars(module).items()):
            if callable(thing) and getattr(thing, "__module__", "").startswith("pneutac_sim."):
                if isinstance(thing, types.FunctionType) or hasattr(thing, "py_func"):
                    monkeypatch.setattr(module, name, refuse)
                elif isinstance(thing, type) and not issubclass(thing, Exception):
                    monkeypatch.setattr(thing, "__init__", refuse)
    fresh = StandinWorld("card")
    touched(fresh, 35)
    assert fresh.touch.displacement_mm.max() > 0.2


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
    for _ in range(50):
        o = world.step(expert.action())
        image = world.touch.gel.image(world.touch.displacement_mm)
        felt.append(contact_pixels(image, world.touch.rest_image, CONTACT_THRESHOLD))
        shown.append(int(world.touch.pixels))
        assert np.expm1(o.state[STATE_NAMES.index("contact_pixels.pos")]) == pytest.approx(
            shown[-1], rel=1e-3
        )
        seen = contact_area(quieted(o.tactile), quieted(world.touch.rest_image)).pixels
        assert shown[-1] == pytest.approx(seen, abs=1)
    felt, shown = np.array(felt, float), np.array(shown, float)
    assert felt.max() > 150
    assert np.abs(shown[1:] - felt[:-1]).mean() < 0.6 * np.abs(shown - felt).mean()


def test_noise_and_drift_of_the_light_touch_nothing_in_any_episode(world):
    """Single pixels beyond 6 levels, the least calibrated threshold, began a touch in one of ten once."""
    camera, rest = CameraNoise(world.touch.rest_image.shape), world.touch.rest_image
    for seed in range(60):
        camera.begin(np.random.default_rng(seed))
        assert max(contact_pixels(camera.photograph(rest), rest, 6.0) for _ in range(10)) == 0


def test_the_finger_rests_where_the_rod_does_but_for_its_weight(world):
    """A hinge turns by what the rod bends, less what weight takes back; pressure and memory are the rod's."""
    world.reset(0)
    rod = new_rod()
    rod.step(0.0, 8 * DT + DT)
    for _ in range(40):
        world.step([0, 0, 0, 9.0])
        rod.step(9.0, DT)
    bends = np.array([world.data.joint(f"bend_{n}").qpos[0] for n in range(PARTS)])
    assert world.pressure_kpa == pytest.approx(9.0, abs=0.05)
    assert 0 < rod.bends_rad(PARTS).sum() - bends.sum() < 0.08
    assert np.abs(rod.bends_rad(PARTS) - bends).max() < 0.02


def test_the_gel_pushes_back_as_hertz_says(world):
    touched(world, 30)
    for _ in range(20):
        world.step([0.0, 0.0, 0.0, 0.0])
    depth = -1e3 * float(world.data.joint("pad").qpos[0])
    assert depth > 0.2
    total, force = 0.0, np.zeros(6)
    import mujoco

    for i in range(world.data.ncon):
        if world.model.geom("pad").id in (world.data.contact[i].geom1, world.data.contact[i].geom2):
            mujoco.mj_contactForce(world.model, world.data, i, force)
            total += force[0]
    hertz = 4 / 3 * 1e-3 * GEL_KPA * np.sqrt(DOME_MM) * depth**1.5
    assert gel_force_n(depth) == pytest.approx(hertz)
    assert total == pytest.approx(hertz, rel=0.1)


@pytest.mark.parametrize("station", [Station(), Station(arm="ur5"), Station(arm="so101", latency_s=0.1)])
def test_experts_do_the_card_with_any_arm(station):
    world = StandinWorld("card", touch="none", station=station)
    assert len(world.reset(0).state) == 2 * station.joints + 6
    assert world.reset(0).state[EE] == pytest.approx(world.flange_m - station.base_m, abs=1e-3)
    assert sum(succeeds(world, seed, steps=80) for seed in range(3)) >= 2


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
    with pytest.raises(InputError, match="short of .* where the task 'switch' starts"):
        StandinWorld("switch", station=Station(arm="so101", base_m=(0.0, 0.0, 0.2)))
    with pytest.raises(InputError, match="touch is 'probe'; it must be one of image, area, none"):
        StandinWorld("switch", touch="probe")
    with pytest.raises(InputError, match="no task 'door'"):
        StandinWorld("door")
