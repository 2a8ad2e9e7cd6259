"""Creep of a gel hidden in truths that share no form with ours: what is found, and what it explains.

Run: .venv/bin/python benchmarks/tactile_creep.py [--shares='[0, 0.1]'] [--seeds='[1, 2]'] [--folder=DIR]
With --folder each press of a recording without hold_s is stated as held for 20 s, 3 s after the one before:
its images hold no such order, so that nothing may be found.
"""

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from lerobot_pneutac import Recording, Twin, add, calibrate
from pneutac_benchmarks.tactile.creeping import write_creeping
from pneutac_sim.errors import InputError

EFFECT = "gel_creep"


def tried(recording: Recording) -> dict:
    """Errors on held-out photographs without and with creep, and whether it was kept."""
    twin = calibrate(Twin("gel", 16.0), recording).twin
    try:
        result = add(twin, recording, [EFFECT])
    except InputError as e:
        return {"found": False, "why": str(e)[:120]}
    row = {"found": result.accepted, "before": result.before["heldout"], "after": result.after["heldout"]}
    return {k: round(v, 3) for k, v in row.items()} | {
        k: round(v["value"], 3) for k, v in (result.parameters or {}).items()
    }


def stated(folder: Path) -> Recording:
    """A recording with holds that it never had."""
    recording = Recording.load(folder)
    n = len(recording)
    samples = recording.samples.assign(time_s=23.0 * np.arange(1, n + 1), hold_s=20.0)
    return replace(recording, samples=samples)


def main() -> None:
    """Measures and prints a row each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shares", default="[0, 0.05, 0.1, 0.2]")
    parser.add_argument("--seeds", default="[1, 2]")
    parser.add_argument("--folder", type=Path)
    args = parser.parse_args()
    if args.folder:
        print({"folder": args.folder.name} | tried(stated(args.folder)), flush=True)
        return
    for seed in json.loads(args.seeds):
        for share in json.loads(args.shares):
            with tempfile.TemporaryDirectory() as folder:
                file = write_creeping(Path(folder) / "truth", share, seed)
                known = json.loads((file / "truth.json").read_text())
                print(known | tried(Recording.load(file)), flush=True)


if __name__ == "__main__":
    main()
