"""Recorded and augmented datasets as lerobot-doctor, lerobot-lint and `check` judge them; their card."""

import json
import shutil

import pytest
import yaml
from demonstration_sets import write_demonstrations
from doc_blocks import ROOT
from lerobot_doctor.dataset_loader import load_dataset
from lerobot_doctor.runner import Severity, run_checks
from lerobot_lint.config import load_profile
from lerobot_lint.engine import check_dataset

from lerobot_pneutac.verbs.augment import AugmentConfig, DatasetRef, augment
from lerobot_pneutac.verbs.check import check_path
from pneutac_datasets.demonstrations.card import write_card

DEMOS = ROOT / "tests/golden/recordings/demos"
PAGE = (ROOT / "docs/how_to/datasets_for_others.md").read_text()


@pytest.fixture(scope="module")
def datasets(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sets")
    shutil.copytree(DEMOS, folder / "recorded")
    refs = [DatasetRef(f"local/{n}", folder / n) for n in ("recorded", "augmented")]
    augment(AugmentConfig(dataset=refs[0], output=refs[1], task="switch", episodes=3, method="naive"))
    write_card(folder / "recorded")
    return folder


@pytest.mark.parametrize("name", ["recorded", "augmented"])
def test_lerobot_doctor_fails_nothing_and_its_warnings_are_explained(datasets, name):
    results = run_checks(load_dataset(str(datasets / name))).results
    assert len(results) > 8
    assert [r.name for r in results if r.severity == Severity.FAIL] == []
    warned = [r.name for r in results if r.severity == Severity.WARN]
    assert [w for w in warned if f"| {w} |" not in PAGE] == []


@pytest.mark.parametrize("name", ["recorded", "augmented"])
def test_what_lerobot_lint_finds_is_explained(datasets, name):
    found = {f.check for f in check_dataset(str(datasets / name), load_profile("default"), units="radians")}
    assert [code for code in sorted(found) if f"`{code}`" not in PAGE] == []


@pytest.mark.parametrize("name", ["recorded", "augmented"])
def test_the_card_names_features_units_station_and_licence(datasets, name):
    head, _, text = (datasets / name / "README.md").read_text()[4:].partition("---\n")
    assert yaml.safe_load(head)["license"] == "apache-2.0"
    info = json.loads((datasets / name / "meta/info.json").read_text())
    for feature in info["features"]:
        assert f"| `{feature}` |" in text
    assert "| `action` | `pressure.pos` | kPa |" in text and "Arm panda, mount 20 mm" in text
    assert ("`pneutac augment`" in text) == (name == "augmented")


def test_check_notes_short_episodes_idle_actions_and_limits(tmp_path):
    notes = " ".join(check_path(write_demonstrations(tmp_path / "idle", (12.0, 12.0, 3.0))).notes)
    assert "3 of 3 episodes have fewer than 100 frames" in notes and "--policy.chunk_size=5 " in notes
    assert "stays the same in episodes 0 (4 frames from 0.0 s), 1 (4" in notes
    assert "pressure.pos is at its highest value, 12, in 67 % of the frames" in notes
