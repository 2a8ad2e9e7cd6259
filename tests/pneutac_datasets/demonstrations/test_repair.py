"""Datasets whose recording was killed: `pneutac repair` finds every finished episode."""

import json
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from lerobot.datasets import LeRobotDataset

from pneutac_benchmarks.robustness.killed_recording import kill_recordings
from pneutac_datasets.demonstrations.repair.dataset import repair_dataset
from pneutac_datasets.demonstrations.repair.parquet_footer import mend
from pneutac_datasets.demonstrations.save import quiet_encoders
from pneutac_sim.errors import InputError

FEATURES = {
    "action": {"dtype": "float32", "shape": (4,), "names": list("abcd")},
    "observation.images.tactile": {"dtype": "video", "shape": (64, 64, 3), "names": ["h", "w", "c"]},
}


@pytest.mark.slow
def test_a_few_kills_lose_nothing_and_recording_goes_on(tmp_path):
    assert kill_recordings(tmp_path, kills=2).broken == ()


@pytest.mark.nightly
def test_a_hundred_kills_lose_nothing_and_recording_goes_on(tmp_path):
    assert kill_recordings(tmp_path, kills=100, seed=1).broken == ()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    root = tmp_path_factory.mktemp("whole") / "demo"
    with quiet_encoders():
        dataset = LeRobotDataset.create("local/demo", 15, FEATURES, root=root, video_backend="pyav")
        for episode in range(2):
            for _ in range(5):
                image = np.full((64, 64, 3), 100 * episode, np.uint8)
                action = np.full(4, episode, np.float32)
                dataset.add_frame({"action": action, "observation.images.tactile": image, "task": "press"})
            dataset.save_episode()
        dataset.finalize()
    return root


@pytest.fixture
def torn(whole, tmp_path):
    """The same, killed before its files got their ends."""
    root = tmp_path / "demo"
    shutil.copytree(whole, root)
    for file in root.rglob("file-000.parquet"):
        data = file.read_bytes()
        file.write_bytes(data[: -8 - int.from_bytes(data[-8:-4], "little")])
    return root


def test_what_is_made_anew_is_what_lerobot_wrote(whole, torn):
    repaired = repair_dataset(torn)
    assert (repaired.episodes, repaired.frames, repaired.recovered) == (2, 10, 2)
    old, new = (
        pq.read_table(r / "meta/episodes/chunk-000/file-000.parquet").to_pylist() for r in (whole, torn)
    )
    assert [list(r) for r in old] == [list(r) for r in new]
    for a, b in zip(old, new, strict=True):
        for key in a:
            if key.startswith("stats/observation.images"):  # of videos they are those of decoded frames
                continue
            same = np.allclose(a[key], b[key], atol=1e-6) if key.startswith("stats/") else a[key] == b[key]
            assert same, key
    infos = [json.loads((r / "meta/info.json").read_text()) for r in (whole, torn)]
    assert infos[0] == infos[1]


def test_a_whole_dataset_stays_as_it_is(whole, tmp_path):
    root = tmp_path / "demo"
    shutil.copytree(whole, root)
    before = {f: f.read_bytes() for f in root.rglob("*") if f.is_file() and f.name != "stats.json"}
    assert repair_dataset(root).remarks == ()
    assert {f: f.read_bytes() for f in before} == before


def test_a_torn_info_is_taken_from_a_dataset_of_the_same_robot(whole, torn):
    (torn / "meta/info.json").write_text("{")
    with pytest.raises(InputError, match="is torn; give --like=DATASET"):
        repair_dataset(torn)
    assert repair_dataset(torn, like=whole).episodes == 2


def test_a_video_torn_while_it_was_copied_is_found_where_it_was_made(torn, tmp_path, monkeypatch):
    (video,) = torn.rglob("*.mp4")
    made = tmp_path / "temporary"
    made.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(made))
    (made / "tmpold.mp4").write_bytes(b"another video")
    shutil.copy(video, made / "tmpabc.mp4")
    data = video.read_bytes()
    video.write_bytes(data[: len(data) // 2])
    repaired = repair_dataset(torn)
    assert repaired.episodes == 2 and "was torn" in " ".join(repaired.remarks)
    assert video.read_bytes() == data


def test_an_episode_without_its_video_is_left_out(torn):
    for video in torn.rglob("*.mp4"):
        video.unlink()
    repaired = repair_dataset(torn)
    assert repaired.episodes == 0 and "has no video; it is left out" in " ".join(repaired.remarks)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_a_parquet_file_cut_anywhere_keeps_its_whole_row_groups(tmp_path, share):
    rng = np.random.default_rng(0)
    tables = [
        pa.table(
            {
                "vector": pa.FixedSizeListArray.from_arrays(pa.array(rng.normal(size=60)), 3),
                "image": [{"bytes": rng.bytes(70_000), "path": "x.png"} for _ in range(20)],  # several pages
                "index": np.arange(20),
            }
        )
        for _ in range(3)
    ]
    file, ends = tmp_path / "file.parquet", []
    with pq.ParquetWriter(file, tables[0].schema, use_dictionary=True) as writer:
        for table in tables:
            writer.write_table(table)
            ends.append(file.stat().st_size)
    cut = int(share * ends[-1])
    file.write_bytes(file.read_bytes()[:cut])
    whole_groups = sum(end <= cut for end in ends)
    assert mend(file, tables[0].schema) == whole_groups
    if whole_groups:
        assert pq.read_table(file).equals(pa.concat_tables(tables[:whole_groups]))
