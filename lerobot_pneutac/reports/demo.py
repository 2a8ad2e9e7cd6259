"""The demo's page: what was found, how the error fell, what the policies do and feel, what was run."""

from pathlib import Path

import numpy as np
from PIL import Image

from lerobot_pneutac.reports.diagnosis import error_bars
from lerobot_pneutac.reports.figures import curves
from lerobot_pneutac.reports.page import AFTER, BEFORE, MEASURED, Report
from pneutac_datasets.recording.wording import joined
from pneutac_sim.effects.laws import plain_name

FILMS = 3  # starts of which both films are shown
TITLES = {
    "bench": "Measured",
    "twin": "Twin, calibrated and compared",
    "diagnose": "Diagnosis",
    "add": "Missing effects added",
    "record": "Demonstrations",
    "augment": "Augmentation",
    "train": "Training",
    "evaluate": "Evaluation",
}


def demo_page(result) -> Report:
    state, out = result.state, result.out
    page = result.lead_page()
    page.heading("The error of the twin")
    page.figure(
        _errors(state, result.added),
        "Held-out tip error before and after. The measurements are of the stand-in: an elastic rod whose air,"
        " creep and hysteresis have other equations than the twin's effects.",
    )
    page.text(state["diagnose"]["sentence"])
    page.heading("What the policies do")
    page.text(
        "Both policies on the stand-in from the same starts: at the left trained with augmentation, at the"
        " right on the recorded demonstrations alone."
    )
    films = [sorted((out / folder).rglob("*.mp4")) for folder in ("eval", "eval_alone")]
    for start, pair in list(enumerate(zip(*films, strict=False)))[:FILMS]:
        ends = ["done" if state["evaluate"][arm][start] else "not done" for arm in ("augmented", "alone")]
        page.videos(list(pair), f"Start {start + 1}: with augmentation {ends[0]}, the ten alone {ends[1]}.")
    page.heading("What it feels")
    page.image(demonstration_strip(out / "demonstrations"), "One demonstration: touch over time")
    for picture in sorted((out / "touch").glob("*.png"))[:1]:
        page.image(np.asarray(Image.open(picture).convert("RGB")), "Presses and the calibrated model")
    page.heading("Learning curve")
    page.figure(
        _losses(state["train"]),
        "Training loss of lerobot-train, each on its own data: it does not tell which policy is better",
    )
    page.heading("Try next")
    page.code("\n".join(result.next_commands))
    return _with_commands(page, state)


def quick_page(result, before, after) -> Report:
    """The report of a finished quick demo, not yet written, with the `BodyComparison`s of another day."""
    state = result.state
    page = result.lead_page()
    page.figure(
        _another_day(before, after),
        "The tip on another day, which neither calibration nor diagnosis saw. The measurements are of a"
        " simulated rod with friction of many small elements; the twin's effects have other equations.",
        420,
    )
    page.figure(_errors(state, result.added), "Error of the tip on that day, before and after.")
    page.text(state["diagnose"]["sentence"])
    page.heading("Try next")
    page.code("\n".join(result.next_commands))
    return _with_commands(page, state)


def _with_commands(page: Report, state: dict) -> Report:
    page.heading("What was run")
    for name, title in TITLES.items():
        if name in state:
            page.text(f"**{title}**, {state[name]['seconds']:.0f} s")
            page.code("\n".join(state[name]["commands"]))
    return page


def _another_day(before, after):
    """Where the tip moves most in the longest trial: measured, and by both twins."""
    rows = max(before.recording.trials().values(), key=lambda r: r.stop - r.start)
    column = int(np.ptp(before.measured[rows, : before.counted], axis=0).argmax())
    time_s = before.recording.column("time_s")[rows]
    shown = (("measured", before.measured, MEASURED), ("before", before.model, BEFORE))
    lines = (
        (name, time_s, values[rows, column].round(3), colour)
        for name, values, colour in (*shown, ("after", after.model, AFTER))
    )
    return curves(lines, "time (s)", before.columns[column])


def _errors(state: dict, added: list[str]):
    errors = (state[stage]["tip_error_mm"] for stage in ("twin", "add"))
    names = ("calibrated", f"with {joined(map(plain_name, added))}")
    steps = [(n, e, None, c) for n, e, c in zip(names, errors, (BEFORE, AFTER), strict=True)]
    return error_bars(steps, "mm", state["add"]["noise_mm"])


def _losses(training: dict):
    lines = (
        (name, (1 + np.arange(len(training[arm]))) * training["log_freq"], training[arm], None)
        for arm, name in (("augmented", "with augmentation"), ("alone", "recorded ones alone"))
    )
    return curves(lines, "step", "loss (mm² per step + kPa²)").update_yaxes(type="log")


def demonstration_strip(root: Path) -> np.ndarray:
    """Tactile images of the first episode around its strongest contact, side by side, uint8 (H, W, 3)."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset(f"local/{root.name}", root=root, episodes=[0])
    names = dataset.features["observation.state"]["names"]
    states = dataset.hf_dataset["observation.state"]
    area = np.array([float(s[names.index("contact_area.pos")]) for s in states])
    peak = int(area.argmax())
    picks = np.clip(np.linspace(peak - 20, peak + 20, 8).astype(int), 0, len(dataset) - 1)
    images = [dataset[int(i)]["observation.images.tactile"].numpy() for i in picks]
    return (np.concatenate([i.transpose(1, 2, 0) for i in images], axis=1) * 255).round().astype(np.uint8)
