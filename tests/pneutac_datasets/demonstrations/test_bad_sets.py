"""LeRobotDatasets with damage, of other versions or with wrong numbers: `check` says what verbs refuse."""

import codecs
import json
import re
import shutil
import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import httpx
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from augmenting import config_of
from demonstration_sets import write_demonstrations
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.datasets.aggregate import aggregate_datasets

from lerobot_pneutac.verbs.augment import AugmentConfig, DatasetRef, augment
from lerobot_pneutac.verbs.check import check_path
from lerobot_robot_pneutac.lerobot_inside import prepare
from lerobot_robot_pneutac.policy.tactile_encoder import other_sensor
from lerobot_robot_pneutac.standin.world import new_gel
from pneutac_datasets.demonstrations.augment import run
from pneutac_datasets.demonstrations.augment.reference import read_references
from pneutac_datasets.demonstrations.faults import TACTILE, Recorded
from pneutac_datasets.demonstrations.naive import augment_naive
from pneutac_datasets.demonstrations.reading import load_demonstrations, task_to_do
from pneutac_datasets.demonstrations.repair import repair_dataset
from pneutac_sim.dataset_files import ACTION, STATE, Files
from pneutac_sim.errors import InputError
from pneutac_sim.features import STATE_NAMES
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.pace import DONE, OUTCOME_FILE, PACE_FILE, Pace

DEMOS = Path(__file__).parents[2] / "golden" / "recordings" / "demos"
DATA, EPISODES = "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet"
VIDEO = f"videos/{TACTILE}/chunk-000/file-000.mp4"
PRESSURE = STATE_NAMES.index("pressure.pos")
EE = slice(STATE_NAMES.index("ee_x.pos"), STATE_NAMES.index("ee_x.pos") + 3)


def info(**changes):
    """Changes `info.json`; a value of None takes a field away."""

    def damage(root):
        file = root / "meta/info.json"
        content = json.loads(file.read_text()) | changes
        file.write_text(json.dumps({k: v for k, v in content.items() if v is not None}))

    return damage


def feature(key, **changes):
    """Changes a feature of `info.json`, or takes it away."""

    def damage(root):
        features = json.loads((root / "meta/info.json").read_text())["features"]
        there = features.pop(key)
        info(features=features | ({key: there | changes} if changes else {}))(root)

    return damage


def without(name):
    def damage(root):
        (shutil.rmtree if (root / name).is_dir() else Path.unlink)(root / name)

    return damage


def half(name):
    def damage(root):
        (root / name).write_bytes((root / name).read_bytes()[: (root / name).stat().st_size // 2])

    return damage


def pointer(name):
    def damage(root):
        (root / name).write_text(
            f"version https://git-lfs.github.com/spec/v1\noid sha256:{64 * '0'}\nsize 9\n"
        )

    return damage


def text(name, content):
    return lambda root: (root / name).write_text(content)


def rows(change, name=DATA):
    """Changes a table of the dataset, as pandas has it."""

    def damage(root):
        schema = pq.read_schema(root / name)
        table = change(pq.read_table(root / name).to_pandas())
        fits = list(table.columns) == schema.names
        new = pa.Table.from_pandas(table, schema if fits else None, preserve_index=False)
        pq.write_table(new, root / name)

    return damage


def numbers(key, change):
    """Changes one column of vectors, (n, k)."""

    def changed(table):
        return table.assign(**{key: list(change(np.stack(table[key]).astype(np.float64)).astype(np.float32))})

    return rows(changed)


def times(factor, columns):
    return lambda x: np.hstack([x[:, c : c + 1] * (factor if c in columns else 1) for c in range(x.shape[1])])


def shifted(by, columns):
    return lambda x: x + by * np.isin(np.arange(x.shape[1]), columns)


def column(name, change, file=EPISODES):
    return rows(lambda table: table.assign(**{name: change(table[name])}), file)


def other_tasks(root):
    file = root / "meta/tasks.parquet"
    table = pd.read_parquet(file)
    table.assign(task_index=table["task_index"] + 3).to_parquet(file)


def narrow(root):
    table = pq.read_table(root / DATA)
    vectors = pa.array([a[:3] for a in table[ACTION].to_pylist()], pa.list_(pa.float32()))
    pq.write_table(table.set_column(table.schema.names.index(ACTION), ACTION, vectors), root / DATA)


def marked(root):
    file = root / "meta/info.json"
    file.write_bytes(codecs.BOM_UTF8 + file.read_bytes())


def nothing(root):
    info(total_episodes=0, total_frames=0)(root)
    for folder in ("data", "meta/episodes", "videos"):
        shutil.rmtree(root / folder)


def statistic(name, value):
    """Changes a statistic of the action."""
    return statistics(lambda s: s[ACTION].update({name: [value] * len(s[ACTION][name])}))


def statistics(change):
    def damage(root):
        file = root / "meta/stats.json"
        stats = json.loads(file.read_text())
        change(stats)
        file.write_text(json.dumps(stats))

    return damage


SHORT = "breaks off: it holds"
FROM = f"videos/{TACTILE}/from_timestamp"
BAD = {
    "v2.1": (info(codebase_version="v2.1"), "convert_dataset_v21_to_v30 --repo-id=local/demos"),
    "v4.0": (info(codebase_version="v4.0"), "recorded with a newer LeRobot"),
    "info is a pointer": (pointer("meta/info.json"), "info.json is a Git LFS pointer"),
    "info is cut": (half("meta/info.json"), "is not valid JSON"),
    "features are a list": (info(features=[]), "'features' must be an object"),
    "no dtype": (feature(ACTION, dtype=None), "'action' lacks 'dtype' or 'shape'"),
    "no fps": (info(fps=None), "'fps' is None"),
    "fps 30": (info(fps=30), "30 fps, but the station's|timestamp"),
    "a video path that leads out": (info(video_path="../{video_key}.mp4"), "'video_path' is"),
    "whole numbers": (feature(STATE, dtype="int64"), "'dtype' of 'observation.state' is 'int64'"),
    "a byte order mark": (marked, "info.json begins with a byte order mark"),
    "5 episodes": (info(total_episodes=5), "2 episodes and info.json counts 5"),
    "99 frames": (info(total_frames=99), "110 rows and info.json counts 99"),
    "count is a text": (info(total_episodes="two"), "must be a whole number"),
    "names null": (feature(STATE, names=None), "'observation.state' has the names None; write one list"),
    "channels first": (feature(TACTILE, shape=[3, 320, 240]), r"channels first; write \[320, 240, 3\]"),
    "other image size": (feature(TACTILE, shape=[480, 640, 3]), "those of the twin's sensor"),
    "no touch": (feature(TACTILE), f"feature '{TACTILE}' is missing"),
    "a name less": (feature(STATE, names=STATE_NAMES[:-1]), "'observation.state' lacks 'pressure.pos'"),
    "shape of 19": (feature(STATE, shape=[19]), "20 names and the shape .19.; it must be .20."),
    "no tasks": (without("meta/tasks.parquet"), "tasks.parquet is missing"),
    "tasks of other numbers": (other_tasks, "has the task number 0"),
    "no episodes": (without("meta/episodes"), "episodes holds no .parquet file"),
    "episodes cut": (half(EPISODES), "is cut short or damaged"),
    "an episode less": (rows(lambda t: t.iloc[:1], EPISODES), "1 episodes and info.json counts 2"),
    "lengths": (column("length", lambda x: x - 1), "rows of episode 0 and meta/episodes counts"),
    "from index": (column("dataset_from_index", lambda x: x + 1), "places episode 0 in the rows 1"),
    "no place of the video": (rows(lambda t: t.drop(columns=FROM), EPISODES), "lacks the column 'videos/"),
    "from_timestamp": (column(FROM, lambda x: x + 0.0003), r"has no frame at .*\(from_timestamp\)"),
    "from_timestamp a frame later": (column(FROM, lambda x: x + 1 / 15), SHORT),
    "no stats": (without("meta/stats.json"), "stats.json is missing; run `pneutac repair"),
    "stats cut": (half("meta/stats.json"), "is not valid JSON"),
    "stats of nothing": (text("meta/stats.json", "{}"), "'observation.state' lacks 'min'"),
    "stats without images": (statistics(lambda s: s.pop(TACTILE)), "images.tactile' lacks 'min'"),
    "a mean of nan": (statistic("mean", float("nan")), "'action' has a mean outside"),
    "nothing recorded": (nothing, "demos holds no episode; delete it and record again"),
    "no data": (without("data"), "data holds no .parquet file"),
    "data pointer": (pointer(DATA), "is a Git LFS pointer"),
    "80 of 110 rows": (rows(lambda t: t.iloc[:80]), "rows of episode 1 and meta/episodes counts"),
    "a row in the midst is missing": (rows(lambda t: t.drop(index=20)), "rows of episode 0"),
    "rows shuffled": (rows(lambda t: t.sample(frac=1, random_state=0)), "out of order"),
    "no action": (rows(lambda t: t.drop(columns=ACTION)), "lacks the column 'action'"),
    "timestamps": (column("timestamp", lambda x: x + 0.002, DATA), "has timestamp 0.0020 s"),
    "vectors of 3": (narrow, "does not hold .4. numbers"),
    "no videos": (without("videos"), "mp4 is missing"),
    "video cut": (half(VIDEO), SHORT),
    "video pointer": (pointer(VIDEO), "mp4 is a Git LFS pointer"),
    "joints in degrees": (numbers(STATE, times(57.3, range(14))), "as degrees do; record radians"),
    "velocities reversed": (numbers(ACTION, times(-1, [0])), "'dx.vel' .* moves against the command"),
    "places in mm": (numbers(STATE, times(1000, range(EE.start, EE.stop))), "do not fit"),
}  # fmt: skip


def copied(folder):
    return Path(shutil.copytree(DEMOS, folder / "demos"))


@pytest.mark.parametrize("bad", BAD)
def test_check_says_what_the_verbs_refuse(tmp_path, bad):
    damage, said = BAD[bad]
    root = copied(tmp_path)
    damage(root)
    try:
        faults = check_path(root).faults
    except InputError as e:
        faults = [str(e)]
    assert re.search(said, " ".join(faults), re.DOTALL), faults
    refused = []
    for read in (
        lambda: load_demonstrations(root, task="switch"),
        lambda: read_references(Recorded(root), "local/demos"),
        lambda: augment_naive(Recorded(root), config_of(root, tmp_path / "new", method="naive", episodes=1)),
    ):
        try:
            read()
        except InputError as e:  # any other exception fails the test
            refused.append(str(e))
    assert refused
    assert not any("cannot be read by LeRobot" in sentence for sentence in refused)


def spoilt(value):
    def change(action):
        return np.where(np.arange(len(action))[:, None] == 70, value, action)

    return change


@pytest.mark.parametrize("bad", [*BAD, "nan", "infinity"])
def test_lerobots_commands_refuse_before_their_work_what_check_calls_damaged(tmp_path, monkeypatch, bad):
    """Of any policy; what is whole but no demonstration is for the policy to refuse."""
    root = copied(tmp_path)
    numbers(ACTION, spoilt(float(bad)))(root) if bad not in BAD else BAD[bad][0](root)
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)
    try:
        said = (*Files(root).damage, "")[0] if bad in BAD else "Episode 1 holds numbers that are not finite"
    except InputError as e:
        said = str(e)
    for command, refused in (("train", said), ("replay", said), ("record", said if bad in BAD else "")):
        argv = f"lerobot-{command} --dataset.repo_id=local/demos --dataset.root={root} --resume=true"
        monkeypatch.setattr(sys, "argv", argv.split())
        if refused:
            with pytest.raises(SystemExit, match=f"^error: .*{re.escape(refused)}"):
                prepare()
        else:
            prepare()


REPAIRED = dict.fromkeys(("5 episodes", "episodes cut", "no stats", "stats without images"), "")
REPAIRED |= {"from_timestamp": "did not fit the videos"}


@pytest.mark.parametrize("bad", REPAIRED)
def test_repair_mends_what_check_sends_to_it(tmp_path, bad):
    root = copied(tmp_path)
    BAD[bad][0](root)
    assert "pneutac repair --dataset=" in " ".join(check_path(root).faults)
    repaired = repair_dataset(root)
    assert repaired.frames == 110 and REPAIRED[bad] in " ".join(repaired.remarks)
    assert check_path(root).faults == []


def test_images_in_parquet_are_opened(tmp_path):
    root = write_demonstrations(tmp_path / "demos")
    assert check_path(root).faults == []
    name = next(str(f.relative_to(root)) for f in (root / "data").rglob("*.parquet"))

    def emptied(table):
        table[TACTILE] = [{"bytes": b"\x89PNG", "path": "x.png"} for _ in range(len(table))]
        return table

    rows(emptied, name)(root)
    (fault,) = check_path(root).faults
    assert "cannot be read as an image" in fault and "row 0" in fault


def notes_of(root, damage):
    damage(root)
    found = check_path(root)
    assert found.faults == []
    short = "fewer than 100 frames"  # both of the golden demonstrations are
    return " ".join(n for n in found.notes if short not in n)


def achieved(hz):
    return lambda root: (root / "meta" / PACE_FILE).write_text(json.dumps({"0": vars(Pace(hz, 0, 0.1))}))


def jumps(state):
    return state + 0.05 * np.outer(np.arange(len(state)) > 30, np.arange(20) == EE.start)


POOR = {
    "other joints": (numbers(STATE, shifted(np.radians(10.0), [1])), "angles put the flange of 'panda'"),
    "another rate": (numbers(ACTION, times(2.0, range(3))), "moves 0.5 times .* Was the loop faster"),
    "slightly slow": (achieved(14.8), "^$"),
    "slow": (achieved(13.0), "fell short of 15 Hz"),
    "slightly quick": (achieved(15.2), "^$"),
    "quick": (achieved(28.5), "ran faster than 15 Hz"),
    "another robot": (info(robot_type="so101_follower"), "robot_type is 'so101_follower'; compare"),
    "no gauge": (numbers(STATE, times(0, [PRESSURE])), "pressure.pos stays at 0 kPa"),
    "lost frames": (numbers(STATE, jumps), "the flange jumps by 5"),
}  # fmt: skip


@pytest.mark.parametrize("poor", POOR)
def test_what_is_poor_is_noted_and_what_is_no_measurement_is_refused_as_one(tmp_path, poor):
    damage, said = POOR[poor]
    root = copied(tmp_path)
    assert re.search(said, notes_of(root, damage))
    if poor in ("another robot", "no gauge", "lost frames"):
        with pytest.raises(InputError, match=said.split(";")[0]):
            load_demonstrations(root, task="switch")
    else:
        noted = load_demonstrations(root, task="switch").warnings
        assert said == "^$" or any(re.search(said, note) for note in noted)


def test_episodes_by_pandas_are_read_too(tmp_path):
    """A table that pandas wrote anew, in one row group, is a whole one."""
    root = copied(tmp_path)
    pd.read_parquet(root / EPISODES).to_parquet(root / EPISODES)
    assert check_path(root).faults == []


def some_failed(folder, areas, outcomes):
    """Demonstrations whose touch begins in their third frame, or never; and how they ended."""
    root = write_demonstrations(folder, (12.0,) * len(areas), areas)
    begun, others = np.arange(5 * len(areas)) % 5 > 1, np.arange(20) != STATE_NAMES.index("contact_area.pos")
    numbers(STATE, lambda s: s * (begun[:, None] | others))(root)
    (root / "meta" / OUTCOME_FILE).write_text(json.dumps(outcomes))
    return root


def naive(root, out):
    given, new = DatasetRef("local/demos", root), DatasetRef("local/new", out)
    notes = []
    made = augment(AugmentConfig(given, new, "switch", "naive", episodes=4), note=notes.append)
    return made, notes


def test_failed_demonstrations_are_named_and_set_aside(tmp_path):
    outcomes = {"0": DONE, "2": "the object was pressed with 1.4 N", "3": DONE}
    root = some_failed(tmp_path / "demos", (0.1, 0.0, 0.1, 0.1), outcomes)
    sentence = (
        f"{root}: set aside episode 1 (never touches anything (contact_area.pos is 0 throughout)), episode 2"
        " (the object was pressed with 1.4 N); the other 2 are used."
    )
    found = check_path(root)
    assert found.faults == [] and sentence in found.notes
    made, notes = naive(root, tmp_path / "new")
    assert notes == [sentence] and list(made.failed) == [1, 2]
    assert {line["source_episode"] for line in made.summary["provenance"]} == {0, 3}
    assert made.summary["kept"] == 4


@pytest.mark.parametrize(
    ("areas", "outcomes", "said"),
    [
        ((0.1, 0.0), {}, "has 1 demonstration besides episode 1 .never touches anything"),
        ((0.0, 0.0, 0.0), {}, "has no demonstrations besides episodes 0, 1, 2 .never touches"),
        (
            (0.1, 0.1),
            {"0": "late", "1": "late"},
            "no demonstrations besides episodes 0, 1 .late.; augment needs",
        ),
        ((0.1,), {}, "has 1 demonstration; augment needs two or more: record more with lerobot-record"),
    ],
)
def test_too_few_that_did_not_fail_are_one_error(tmp_path, areas, outcomes, said):
    root = some_failed(tmp_path / "demos", areas, outcomes)
    (fault,) = check_path(root).faults
    assert re.search(said, fault)
    with pytest.raises(InputError, match=said):
        naive(root, tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_training_that_goes_on_is_refused_by_the_dataset_of_its_file(tmp_path, monkeypatch):
    """Its command line names none; LeRobot would fail somewhere in the loading, or train."""
    root, checkpoint = copied(tmp_path), tmp_path / "pretrained_model"
    checkpoint.mkdir()
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)
    monkeypatch.setattr("lerobot_robot_pneutac.lerobot_inside.check_policy", lambda _: None)

    def resumed(path, match=None):
        monkeypatch.setattr(sys, "argv", ["lerobot-train", f"--config_path={path}", "--resume=true"])
        with pytest.raises(SystemExit, match=match) if match else nullcontext():
            prepare()

    file = checkpoint / "train_config.json"
    for path in (file, checkpoint):
        resumed(path, "pretrained_model.* holds no train_config.json; give that of a checkpoint, as in")
    file.write_text(json.dumps({"dataset": {"repo_id": "local/demos", "root": str(root), "episodes": None}}))
    resumed(file)
    (root / DATA).unlink()
    for path in (file, checkpoint):
        resumed(path, f"^error: {root}/data holds no .parquet file")
    shutil.rmtree(root)
    monkeypatch.setattr("lerobot_robot_pneutac.lerobot_inside.HF_HUB_OFFLINE", True)
    resumed(file, f"--dataset.root: '{root}' holds no LeRobotDataset")


@pytest.mark.parametrize(
    "chosen, named",
    [
        ("", '1 (slipped), 2 (missed); leave them out by --dataset.episodes="[0,3]"'),
        ("[0, 2]", '2 (missed); leave them out by --dataset.episodes="[0]"'),
        ("[0]", ""),
    ],
)
def test_training_names_the_demonstrations_that_failed(tmp_path, monkeypatch, caplog, chosen, named):
    outcomes = {"0": DONE, "1": "slipped", "2": "missed"}
    root = some_failed(tmp_path / "demos", (0.1, 0.1, 0.1, 0.1), outcomes)
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)
    argv = ["lerobot-train", f"--dataset.root={root}", *([f"--dataset.episodes={chosen}"] if chosen else [])]
    monkeypatch.setattr(sys, "argv", argv)
    prepare()
    said = [r.getMessage() for r in caplog.records if "are trained on" in r.getMessage()]
    assert len(said) == bool(named) and all(f"episode{'s' * (not chosen)} {named}." in each for each in said)


def test_outcomes_of_episodes_that_are_not_there_are_refused(tmp_path):
    """A user who counts from 1 would have a failed demonstration used."""
    root = some_failed(tmp_path / "demos", (0.1, 0.1, 0.1), {"3": "slipped"})
    said = "outcomes.json names episode 3, and the dataset has the episodes 0 to 2; correct the numbers"
    for refuses in (lambda: check_path(root), lambda: naive(root, tmp_path / "new")):
        with pytest.raises(InputError, match=said):
            refuses()
    assert not (tmp_path / "new").exists()


def test_damaged_outcomes_are_one_error(tmp_path):
    root = some_failed(tmp_path / "demos", (0.1, 0.1), [1])
    with pytest.raises(InputError, match="outcomes.json is damaged"):
        check_path(root)
    (root / "meta" / OUTCOME_FILE).unlink()
    (root / "meta" / OUTCOME_FILE).mkdir()
    with pytest.raises(InputError, match="outcomes.json is damaged .*cannot be read"):
        check_path(root)


def test_a_folder_for_a_station_and_a_disk_too_small_are_refused(tmp_path, monkeypatch):
    root, output = copied(tmp_path), DatasetRef("local/new", tmp_path / "new")
    how = {"method": "naive", "episodes": 10**8}
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=9e9))
    with pytest.raises(InputError, match="which take about .* GB, and .* has 9 GB free; give at most"):
        augment(AugmentConfig(DatasetRef("local/demos", root), output, **how))
    (root / "meta" / "station.yaml").mkdir()
    with pytest.raises(InputError, match="There is no file '.*station.yaml'"):
        check_path(root)


@pytest.mark.parametrize("used", [[0, 1], [1]])
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_datasets_whose_features_are_described_otherwise_are_mixed_and_merge(used, share, tmp_path):
    """LeRobot's conversion of older datasets adds the rate to every feature that is no video."""
    root = copied(tmp_path)
    content = json.loads((root / "meta/info.json").read_text())
    for each in content["features"].values():
        if each["dtype"] != "video":
            each["fps"] = content["fps"]
    (root / "meta/info.json").write_text(json.dumps(content))
    source = LeRobotDatasetMetadata("local/demos", root)
    shard, part = Path(shutil.copytree(DEMOS, tmp_path / "work" / "set")), tmp_path / "new.part"
    copies = run._merge(shard, part, "local/new", source, used, share)
    assert bool(copies) == (share > 0)
    aggregate_datasets(["local/new", "local/demos"], "local/all", [part, root], tmp_path / "all")
    frames = LeRobotDatasetMetadata("local/all", tmp_path / "all").total_frames
    assert frames == source.total_frames + LeRobotDatasetMetadata("local/new", part).total_frames


def test_failed_demonstrations_are_not_mixed_in(tmp_path):
    """A dataset of 110 frames with half as many recorded ones, all of them of episode 1."""
    source = LeRobotDatasetMetadata("local/demos", copied(tmp_path))
    shard, part = Path(shutil.copytree(DEMOS, tmp_path / "work" / "set")), tmp_path / "new.part"
    lines = run._merge(shard, part, "local/new", source, [1], 0.5)
    length = source.episodes[1]["length"]
    assert {line["source_episode"] for line in lines} == {1} and len(lines) == round(110 / length)
    new, recorded = (LeRobotDataset(f"local/{d.name}", d, video_backend="pyav") for d in (part, source.root))
    assert len(new) == 110 + len(lines) * length
    last = source.episodes[1]["dataset_to_index"] - 1
    assert (new[len(new) - 1][TACTILE] - recorded[last][TACTILE]).abs().max() < 0.1  # encoded once more
    assert sorted(f.name for f in tmp_path.iterdir()) == ["demos", "new.part", "work"]


def test_demonstrations_of_another_task_are_refused():
    here = Path("demos")
    for named in ("flip the switch", "Flip the toggle switch.", "Push the Switch."):
        assert task_to_do("", [named] * 2, here) == "switch"
    for unnamed in ("press", "push the button, not the switch"):
        with pytest.raises(InputError, match="names no task; say with task= which of switch, egg,"):
            task_to_do("", [unnamed], here)
    assert task_to_do("egg", ["do it"], here) == "egg"
    assert task_to_do("mine", ["flip the switch"], here) == "mine"  # of a user's package
    with pytest.raises(InputError, match="names the task 'switch', not --task=egg; give demonstrations"):
        task_to_do("egg", ["flip the switch"], here)
    for given, text in (
        ("button", "flip the switch"),
        ("switch", "Press the call button twice and hold it."),
    ):
        with pytest.raises(InputError, match=f"not --task={given}; give demonstrations of '{given}'"):
            task_to_do(given, [text], here)
    with pytest.raises(InputError, match="of 'switch' .* and 'egg' .*; give a dataset of one task"):
        task_to_do("", ["flip the switch", "Open the egg carton."], here)


def test_demonstrations_of_another_sensor_are_named(tmp_path):
    """Of the same kind but another gel: noted; turned: refused."""
    meta = LeRobotDatasetMetadata("local/demos", DEMOS)
    assert other_sensor(meta, TactileSensor()) == ""
    gel, rest = TactileSensor().model, new_gel().rest_image
    standin, turned = (TactileSensor(replace(gel, rest_image=r)) for r in (rest, rest[::-1].copy()))
    assert "% of the pixels of 'observation.images.tactile' differ" in other_sensor(meta, standin)
    with pytest.raises(InputError, match="not of the twin's kind of sensor, or turned .correlation"):
        other_sensor(meta, turned)


def test_a_hub_out_of_reach_is_one_sentence(monkeypatch):
    def unreachable(*args, **kwargs):
        raise httpx.ConnectError("[Errno -2] Name or service not known")

    monkeypatch.setattr("lerobot.datasets.LeRobotDataset", unreachable)
    with pytest.raises(InputError, match=r"no dataset of that name came from the Hub \(\[Errno -2\] Name or"):
        load_demonstrations("nobody/none")
