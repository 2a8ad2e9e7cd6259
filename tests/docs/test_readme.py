"""Every block of the README runs as printed; it is short, and its links lead somewhere."""

import re
import shlex
from dataclasses import replace

import draccus
import pytest
from doc_blocks import ROOT, RUN, blocks, run_block, run_page
from lerobot.scripts.lerobot_record import RecordConfig

import lerobot_robot_pneutac  # noqa: F401  registers robot and teleoperator

TEXT = (ROOT / "README.md").read_text()


@pytest.mark.slow
def test_blocks_of_the_bench_run_on_two_minutes(tmp_path, monkeypatch):
    """In place of five; `lerobot-record` is run in test_plugin_loop, and here its options are read."""
    monkeypatch.chdir(tmp_path)
    made, python, recorded = (b for b in blocks("README.md") if b.kind in RUN and not b.why)
    run_block("README.md", replace(made, text=made.text.replace("--minutes=5", "--minutes=2")), tmp_path)
    exec(compile(python.text, "README.md", "exec"), {})
    assert (tmp_path / "outputs/readme/added/report.html").is_file()
    command = shlex.split(recorded.text.replace("\\\n", " "), comments=True)
    given = command[command.index("lerobot-record") + 1 :]
    assert draccus.parse(RecordConfig, args=given).dataset.num_episodes == 2


@pytest.mark.nightly
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
