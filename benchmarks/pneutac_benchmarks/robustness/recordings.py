"""Damaged bench recordings, read as a verb reads them."""

import json
import random
from pathlib import Path

import numpy as np
import pandas as pd
from PIL import Image

from pneutac_benchmarks.robustness import images
from pneutac_benchmarks.robustness.outcome import Outcome, judge
from pneutac_benchmarks.robustness.texts import mutated_csv, mutated_json
from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.noise import noise_floor
from pneutac_datasets.recording.photographs import masked_cameras, read_camera, read_photograph
from pneutac_datasets.recording.recording import Recording

ROWS = 24


def write_whole(folder: Path) -> list[Path]:
    """A finger's recording with photographs, an arm's, a gel's, and a finger's in Parquet."""
    rng = np.random.default_rng(0)
    n = np.arange(ROWS)
    kpa = 5 + 5 * np.sin(n / 3)
    finger = pd.DataFrame({"trial": n // 12, "time_s": 0.2 * (n % 12), "pressure_cmd_kpa": kpa.round(3)})
    finger["pressure_kpa"] = (kpa + 0.01 * rng.normal(size=ROWS)).round(4)
    for axis, column in zip("xyz", (118 - 0.1 * kpa**2, 0 * kpa, 5 * kpa), strict=True):
        finger[f"tip_{axis}_mm"] = (column + 0.2 * rng.normal(size=ROWS)).round(4)
    arm = finger.rename(columns={"pressure_cmd_kpa": "pressure_cmd_1_kpa", "pressure_kpa": "pressure_1_kpa"})
    for chamber in (2, 3):
        arm[f"pressure_cmd_{chamber}_kpa"] = kpa[::-1].round(3)
    photographed = finger.assign(
        image_front="front.png", mask_front="mask.png", payload_g=0, temperature_c=21.5
    )
    gel = pd.DataFrame({"role": ["calibration"] + ["heldout"] * 3, "trial": 0, "time_s": [0, 1, 2, 3]})
    gel = gel.assign(
        image="press.png", indenter=["sphere", "sphere", "cylinder", "cube"], indenter_radius_mm=3.0
    )
    gel = gel.assign(indenter_size_mm=3.0, x_mm=0.4, y_mm=[0.3, 0.1, 0, -1], depth_mm=0.9)
    camera = {"intrinsics": [[90, 0, 16], [0, 90, 12], [0, 0, 1]], "extrinsics": np.eye(4).tolist()}
    base = {"length_mm": 118.5, "spine_joint_positions_mm": [15, 45, 75, 104], "samples": "samples.csv"}
    more = {
        "noise": {f"tip_{a}_mm": 0.2 for a in "xyz"},
        "trials": {"1": {"start": "continues", "pause_s": 12}},
        "notes": "a note",
    }
    flat = {"rest_image": "rest.png", "px_per_mm": 1.6, "gel_size_mm": [19, 25, 4], "samples": "samples.csv"}
    whole = (
        ("finger", photographed, {"device": "finger", **base, **more, "cameras": {"front": camera}}),
        ("arm", arm, {"device": "arm", **base, "spine_joint_positions_mm": [20, 50, 100]}),
        ("gel", gel, {"device": "gel", **flat}),
        ("parquet", finger, {"device": "finger", **base, "samples": "samples.parquet"}),
    )
    for name, table, meta in whole:
        (folder / name).mkdir(parents=True)
        (folder / name / "recording.json").write_text(json.dumps(meta, indent=1))
        if meta["samples"].endswith("csv"):
            table.to_csv(folder / name / "samples.csv", index=False)
        else:
            table.to_parquet(folder / name / "samples.parquet", index=False)
    pictures = {n: rng.integers(0, 256, (40, 32, 3)) for n in ("finger/front", "finger/mask")}
    pictures["gel/rest"] = rng.integers(100, 120, (40, 32, 3))
    pictures["gel/press"] = pictures["gel/rest"].copy()  # away from the contact the two show the same
    pictures["gel/press"][15:25, 11:21] = rng.integers(40, 220, (10, 10, 3))
    for name, image in pictures.items():
        Image.fromarray(image.astype(np.uint8)).save(folder / f"{name}.png")
    return [folder / name for name, _, _ in whole]


def read(folder: Path) -> None:
    """All that the verbs ask of a recording before they compute anything."""
    recording = Recording.load(folder)
    recording.split()
    _ = recording.starts, recording.conditions, recording.observations, recording.spine_joint_positions_mm
    if recording.device == "gel":
        GelRecording.load(recording, to_fit=True)
        return
    noise_floor(check(recording)[0])
    for camera in masked_cameras(recording):
        read_camera(recording, camera)
        read_photograph(recording, 0, camera)


def damage_recordings(work: Path, number: int, seed: int = 0) -> Outcome:
    """Mutated recordings: each is read or refused in a sentence.

    Args:
        work: an empty folder.
        number: how many.
        seed: of the damage.
    """
    folders = write_whole(work)
    whole = {f: f.read_bytes() for folder in folders for f in folder.iterdir()}
    for folder in folders:
        read(folder)
    rng = random.Random(seed)

    def attempt(i: int) -> None:
        folder = folders[i % len(folders)]
        file = rng.choice(sorted(f for f in whole if f.parent == folder and f.suffix != ".png"))
        lines = whole[file].decode(errors="replace").splitlines()
        if file.suffix == ".json":
            file.write_text(mutated_json(lines, rng))
        elif file.suffix == ".csv" and rng.random() < 0.9:
            file.write_text(mutated_csv(lines, rng))
        else:
            file.write_bytes(images.mutated(whole[file], rng))
        try:
            read(folder)
        finally:
            file.write_bytes(whole[file])

    return judge("recordings: mutated recording.json, CSV and Parquet", number, attempt)
