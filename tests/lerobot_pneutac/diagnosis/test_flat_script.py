"""A flat script, without `if __name__ == "__main__"`, may call verbs that share work among processes."""

import subprocess
import sys

SCRIPT = """
import numpy as np

from lerobot_pneutac.diagnosis import engine
from pneutac_datasets.generate.hidden.generate import generate
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.twin import Twin

print("the script runs")
engine.PATIENCE_S = 0.0  # at once in other processes
generate(["none"], "bench", minutes=1, hz=5)
recording = Recording.load("bench")
job = engine.Job(Twin.builtin(), (), "pose", "command", 1)
with engine.Engine(recording, np.ones(len(recording.samples), bool), jobs=2) as fits:
    print(len(fits.run([job] * 4)), fits._pool is not None)
"""


def test_workers_do_not_run_the_script_again(tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    done = subprocess.run([sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout == "the script runs\n4 True\n"
