"""The map: its generated part is up to date, every file and name exists; thresholds of the diagnosis."""

import re

import pytest
from doc_blocks import ROOT

from lerobot_pneutac.diagnosis import thresholds

PAGE = (ROOT / "docs/concepts/map.md").read_text()


@pytest.fixture
def idea_map(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs" / "generate")
    import idea_map

    return idea_map


def test_effects_and_commands_are_up_to_date(idea_map):
    assert PAGE.endswith(idea_map.generated()), "run `python docs/generate/idea_map.py`"


def test_every_file_and_name_exists(idea_map):
    assert not idea_map.missing(PAGE)
    assert idea_map.missing("`sim/none.py`, `sim/pneutac_sim/twin.py`: `Other`") == [
        "sim/none.py",
        "sim/pneutac_sim/twin.py Other",
    ]


def test_it_has_every_equation_of_the_paper():
    """Five are numbered there; the others stand in its text."""
    numbered = [f"paper, eq. {n}:" for n in range(1, 6)]
    others = r"q^{cmd}_n|L\,\nabla d_g|\tau_s =|\tau_r^\star =|f_m :|o_t =|1000\,|\hat I - I_{indent}"
    assert [text for text in (*numbered, *others.split("|")) if text not in PAGE] == []


def test_the_page_of_the_diagnosis_has_the_thresholds_of_the_code():
    page = (ROOT / "docs/concepts/diagnosis.md").read_text()
    rows = re.findall(r"^\| `([A-Z_]+)` \| ([\d.]+) \|", page, re.M)
    assert len(rows) > 9
    assert [(name, float(value)) for name, value in rows if getattr(thresholds, name) != float(value)] == []
    assert len(page.split()) <= 900
