"""The examples run as they are, in an empty folder, and stay short."""

import os
import subprocess
import sys

import pytest
from doc_blocks import ROOT

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
# Half a minute and more each; the front page and a tutorial do the same by commands.
LONG = {"augment", "calibrate_digit", "environment", "find_missing_effect", "mpm_finger", "splat_gel"}


def test_there_are_eight():
    assert len(EXAMPLES) == 8


@pytest.mark.slow
@pytest.mark.parametrize(
    "path", [pytest.param(p, marks=[pytest.mark.nightly] * (p.stem in LONG), id=p.stem) for p in EXAMPLES]
)
def test_it_runs(path, tmp_path):
    env = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "PNEUTAC_DATA")}
    env |= {"HF_HOME": str(tmp_path / "hf"), "HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, path], cwd=tmp_path, env=env, capture_output=True, text=True)
    assert done.returncode == 0, f"{done.stdout[-2000:]}\n{done.stderr[-4000:]}"
    assert done.stdout.strip()


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_it_is_short(path):
    assert len(path.read_text().splitlines()) < 60
