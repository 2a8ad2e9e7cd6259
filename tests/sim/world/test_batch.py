"""Many worlds at once agree with the single world, step by step."""

import gymnasium
import numpy as np
import pytest

from pneutac_sim.effects import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin, Value
from pneutac_sim.world.base import Variation
from pneutac_sim.world.expert import ScriptedExpert

pytest.importorskip("mujoco_warp", reason="the extra `warp` is not installed")
torch = pytest.importorskip("torch")

from pneutac_sim.gel.contact_batch import ContactBatch, Playback  # noqa: E402
from pneutac_sim.world.batch import BatchedWorld, wp  # noqa: E402

# MuJoCo Warp takes a minute to compile on a CPU.
pytestmark = pytest.mark.nightly
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
FLANGE_M, SPINE_RAD, AREA = (
    2e-5,
    0.01,
    0.02,
)  # how far one control step in the batch may be from the single world


def show(batch: BatchedWorld, world: int) -> None:
    """Puts the single world, which has made the same start and steps, into the state of one of the batch."""
    g = batch.single
    for name, mine in (("qpos", g.data.qpos), ("qvel", g.data.qvel), ("_warmstart", g.data.qacc_warmstart)):
        mine[:] = getattr(batch, name)[world].cpu().numpy()
    g.model.dof_frictionloss[:] = batch.fields["dof_frictionloss"][world].cpu().numpy()


@pytest.mark.parametrize(("task", "steps"), [("switch", 45), ("egg", 45), ("card", 60)])
def test_each_step_is_that_of_the_single_world(task, steps):
    """Contacts chatter, and two runs part: the single world begins each step where the batch is."""
    import mujoco

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
    g, rng = batch.single, np.random.default_rng(0)
    g.reset(0)
    from types import SimpleNamespace

    import mujoco

    rows, expected = [], []
    for _ in range(80):
        g.data.qpos[3:7] = rng.uniform(-0.2, 0.2, 4)
        mujoco.mj_kinematics(g.model, g.data)
        aim = g.data.geom("bar").xpos + rng.uniform(-1, 1, 3) * (0.001, 0.006, 0.006) - (0.0055, 0, 0)
        g.data.qpos[:3] += aim - g.gel_m
        mujoco.mj_kinematics(g.model, g.data)
        rows.append(
            [a.copy() for a in (g.data.geom_xpos, g.data.geom_xmat, g.data.site_xpos, g.data.site_xmat)]
        )
        found = g._pad._springs.of(*g.touch.objects(g.data)) or g._pad._free
        expected.append((found.force(found.depth_m), g.touch.sensor.probe(*g.touch.objects(g.data))))
    kinds = (wp.vec3, wp.mat33, wp.vec3, wp.mat33)
    with wp.ScopedDevice(batch.device):
        columns = [
            wp.array(np.array(c, np.float32).reshape(80, -1, *((3, 3) if k is wp.mat33 else (3,))), dtype=k)
            for c, k in zip(zip(*rows, strict=True), kinds, strict=True)
        ]
    names = ("geom_xpos", "geom_xmat", "site_xpos", "site_xmat")
    data = SimpleNamespace(nworld=80, **dict(zip(names, columns, strict=True)))
    t, gel = g.touch, g.sensor.model
    from pneutac_sim.gel.force import GelForce

    contact = ContactBatch(
        GelForce.of(g.twin),
        gel.window_mm,
        gel.thickness_mm,
        t.felt,
        t.kinds,
        t.sizes,
        g._gel,
        data,
        batch.device,
        g._pad._free,
    )
    depth = contact.look().cpu().numpy()
    k1, k3, x = (a.cpu().numpy() for a in contact.springs(Playback(batch.torch_device)))
    force, grids = (np.array(column) for column in zip(*expected, strict=True))
    off = np.abs((k1 * x + k3 * x**3) / force - 1)
    assert off.max() < 0.05 and np.quantile(off, 0.75) < 0.005
    assert np.abs(depth - grids).max() < 1e-3
    assert (grids.max((1, 2)) > 0.3).sum() > 40
