"""A twin with its history as one page."""

import pytest

from lerobot_pneutac.cli import run_verb
from lerobot_pneutac.verbs.report import report
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin


@pytest.fixture
def folder(tmp_path):
    twin, errors = Twin.builtin(), {"train": 2.0, "heldout": 2.2, "unit": "mm"}
    twin.save_version(tmp_path / "finger", "calibrated", "bench", errors)
    twin.effects["creep"] = get_effect("creep").start(15.0)
    twin.save_version(tmp_path / "finger", "added creep", "bench", errors | {"heldout": 0.61})
    return tmp_path / "finger"


def test_the_page_tells_history_effects_and_numbers_and_needs_nothing_else(folder, tmp_path, capsys):
    before = (folder / "twin.yaml").read_bytes()
    run_verb("report", [str(folder), f"--out={tmp_path / 'out'}"])
    page = (tmp_path / "out" / "report.html").read_text()
    assert "0.61 mm off" in page and "added creep" in page and "gain_rad_per_kpa" in page
    assert 'src="http' not in page and (folder / "twin.yaml").read_bytes() == before
    found = report(Twin.load(folder)).to_dict()
    assert [e["heldout"] for e in found["history"]] == [2.2, 0.61] and found["effects"] == ["creep"]


def test_one_that_was_never_judged_and_options_that_do_not_go_together(tmp_path):
    Twin(device="gel").save(tmp_path / "gel")
    assert "never tested" in report(Twin.load(tmp_path / "gel")).sentence
    with pytest.raises(InputError, match="must end in .rrd"):
        run_verb("report", [str(tmp_path / "gel"), "--rrd=x.txt"])
    with pytest.raises(InputError, match="goes with --rrd"):
        run_verb("report", [str(tmp_path / "gel"), "--recording=x"])
    with pytest.raises(InputError, match="--rrd takes a finger or an arm"):
        run_verb("report", [str(tmp_path / "gel"), f"--rrd={tmp_path / 'x.rrd'}"])
