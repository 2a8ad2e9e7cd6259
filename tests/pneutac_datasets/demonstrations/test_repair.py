"""Datasets whose recording was killed: `pneutac repair` finds every finished episode."""

import errno
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from lerobot.datasets import LeRobotDataset

from pneutac_benchmarks.robustness.killed_recording import kill_recordings
from pneutac_datasets.demonstrations.parquet_footer import fix_footer
from pneutac_datasets.demonstrations.repair import repair_dataset
from pneutac_datasets.demonstrations.save import quiet_encoders
from pneutac_sim.errors import InputError
from pneutac_sim.files import write_json
from pneutac_sim.pace import DONE, OUTCOME_FILE, PACE_FILE, PROVENANCE, read_outcomes, read_pace

FEATURES = {
    "action": {"dtype": "float32", "shape": (4,), "names": list("abcd")},
    "observation.images.tactile": {"dtype": "video", "shape": (64, 64, 3), "names": ["h", "w", "c"]},
}


@pytest.mark.slow
@pytest.mark.parametrize("kills", [2, pytest.param(100, marks=pytest.mark.nightly)])
def test_kills_lose_nothing_and_recording_goes_on(tmp_path, kills):
    assert kill_recordings(tmp_path, kills=kills, seed=kills // 100).broken == ()


def write(root, episodes, files_mb=None):
    """Episodes of five frames, each in a video of its own where `files_mb` is tiny."""
    with quiet_encoders():
        dataset = LeRobotDataset.create(f"local/{root.name}", 15, FEATURES, root=root, video_backend="pyav")
        dataset.meta.info.video_files_size_in_mb = files_mb or dataset.meta.info.video_files_size_in_mb
        for episode in range(episodes):
            for i in range(5):
                image = np.full((64, 64, 3), 40 * episode + i, np.uint8)
                action = np.full(4, episode, np.float32)
                dataset.add_frame({"action": action, "observation.images.tactile": image, "task": "press"})
            dataset.save_episode()
        dataset.finalize()
    return root


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return write(tmp_path_factory.mktemp("whole") / "demo", 2)


@pytest.fixture
def finished(whole, tmp_path):
    return Path(shutil.copytree(whole, tmp_path / "finished"))


@pytest.fixture
def torn(whole, tmp_path):
    """The same, killed before its files got their ends."""
    root = Path(shutil.copytree(whole, tmp_path / "demo"))
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


def test_a_whole_dataset_stays_as_it_is(finished):
    before = {f: content for f, content in _bytes(finished).items() if f.name != "stats.json"}
    assert repair_dataset(finished).remarks == ()
    assert before.items() <= _bytes(finished).items()


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


def _bytes(root):
    return {f.relative_to(root): f.read_bytes() for f in root.rglob("*") if f.is_file()}


def _cut_in_half(video):
    video.write_bytes(video.read_bytes()[: video.stat().st_size // 2])


def _overwritten(video):
    data = video.read_bytes()
    begin = data.index(b"mdat") + 4
    video.write_bytes(data[:begin] + bytes(len(data) - begin))


def _pointer(file):
    file.write_text(f"version https://git-lfs.github.com/spec/v1\noid sha256:{64 * '0'}\nsize 12\n")


DAMAGE = {
    "none": (lambda video: shutil.rmtree(video.parents[2]), "is missing"),
    "pointer": (_pointer, "is a Git LFS pointer and not the file itself; run `git lfs pull`"),
    "half": (_cut_in_half, "of the 5 frames of episode|cannot be opened"),
    "overwritten": (_overwritten, "cannot be decoded"),
}


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("state", ["torn", "finished"])
def test_missing_videos_are_named_and_nothing_is_changed(damage, state, request):
    root = request.getfixturevalue(state)
    (video,) = root.rglob("*.mp4")
    content = video.read_bytes()
    hurt, reason = DAMAGE[damage]
    hurt(video)
    before = _bytes(root)
    with pytest.raises(InputError, match=f"episode.* are missing: .*({reason})") as refused:
        repair_dataset(root)
    assert "Put the videos back and repeat, or give --drop" in str(refused.value)
    assert _bytes(root) == before
    video.parent.mkdir(parents=True, exist_ok=True)
    video.write_bytes(content)
    repaired = repair_dataset(root)
    assert (repaired.episodes, repaired.frames) == (2, 10)


def test_episodes_without_video_are_dropped_when_asked_and_their_numbers_stored(torn):
    shutil.rmtree(torn / "videos")
    repaired = repair_dataset(torn, drop=True)
    assert repaired.episodes == 0 and "the numbers are in left_out/" in " ".join(repaired.remarks)
    numbers = [pq.read_table(f)["action"].to_pylist() for f in sorted((torn / "left_out").glob("*.parquet"))]
    assert numbers == [[[e] * 4] * 5 for e in (0.0, 1.0)]


@pytest.mark.parametrize("gone", [1, 2])
def test_an_episode_in_the_middle_is_dropped_and_the_others_are_numbered_anew(tmp_path, gone):
    root = write(tmp_path / "three", 3, 1e-6)
    assert len(list(root.rglob("*.mp4"))) == 3
    (root / f"videos/observation.images.tactile/chunk-000/file-00{gone}.mp4").unlink()
    write_json(root / "meta" / OUTCOME_FILE, {"0": DONE, "1": "slipped", "2": "missed", "3": "never written"})
    pace = {"achieved_hz": 15.0, "late_frames": 0, "longest_s": 0.1}
    write_json(root / "meta" / PACE_FILE, {str(e): pace | {"late_frames": e} for e in range(3)})
    made = [json.dumps({"episode": e, "seed": 10 * e}) for e in range(3)]
    (root / "meta" / PROVENANCE).write_text("\n".join(made) + "\n")
    with pytest.raises(InputError, match=f"the videos of episode {gone} .*file-00{gone}.mp4 is missing"):
        repair_dataset(root)
    repaired = repair_dataset(root, drop=True)
    assert (repaired.episodes, repaired.recovered) == (2, 0)
    dataset = LeRobotDataset("local/three", root, video_backend="pyav", return_uint8=True)
    stay = [e for e in range(3) if e != gone]
    assert [int(dataset[i]["action"][0]) for i in range(10)] == [e for e in stay for _ in range(5)]
    assert [int(dataset[i]["index"]) for i in range(10)] == list(range(10))
    assert read_outcomes(root / "meta") == {0: DONE, 1: {1: "missed", 2: "slipped"}[gone]}
    assert [p.late_frames for p in read_pace(root / "meta").values()] == stay
    lines = [json.loads(line) for line in (root / "meta" / PROVENANCE).read_text().splitlines()]
    assert lines == [{"episode": k, "seed": 10 * e} for k, e in enumerate(stay)]
    shown = [float(dataset[i]["observation.images.tactile"].float().mean()) for i in (0, 5)]
    np.testing.assert_allclose(shown, [40 * e for e in stay], atol=3)
    assert pq.read_table(root / f"left_out/episode-00000{gone}.parquet")["action"][0].as_py() == [gone] * 4


@pytest.mark.parametrize("damage", [_cut_in_half, lambda video: video.unlink()])
def test_no_episode_is_shown_another_ones_images_after_a_damaged_file(tmp_path, damage):
    """In a killed recording nothing says how many episodes a damaged file held."""
    root = write(tmp_path / "three", 3, 1e-6)
    shutil.rmtree(root / "meta" / "episodes")
    first = root / "videos/observation.images.tactile/chunk-000/file-000.mp4"
    content = first.read_bytes()
    damage(first)
    with pytest.raises(InputError, match="the videos of episodes 0, 1, 2 .* are missing"):
        repair_dataset(root)
    first.write_bytes(content)
    assert repair_dataset(root).recovered == 3


def test_the_episode_that_was_being_written_is_left_out_with_its_pictures(tmp_path):
    """LeRobot deletes an episode's pictures when its video is made."""
    root = write(tmp_path / "three", 3, 1e-6)
    shutil.rmtree(root / "meta" / "episodes")
    (root / "videos/observation.images.tactile/chunk-000/file-002.mp4").unlink()
    pictures = root / "images/observation.images.tactile/episode-000002"
    pictures.mkdir(parents=True)
    (pictures / "frame-000000.png").write_bytes(b"a picture")
    repaired = repair_dataset(root)
    assert repaired.episodes == 2 and "Episode 2 was being written" in " ".join(repaired.remarks)
    left = {f.name for f in (root / "left_out").iterdir()}
    assert left == {"episode-000002.parquet", "observation.images.tactile-episode-000002"}
    assert not list((root / "images").glob("*/episode-*"))


@pytest.mark.parametrize("number", [errno.EROFS, errno.EACCES])
def test_a_folder_that_cannot_be_written_is_one_sentence(torn, monkeypatch, number):
    def refuse(*args, **options):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("tempfile.TemporaryDirectory", refuse)
    with pytest.raises(InputError, match="cannot be written .*; copy the dataset to where you may write"):
        repair_dataset(torn)


DATA, INFO = "data/chunk-000/file-000.parquet", "meta/info.json"
REFUSED = {
    "numbers are a pointer": (lambda r: _pointer(r / DATA), f"{DATA} is a Git LFS pointer"),
    "info is a pointer": (lambda r: _pointer(r / INFO), f"{INFO} is a Git LFS pointer"),
    "rows are missing": (
        lambda r: pq.write_table(pq.read_table(r / DATA).slice(0, 8), r / DATA),
        "data/ holds 3 of the 5 rows of episode 1; restore data/",
    ),
    "another version": (
        lambda r: (r / INFO).write_text((r / INFO).read_text().replace('"v3.0"', '"v4.0"')),
        "codebase_version is 'v4.0', and v3.0 is read here",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_repaired_is_refused_and_nothing_is_changed(finished, case):
    spoil, said = REFUSED[case]
    spoil(finished)
    before = _bytes(finished)
    with pytest.raises(InputError, match=said):
        repair_dataset(finished)
    assert _bytes(finished) == before


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
    whole_bytes = max(end for end in [4, *ends] if end <= cut)
    assert fix_footer(file, tables[0].schema, tmp_path / "new") == (whole_groups, cut - whole_bytes)
    if whole_groups:
        assert pq.read_table(tmp_path / "new").equals(pa.concat_tables(tables[:whole_groups]))
