import numpy as np
import pytest
import torch
from lerobot.datasets import LeRobotDataset
from lerobot.policies import make_pre_post_processors
from lerobot.utils.constants import ACTION, OBS_STATE
from torch.utils.data import default_collate

from lerobot_robot_pneutac.policy.configuration_pneutac_bc import TACTILE
from lerobot_robot_pneutac.policy.modeling_pneutac_bc import PneutacBCPolicy
from pneutac_benchmarks.policy.frames import Frames, read_frames
from pneutac_benchmarks.policy.in_memory import held_out_episodes, new_policy, save, train
from pneutac_datasets.demonstrations.save import create_dataset, quiet_encoders
from pneutac_sim.features import ACTION_HIGH, ACTION_LOW, ACTION_NAMES, CONTROL_HZ, IMAGE_SHAPE, STATE_NAMES

pytestmark = pytest.mark.slow

LENGTHS = (5, 7, 4)


@pytest.fixture(autouse=True)
def _one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def write(root, lengths=LENGTHS, seed=0, level=100, video=True):
    """Episodes that begin untouched; then a bright spot wanders, and the action follows it."""
    rng = np.random.default_rng(seed)
    features = {
        OBS_STATE: {"dtype": "float32", "shape": (len(STATE_NAMES),), "names": list(STATE_NAMES)},
        ACTION: {"dtype": "float32", "shape": (len(ACTION_NAMES),), "names": list(ACTION_NAMES)},
        TACTILE: {
            "dtype": "video" if video else "image",
            "shape": IMAGE_SHAPE,
            "names": ["height", "width", "channels"],
        },
    }
    repo_id = f"local/{root.name}"
    dataset = create_dataset(repo_id, root, CONTROL_HZ, features, "pneutac", video, max(lengths))
    with quiet_encoders():
        for length in lengths:
            for i in range(length):
                image = np.full(IMAGE_SHAPE, level, np.uint8)
                row, column = rng.integers(40, 200, 2)
                if i:
                    image[row : row + 40, column : column + 40] += 60
                shares = np.array([row, column, i, 0]) / (240, 240, 10, 1)
                action = ACTION_LOW + shares * (np.array(ACTION_HIGH) - ACTION_LOW)
                dataset.add_frame(
                    {
                        OBS_STATE: 0.1 * rng.standard_normal(len(STATE_NAMES)).astype(np.float32),
                        ACTION: action.astype(np.float32),
                        TACTILE: image,
                        "task": "follow",
                    }
                )
            dataset.save_episode()
        dataset.finalize()
    return root, repo_id


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write(tmp_path_factory.mktemp("data") / "follow")


@pytest.fixture(scope="module")
def frames(data):
    return read_frames(data)


def samples(data, rows):
    """The batch that lerobot-train would make of these frames."""
    root, repo_id = data
    deltas = {ACTION: [-1 / CONTROL_HZ, 0.0]}
    dataset = LeRobotDataset(repo_id, root, delta_timestamps=deltas, video_backend="pyav")
    batch = default_collate([dataset[i] for i in rows])
    if batch[TACTILE].dtype == torch.uint8:
        batch[TACTILE] = batch[TACTILE].float() / 255
    return batch


@pytest.mark.parametrize("use_tactile", [True, False])
def test_loss_and_gradients_are_those_of_forward(data, frames, use_tactile, monkeypatch):
    policy = new_policy(use_tactile, 3e-4, 0, "cpu").train()
    policy.learn_from(frames.demonstrations, frames.rest)
    rows = [0, 3, 5, 11, 12, 15]  # both sides of the episodes' borders
    batch = samples(data, rows)

    def run(loss_of):
        torch.manual_seed(4)  # the same noise and hidden actions
        policy.zero_grad()
        loss, terms = loss_of()
        loss.backward()
        return loss.item(), terms, [p.grad.clone() for p in policy.parameters()]

    arrays = [frames.state, frames.previous, frames.first, frames.action]
    arrays = [torch.from_numpy(a[rows]) for a in arrays]
    difference = torch.from_numpy(frames.difference[rows]).float() if use_tactile else None
    if use_tactile:  # the images are kept in half precision
        exact = policy.encoder.difference(batch[TACTILE])
        assert torch.allclose(difference, exact, rtol=2**-11, atol=2**-24)
        monkeypatch.setattr(policy, "_difference", lambda batch: difference)
    loss, terms, gradients = run(lambda: policy(batch))
    loss_m, terms_m, gradients_m = run(lambda: policy.loss(*arrays, difference))
    assert loss_m == pytest.approx(loss, rel=1e-5) and terms_m == pytest.approx(terms, rel=1e-5)
    for a, b in zip(gradients, gradients_m, strict=True):
        assert a.abs().max() > 0 and torch.allclose(a, b, rtol=1e-3, atol=1e-4 * a.abs().max().item())


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
