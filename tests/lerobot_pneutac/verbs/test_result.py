"""What all results share: plain numbers, and a report that says of what it is and what comes next.

A twin with its history as one page.
"""

import pytest
from verbs import verb

from lerobot_pneutac.verbs.history import report
from lerobot_pneutac.verbs.result import Result
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.twin import Twin


def test_what_has_no_place_in_json_is_refused():
    class Found(Result):
        def content(self):
            return {"a": {1, 2}}

    with pytest.raises(TypeError, match="set has no place in a result.json"):
        Found().to_dict()


def test_a_report_that_is_stopped_leaves_the_earlier_one(tmp_path):
    class Found(Result):
        heading, written = "first", ("twin",)

        def write_more(self, folder):
            (folder / "twin").mkdir()

    class Stopped(Result):
        def page(self):
            raise KeyboardInterrupt

    page = Found().report(tmp_path / "out")
    before = {p: p.read_bytes() for p in (page, page.with_name("result.json"))}
    for out in ("out", "new"):
        with pytest.raises(KeyboardInterrupt):
            Stopped().report(tmp_path / out)
    assert {p: p.read_bytes() for p in before} == before
    assert (tmp_path / "out" / "twin").is_dir() and not (tmp_path / "new").exists()


def test_the_next_command_is_told_of_demonstrations_what_the_first_was(tmp_path):
    class Found(Result):
        title, next_command = "found", "pneutac add --twin=t --recording=d"

    first = "pneutac diagnose --twin=t --recording=d --task=button '--station=my lab.yaml' --seed=1"
    page = Found().report(tmp_path, first).read_text()
    assert "--recording=d --task=button &#39;--station=my lab.yaml&#39;</pre>" in page
    assert "<pre>pneutac add --twin=t --recording=d</pre>" in Found().report(tmp_path).read_text()


def test_a_notebook_shows_remarks_without_the_markup_of_the_console():
    class Found(Result):
        title, sentence = "found", "It is found."

        def remarks(self):
            return ["[bold]Warnings[/]", r"- of \[this]", "- of [/that]"]

    shown = Found()._repr_html_()
    assert "Warnings" in shown and "[bold]" not in shown and "of [this]" in shown and "of [/that]" in shown


@pytest.fixture
def folder(tmp_path):
    twin, errors = Twin.builtin(), {"train": 2.0, "heldout": 2.2, "unit": "mm"}
    twin.save_version(tmp_path / "finger", "calibrated", "bench", errors)
    twin.effects["creep"] = get_effect("creep").start(15.0)
    twin.save_version(tmp_path / "finger", "added creep", "bench", errors | {"heldout": 0.61})
    return tmp_path / "finger"


def test_the_page_tells_history_effects_and_numbers_and_needs_nothing_else(folder, tmp_path, capsys):
    before = (folder / "twin.yaml").read_bytes()
    verb("report", str(folder), out=tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text()
    assert "its test error was 0.61 mm" in page and "added creep" in page and "gain_rad_per_kpa" in page
    assert 'src="http' not in page and (folder / "twin.yaml").read_bytes() == before
    found = report(Twin.load(folder)).to_dict()
    assert [e["heldout"] for e in found["history"]] == [2.2, 0.61] and found["effects"] == ["creep"]
