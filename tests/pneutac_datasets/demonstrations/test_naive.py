import numpy as np
import pytest
from augmenting import config_of
from demonstration_sets import write_episodes
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata, merge_datasets
from lerobot.utils.constants import OBS_STATE

from pneutac_datasets.demonstrations import episodes, naive
from pneutac_datasets.demonstrations.episodes import Episode
from pneutac_datasets.demonstrations.faults import Recorded
from pneutac_datasets.demonstrations.naive import augment_naive, vary
from pneutac_sim.features import (
    ACTION_HIGH,
    ACTION_LOW,
    AREA,
    EE,
    IMAGE_SHAPE,
    N_PIXELS,
    PIXELS,
    PRESSURE,
    STATE_HIGH,
    STATE_LOW,
)

FPS = 15
SLOPE = np.zeros((3, 7))
SLOPE[0, 1] = 2.0  # rad/m


def demonstration(speed=0.03, length=40, contact=(20, 30)) -> Episode:
    """Straight motion along x at constant speed; joint 2 follows; a grey gel brightens in contact."""
    t = np.arange(length) / FPS
    state = np.zeros((length, 20))
    state[:, EE] = np.stack([0.4 + speed * t, 0 * t, 0.3 + 0 * t], 1)
    state[:, 1] = 2.0 * speed * t
    state[:, 8] = 2.0 * speed
    state[:, 3] = -2.5
    state[:, 5] = 2.5
    state[contact[0] : contact[1], AREA] = 0.1
    state[:, PIXELS] = np.log1p(state[:, AREA] * N_PIXELS)
    state[:, PRESSURE] = 6.0
    action = np.zeros((length, 4))
    action[:, 0], action[:, 3] = speed, 6.0
    images = np.full((length, *IMAGE_SHAPE), 100, np.uint8)
    images[contact[0] : contact[1], 100:200, 80:160] = 140
    return Episode(state, action, images, "push", FPS)


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    root = tmp_path_factory.mktemp("naive") / "source"
    moves = map(demonstration, (0.03, 0.05))
    return write_episodes(
        root,
        [zip(e.state, e.action, e.images, strict=True) for e in moves],
        fps=FPS,
        task="push",
        video=True,
    )


def naive_of(source, out, episodes=1, seed=1):
    augment_naive(Recorded(source), config_of(source, out, method="naive", episodes=episodes, seed=seed))
    return out


def read(root, name, key):
    dataset = LeRobotDataset(f"local/{name}", root, video_backend="pyav")
    return np.array(dataset.hf_dataset.with_format("numpy")[key])


@pytest.mark.slow
def test_features_stay_and_datasets_merge(source, tmp_path):
    out = naive_of(source, tmp_path / "more", 3)
    old = LeRobotDatasetMetadata("local/source", source)
    new = LeRobotDatasetMetadata("local/more", out)
    assert (new.features, new.fps, new.robot_type) == (old.features, old.fps, old.robot_type)
    assert new.total_episodes == 3
    merged = merge_datasets(
        [LeRobotDataset("local/source", source), LeRobotDataset("local/more", out)],
        output_repo_id="local/merged",
        output_dir=tmp_path / "merged",
    )
    assert merged.num_episodes == 5
    assert merged.num_frames == old.total_frames + new.total_frames
    assert merged[merged.num_frames - 1]["task"] == "push"


def test_an_episode_of_a_video_is_as_its_frames_one_by_one(source, monkeypatch):
    monkeypatch.setattr(episodes, "DECODED_AT_ONCE", 7)  # several parts, the last one shorter
    dataset = LeRobotDataset("local/source", source, return_uint8=True)
    rows = range(dataset.meta.episodes[1]["dataset_from_index"], dataset.num_frames)
    images = [dataset[i][episodes.TACTILE].numpy().transpose(1, 2, 0) for i in rows]
    read = episodes.load_episode(dataset, 1)
    np.testing.assert_array_equal(read.images, images)
    assert len(read) == 40 and np.ptp(read.images[:, 150, 120, 0].astype(int)) > 20


@pytest.mark.slow
def test_same_seed_same_dataset_other_seed_another(source, tmp_path):
    states = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        naive_of(source, tmp_path / name, 1, seed)
        states.append(read(tmp_path / name, name, OBS_STATE))
    np.testing.assert_array_equal(states[0], states[1])
    assert states[0].shape != states[2].shape or np.abs(states[0] - states[2]).max() > 1e-4


@pytest.mark.parametrize("seed", range(8))
def test_varied_demonstrations_stay_within_bounds_and_consistent(seed):
    rng = np.random.default_rng(seed)
    e = vary(demonstration(), demonstration(0.05, 50, (15, 40)) if seed % 2 else None, SLOPE, rng)
    assert e.state.dtype == e.action.dtype == np.float32
    assert ((e.state >= STATE_LOW) & (e.state <= STATE_HIGH)).all()
    assert ((e.action >= ACTION_LOW) & (e.action <= ACTION_HIGH)).all()
    assert len(e.state) == len(e.action) == len(e.images)
    # Contact pixels follow from the area, pressure and its command keep together.
    np.testing.assert_allclose(e.state[:, PIXELS], np.log1p(e.state[:, AREA] * N_PIXELS), rtol=1e-4)
    np.testing.assert_allclose(e.state[:, PRESSURE], e.action[:, 3], rtol=1e-5)
    # The commanded velocity leads where the flange goes: integrated, it ends where the path ends.
    travelled = np.cumsum(e.action[:-1, :3], 0) / FPS
    path = e.state[1:, EE] - e.state[0, EE]
    np.testing.assert_allclose(travelled, path, atol=0.0015)
    # And joint 2 goes with it, in angle and in rate.
    turned = np.cumsum(e.state[:-1, 8]) / FPS
    np.testing.assert_allclose(turned, e.state[1:, 1] - e.state[0, 1], atol=0.003)


def test_appearance_changes_contact_and_brightness_but_not_the_order(source):
    e = demonstration()
    v = naive._change_appearance(e.images, np.random.default_rng(3)).astype(float)
    rest, contact = v[0, 0, 0], v[25, 150, 120]
    assert (np.abs(rest - 100) > 0).any()
    assert (np.abs(rest - 100) < 10).all()
    ratio = (contact - rest) / 40
    assert ((ratio > 0.75) & (ratio < 1.3)).all()
