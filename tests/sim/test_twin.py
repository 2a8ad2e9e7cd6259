"""The twin's folder: round trip, history, and one clear sentence for each kind of damage.

A twin's folder survives what can stop its writing, and what is wrong in it ends in one sentence.
"""

import errno
import os
import re
from dataclasses import fields
from pathlib import Path

import huggingface_hub
import numpy as np
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
from pneutac_sim.effects import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.finger import Pipeline
from pneutac_sim.finger.stages import Geometry
from pneutac_sim.gel.force import MATERIAL
from pneutac_sim.gel.model import OWN_PLACE, GelModel
from pneutac_sim.mpm.solid import BY_DEVICE, DEFAULTS
from pneutac_sim.twin import GEL, PARAMETERS, Twin, Value, twin_digest


def test_round_trip_keeps_every_field(tmp_path):
    twin = Twin.builtin()
    twin.parameters["gain_rad_per_kpa"] = Value(0.0123, (0.012, 0.0126))
    twin.effects["valve_lag"] = {"fill_time_s": Value(0.1, (0.08, 0.12)), "vent_time_s": Value(2.0)}
    twin.pressure_range_kpa = (-20.0, 60.0)
    twin.gel = {"px_per_mm": 20.0, "light": [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]}
    twin.arrays["rest_image"] = np.random.default_rng(0).integers(0, 255, (4, 3, 3), dtype=np.uint8)
    back = Twin.load(twin.save(tmp_path / "twin"))
    assert back.parameters == twin.parameters and back.effects == twin.effects and back.gel == twin.gel
    assert back.pressure_range_kpa == (-20.0, 60.0)
    assert back.spine_joint_positions_mm == twin.spine_joint_positions_mm == [13.75, 41.25, 68.75, 96.25]
    np.testing.assert_array_equal(back.arrays["rest_image"], twin.arrays["rest_image"])
    assert Twin.from_pretrained(tmp_path / "twin").parameters == twin.parameters


def test_a_hub_out_of_reach_is_one_sentence(monkeypatch, tmp_path):
    def unreachable(*args, **kwargs):
        raise huggingface_hub.errors.LocalEntryNotFoundError("Name or service not known\nmore")

    sentence = "no twin of that name came from the Hub \\(Name or service not known\\); check the name"
    for name in ("snapshot_download", "HfApi"):
        monkeypatch.setattr(huggingface_hub, name, unreachable)
    with pytest.raises(InputError, match=f"There is no folder 'nobody/none', and {sentence}") as refused:
        Twin.from_pretrained("nobody/none")
    assert "\n" not in str(refused.value)
    with pytest.raises(InputError, match="The twin was not uploaded to 'nobody/none'"):
        Twin.builtin().push_to_hub("nobody/none")


def test_a_twin_that_does_not_say_was_measured_over_the_papers_pressures(tmp_path):
    file = Twin.builtin().save(tmp_path) / "twin.yaml"
    text = file.read_text()
    given = "pressure_range_kpa:\n- 0.0\n- 15.0\n"
    assert given in text
    file.write_text(text.replace(given, ""))
    assert Twin.load(tmp_path).pressure_range_kpa == (0.0, 15.0)
    for wrong in ("[15, 0]", "[5, 20]", "20", "[0, .inf]", "[0, much]", "[0, 0]"):
        file.write_text(text.replace(given, f"pressure_range_kpa: {wrong}\n"))
        with pytest.raises(
            InputError, match=r"twin.yaml: .*pressure_range_kpa is .* with 0 \(vented\) among"
        ):
            Twin.load(tmp_path)


def test_versions_keep_the_earlier_twin(tmp_path):
    twin = Twin.builtin()
    twin.save_version(tmp_path, "calibrated", "bench", {"train": 2.0, "heldout": 2.2, "unit": "mm"})
    twin.effects["creep"] = get_effect("creep").start()
    twin.save_version(tmp_path, "added creep", "bench", {"train": 0.5, "heldout": 0.6, "unit": "mm"})
    assert [h["heldout"] for h in Twin.load(tmp_path).history] == [2.2, 0.6]
    assert Twin.load(tmp_path / "history" / "000").effects == {}
    assert "creep" in Twin.load(tmp_path / "history" / "001").effects


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("value: 0.01114", "value: .nan", ".*gain_rad_per_kpa"),
        ("effects: {}", "effects: none", "field 'effects' is 'none'"),
        ("gain_alpha", "gain_omega", "body: unknown parameter 'gain_omega'; did you mean 'gain_alpha'\\?"),
        ("gain_alpha", "zzz", "body: unknown parameter 'zzz'; those that exist .* and \\d+ more\\.$"),
        ("value: 0.0313", "value: 0.0313\n    ci59: [0, 1]", "parameters.gain_alpha: unknown field 'ci59'"),
        ("length_mm:", "lenght_mm:", "unknown field 'lenght_mm'; did you mean 'length_mm'\\?"),
        ("effects: {}", "effects:\n  crep: {}", "There is no effect 'crep'; did you mean 'creep'\\?"),
        (
            "effects: {}",
            "effects:\n  dead_time:\n    delay_sec: {value: 0.1}",
            "effects.dead_time: unknown parameter 'delay_sec'; did you mean 'delay_s'\\?",
        ),
        ("effects: {}", "effects:\n  dead_time: {}", "effects.dead_time: delay_s is missing; add what is"),
        ("value: 0.01114", "value: true", "field 'parameters.gain_rad_per_kpa' .*True is no number"),
        ("history: []", "history: {}", "field 'history' is {}; it must hold an entry for each version"),
        ("history: []", "history: [{change: new}]", "history, entry 0: field 'version' is missing"),
        (
            "history: []",
            "history: [{version: 0, change: a, train: .nan}]",
            "history, entry 0: field 'train' is nan; give a finite number",
        ),
    ],
)
def test_a_malformed_twin_names_file_and_field(old, new, said, tmp_path):
    file = Twin.builtin().save(tmp_path) / "twin.yaml"
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(InputError, match=f"twin.yaml: {said}"):
        Twin.load(tmp_path)
    assert any(re.search(f"twin.yaml: {said}", fault) for fault in Twin.faults(tmp_path))


@pytest.mark.parametrize("content", ["", "# nothing", "[]", "- 1"])
def test_an_empty_twin_is_answered_by_what_to_do(tmp_path, content):
    Twin.builtin().save(tmp_path / "t")
    file = tmp_path / "t" / "twin.yaml"
    file.write_text(content)
    (fault,) = Twin.faults(tmp_path / "t")
    with pytest.raises(InputError) as e:
        Twin.load(tmp_path / "t")
    assert fault == str(e.value) and ("is empty; " if content != "- 1" else "holds no fields; ") in fault
    assert f"`pneutac new --twin={tmp_path / 't'}`" in fault
    (tmp_path / "t" / "history" / "001").mkdir(parents=True)
    (tmp_path / "t" / "history" / "001" / "twin.yaml").write_text("")
    assert "copy the last one that is stored" in Twin.faults(tmp_path / "t")[0]


def test_a_fault_of_a_file_that_versions_share_is_reported_once(tmp_path):
    twin = Twin.builtin()
    twin.arrays["rest_image"] = np.zeros((4, 3, 3), np.uint8)
    for change in ("first", "second", "third"):
        twin.save_version(tmp_path, change, "bench", {})
    (arrays,) = tmp_path.glob("arrays-*")
    arrays.write_bytes(b"")
    (fault,) = [f for f in Twin.faults(tmp_path) if "history" not in f]
    assert "is corrupted" in fault


def test_a_twin_may_have_the_parameters_that_the_pipeline_the_solid_and_the_gel_know():
    for device, joints in (("finger", 4), ("arm", 6)):
        twin = Twin(device=device)
        pipeline = Pipeline(Geometry(device, 110.0, tuple(twin.spine_joint_positions_mm)), body=None)
        bends = {f"bend_{n + 1}" for n in range(joints)}
        assert set(pipeline.names) - bends <= set(PARAMETERS[device])
        assert {*DEFAULTS, *BY_DEVICE} <= set(PARAMETERS[device])
    assert set(MATERIAL) <= set(PARAMETERS["gel"])
    assert {f.name for f in fields(GelModel)} == {*GEL, *OWN_PLACE}


@pytest.mark.parametrize("name", ["gain_rad_per_kpa", "gain_beta", "rest_pressure_kpa"])
def test_a_file_without_a_parameter_of_the_body_is_read_by_a_fit_alone(tmp_path, name):
    twin = Twin.builtin()
    del twin.parameters[name]
    twin.save(tmp_path)
    says = f"twin.yaml: body: {name} is missing; `pneutac calibrate --twin={tmp_path} --recording=DIR` finds"
    with pytest.raises(InputError, match=says):
        Twin.load(tmp_path)
    assert len(Twin.faults(tmp_path)) == 1
    twin = Twin.load(tmp_path, calibrated=False)
    assert np.isfinite(Pipeline.of(twin).theta(twin, 15.0)).all()


@pytest.mark.parametrize(("device", "joints", "missing"), [("finger", 1, 2), ("finger", 2, 3), ("arm", 6, 3)])
def test_a_body_of_few_joints_has_no_profile_to_find(device, joints, missing):
    twin = Twin(device, spine_joint_positions_mm=list(np.linspace(10.0, 90.0, joints)))
    assert len(twin.missing) == missing
    pipeline = Pipeline.of(twin)
    assert not pipeline.update(twin, pipeline.theta(twin)).missing


def test_a_name_that_is_given_twice_is_refused(tmp_path):
    (tmp_path / "a.yaml").write_text("day: 1\nday: 2\n")
    with pytest.raises(InputError, match="a.yaml, line 2, .*'day' is given twice"):
        files.read_yaml(tmp_path / "a.yaml")


def test_an_earlier_version_has_the_arrays_of_its_time(tmp_path):
    twin = Twin.builtin()
    for value in (1, 2):
        twin.arrays["rest_image"] = np.full((2, 2, 3), value, np.uint8)
        twin.save_version(tmp_path, f"{value}", "bench", {"train": 1.0, "heldout": 1.0, "unit": "mm"})
    first = Twin.load(tmp_path, 0)
    assert first.arrays["rest_image"].max() == 1 and len(first.history) == 1 and first.folder == tmp_path
    with pytest.raises(InputError, match="no version 7"):
        Twin.load(tmp_path, 7)


SAVED = Path(__file__).parents[1] / "golden" / "twins" / "finger"


@pytest.mark.nightly  # every day: files are on disk before they get their names, below
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
    twin, given = Twin.builtin(), {"task": "switch"}
    twin.save_version(tmp_path, "first", "bench", {"dragging": given, "imprint": given})
    twin.save_version(tmp_path, "second", "bench", {"imprint": given})
    with pytest.raises(InputError, match="history, entry 2: field 'train' is nan"):
        twin.save_version(tmp_path, "third", "bench", {"train": float("nan")})
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


def test_the_digest_of_a_twin_is_that_of_all_that_it_does(tmp_path):
    def digest(change=lambda twin: None):
        twin = Twin.builtin()
        twin.arrays["rest_image"] = np.zeros((2, 2, 3), np.uint8)
        change(twin)
        loaded = Twin.load(twin.save(tmp_path / "twin"))
        assert twin_digest(loaded) == twin_digest(twin)
        return twin_digest(loaded)

    def trained(twin):
        (tmp_path / "net").write_bytes(b"weights")
        twin.networks["action"] = tmp_path / "net"

    changes = (
        lambda twin: twin.parameters.update(gain_rad_per_kpa=Value(0.021)),
        lambda twin: twin.effects.update(creep={p.name: Value(0.1) for p in get_effect("creep").parameters}),
        lambda twin: twin.gel.update(px_per_mm=11.0),
        lambda twin: twin.arrays["rest_image"].fill(1),
        trained,
    )
    assert digest() == digest() and len({digest(), *map(digest, changes)}) == 6
