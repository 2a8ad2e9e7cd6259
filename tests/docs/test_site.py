"""What the site is generated from; `make docs` builds all of it, strictly."""

import re

import pytest
from doc_blocks import ROOT
from latex2mathml.converter import convert

from pneutac_sim.effects import all_effects

GENERATED = {"concepts/effects.md", "reference/commands.md", "changes.md", "contributing.md"}


@pytest.mark.parametrize("name", list(all_effects()))
def test_an_effect_shows_its_equation(name):
    assert convert(all_effects()[name].equation).startswith("<math")


def test_every_page_is_in_the_navigation_and_the_other_way_round():
    nav = set(re.findall(r"[\w/]+\.md", (ROOT / "mkdocs.yml").read_text().partition("\nnav:")[2]))
    pages = {p.relative_to(ROOT / "docs").as_posix() for p in (ROOT / "docs").rglob("*.md")}
    tables = {f"results/{p.relative_to(ROOT / 'benchmarks')}" for p in (ROOT / "benchmarks").rglob("*.md")}
    tables = {t.replace("README.md", "index.md") for t in tables}
    assert nav == pages | GENERATED | tables
