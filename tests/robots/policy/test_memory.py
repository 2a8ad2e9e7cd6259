"""What a policy remembers, and labels without the demonstrator's delay."""

import shutil

import numpy as np
import pytest
import torch
from demonstration_sets import write_episodes
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.policies import make_policy
from lerobot.utils.constants import ACTION, OBS_STATE
from torch.utils.data import default_collate

from lerobot_robot_pneutac.policy import memory
from lerobot_robot_pneutac.policy.configuration_pneutac_bc import (
    ANSWER_DELAY,
    HUBER_DELTA,
    NETWORKS,
    TACTILE,
    PneutacBCConfig,
    ahead,
    frames_ahead,
)
from lerobot_robot_pneutac.policy.modeling_pneutac_bc import PneutacBCPolicy
from pneutac_datasets.demonstrations.augment.run import finish
from pneutac_sim.errors import InputError
from pneutac_sim.features import AREA, EE, PRESSURE, STATE_NAMES

HZ = 15


def states(frames: int, touched: slice, seed: int = 0) -> np.ndarray:
    """A hand that goes along x at 1 mm a frame under rising pressure, in touch for a while."""
    state = np.zeros((frames, len(STATE_NAMES)), np.float32)
    state[:, EE] = np.arange(frames)[:, None] * [1e-3, 0.0, 0.0]
    state[:, PRESSURE] = 0.1 * np.arange(frames)
    state[touched, AREA] = 0.05
    return state


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Two demonstrations of 30 and 20 frames whose actions say where they are."""
    root = tmp_path_factory.mktemp("data") / "demos"
    episodes = []
    for frames, touched in ((30, slice(10, 14)), (20, slice(5, 8))):
        rows = enumerate(states(frames, touched))
        episodes.append([(state, [0.001 * t, 0, 0, 0.1 * t], 100 + t % 3) for t, state in rows])
    return write_episodes(root, episodes, fps=HZ)


def test_it_remembers_where_and_when_it_touched_and_what_it_sensed_before():
    state = torch.from_numpy(states(60, slice(20, 25)))
    found = memory.of_episodes(state, np.zeros(60), 1, HZ)
    assert found.shape == (60, memory.size(1))
    assert not found[:20, :4].any(), "no touch yet"
    assert torch.equal(found[20:25, 0], torch.ones(5)) and not found[20:25, 1:4].any()
    lately = np.exp(-(np.arange(25, 60) - 24) / HZ / memory.FADES_S)
    assert np.allclose(found[25:, 0], lately, rtol=1e-5)
    assert np.allclose(found[25:, 1], lately * (np.arange(25, 60) - 24) * 0.1, rtol=1e-4), "in centimetres"
    for k, frames in enumerate((8, 16)):
        moved, area, pressure = found[:, 4 + 5 * k], found[:, 7 + 5 * k], found[:, 8 + 5 * k]
        ago = np.minimum(np.arange(60), frames)
        assert np.allclose(moved, ago * 0.05, rtol=1e-4) and np.allclose(pressure, -0.1 * ago, atol=1e-5)
        assert torch.equal(area > 0, torch.from_numpy(np.roll(state[:, AREA].numpy() > 0, frames)))


def test_training_and_control_remember_the_same(dataset):
    """In the order of control every frame has what the training's table says, in both episodes."""
    meta = LeRobotDatasetMetadata("local/demos", dataset)
    policy = make_policy(PneutacBCConfig(device="cpu"), meta)
    assert policy.config.memory
    data = LeRobotDataset("local/demos", root=dataset)
    seen = []
    policy._predict = lambda state, difference, previous, recalled: (
        seen.append(recalled) or torch.zeros(len(state), 4)
    )
    for first, end in ((0, 30), (30, 50)):
        policy.reset()
        for k in range(first, end):
            policy.select_action({OBS_STATE: data[k][OBS_STATE][None], TACTILE: data[k][TACTILE][None]})
    assert torch.allclose(torch.cat(seen), policy._memories, atol=1e-6)
    assert policy._memories[:, [0, 1, 4, 7, 8, 9, 12, 13]].any(0).all(), "all but motion aside"


def test_without_touch_the_memory_is_of_motion_alone(dataset):
    meta = LeRobotDatasetMetadata("local/demos", dataset)
    policy = make_policy(PneutacBCConfig(device="cpu", use_tactile=False), meta)
    data = LeRobotDataset("local/demos", root=dataset)
    touched = [data[k][OBS_STATE][None] for k in range(20)]
    free = [s.clone() for s in touched]
    for s in free:
        s[:, [AREA, AREA + 1]] = 0.0
    runs = []
    for run in (touched, free):
        policy.reset()
        runs.append(torch.cat([policy.select_action({OBS_STATE: s}) for s in run]))
    assert torch.equal(*runs)


def test_labels_in_touch_are_those_of_the_answer():
    action = np.arange(12.0)[:, None] * np.ones(4)
    area = np.where(np.isin(np.arange(12), [3, 4, 10]), 0.1, 0.0)
    moved = ahead(action, area, np.repeat([0, 1], [6, 6]), 2)[:, 0]
    # Touch at 3 and 4, two frames after it 5; within the episode nothing is beyond 5. Then touch at 10.
    assert moved.tolist() == [0, 1, 2, 5, 5, 5, 6, 7, 8, 9, 11, 11]
    assert frames_ahead(7, HZ) == 3 and frames_ahead(1, HZ) == 1


def test_a_dataset_names_its_delay_and_the_loss_counts_from_moved_labels(dataset, tmp_path):
    shutil.copytree(dataset, tmp_path / "late")
    finish(tmp_path / "late", [], answer_delay=2)
    meta = LeRobotDatasetMetadata("local/demos", tmp_path / "late")
    assert meta.features[ACTION]["info"][ANSWER_DELAY] == 2
    policy = make_policy(PneutacBCConfig(device="cpu"), meta).eval()
    known = policy.config
    assert (known.answer_delay, known.huber_delta, known.networks) == (2, HUBER_DELTA, NETWORKS)
    assert make_policy(PneutacBCConfig(device="cpu", networks=1), meta).config.networks == 1
    plain = make_policy(PneutacBCConfig(device="cpu"), LeRobotDatasetMetadata("local/demos", dataset)).config
    assert (plain.huber_delta, plain.networks) == (0, 1)
    data = LeRobotDataset("local/demos", root=tmp_path / "late", delta_timestamps={ACTION: [-1 / HZ, 0.0]})
    given = []
    policy.loss = lambda state, previous, hidden, target, *rest: given.append((previous, target))
    policy.forward(default_collate([data[k] for k in (0, 9, 10, 15, 16, 30)]))
    previous, target = given[0]
    assert (1e3 * target[:, 0]).round().tolist() == [0, 9, 12, 17, 16, 0]
    assert (1e3 * previous[1:5, 0]).round().tolist() == [8, 9, 16, 17]


def test_weights_without_memory_still_load_and_others_are_named(dataset, tmp_path):
    meta = LeRobotDatasetMetadata("local/demos", dataset)
    old = make_policy(PneutacBCConfig(device="cpu", memory=False), meta)
    old.save_pretrained(tmp_path / "old")
    text = (tmp_path / "old" / "config.json").read_text()
    assert '"memory": false,' in text
    (tmp_path / "old" / "config.json").write_text(text.replace('"memory": false,', ""))
    assert not PneutacBCPolicy.from_pretrained(tmp_path / "old").config.memory
    with pytest.raises(InputError, match="give --policy.memory=false, or train again"):
        make_policy(PneutacBCConfig(device="cpu", pretrained_path=tmp_path / "old"), meta)
    old.config.memory = True
    with pytest.raises(InputError, match="needs the dataset that it is trained on"):
        PneutacBCPolicy(old.config).forward({})
