"""The bench verbs run where neither Taichi nor torch nor LeRobot is installed."""

import json
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

WITHOUT = """
import json, sys
import scipy.signal  # looks for torch in sys.modules by its name, where None stands for what is not installed
for name in ("taichi", "torch", "lerobot"):
    sys.modules[name] = None  # importing it raises ImportError
from lerobot_pneutac.cli import main
for line in json.load(sys.stdin):
    sys.argv = ["pneutac", *line]
    main()
"""


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A small recording of markers, of a finger that stiffens the other way."""
    root = tmp_path_factory.mktemp("light")
    time_s = np.arange(0, 12, 0.1)
    rows = []
    for trial in range(4):
        kpa = 6 + 5 * np.sin(2 * np.pi * (0.15 + 0.05 * trial) * time_s + trial)
        angle = np.maximum(0.05 * kpa * (1 + 0.03 * kpa), 1e-6)
        tip = 110 / angle * np.stack([np.sin(angle), np.zeros_like(angle), 1 - np.cos(angle)])
        tip += np.random.default_rng(trial).normal(0, 0.3, tip.shape)
        columns = {"trial": trial, "time_s": time_s, "pressure_cmd_kpa": kpa}
        rows.append(pd.DataFrame(columns | dict(zip(("tip_x_mm", "tip_y_mm", "tip_z_mm"), tip, strict=True))))
    folder = root / "bench"
    folder.mkdir()
    pd.concat(rows).to_csv(folder / "samples.csv", index=False)
    meta = '{"device": "finger", "length_mm": 110, "samples": "samples.csv", "noise": '
    (folder / "recording.json").write_text(meta + '{"tip_x_mm": 0.3, "tip_y_mm": 0.3, "tip_z_mm": 0.3}}')
    return root


@pytest.mark.slow
def test_the_bench_verbs_need_neither_taichi_nor_torch_nor_lerobot(bench):
    pair = [f"--twin={bench / 'twin'}", f"--recording={bench / 'bench'}"]
    more = {"diagnose": ["--jobs=1"], "add": ["--effect=stiffening"]}
    verbs = ["calibrate", "compare", "diagnose", "add"]
    lines = [["new", *pair], *([v, *pair, f"--out={bench / v}", *more.get(v, [])] for v in verbs)]
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT], input=json.dumps(lines), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert all((bench / v / "result.json").is_file() for v in verbs)
