"""A twin's folder survives what can stop its writing, and what is wrong in it ends in one sentence."""

import errno
import os
from pathlib import Path

import pytest

from pneutac_benchmarks.robustness.twins import (
    compare_damaged_twins,
    damage_twins,
    first,
    kill_saves,
    save_at_once,
    second,
)
from pneutac_sim import files
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin

SAVED = Path(__file__).parents[1] / "golden" / "twins" / "finger"


@pytest.mark.slow
def test_a_save_that_is_killed_at_any_operation_leaves_the_old_twin_or_the_new(tmp_path):
    assert kill_saves(tmp_path).broken == ()


def test_nothing_takes_a_files_place_before_the_disk_holds_it(tmp_path, monkeypatch):
    first(tmp_path)
    done = []
    fsync, replace = os.fsync, Path.replace

    def noted_fsync(handle):
        done.append(("held", os.readlink(f"/proc/self/fd/{handle}")))
        fsync(handle)

    def noted_replace(part, file):
        done.append(("renamed", str(part), str(file)))
        return replace(part, file)

    monkeypatch.setattr(os, "fsync", noted_fsync)
    monkeypatch.setattr(Path, "replace", noted_replace)
    second(tmp_path)
    renamed = [i for i, d in enumerate(done) if d[0] == "renamed"]
    assert Path(done[renamed[-1]][2]) == tmp_path / "twin.yaml" and len(renamed) == 4
    for i in renamed:
        assert done[i - 1] == ("held", done[i][1])
        assert done[i + 1] == ("held", str(Path(done[i][2]).parent))


def test_of_two_processes_that_save_none_loses_a_version(tmp_path):
    assert save_at_once(tmp_path, number=24).broken == ()


@pytest.mark.nightly
def test_of_two_processes_that_save_ten_thousand_versions_none_is_lost(tmp_path):
    assert save_at_once(tmp_path, number=10_000).broken == ()


def test_a_full_disk_is_one_sentence_and_leaves_nothing_behind(tmp_path, monkeypatch):
    first(tmp_path)
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}

    def full(*args):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match="No space is left to write .*; free some and repeat"):
        second(tmp_path)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


@pytest.mark.parametrize("number", [150, pytest.param(10_000, marks=pytest.mark.nightly)])
def test_a_damaged_twin_is_read_or_refused_in_a_sentence(tmp_path, number):
    outcome = damage_twins(SAVED, tmp_path, number)
    assert outcome.broken == () and 0.3 * number < outcome.refused < number


@pytest.mark.parametrize("number", [40, pytest.param(1000, marks=pytest.mark.nightly)])
def test_a_damaged_twin_is_compared_or_refused_in_a_sentence(tmp_path, number):
    outcome = compare_damaged_twins(SAVED, tmp_path, number)
    assert outcome.broken == () and 0.3 * number < outcome.refused < number


def test_a_date_in_yaml_is_a_text(tmp_path):
    (tmp_path / "a.yaml").write_text("day: 2020-01-01")
    assert files.read_yaml(tmp_path / "a.yaml") == {"day": "2020-01-01"}


def test_yaml_has_limits(tmp_path):
    file = tmp_path / "twin.yaml"
    for text, why in (
        ("a: " + "[" * 5000, "nested too deeply|not valid YAML"),
        ("a: &x [1]\nb: *x", "aliases are not read"),
        ("a: " + "1" * 2**20, "larger than"),
        ('a: "\\e[2J"', "control characters are not read"),
    ):
        file.write_text(text)
        with pytest.raises(InputError, match=why):
            Twin.load(tmp_path)


def test_what_a_twin_holds_twice_is_written_twice_and_read_again(tmp_path):
    twin, errors = Twin.builtin(), {"train": 1.0}
    twin.save_version(tmp_path, "first", "bench", {"by": errors, "again": errors})
    twin.save_version(tmp_path, "second", "bench", {"by": errors})
    assert Twin.load(tmp_path).history == twin.history


@pytest.mark.parametrize("name", ["action.safetensors", "history", "twin.yaml"])
def test_a_link_out_of_the_folder_is_refused_but_not_in_the_hubs_cache(tmp_path, name):
    twin = Twin.builtin()
    twin.networks["action"] = tmp_path / "trained"
    twin.networks["action"].write_bytes(b"weights")
    here, hub = tmp_path / "twin", tmp_path / "cache" / "snapshots" / "0f" / "twin"
    for folder, aside in ((here, tmp_path / "private"), (hub, tmp_path / "cache" / "blobs")):
        twin.save_version(folder, "first", "bench", {})
        twin.history.clear()
        aside.mkdir()
        (folder / name).rename(aside / name)
        (folder / name).symlink_to(aside / name)
    with pytest.raises(InputError, match=f"{name} is a link that leads out of the twin's folder"):
        Twin.load(here)
    assert Twin.load(hub).networks["action"].read_bytes() == b"weights"
