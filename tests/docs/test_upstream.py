"""The requests to LeRobot reproduce what is missing there; one module knows its inside."""

import os
import re
import subprocess
import sys

import pytest
from doc_blocks import ROOT

from lerobot_robot_pneutac import lerobot_inside


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["episode_hooks", "writer_survives_a_kill", "similar_observations"])
def test_a_reproduction_prints_what_its_page_says(name, tmp_path):
    """Where it prints something else LeRobot has changed: look whether a patch of ours is superfluous."""
    env = os.environ | {"HF_HOME": str(tmp_path), "HF_HUB_OFFLINE": "1"}
    script = ROOT / "docs/upstream" / f"{name}.py"
    done = subprocess.run(
        [sys.executable, script], env=env, cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr[-3000:]
    (shown,) = re.findall(r"```text\n(.*?)```", script.with_suffix(".md").read_text(), re.S)
    lines = [re.sub(r"\d+ observations", "n observations", line) for line in shown.splitlines()]
    out = re.sub(r"\d+ observations", "n observations", done.stdout)
    assert [line for line in lines if line not in out] == []


def test_one_module_knows_the_inside_of_lerobot():
    inside = re.compile(
        r"^\s*(from lerobot\.datasets\.(\w*utils|compute_stats|dataset_\w+r)\b"
        r"|import lerobot\.datasets\.)",
        re.M,
    )
    files = [f for folder in ("robots", "datasets", "lerobot_pneutac") for f in (ROOT / folder).rglob("*.py")]
    assert len(files) > 100
    assert [f for f in files if f.name != "lerobot_inside.py" and inside.search(f.read_text())] == []
    for name in lerobot_inside._OF_DATASETS:
        assert callable(getattr(lerobot_inside, name))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        lerobot_inside.nothing  # noqa: B018
