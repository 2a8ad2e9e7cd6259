"""Every block of the README runs as printed; it is short, and its links lead somewhere."""

import re

import pytest
from doc_blocks import ROOT, run_page

TEXT = (ROOT / "README.md").read_text()


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_blocks_run(tmp_path):
    run_page("README.md", tmp_path)
    assert (tmp_path / "outputs/readme/added/report.html").is_file()
    assert (tmp_path / "outputs/readme/demos/meta/info.json").is_file()


def test_it_is_short():
    assert len(TEXT.split()) <= 600
    assert "make demo" in TEXT and "make test" in TEXT


def test_links_lead_to_files():
    links = re.findall(r"\]\(([^)#]+)(?:#[\w-]+)?\)", TEXT)
    missing = [link for link in links if "://" not in link and not (ROOT / link).exists()]
    assert links and not missing
