"""Datasets of small images: they say to `pneutac_bc` what the whole ones say."""

import numpy as np
import pytest
import torch
from demonstration_sets import features_of, write_episodes
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.utils.constants import ACTION, OBS_STATE
from lerobot.utils.feature_utils import dataset_to_policy_features
from torch.utils.data import default_collate

from lerobot_robot_pneutac.lerobot_inside import RunningQuantileStats
from lerobot_robot_pneutac.policy.configuration_pneutac_bc import PREVIOUS_ACTION, TACTILE, PneutacBCConfig
from lerobot_robot_pneutac.policy.modeling_pneutac_bc import PneutacBCPolicy
from lerobot_robot_pneutac.policy.tactile_encoder import DIFFERENCE_SCALE
from lerobot_robot_pneutac.standin.world import new_gel
from pneutac_datasets.demonstrations.episodes import Episode, save_episode
from pneutac_datasets.demonstrations.pool import main, pool_demonstrations
from pneutac_datasets.demonstrations.save import (
    EncodedVideos,
    PixelStatistics,
    create_dataset,
    decode,
    encode,
    written,
)
from pneutac_sim.errors import InputError
from pneutac_sim.features import ACTION_NAMES, IMAGE_SHAPE, STATE_NAMES
from pneutac_sim.world.station import Station
from pneutac_sim.world.world import World

FRAMES = 4


def write(root, seed, fps=15, shape=IMAGE_SHAPE):
    """Two demonstrations of random states and random images."""
    rng = np.random.default_rng(seed)

    def frame():
        image = rng.integers(40, 200, shape, dtype=np.uint8)
        return *(rng.normal(size=n) for n in (len(STATE_NAMES), len(ACTION_NAMES))), image

    return write_episodes(root, [[frame() for _ in range(FRAMES)] for _ in range(2)], fps=fps, shape=shape)


@pytest.fixture(
    scope="module", params=[IMAGE_SHAPE, (120, 160, 3), (170, 123, 3)], ids=["digit", "lying", "odd"]
)
def pooled(tmp_path_factory, request):
    folder = tmp_path_factory.mktemp("pool")
    sources = [write(folder / name, seed, shape=request.param) for name, seed in (("a", 1), ("b", 2))]
    return sources, pool_demonstrations(sources, folder / "small", "local/small")


def test_states_actions_and_means_are_those_of_the_sources_in_order(pooled):
    sources, out = pooled
    small = LeRobotDataset("local/small", root=out)
    whole = [f for s in sources for f in LeRobotDataset(f"local/{s.name}", root=s)]
    assert sorted(small[0][TACTILE].shape) == [3, 60, 80]
    assert small.num_episodes == 4 and len(small) == len(whole)
    for a, b in zip(small, whole, strict=True):
        assert torch.equal(a[OBS_STATE], b[OBS_STATE]) and torch.equal(a[ACTION], b[ACTION])
        means = torch.nn.functional.adaptive_avg_pool2d(b[TACTILE], a[TACTILE].shape[1:])
        assert (a[TACTILE] - means).abs().max() < 0.51 / 255  # rounded to 8 bit, no more


def policy_for(out, **options) -> PneutacBCPolicy:
    """An untrained policy of a dataset of small images."""
    meta = LeRobotDatasetMetadata(f"local/{out.name}", out)
    features = dataset_to_policy_features(meta.features)
    options["input_features"] = {k: f for k, f in features.items() if k.startswith("observation")}
    torch.manual_seed(0)
    config = PneutacBCConfig(device="cpu", output_features={ACTION: features[ACTION]}, **options)
    return PneutacBCPolicy(config, dataset_meta=meta).eval()


def test_one_row_a_sample_says_what_three_do(pooled):
    sources, out = pooled
    losses = {}
    for whole in (False, True):
        policy, times = policy_for(out, previous_action_in_data=whole), None if whole else [-1 / 15, 0.0]
        assert policy.config.action_delta_indices == (None if whole else [-1, 0])
        assert policy.config.image_shape == tuple(
            LeRobotDataset("local/a", root=sources[0])[0][TACTILE].shape
        )
        assert "observation.previous_action" not in policy.config.input_features
        data = LeRobotDataset("local/small", root=out, delta_timestamps=times and {ACTION: times})
        losses[whole] = policy(default_collate([data[i] for i in range(len(data))]))[0].item()
    assert losses[True] == pytest.approx(losses[False], rel=1e-5)


def test_a_start_in_mid_episode_has_no_previous_action_of_another(tmp_path):
    """Data and policy take the same: no velocity, and the pressure that there is."""
    out = pool_demonstrations([write(tmp_path / "a", 1)], tmp_path / "small", "local/small")
    small = LeRobotDataset("local/small", root=out)
    first = small[FRAMES]  # of the second demonstration, whose arm moves and whose finger is under pressure
    pressure = first[OBS_STATE][STATE_NAMES.index("pressure.pos")]
    hold = torch.tensor([0.0, 0.0, 0.0, pressure])
    assert torch.equal(first[PREVIOUS_ACTION], hold)
    policy = policy_for(out)
    image = torch.nn.functional.interpolate(first[TACTILE][None], IMAGE_SHAPE[:2])
    seen = {OBS_STATE: first[OBS_STATE][None], TACTILE: image}
    policy.reset()
    begun = policy.predict_action_chunk(seen)
    policy._previous = hold[None]
    torch.testing.assert_close(policy.predict_action_chunk(seen), begun)
    policy._previous = hold[None] + 0.1
    assert (policy.predict_action_chunk(seen) - begun).abs().max() > 0


def test_a_policy_on_the_twin_has_the_twins_own_image_at_rest(tmp_path):
    """Of demonstrations made on the twin it sees nothing there before a touch; of the stand-in's it does."""
    world = World("switch", touch="image", fidelity="probe")
    at_rest = torch.from_numpy(world.reset(4).tactile.copy()).permute(2, 0, 1)[None] / 255
    shown = {}
    for name, image in (("twin", world.sensor.rest_image), ("standin", new_gel().rest_image)):
        write_episodes(tmp_path / name, [[(1, 1, image)] * 2])
        out = pool_demonstrations([tmp_path / name], tmp_path / f"{name}_small", f"local/{name}_small")
        difference = policy_for(out).encoder.difference(at_rest)
        shown[name] = float((255 * DIFFERENCE_SCALE * difference).abs().mean())
    assert shown["twin"] < 0.5 and shown["standin"] > 3.0, shown  # levels


def test_a_stop_leaves_nothing_half_written(tmp_path, monkeypatch):
    sources = [write_episodes(tmp_path / "a", [[(1, 1, 90)] * 2])]

    def stop(_):
        raise KeyboardInterrupt

    monkeypatch.setattr("pneutac_datasets.demonstrations.pool.previous_actions", stop)
    with pytest.raises(KeyboardInterrupt):
        pool_demonstrations(sources, tmp_path / "small", "local/small")
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


def test_the_station_goes_along_and_must_be_one(tmp_path):
    sources = [write(tmp_path / name, 1) for name in "ab"]
    Station(mount_mm=50).save(sources[0] / "meta")
    with pytest.raises(InputError, match="/b' has another meta/station.yaml than '.*/a', or one"):
        pool_demonstrations(sources, tmp_path / "small", "local/small")
    Station(mount_mm=50).save(sources[1] / "meta")
    out = pool_demonstrations(sources, tmp_path / "small", "local/small")
    assert Station.load(out / "meta" / "station.yaml") == Station(mount_mm=50)


def test_bad_input_is_named(pooled, tmp_path):
    sources, _ = pooled
    with pytest.raises(InputError, match="holds no LeRobotDataset"):
        pool_demonstrations([tmp_path / "none"], tmp_path / "x", "local/x")
    with pytest.raises(InputError, match="frames per second"):
        pool_demonstrations([sources[0], write(tmp_path / "slow", 3, fps=10)], tmp_path / "y", "local/y")
    smaller = write(tmp_path / "smaller", 3, shape=(90, 70, 3))
    with pytest.raises(InputError, match="give datasets of one sensor, arm"):
        pool_demonstrations([sources[0], smaller], tmp_path / "z", "local/z")
    small = write(tmp_path / "small", 3, shape=(80, 60, 3))
    with pytest.raises(InputError, match="already"):
        pool_demonstrations([small], tmp_path / "z", "local/z")
    with pytest.raises(SystemExit, match="exists"):
        main(["--out", str(sources[1]), str(sources[0])])


def test_videos_encoded_before_are_those_that_lerobot_encodes_while_it_writes(tmp_path):
    rng, roots, column = np.random.default_rng(1), [tmp_path / "one", tmp_path / "other"], (6, *IMAGE_SHAPE)
    states, actions = rng.normal(size=(6, len(STATE_NAMES))), rng.normal(size=(6, len(ACTION_NAMES)))
    images = [rng.integers(40 * k, 40 * k + 90, column, dtype=np.uint8) for k in range(3)]
    for root in roots:
        dataset = create_dataset("local/x", root, 15, features_of(video=True), "pneutac", True, 6, 1)
        videos = EncodedVideos(dataset) if root == roots[1] else None
        with written(dataset):
            for shown in images:
                if videos:
                    videos.films, shown = encode({TACTILE: shown}, 15), np.broadcast_to(np.uint8(0), column)
                row = (x.astype(np.float32) for x in (states, actions))
                save_episode(dataset, Episode(*row, shown, "press", 15))
    one, other = (LeRobotDataset("local/x", root, video_backend="pyav") for root in roots)
    assert one.meta.info == other.meta.info and len(one) == len(other) == 18
    assert [p.name for p in roots[1].rglob("*.mp4")] == [p.name for p in roots[0].rglob("*.mp4")]
    for a, b in zip(one, other, strict=True):
        assert all(torch.equal(a[key], b[key]) for key in (OBS_STATE, ACTION, TACTILE, "timestamp"))
    for name, values in one.meta.stats[TACTILE].items():
        np.testing.assert_array_equal(other.meta.stats[TACTILE][name], values)
    assert np.abs(decode(videos.films[TACTILE]).astype(int) - images[-1]).mean() < 30


def test_statistics_of_pixels_are_those_of_lerobot():
    """Counted by levels they are exact; LeRobot's quantiles lie in bins of a twentieth of a level."""
    ours, theirs = PixelStatistics(), RunningQuantileStats()
    for frame in np.random.default_rng(0).normal(90, (20, 40, 5), (30, 400, 3)).clip(0, 255).astype(np.uint8):
        ours.update(frame)
        theirs.update(frame)
    one, other = ours.get_statistics(), theirs.get_statistics()
    assert one.keys() == other.keys() and one["count"] == other["count"]
    for key in one:
        np.testing.assert_allclose(one[key], other[key], atol=0.06, err_msg=key)
