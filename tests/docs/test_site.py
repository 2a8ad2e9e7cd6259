"""What the site is generated from; `make docs` builds all of it, strictly."""

import re

import pytest
from doc_blocks import ROOT
from latex2mathml.converter import convert

from pneutac_sim.effects import all_effects
from pneutac_sim.effects.laws import law_names
from pneutac_sim.effects.registry import get_effect

GENERATED = {
    "concepts/effects.md",
    "concepts/laws.md",
    "concepts/places.md",
    "reference/commands.md",
    "changes.md",
    "contributing.md",
}


@pytest.mark.parametrize("name", [*all_effects(), *law_names()])
def test_an_effect_shows_its_equation(name):
    assert convert(get_effect(name).equation.replace("|", r"\vert ")).startswith("<math")


def test_the_table_of_places_has_every_effect_and_asks_the_places(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs" / "generate")
    import places

    page = places.page()
    assert all(f"| `{name}` |" in page for name in all_effects())
    rows = [line for line in page.splitlines() if line.startswith(("| `", "| law"))]
    assert len(rows) < len(all_effects()) + 12 and all(r.count("|") == rows[0].count("|") for r in rows)
    assert places.places("thermal") == ("joints",) * 5
    assert places.places("tip_y += x z") == ("tip", "tip; no pictures", "tip", "tip", "tip")
    assert places.places("base_tilt") == ("tip",) * 5
    assert places.places("camera_misalignment") == (*("reading",) * 4, "-")
    assert places.places("shadow") == (*("image",) * 4, "area")
    assert places.places("registration_shift") == ("photographs", "-", "-", "-", "-")


def test_what_a_reader_runs_meets_no_folder_of_another_page():
    runs = [ROOT / "README.md", *ROOT.glob("docs/tutorials/*.md"), *ROOT.glob("examples/*.py")]
    folders = [set(re.findall(r"outputs/(\w+)", p.read_text())) - {"demo"} for p in runs]
    assert sum(map(len, folders)) == len(set().union(*folders)) > 8


def test_every_page_is_in_the_navigation_and_the_other_way_round():
    nav = set(re.findall(r"[\w/]+\.md", (ROOT / "mkdocs.yml").read_text().partition("\nnav:")[2]))
    pages = {p.relative_to(ROOT / "docs").as_posix() for p in (ROOT / "docs").rglob("*.md")}
    tables = {f"results/{p.relative_to(ROOT / 'benchmarks')}" for p in (ROOT / "benchmarks").rglob("*.md")}
    tables = {t.replace("README.md", "index.md") for t in tables}
    notes = {t for t in tables if t.startswith("results/notes/")}  # for developers; results link to them
    assert notes and nav == pages | GENERATED | tables - notes
