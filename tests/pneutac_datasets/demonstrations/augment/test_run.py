import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from augmenting import config_of

from pneutac_datasets.demonstrations.augment import run
from pneutac_datasets.demonstrations.augment.episode import Attempt, AugmentSetup
from pneutac_datasets.demonstrations.augment.reference import Reference
from pneutac_datasets.demonstrations.reading import work_folder
from pneutac_sim.errors import InputError
from pneutac_sim.files import write_text
from pneutac_sim.twin import Twin
from pneutac_sim.world.base import Variation


def test_a_run_that_was_stopped_when_only_its_work_folder_was_left_ends(tmp_path, monkeypatch):
    new, meta = tmp_path / "new", SimpleNamespace(repo_id="local/demos")
    lines = [{"method": "expert"}, {"method": "expert"}, {"method": run.RECORDED}]

    def setup(episodes):
        config = config_of(tmp_path / "demos", new, method="expert", episodes=episodes)
        r = Reference(0, np.zeros((9, 3)), np.linspace(0, 0.1, 9), np.zeros((9, 4)), "flip the switch")
        return AugmentSetup(config, [r], "switch")

    def stopped(*_):
        write_text(new / "meta" / run.PROVENANCE, "".join(json.dumps(line) + "\n" for line in lines))
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(run, "_make_and_write", stopped)
        run.augment_guided(meta, setup(2))
    with pytest.raises(InputError, match="holds 2 demonstrations, not 3; give a new folder for them"):
        run.augment_guided(meta, setup(3))
    found = run.augment_guided(meta, setup(2))
    assert (found["kept"], found["copies"], found["earlier"]) == (2, 1, 2) and not work_folder(new).exists()


def test_a_run_does_not_go_on_with_a_twin_that_was_changed_meanwhile(tmp_path):
    """Half of its demonstrations would be another finger's."""
    meta, twin = SimpleNamespace(repo_id="local/demos"), Twin.builtin()
    config = config_of(tmp_path / "demos", tmp_path / "new", twin=twin.save(tmp_path / "twin"))
    r = Reference(0, np.zeros((9, 3)), np.linspace(0, 0.1, 9), np.zeros((9, 4)), "flip the switch")
    setup, work = AugmentSetup(config, [r], "switch"), run.Work(tmp_path / "new.work")
    work.open(run._run(meta, setup))
    work.open(run._run(meta, setup))
    twin.parameters["gain_rad_per_kpa"] = replace(twin.parameters["gain_rad_per_kpa"], value=0.021)
    twin.save(tmp_path / "twin")
    with pytest.raises(InputError, match="new.work' holds a run with another twin; give another folder"):
        work.open(run._run(meta, setup))


def test_a_folder_of_somebody_else_is_not_taken_for_a_runs_own_and_removed(tmp_path):
    work = run.Work(tmp_path / "new.work")
    work.folder.mkdir()
    (work.folder / "run.json.17.part").touch()  # of a run that was killed as it began
    work.open({"seed": 0})
    (work.folder / "run.json").rename(work.folder / "thesis.txt")
    with pytest.raises(InputError, match="new.work' is where this run .* and it holds 'thesis.txt'; move"):
        work.open({"seed": 0})


@pytest.mark.parametrize("keep", [0, 100, 400, None])
def test_a_demonstration_that_was_damaged_meanwhile_is_named(tmp_path, keep):
    work, start = run.Work(tmp_path), (3, Variation())
    state, images = np.zeros((9, 20), np.float32), np.zeros((9, 8, 6, 3), np.uint8)
    work.save_episode(0, Attempt(state, state[:, :4], images, None, 0.0, 1.0, start), {"source": 0}, {})
    assert work.load_spent(0) == ({"source": 0}, {"encoding": work.load_spent(0)[1]["encoding"]})
    file = work.episode_file(0)
    data = file.read_bytes()
    middle = len(data) // 2
    file.write_bytes(data[:keep] if keep is not None else data[:middle] + b"?" * 200 + data[middle + 200 :])
    with pytest.raises(InputError, match="episode_000000.npz' is damaged; delete it, and the same command"):
        work.load_episode(0)


def test_what_comes_before_the_first_demonstration_has_a_name(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "_made", None)
    monkeypatch.setattr(run, "Generator", lambda setup: setup)
    work, seen = run.Work(tmp_path), []
    progress = run._prepared(work, lambda *shown: seen.append(shown))
    progress("making demonstrations", 0, 2)
    run.generator(AugmentSetup, tmp_path)  # as a process does before its first demonstration
    progress("making demonstrations", 0, 2)
    assert seen == [("preparing the worlds", 0, 2), ("making demonstrations", 0, 2)]
