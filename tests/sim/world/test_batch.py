"""Many worlds at once agree with the single world, step by step."""

import gymnasium
import mujoco
import numpy as np
import pytest

from pneutac_sim.effects import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin, Value
from pneutac_sim.world.base import Variation
from pneutac_sim.world.expert import ScriptedExpert

pytest.importorskip("mujoco_warp", reason="the extra `warp` is not installed")
torch = pytest.importorskip("torch")

from pneutac_sim.world.batch import BatchedWorld, Rollouts  # noqa: E402
from pneutac_sim.world.gantry import Gantry  # noqa: E402

# MuJoCo Warp takes a minute to compile on a CPU.
pytestmark = pytest.mark.nightly
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
# How far one control step in the batch may be from the single world.
FLANGE_M, SPINE_RAD, AREA = 2e-5, 0.01, 0.02


def show(batch: BatchedWorld, world: int) -> None:
    """Puts the single world, which has made the same start and steps, into the state of one of the batch."""
    g = batch.single
    for name, mine in (("qpos", g.data.qpos), ("qvel", g.data.qvel), ("_warmstart", g.data.qacc_warmstart)):
        mine[:] = getattr(batch, name)[world].cpu().numpy()
    g.model.dof_frictionloss[:] = batch.fields["dof_frictionloss"][world].cpu().numpy()


@pytest.mark.parametrize(("task", "steps"), [("switch", 45), ("egg", 45), ("card", 60)])
def test_each_step_is_that_of_the_single_world(task, steps):
    """Contacts chatter, and two runs part: the single world begins each step where the batch is."""
    batch = BatchedWorld(task, 2, device=DEVICE)
    varied = [Variation(bend_gain=1.1, friction=0.9, late_commands=1), Variation(shift_m=(0.004, 0.0, 0.0))]
    batch.reset(3, variations=varied)
    g = batch.single
    touched = 0
    for world, variation in enumerate(varied):
        batch.reset(3, variations=varied)
        g.variation = variation
        g.reset(3 + world)
        assert np.abs(batch.qpos[world].cpu().numpy() - g.data.qpos).max() < 1e-3
        expert = ScriptedExpert(g, np.random.default_rng(world), tremor=False)
        off = []
        for _ in range(steps):
            show(batch, world)
            mujoco.mj_kinematics(g.model, g.data)
            action = expert.action()
            batch.step(np.stack([action, action]))
            g.step(action)
            q, spine = batch.qpos[world].cpu().numpy(), batch._qpos_of_spine
            off.append([np.abs(q[:3] - g.data.qpos[:3]).max(), np.abs(q[spine] - g.data.qpos[spine]).max(),
                        abs(float(batch.area[world]) - g.touch.area)])  # fmt: skip
            assert bool(batch.success[world]) == g.success
            touched += g.touch.area > 0
        flange, spine, area = np.array(off).T
        assert flange.max() < FLANGE_M
        assert np.quantile(spine, 0.9) < SPINE_RAD
        assert np.quantile(area, 0.9) < AREA
    assert touched > 5


@pytest.mark.parametrize("task", ["switch", "egg", "card"])
def test_a_rollout_is_that_of_one_gantry(task):
    """From states in contact: the next steps of three sequences, for two worlds in another order."""
    batch, ahead = (BatchedWorld(task, n, device=DEVICE, forked=True) for n in (2, 7))
    varied = [Variation(shift_m=(0.004, 0.0, 0.0)), Variation(bend_gain=1.1, friction=0.9, late_commands=1)]
    batch.reset(3, variations=varied)
    g, rng = batch.single, np.random.default_rng(0)
    g.variation = varied[1]
    g.reset(4)
    expert, gantry, rollouts = ScriptedExpert(g, rng, tremor=False), Gantry(g), Rollouts(batch, ahead)
    off = []
    for _ in range(70):
        action = expert.action()
        batch.step(np.stack([action, action]))
        g.step(action)
        show(batch, 1)
        if not g.touch.area > 0:
            continue
        tried = action + rng.normal(0, (0.006, 0.006, 0.006, 0.6), (3, 2, 4))
        tried = np.clip(tried, *g.action_limits)
        gantry.mirror(g)
        flange, area = gantry.rollouts(tried)
        rollouts.mirror([1, 0], 3, np.array([g.touch.area, 0.0]))
        many_flange, many_area = rollouts.rollouts(np.stack([tried, tried]))
        assert many_flange.shape == (2, 3, 2, 3) and many_area.shape == (2, 3, 2)
        off.append([np.abs(many_flange[0] - flange).max(), *np.abs(many_area[0] - area).ravel()])
        if len(off) == 6:
            break
    off = np.array(off)
    assert len(off) == 6
    assert off[:, 0].max() < FLANGE_M
    assert np.quantile(off[:, 1:], 0.9) < AREA


def test_worlds_go_on_from_a_fork_as_if_nothing_had_been():
    """By formulas, a roll-out is what the batch does itself; and a world that waits misses nothing."""
    twin = Twin.builtin()
    for name, values in {"play(p)": {}, "valve_slew": {}, "dead_time": {"delay_s": 0.1}}.items():
        twin.effects[name] = get_effect(name).start(15.0) | {k: Value(v) for k, v in values.items()}
    options = "card", 2, twin, DEVICE, "probe"
    batch, ahead = (BatchedWorld(*options, forked=True) for _ in range(2))
    g, varied = batch.single, [Variation(late_commands=1, friction=1.1), Variation(late_commands=1)]

    def begin():
        batch.reset(3, variations=varied)
        for action in before:
            batch.step(np.stack([action, action]))
        batch._warmstart.zero_()  # as `mirror` does

    g.variation = varied[0]
    g.reset(3)
    expert, before = ScriptedExpert(g, np.random.default_rng(0), tremor=False), []
    while not g.touch.area > 0:
        before.append(expert.action())
        g.step(before[-1])
    tried = np.array([expert.action() * scale for scale in np.linspace(1, 0.7, 6)])
    begin()
    rollouts = Rollouts(batch, ahead)
    rollouts.mirror([1, 0], 1, batch.area.cpu().numpy()[::-1])
    flange, area = rollouts.rollouts(np.stack([tried, tried])[:, None])
    kpa = ahead.pressure_kpa.cpu().numpy()[::-1]
    found = []
    for waits in (False, True):
        begin()
        rows = []
        for action in tried:
            stays = batch.fork([1])
            batch.step(np.stack([action, action]))
            if waits:
                batch.resume([1], stays)
            rows.append([batch.state[0].cpu().numpy().copy(), float(batch.area[0])])
        for action in tried if waits else ():
            batch.step(np.stack([action, action]))
        found.append(batch.state[1].cpu().numpy().copy())
        if not waits:
            np.testing.assert_allclose([r[0][:3] for r in rows], flange[1, 0], atol=FLANGE_M)
            assert np.quantile(np.abs(np.array([r[1] for r in rows]) - area[1, 0]), 0.9) < AREA
            np.testing.assert_allclose(batch.pressure_kpa.cpu().numpy(), kpa, atol=1e-4)
    assert area[1, 0].max() > 0 and np.ptp(kpa) < 15
    np.testing.assert_allclose(found[0][:3], found[1][:3], atol=FLANGE_M)
    np.testing.assert_allclose(found[0][8:], found[1][8:], atol=1e-4)


def test_the_vector_environment_keeps_gymnasiums_rules():
    env = gymnasium.make_vec(
        "pneutac_sim/switch", num_envs=3, device=DEVICE, max_episode_steps=2, fidelity="probe"
    )
    first, _ = env.reset(seed=1)
    assert env.observation_space.contains(first)
    again, _ = env.reset(seed=1)
    np.testing.assert_array_equal(first, again)
    action = np.zeros((3, 4), np.float32)
    flags = []
    for _ in range(4):
        observation, reward, terminated, truncated, info = env.step(action)
        assert env.observation_space.contains(observation)
        flags.append(truncated.all())
        assert not reward.any() and not terminated.any() and not info["is_success"].any()
    assert flags == [False, True, False, False]  # the third step begins again, whatever the action
    batch = env.unwrapped.world
    assert batch.images().shape == (3, *batch.single.sensor.rest_image.shape)
    with pytest.raises(InputError, match=r"shape \(2, 4\); it must be \(3, 4\)"):
        env.step(action[:2])
    with pytest.raises(InputError, match="not all finite"):
        env.step(action * np.nan)


def test_a_mount_askew_and_a_memory_act_as_in_the_single_world():
    twin = Twin.builtin()
    given = {"base_tilt": {"pitch_rad": -0.09, "shift_z_mm": 2.0}, "play(p)": {}, "valve_slew": {}}
    for name, values in given.items():
        twin.effects[name] = get_effect(name).start(15.0) | {k: Value(v) for k, v in values.items()}
    batch, off = BatchedWorld("switch", 1, twin, DEVICE), []
    one, low, high = batch.single, [-0.05, -0.05, 0.0, 0.0], [0.0, 0.05, 0.05, 15.0]
    batch.reset(3)
    one.reset(3)
    for action in np.random.default_rng(0).uniform(low, high, (12, 4)):
        batch.step(action[None])
        one.step(action)
        gel_m = batch.poses["site_xpos"][0, one._gel].cpu().numpy()
        kpa = float(batch.state[0, 8]) - float(one._pipeline.pressure_kpa[0])
        off.append([np.abs(gel_m - one.gel_m).max(), abs(kpa)])
    assert np.max(off, 0)[0] < 1e-6 and np.max(off, 0)[1] < 1e-5


def test_what_has_no_batched_form_is_refused():
    long = Twin.builtin()
    long.effects["elongation"] = get_effect("elongation").start(15.0)
    for options, message in (
        ({"twin": long}, "moves the tip beyond the bend, as elongation does"),
        ({"task": "button"}, "know the tasks switch, egg, card, not 'button'"),
        ({"worlds": 0}, "worlds is 0"),
        ({"fidelity": "mpm"}, "fidelity"),
        ({"conditions": {"temperature_c": [20.0, 30.0]}}, "a range for temperature_c"),
    ):
        with pytest.raises(InputError, match=message):
            BatchedWorld(**({"worlds": 1, "device": "cpu"} | options))


def test_springs_are_those_of_one_gel():
    """Eighty random presses: forces within 5 %, three quarters of them within 0.5 %."""
    batch = BatchedWorld("switch", 80, device=DEVICE, fidelity="probe")
    batch.reset([0] * 80)
    g, rng = batch.single, np.random.default_rng(0)
    g.reset(0)
    expected = []
    for world in range(80):
        g.data.qpos[3:7] = rng.uniform(-0.2, 0.2, 4)
        mujoco.mj_kinematics(g.model, g.data)
        aim = g.data.geom("bar").xpos + rng.uniform(-1, 1, 3) * (0.001, 0.006, 0.006) - (0.0055, 0, 0)
        g.data.qpos[:3] += aim - g.gel_m
        mujoco.mj_kinematics(g.model, g.data)
        batch.qpos[world] = torch.as_tensor(g.data.qpos)
        found = g._pad._springs.of(*g.touch.objects(g.data)) or g._pad._free
        expected.append((found.force(found.depth_m), g.touch.sensor.probe(*g.touch.objects(g.data))))
    with batch._on_device():
        batch._place()
        depth = batch._contact.look().cpu().numpy()
        k1, k3, x = (a.cpu().numpy() for a in batch._contact.springs(batch._play))
    force, grids = (np.array(column) for column in zip(*expected, strict=True))
    off = np.abs((k1 * x + k3 * x**3) / force - 1)
    assert off.max() < 0.05 and np.quantile(off, 0.75) < 0.005
    assert np.abs(depth - grids).max() < 1e-3
    assert (grids.max((1, 2)) > 0.3).sum() > 40
