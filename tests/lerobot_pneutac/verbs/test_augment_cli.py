import json
import os
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import partialmethod

import numpy as np
import pandas as pd
import pytest
from augmenting import setup_of
from filelock import FileLock
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata, merge_datasets
from lerobot.utils.constants import ACTION, OBS_STATE
from played import played

from lerobot_pneutac.cli import run_verb
from lerobot_pneutac.verbs.augment import Augmentation, AugmentConfig, DatasetRef
from lerobot_robot_pneutac.cameras.simulated import PneutacSceneConfig
from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from lerobot_robot_pneutac.robots.pneutac_sim import PneutacSim
from lerobot_robot_pneutac.teleoperators.base_teleop import PneutacScriptedConfig
from lerobot_robot_pneutac.teleoperators.pneutac_scripted import PneutacScripted
from pneutac_datasets.demonstrations.augment import run, scene
from pneutac_datasets.demonstrations.augment.episode import Attempt, AugmentSetup
from pneutac_datasets.demonstrations.augment.run import Work
from pneutac_datasets.demonstrations.episodes import POINTS, TACTILE
from pneutac_datasets.demonstrations.record import record_episodes
from pneutac_sim import executor
from pneutac_sim.errors import InputError
from pneutac_sim.files import LOCK
from pneutac_sim.world.base import Variation
from pneutac_sim.world.world import World

pytestmark = pytest.mark.slow

FEW = 6
QUICK = ["--planner.samples=4", "--planner.elites=2", "--planner.iterations=1", "--planner.horizon=6"]


@pytest.fixture(scope="module", autouse=True)
def few_scenes():
    """Few scenes are drawn and tried: that objects are found where they stood is the planner's test."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scene, "PARENTS", (2, 1, 1))
        patch.setattr(scene, "CHILDREN", 4)
        patch.setattr(AugmentSetup, "__init__", partialmethod(AugmentSetup.__init__, candidates=FEW))
        yield


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    root = tmp_path_factory.mktemp("augment") / "demos"
    camera = {"front": PneutacSceneConfig(width=64, height=48)}
    robot = PneutacSim(
        PneutacSimConfig(id="t", task="switch", seed=3, fidelity="probe", tactile_points=True, cameras=camera)
    )
    teleop = PneutacScripted(PneutacScriptedConfig(id="t", seed=3, episode_steps=80))
    return record_episodes(robot, teleop, "local/demos", root, 2, "flip the switch", False)


def plain(recorded, out, *more) -> list[str]:
    return [
        "--dataset.repo_id=local/demos",
        f"--dataset.root={recorded}",
        f"--output.repo_id=local/{out.name}",
        f"--output.root={out}",
        *more,
    ]


def options(recorded, out, *more) -> list[str]:
    return plain(recorded, out, "--fidelity=probe", "--workers=1", "--method=planner", *QUICK, *more)


def table(root) -> tuple[np.ndarray, np.ndarray]:
    dataset = LeRobotDataset(f"local/{root.name}", root, video_backend="pyav")
    rows = dataset.hf_dataset.with_format("numpy")
    return np.stack(rows[OBS_STATE][:]), np.stack(rows[ACTION][:])


@contextmanager
def threads(workers):
    """In place of a pool of processes, which would not know of few scenes."""
    with ThreadPoolExecutor(workers) as pool:
        yield pool


@pytest.fixture(scope="module")
def made(recorded, tmp_path_factory):
    """Two demonstrations, one of which is checked, by formulas in place of material points."""
    folder = tmp_path_factory.mktemp("made")
    checks = ["--check_mpm=1", f"--out={folder / 'report'}"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(executor, "process_pool", threads)
        patch.setattr(run, "process_pool", threads)
        patch.setattr(run, "CHECKED_BY", "probe")
        run_verb("augment", options(recorded, folder / "more", "--episodes=2", "--seed=5", *checks))
    return folder


def test_the_task_is_the_one_that_the_instruction_names(recorded, tmp_path, monkeypatch):
    root, instruction = shutil.copytree(recorded, tmp_path / "demos"), "press the button"
    tasks = pd.read_parquet(root / "meta" / "tasks.parquet")
    tasks.rename(index={"flip the switch": instruction}).to_parquet(root / "meta" / "tasks.parquet")
    for file in root.glob("meta/episodes/*/*.parquet"):
        episodes = pd.read_parquet(file)
        episodes["tasks"] = [[instruction]] * len(episodes)
        episodes.to_parquet(file)

    def plan(meta, setup, *more):
        raise InputError(setup.task)

    monkeypatch.setattr(run, "augment_guided", plan)
    with pytest.raises(InputError, match="^button$"):
        run_verb("augment", options(root, tmp_path / "more"))


@pytest.mark.parametrize("method", ["tactile", "naive"])
def test_an_output_that_exists_is_refused_before_anything_is_read(tmp_path, method):
    (tmp_path / "more").mkdir()
    with pytest.raises(InputError, match="more' exists; give a new folder"):
        run_verb("augment", plain(tmp_path / "not there", tmp_path / "more", f"--method={method}"))


def test_output_has_the_sources_features_and_merges(recorded, made, tmp_path):
    old = LeRobotDatasetMetadata("local/demos", recorded)
    new = LeRobotDatasetMetadata("local/more", made / "more")
    assert (new.features, new.fps, new.robot_type) == (old.features, old.fps, old.robot_type)
    assert new.total_episodes == 2
    assert new.stats[OBS_STATE]["mean"].shape == (20,)
    merged = merge_datasets(
        [LeRobotDataset("local/demos", recorded), LeRobotDataset("local/more", made / "more")],
        output_repo_id="local/merged",
        output_dir=tmp_path / "merged",
    )
    assert merged.num_episodes == 4
    frame = merged[merged.num_frames - 1]
    assert frame["task"] == "flip the switch"
    assert frame[TACTILE].shape == (3, 320, 240)


def test_touch_as_data_is_made_where_the_demonstrations_have_it(recorded, made):
    for name, root in (("demos", recorded), ("more", made / "more")):
        rows = LeRobotDataset(f"local/{name}", root, video_backend="pyav").hf_dataset.with_format("numpy")
        points, area = np.stack(rows[POINTS][:]), np.stack(rows[OBS_STATE][:])[:, 17]
        assert points.shape[1:] == (16 * 12 * 6,) and not points[0].any()
        most = points[area.argmax()].reshape(16, 12, 6)
        assert most[..., 2].min() < -0.2 and most[..., 5].sum() < -0.2  # mm, N
    info = LeRobotDatasetMetadata("local/more", made / "more").features[POINTS]["info"]
    assert info["units"] == ["mm", "mm", "mm", "N", "N", "N"] and "image columns" in info["frame"]


def test_scene_cameras_see_what_is_made(recorded, made):
    """The first pictures are alike, the last shows the lever flipped."""
    key = "observation.images.front"
    old, new = (
        LeRobotDataset(f"local/{n}", r, video_backend="pyav")
        for n, r in (("demos", recorded), ("more", made / "more"))
    )
    end = new.meta.episodes[0]["dataset_to_index"] - 1
    start, last, before = (255 * each[key] for each in (new[0], new[end], old[0]))
    assert start.shape == (3, 48, 64)
    assert (start - before).abs().mean() < 8 and ((last - start).abs().amax(0) > 40).float().mean() > 0.005


def test_provenance_and_report_tell_what_was_done(made):
    lines = [json.loads(x) for x in (made / "more" / "meta" / "provenance.jsonl").read_text().splitlines()]
    assert [x["episode"] for x in lines] == [0, 1]
    for x in lines:
        assert x["seed"] == 5
        assert x["source_episode"] in (0, 1)
        assert x["cost"] > 0
        assert x["shift_m"][2] == 0
        assert all(r["reason"] for r in x["rejected"])
    result = json.loads((made / "report" / "result.json").read_text())
    assert result["kept"] == 2
    assert result["attempts"] == 2 + sum(result["rejected"].values())
    assert "Contact area" in (made / "report" / "report.html").read_text()
    assert not (made / "more.work").exists()


def test_an_image_is_that_of_its_state(made):
    dataset = LeRobotDataset("local/more", made / "more", video_backend="pyav")
    state = np.stack(dataset.hf_dataset.with_format("numpy")[OBS_STATE][:])
    rest = dataset[0][TACTILE].numpy()
    touching = int(state[:, 17].argmax())
    changed = np.abs(dataset[touching][TACTILE].numpy() - rest).mean(0) > 12 / 255
    assert changed.mean() == pytest.approx(state[touching, 17], abs=0.02)


def command(recorded, out) -> list[str]:
    code = f"""
import sys
from functools import partialmethod
from lerobot_pneutac.cli import run_verb
from lerobot_pneutac.verbs.augment import Augmentation, AugmentConfig, DatasetRef
from pneutac_datasets.demonstrations.augment.episode import AugmentSetup

AugmentSetup.__init__ = partialmethod(AugmentSetup.__init__, candidates={FEW})
run_verb("augment", sys.argv[1:])
"""
    return [sys.executable, "-c", code, *options(recorded, out, "--episodes=2", "--seed=5")]


@pytest.mark.nightly
def test_killed_and_resumed_on_ray_equals_uninterrupted(recorded, tmp_path):
    made, out = tmp_path / "made", tmp_path / "again"
    run_verb("augment", options(recorded, made / "more", "--episodes=2", "--seed=5"))
    work = tmp_path / "again.work"
    process = subprocess.Popen(command(recorded, out), env=os.environ, stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 600  # on a busy machine
    while not list(work.glob("episode_*.npz")) and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not out.exists()
    assert list(work.glob("episode_*.npz"))
    with pytest.raises(InputError, match="another seed; give another folder"):
        run_verb("augment", options(recorded, out, "--episodes=2", "--seed=6"))
    run_verb("augment", options(recorded, out, "--episodes=2", "--seed=5", "--executor=ray"))
    for one, two in zip(table(made / "more"), table(out), strict=True):
        np.testing.assert_array_equal(one, two)
    one, two = (LeRobotDataset(f"local/{d.name}", d, video_backend="pyav") for d in (made / "more", out))
    for k in range(0, len(one), 7):
        assert (one[k][TACTILE] == two[k][TACTILE]).all()
    for key in (OBS_STATE, ACTION, TACTILE):
        for name, values in one.meta.stats[key].items():
            np.testing.assert_allclose(two.meta.stats[key][name], values, rtol=1e-6, atol=1e-6)
    name = "meta/provenance.jsonl"
    assert (out / name).read_text() == (made / "more" / name).read_text()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["again", "made"]


def test_bad_input_is_named(recorded, made, tmp_path):
    def refused(*more, match):
        with pytest.raises(InputError, match=match):
            run_verb("augment", options(recorded, tmp_path / "o", *more))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("torch.cuda.is_available", lambda: False)
        with pytest.raises(InputError, match="finds no CUDA device here; give cpu"):
            AugmentConfig(DatasetRef("a", recorded), DatasetRef("b", tmp_path / "o"), device="cuda")
    refused(f"--output.root={made / 'more'}", match="exists; give a new folder")
    (tmp_path / "o.work").mkdir()
    with FileLock(tmp_path / "o.work" / LOCK):  # as another process holds it
        refused(match="Another command is writing into '.*o.work'; wait for it and repeat")


@pytest.mark.parametrize("copies, said", [(0, "holds none of the recorded ones"), (4, "ones 2 times")])
def test_whether_the_recorded_ones_are_mixed_in_is_reported(copies, said, tmp_path):
    cfg = AugmentConfig(DatasetRef("a", tmp_path / "a"), DatasetRef("b", tmp_path / "b"))
    summary = {"kept": 10, "wall_s": 60, "copies": copies, "provenance": [{"frames": 12}] * 10}
    remarks = Augmentation(cfg, summary, [range(90)] * 2).remarks()
    one = "one copy of them would be 60 % of its frames. Make more (--episodes), or give --real_share=0.60"
    assert said in remarks[-1] and (one in remarks[-1]) == (copies == 0)
    long = Augmentation(cfg, summary | {"copies": 0}, [range(900)] * 2).remarks()[-1]
    assert long.endswith("would be 94 % of its frames. Make more (--episodes).")  # a share that is refused


def test_the_pace_is_of_what_this_run_made(tmp_path):
    cfg = AugmentConfig(DatasetRef("a", tmp_path / "a"), DatasetRef("b", tmp_path / "b"))
    for earlier, said in (
        (0, "b (1.0 minutes, 10 a"),
        (6, "b (6 of them by a run that was stopped; 1.0 minutes, 4 a"),
    ):
        summary = {"kept": 10, "wall_s": 60, "copies": 2, "earlier": earlier}
        first, *_ = Augmentation(cfg, summary, [None] * 2).remarks()
        assert f"10 new ones in {tmp_path}/{said} minute)." in first


@pytest.mark.parametrize("attempts, doubted", [(9, False), (22, True), (11, False)])
def test_few_attempts_that_work_ask_for_the_finger(attempts, doubted, tmp_path):
    """Nothing in a dataset says how long its finger is; what another one does from it seldom works."""
    cfg = AugmentConfig(DatasetRef("a", tmp_path / "a"), DatasetRef("b", tmp_path / "b"))
    summary = {"kept": 2 if attempts > 11 else attempts // 2, "attempts": attempts}
    summary |= {"wall_s": 60, "copies": 3}
    said = " ".join(Augmentation(cfg, summary, [None] * 3).remarks())
    assert ("Only 2 of 22 attempts" in said and "110 mm long (--twin)?" in said) == doubted


def test_what_is_carried_out_once_more_by_the_same_physics_agrees_wholly(made):
    """So start, object, and actions are those of the demonstration."""
    checks = json.loads((made / "report" / "result.json").read_text())["checks"]
    assert [c["episode"] for c in checks] == [0]
    for c in checks:
        assert c["success"]
        assert c["touched"][0] == c["touched"][1] > 3
        assert c["area_peak"] > 0.01
        assert c["area_rmse"] < 1e-6  # states are kept in single precision
        assert c["image_rmse_levels"] == 0.0
    assert "Carried out once more by material points" in (made / "report" / "report.html").read_text()


@pytest.mark.nightly
def test_what_differs_is_measured_and_what_was_checked_is_not_checked_again(tmp_path):
    world = World("switch", touch="image", fidelity="probe")
    world.variation = Variation(bend_gain=0.97)
    for seed in range(1, 9):
        seen, actions = played(world, seed, steps=150)
        states, images = np.array([o.state for o in seen[:-1]]), np.array([o.tactile for o in seen[:-1]])
        if states[:, 17].max() > 0.02 and world.success:
            break
    start = seed, world.variation
    attempt = Attempt(states, actions, images, None, 0.0, 0.0, start)
    steps, other = [], World("switch", touch="image", fidelity="surrogate")
    found = run.agreement(other, 4, attempt, lambda: steps.append(0))
    assert len(steps) == len(actions)
    assert found.episode == 4 and found.area_peak == pytest.approx(states[:, 17].max())
    assert 0 < found.area_rmse < 0.3 and 0 < found.image_rmse_levels < 60
    away = replace(attempt, start=(seed, replace(world.variation, shift_m=(0.0, 0.0, -5.0))))
    missed = run.agreement(world, 0, away)
    assert not missed.success and missed.touched[0] > 0 and missed.touched[1] == 0
    work, told = Work(tmp_path), []
    work.save_episode(0, attempt, {"cost": 0.0, "area_rmse": 0.0}, {})
    setup = setup_of([])
    loaded = work.load_episode(0)[0]
    assert loaded.start == attempt.start
    work.check_file(0).write_text("{}")
    run.check(work, setup, 1, lambda *a: told.append(a))
    assert not told and work.check_file(0).read_text() == "{}"
