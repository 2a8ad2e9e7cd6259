"""The API: light to import, inputs unchanged, results as data, a refusal is a result."""

import copy
import json
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from generated import once

import lerobot_pneutac
from lerobot_pneutac import InputError, Recording, Twin, add, calibrate, compare
from lerobot_pneutac.verbs.result import ANOTHER_DAY
from pneutac_datasets.generate.finger import generate


@pytest.fixture(scope="module")
def bench(tmp_path_factory, no_soft_body):
    """A short recording with hidden creep and a twin calibrated to it."""
    folder = tmp_path_factory.mktemp("api") / "bench"
    once(generate, ["creep"], folder, 5003, minutes=3.0, hz=10)
    recording = Recording.load(folder)
    twin = Twin.builtin()
    twin.length_mm, twin.spine_joint_positions_mm = recording.length_mm, recording.spine_joint_positions_mm
    return calibrate(twin, recording), recording


def test_importing_is_light_and_registers_the_worlds():
    code = (
        "import sys, lerobot_pneutac, gymnasium; from lerobot_pneutac import Twin, Recording, calibrate, "
        "compare, diagnose, add; gymnasium.spec('pneutac_sim/switch'); "
        "print(sorted({'taichi', 'torch', 'lerobot', 'plotly', 'mujoco'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    assert set(lerobot_pneutac.__all__) <= set(dir(lerobot_pneutac))
    with pytest.raises(AttributeError, match="no attribute 'fly'"):
        _ = lerobot_pneutac.fly


@pytest.fixture(scope="module")
def crept(bench):
    """Creep added to the twin, and what was heard meanwhile."""
    calibrated, recording = bench
    twin, samples, heard = copy.deepcopy(calibrated.twin), recording.samples.copy(), []
    added = add(calibrated.twin, recording, "creep", progress=lambda *step: heard.append(step))
    assert calibrated.twin == twin and recording.samples.equals(samples)
    return added, heard


@pytest.mark.slow
def test_results_are_data_and_leave_what_was_given_as_it_was(bench, crept, tmp_path):
    calibrated, recording = bench
    results = [compare(calibrated.twin, recording), crept[0]]
    assert crept[1][-1] == ("fitting with and without creep", 2, 2)
    for i, result in enumerate(results):
        page = result.report(tmp_path / str(i))
        written = json.loads((page.parent / "result.json").read_text())
        assert written.keys() == result.to_dict().keys() and "<table>" in result._repr_html_()
        assert page.name == "report.html" and result.title.split()[0] in page.read_text()
    compared, added = results
    assert compared.heldout == pytest.approx(calibrated.error["heldout"], rel=1e-6)
    assert added.accepted and added.reason == "" and list(added.twin.effects) == ["creep"]
    assert compare(added.twin, recording).heldout < 0.5 * compared.heldout
    saved = added.save(tmp_path / "twin")
    assert saved.to_dict()["version"] == 0 and Twin.load(tmp_path / "twin") == saved.twin
    assert added.twin.history == [], "saving changes the saved result alone"


@pytest.fixture(scope="module")
def stored(bench, tmp_path_factory):
    """Results of the verbs of a body whose twin is stored; it has the effect already when that is refused."""
    folder = tmp_path_factory.mktemp("stored") / "my twin"
    calibrated = bench[0].save(folder)
    compared = compare(calibrated.twin, bench[1])
    added = add(calibrated.twin, bench[1], "creep").save(folder)
    refused = add(added.twin, bench[1], "creep")
    return {"calibrate": calibrated, "compare": compared, "add": added, "refused": refused}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("verb", "version", "after"),
    [
        ("calibrate", "version 0 (calibrated", "compare"),
        ("compare", "version 0 (calibrated", "diagnose"),
        ("add", "version 1 (added creep", "compare"),
        ("refused", "version 1 (added creep", "diagnose"),
    ],
)
def test_a_report_names_twin_version_and_recording_and_what_comes_next(
    stored, tmp_path, verb, version, after
):
    result = stored[verb]
    page = result.report(tmp_path).read_text()
    twin, recording = result.subject()
    about = page.partition('<p class="about">')[2].partition("</p>")[0]
    assert f"<code>{twin.folder}</code>, {version}" in about
    assert f"Recording: <code>{Path(recording).name}</code>." in about
    assert shlex.split(result.next_command)[:3] == ["pneutac", after, f"--twin={twin.folder}"]
    shown = page.partition("<h2>Do next</h2>")[2].partition("<pre>")[2].partition("</pre>")[0]
    tested = ANOTHER_DAY if verb == "add" else recording  # what was added is tested on another day
    assert shown.replace("&#39;", "'") == result.next_command and f"--recording={tested}" in shown


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "own", "reason"),
    [("creep", ["creep"], "has the effect 'creep' already"), ("leak", [], "changes nothing")],
)
def test_a_refusal_is_a_result(effect, own, reason, bench, crept):
    calibrated, recording = bench
    twin = crept[0].twin if own else calibrated.twin.copy()
    result = add(twin, recording, effect)
    assert not result.accepted and reason in result.reason and result.twin is twin
    assert result.to_dict()["accepted"] is False and reason in result.sentence
    with pytest.raises(InputError, match="no effect 'crep'"):
        add(twin, recording, "crep")


@pytest.mark.slow
def test_blocks_that_report_did_not_choose(bench, crept):
    """Whether an effect is kept is decided on other blocks than those whose error is told."""
    from lerobot_pneutac.study import study_of
    from lerobot_pneutac.verbs.compare_body import train_mask

    calibrated, recording = bench
    parts = study_of(calibrated.twin, recording, adding=["creep"]).parts
    assert (np.stack([parts.train, parts.validation, parts.test]).sum(0) == 1).all()
    added = crept[0].twin.copy()
    added.history.append(
        {"version": 1, "change": "added creep", "recording": str(recording.folder), "seed": 0}
    )
    assert (train_mask(added, recording) == ~parts.test).all(), "compare holds these out"
