"""Finished episodes of a LeRobotDataset cannot be read when its process is killed."""

import multiprocessing
import os
import signal
import tempfile
from pathlib import Path

import numpy as np
from lerobot.datasets import LeRobotDataset

FEATURES = {
    "observation.state": {"dtype": "float32", "shape": (1,), "names": ["joint.pos"]},
    "action": {"dtype": "float32", "shape": (1,), "names": ["joint.pos"]},
}


def write(root: Path) -> None:
    """Three finished episodes, then what a crash or an empty battery does."""
    dataset = LeRobotDataset.create("local/data", 30, FEATURES, root=root, use_videos=False)
    for _ in range(3):
        for _ in range(10):
            value = np.zeros(1, np.float32)
            dataset.add_frame({"observation.state": value, "action": value, "task": "stay"})
        dataset.save_episode()
    os.kill(os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    os.environ["HF_HUB_OFFLINE"] = "1"
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "data"
        child = multiprocessing.get_context("spawn").Process(target=write, args=(root,))
        child.start()
        child.join()
        for file in sorted(root.rglob("*.parquet")):
            whole = file.read_bytes()[-4:] == b"PAR1"
            print(f"{file.relative_to(root)}: {'whole' if whole else 'no footer'}")
        try:
            print(f"{LeRobotDataset('local/data', root=root).num_episodes} episodes can be read.")
        except Exception as e:
            print(f"Reading it: {type(e).__name__}.")
