import numpy as np
import pytest
import torch
from lerobot.policies import make_pre_post_processors
from lerobot.utils.constants import ACTION, OBS_STATE

from lerobot_robot_pneutac.policy.configuration_pneutac_bc import TACTILE
from lerobot_robot_pneutac.policy.modeling_pneutac_bc import PneutacBCPolicy
from pneutac_benchmarks.policy.frames import Frames
from pneutac_benchmarks.policy.in_memory import (
    _Data,
    held_out_episodes,
    learn_from,
    new_policy,
    save,
    train,
)
from pneutac_datasets.demonstrations.episodes import Episode
from pneutac_sim.features import ACTION_HIGH, ACTION_LOW, CONTROL_HZ, IMAGE_SHAPE, STATE_NAMES

pytestmark = pytest.mark.slow

LENGTHS = (5, 7, 4)


@pytest.fixture(autouse=True)
def _one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def episodes(lengths=LENGTHS, seed=0):
    """They begin untouched; then a bright spot wanders, and the action follows it."""
    rng, made = np.random.default_rng(seed), []
    for length in lengths:
        images = np.full((length, *IMAGE_SHAPE), 100, np.uint8)
        places = rng.integers(40, 200, (length, 2))
        for image, (row, column) in zip(images[1:], places[1:], strict=True):
            image[row : row + 40, column : column + 40] += 60
        shares = np.column_stack([places / 240, np.arange(length) / 10, np.zeros(length)])
        action = ACTION_LOW + shares * (np.array(ACTION_HIGH) - ACTION_LOW)
        state = 0.1 * rng.standard_normal((length, len(STATE_NAMES)))
        made.append(
            Episode(state.astype(np.float32), action.astype(np.float32), images, "follow", CONTROL_HZ)
        )
    return made


@pytest.fixture(scope="module")
def frames():
    return Frames.of(episodes())


@pytest.mark.parametrize("use_tactile", [True, False])
def test_loss_and_gradients_are_those_of_forward(frames, use_tactile, monkeypatch):
    policy = new_policy(use_tactile, 3e-4, 0, "cpu", memory=True).train()
    learn_from(policy, frames)
    data = _Data(frames, policy, torch.device("cpu"))
    policy._memories = data._recalled
    rows = np.array([0, 3, 5, 11, 12, 15])  # both sides of the episodes' borders
    whole = np.concatenate([e.images for e in episodes()])[rows]
    batch = {  # what lerobot-train would make of these frames
        OBS_STATE: torch.from_numpy(frames.state[rows]),
        TACTILE: torch.from_numpy(whole).permute(0, 3, 1, 2).float() / 255,
        ACTION: torch.from_numpy(np.stack([frames.previous[rows], frames.action[rows]], 1)),
        f"{ACTION}_is_pad": torch.from_numpy(np.stack([frames.first[rows], np.zeros(6, bool)], 1)),
        "index": torch.from_numpy(rows),
    }

    def run(loss_of):
        torch.manual_seed(4)  # the same noise and hidden actions
        policy.zero_grad()
        loss, terms = loss_of()
        loss.backward()
        return loss.item(), terms, [p.grad.clone() for p in policy.parameters()]

    *arrays, difference, recalled = data.at(rows)
    if use_tactile:  # the images are kept as 8-bit means
        exact = policy.encoder.difference(batch[TACTILE])
        assert (difference - exact).abs().max() <= 0.6 / 32
        monkeypatch.setattr(policy, "_difference", lambda batch: difference)
    loss, terms, gradients = run(lambda: policy(batch))
    loss_m, terms_m, gradients_m = run(lambda: policy.loss(*arrays, difference, recalled))
    assert loss_m == pytest.approx(loss, rel=1e-5) and terms_m == pytest.approx(terms, rel=1e-5)
    for a, b in zip(gradients, gradients_m, strict=True):
        assert a.abs().max() > 0 and torch.allclose(a, b, rtol=1e-3, atol=1e-4 * a.abs().max().item())


def test_joined_frames_number_their_episodes_on_and_know_previous_actions(frames, tmp_path):
    other = Frames.of(episodes((3, 2), seed=1))
    joined = Frames.joined([frames, other])
    assert joined.episodes == 5 and np.bincount(joined.episode).tolist() == [5, 7, 4, 3, 2]
    starts = np.flatnonzero(joined.first)
    assert starts.tolist() == [0, 5, 12, 16, 19]
    inside = np.setdiff1d(np.arange(len(joined)), starts)
    assert np.array_equal(joined.previous[inside], joined.action[inside - 1])
    assert np.array_equal(joined.previous[starts], joined.action[starts])
    two = joined.first_episodes(2)
    assert (two.episodes, len(two)) == (2, 12) and np.array_equal(two.images, joined.images[:12])
    joined.save(tmp_path / "frames.npz")
    again = Frames.load(tmp_path / "frames.npz")
    assert all(np.array_equal(v, getattr(again, k), equal_nan=True) for k, v in vars(joined).items())
    assert again.rest.shape == (3, 320, 240) and torch.allclose(again.rest, torch.tensor(100 / 255))


def test_copies_weight_the_episodes_that_are_trained_on(frames):
    drawn = []

    class Counted(_Data):
        def at(self, rows):
            drawn.extend(frames.episode[rows])
            return super().at(rows)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pneutac_benchmarks.policy.in_memory._Data", Counted)
        train(new_policy(True, 1e-3, 0, "cpu"), frames, 20, 9, 1, copies=[1, 1, 6], rows=1)
    assert np.bincount(drawn).tolist() == [25, 35, 120]  # 5 and 7 frames, and 6 times 4


def test_training_learns_keeps_the_best_and_loads_again(frames, tmp_path):
    policy = new_policy(True, 3e-3, 0, "cpu")
    seen = []
    away = held_out_episodes(3, 0.1, 0)
    told = seen.append
    training = train(policy, frames, 60, 8, 1, away, rows=6, progress=lambda update, loss: told(update))
    curve = training.curve
    assert [row["update"] for row in curve] == seen == [10, 20, 30, 40, 50, 60]
    assert curve[-1]["loss"] < 0.5 * curve[0]["loss"]
    lowest = min(curve, key=lambda row: row["held_out"])
    assert (training.best, training.held_out) == (lowest["update"], lowest["held_out"])
    folder = save(policy, training, tmp_path)
    assert folder == tmp_path / "checkpoints" / f"{training.best:06d}" / "pretrained_model"
    assert f"Steps: {training.best}" in (folder / "README.md").read_text()
    loaded = PneutacBCPolicy.from_pretrained(folder)
    before, after = make_pre_post_processors(loaded.config, str(folder))
    observation = {OBS_STATE: torch.zeros(20), TACTILE: torch.full((3, 320, 240), 0.5), "task": "follow"}
    found = after(loaded.select_action(before(observation)))
    expected = policy.select_action({k: v[None] for k, v in observation.items() if k != "task"})
    assert torch.allclose(found, expected)


def test_episodes_held_out_do_not_teach(frames):
    changed = Frames(**vars(frames))
    changed.action = np.where((frames.episode == 1)[:, None], np.float32(0.05), frames.action)
    policies = [new_policy(True, 3e-4, 0, "cpu") for _ in range(2)]
    for policy, data in zip(policies, (frames, changed), strict=True):
        train(policy, data, 5, 8, 1, [1], rows=1)
    for a, b in zip(*(p.parameters() for p in policies), strict=True):
        assert torch.equal(a, b)
