"""Training by PPO: what the actor reads, going on, reloading, returns that rise, a student's dataset."""

import json
from dataclasses import replace
from itertools import cycle

import numpy as np
import pytest
import torch

pytest.importorskip("stable_baselines3", reason="PPO needs the extra 'rl' (stable-baselines3)")

from lerobot_pneutac.rl.actor import Actor, try_actor
from lerobot_pneutac.rl.env import PpoEnv
from lerobot_pneutac.rl.options import StudentRef
from lerobot_pneutac.rl.ppo import (
    LEAST_STEPS,
    Compute,
    PpoSettings,
    actor_of,
    make_ppo,
    make_worlds,
    train_ppo,
)
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin

pytestmark = pytest.mark.slow

SMALL = PpoSettings(hidden=(32, 32), update_steps=128, batch=64, epochs=2)
TWO = Compute(envs=2, tries=2)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A tiny training in two goes."""
    out = tmp_path_factory.mktemp("ppo") / "switch"
    for steps in (128, 300):
        card = train_ppo("switch", None, 1, steps, out, TWO, SMALL)
    return out, card


def observations(n: int = 6) -> list[dict[str, np.ndarray]]:
    env = PpoEnv("switch")
    rng, seen = np.random.default_rng(0), [env.reset(seed=0)[0]]
    return seen + [env.step(rng.uniform(-1, 1, 4))[0] for _ in range(n - 1)]


def test_only_the_critic_reads_the_objects_state():
    worlds = make_worlds("switch", None, Compute(envs=1))
    model = make_ppo(worlds, 0, "cpu", SMALL)
    one = {k: torch.as_tensor(np.stack([o[k] for o in observations()])) for k in ("actor", "object")}
    two = {"actor": one["actor"], "object": one["object"] + 1}
    with torch.no_grad():
        a, b = (model.policy.get_distribution(o).distribution.mean for o in (one, two))
        v, w = (model.policy.predict_values(o) for o in (one, two))
    assert torch.equal(a, b)
    assert (v - w).abs().min() > 1e-4
    actor = actor_of(model, SMALL)
    with torch.no_grad():
        assert torch.allclose(actor(one["actor"]), a, atol=1e-6)


def test_a_training_goes_on_until_it_has_its_steps_and_its_curve_is_finite(trained):
    out, card = trained
    curve = json.loads((out / "curve.json").read_text())
    assert [row["steps"] for row in curve] == [128, 256, 384] and card["steps"] == 384
    assert all(
        np.isfinite([row["seconds"], row["action_std"], *row["terms"].values()]).all() for row in curve
    )
    assert all(a["seconds"] < b["seconds"] for a, b in zip(curve, curve[1:], strict=False))
    assert 0 <= card["test"]["success"] <= 1 and np.isfinite(card["test"]["return"])
    files = "actor.json", "actor.safetensors", "checkpoint.safetensors", "curve.json"
    assert sorted(p.name for p in out.iterdir()) == [*files]
    actor = (out / "actor.safetensors").read_bytes()
    assert train_ppo("switch", None, 1, 300, out, TWO, SMALL)["steps"] == 384  # all done: it is left as it is
    assert (out / "actor.safetensors").read_bytes() == actor


def test_a_checkpoint_restores_networks_and_optimiser(trained):
    from lerobot_pneutac.rl.ppo import Keeper

    out, card = trained
    run = {k: card[k] for k in ("task", "twin", "seed", "settings", "weights", "options")}
    model = make_ppo(make_worlds("switch", None, TWO), 7, "cpu", SMALL)
    Keeper(out, run, lambda *_: None).resume(model)
    actor = Actor.load(out)
    for o in observations():
        assert np.allclose(actor_of(model, SMALL).act(o["actor"]), actor.act(o["actor"]), atol=1e-7)
    state = model.policy.optimizer.state_dict()["state"]
    assert len(state) == len(list(model.policy.parameters()))
    assert state[0]["step"] == 3 * SMALL.epochs * 2 and state[1]["exp_avg_sq"].max() > 0


def test_a_reloaded_actor_acts_the_same(trained, tmp_path):
    actor = Actor.load(trained[0])
    actor.save(tmp_path / "copy")
    again = Actor.load(tmp_path / "copy")
    assert all(np.array_equal(actor.act(o["actor"]), again.act(o["actor"])) for o in observations())
    env = PpoEnv("switch", length=20)
    assert try_actor(actor, env, 2, 3) == try_actor(again, env, 2, 3)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"steps": 0}, "steps is 0"),
        ({"task": "door"}, "no task 'door'"),
        ({"seed": 2}, "another seed"),
        ({"twin": replace(Twin.builtin(), device="arm")}, "one chamber, and this twin is of an 'arm'"),
    ],
)
def test_bad_input_is_refused(trained, options, match):
    given = {"task": "switch", "twin": None, "seed": 1, "steps": 300, "compute": TWO, "settings": SMALL}
    with pytest.raises(InputError, match=match):
        train_ppo(out=trained[0], **(given | options))


def test_damaged_files_are_refused(trained, tmp_path):
    with pytest.raises(InputError, match="holds no actor.safetensors"):
        Actor.load(tmp_path)
    for name, match in (("actor.json", "not an actor's card"), ("actor.safetensors", "damaged")):
        folder = tmp_path / name
        Actor.load(trained[0]).save(folder)
        (folder / name).write_text("{}")
        with pytest.raises(InputError, match=match):
            Actor.load(folder)
    broken = tmp_path / "broken"
    broken.mkdir()
    (broken / "checkpoint.safetensors").write_bytes(b"nonsense")
    with pytest.raises(InputError, match="damaged; delete it"):
        train_ppo("switch", None, 1, 300, broken, TWO, SMALL)


@pytest.mark.nightly  # MuJoCo Warp takes a minute to compile on a CPU
@pytest.mark.timeout(3000)
def test_a_policy_does_in_a_batch_what_it_does_in_single_worlds(tmp_path):
    """A policy that sees the object pushes the switch, until each world has ended once."""
    pytest.importorskip("mujoco_warp", reason="the extra `warp` is not installed")
    trials = []
    for batch in (False, True):
        worlds = make_worlds("switch", None, Compute(envs=2, batch=batch))
        worlds.seed(3)
        seen, first = worlds.reset(), {}
        if batch:  # the first episodes of its worlds are shorter, so that they are at different moments
            assert np.ptp(worlds.venv._done) > 0
            worlds.venv._done[:] = 0
        rows = [seen]
        while len(first) < 2:
            way, press_mm = 0.05 * seen["object"][:, :3], seen["object"][:, 12:13]
            near = way + (0.004, 0, 0)
            free = np.hstack([near / np.maximum(np.abs(way).max(1, keepdims=True), 0.02), [[-0.5]] * 2])
            push = np.hstack([[[0.25]] * 2, 20 * way[:, 1:], [[0.8]] * 2])
            seen, _, over, infos = worlds.step(np.where(press_mm > 0.12, push, free).clip(-1, 1))
            rows.append(seen)
            for i in np.flatnonzero(over):
                first.setdefault(i, (infos[i]["is_success"], infos[i]["episode"]["r"]))
                assert infos[i]["terminal_observation"]["actor"].shape == seen["actor"].shape[1:]
        trials.append((rows[:9], first))
    (single, ends), (batch, others) = trials
    for a, b in zip(single, batch, strict=True):  # before the first touch: 0.1 mm, 0.01 rad
        assert np.abs(a["object"] - b["object"]).max() < 0.002
        assert np.abs(a["actor"] - b["actor"]).max() < 0.02
    assert {won for won, _ in ends.values()} == {True, False}
    for i in range(2):
        assert ends[i][0] == others[i][0] and others[i][1] == pytest.approx(ends[i][1], abs=0.7)
    short = replace(SMALL, update_steps=32)
    train = train_ppo("switch", None, 1, 32, tmp_path, Compute(envs=2, tries=1, batch=True), short)
    assert train["steps"] == 2 * LEAST_STEPS and np.isfinite(train["test"]["return"])


@pytest.mark.nightly
def test_returns_rise_where_coming_near_is_all_there_is_to_learn(tmp_path):
    quick = PpoSettings(hidden=(32, 32), update_steps=512, batch=128, learning_rate=2e-3, discount=0.9)
    options = {"length": 10, "randomise": False}
    train_ppo("switch", None, 0, 6000, tmp_path, Compute(envs=4, tries=2), quick, **options)
    curve = json.loads((tmp_path / "curve.json").read_text())
    approach = [row["terms"]["approach"] for row in curve]
    assert np.mean(approach[-3:]) > np.mean(approach[:3]) + 0.02
    assert np.mean([r["return"] for r in curve[-3:]]) > np.mean([r["return"] for r in curve[:3]]) + 0.15


def test_a_students_dataset_has_the_features_of_recorded_demonstrations(tmp_path, monkeypatch):
    from lerobot.datasets import LeRobotDataset
    from lerobot.utils.constants import ACTION, OBS_STR
    from lerobot.utils.feature_utils import combine_feature_dicts, hw_to_dataset_features

    from lerobot_pneutac.rl import student as ppo_student
    from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
    from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
    from pneutac_datasets.demonstrations.episodes import load_episode
    from pneutac_sim.features import ACTION_HIGH, ACTION_LOW

    monkeypatch.setattr(ppo_student, "EPISODE_S", 0.4)
    ended, rolled = cycle([lambda: False, lambda: True]), ppo_student.roll_out

    def roll_out(actor, world, *more):  # of every other trial no demonstration is made
        world.task.success = lambda: False
        episode = rolled(actor, world, *more)
        world.task.success = next(ended)
        return episode

    monkeypatch.setattr(ppo_student, "roll_out", roll_out)
    actor = Actor((16,), {"task": "switch"})
    actor.save(tmp_path / "actor")
    root = tmp_path / "demos"
    wanted = StudentRef("local/student", root, 2, "probe", noise=0.1)
    done = ppo_student.record_student(tmp_path / "actor", "switch", None, 3, wanted)
    assert done == (2, 4)
    dataset = LeRobotDataset("local/student", root)
    robot = PneutacSim(PneutacSimConfig(task="switch"))
    recorded = combine_feature_dicts(
        hw_to_dataset_features(robot.action_features, ACTION, False),
        hw_to_dataset_features(robot.observation_features, OBS_STR, False),
    )
    assert all(dict(dataset.features[k]) == f for k, f in recorded.items())
    assert dataset.meta.robot_type == robot.name and dataset.num_episodes == 2
    episode = load_episode(dataset, 1)
    assert len(episode) == 6 and episode.images.shape[1:] == (320, 240, 3)
    assert (episode.action >= ACTION_LOW - 1e-6).all() and (episode.action <= ACTION_HIGH + 1e-6).all()
    assert np.ptp(episode.state[:, 14]) > 0  # the arm moved


def test_a_student_of_another_task_or_of_a_failing_actor_is_refused(tmp_path, monkeypatch):
    from lerobot_pneutac.rl import student as ppo_student

    Actor((16,), {"task": "egg"}).save(tmp_path / "actor")

    def record(task, **options):
        given = {"episodes": 1, "fidelity": "probe", "noise": 0.0} | options
        wanted = StudentRef("local/d", tmp_path / "d", **given)
        ppo_student.record_student(tmp_path / "actor", task, None, 0, wanted)

    with pytest.raises(InputError, match="trained on 'egg', not 'switch'"):
        record("switch")
    with pytest.raises(InputError, match="episodes is 0"):
        record("egg", episodes=0)
    with pytest.raises(InputError, match="noise is 2"):
        record("egg", noise=2.0)
    monkeypatch.setattr(ppo_student, "EPISODE_S", 2 / 15)
    with pytest.raises(InputError, match="succeeded in 0 of 20 trials"):
        record("egg")
