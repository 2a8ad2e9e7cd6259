"""The demo's report page: what was run, what the policy does, how the touch images look."""

import json
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from lerobot_pneutac.reports.page import Report, write_result

TITLES = {
    "calibrate": "Tactile sensor from two images",
    "record": "Demonstrations",
    "augment": "Augmentation",
    "train": "Training",
    "evaluate": "Evaluation",
}


def write_report(out: Path, state: dict) -> Path:
    """Writes `report.html` and `result.json` of a finished demo.

    Args:
        out: the demo's folder.
        state: stage name to its results, seconds and commands.
    """
    evaluation, training = state["evaluate"], state["train"]
    report = Report("A soft tactile finger learns to flip a switch")
    report.lead(
        f"The policy flipped the switch in {evaluation['success_percent']:.0f} % of "
        f"{evaluation['episodes']} randomised starts, after {state['options']['episodes']} demonstrations."
    )
    for video in sorted((out / "eval").rglob("*.mp4"))[:3]:
        report.video(video, f"The policy, {video.stem.replace('_', ' ')}", width=480)

    report.heading("What it feels")
    report.image(demonstration_strip(out / "demonstrations"), "One demonstration: touch over time")
    calibration = out / "calibration"
    source = "a real DIGIT" if state["calibrate"]["real"] else "a generated recording (no real data at hand)"
    for picture in sorted(calibration.glob("*.png"))[:1]:
        from PIL import Image

        image = np.asarray(Image.open(picture).convert("RGB"))
        report.image(image, f"Tactile images of {source} beside the calibrated model")
    if (calibration / "result.json").is_file():
        block = json.loads((calibration / "result.json").read_text()).get("image") or {}
        rows = [{"measure": k, "value": v} for k, v in block.items() if isinstance(v, int | float)]
        report.table(rows, "Held-out images; levels of 8 bit")

    report.heading("Learning curve")
    x = (1 + np.arange(len(training["losses"]))) * training["log_freq"]
    figure = go.Figure(go.Scatter(x=x, y=training["losses"], mode="lines"))
    figure.update_layout(xaxis_title="step", yaxis_title="loss (mm² per step + kPa²)", yaxis_type="log")
    report.figure(figure, "Training loss of lerobot-train")

    report.heading("What was run")
    report.text("The same commands, ready to paste in this folder's parent environment.")
    for name, title in TITLES.items():
        commands = state[name]["commands"]
        report.text(f"**{title}**, {state[name]['seconds']:.0f} s")
        if commands:
            report.code("\n".join(commands))
    write_result(
        out,
        {
            "success_percent": evaluation["success_percent"],
            "episodes": evaluation["episodes"],
            "final_loss": training["losses"][-1],
            "seconds": {name: state[name]["seconds"] for name in TITLES},
        },
    )
    return report.write(out / "report.html")


def demonstration_strip(root: Path, frames: int = 8) -> np.ndarray:
    """Tactile images of the first episode around its strongest contact, side by side, uint8 (H, W, 3)."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset(f"local/{root.name}", root=root, episodes=[0])
    names = dataset.features["observation.state"]["names"]
    area = np.array(
        [float(s[names.index("contact_area.pos")]) for s in dataset.hf_dataset["observation.state"]]
    )
    peak = int(area.argmax())
    picks = np.clip(np.linspace(peak - 20, peak + 20, frames).astype(int), 0, len(dataset) - 1)
    images = [dataset[int(i)]["observation.images.tactile"].numpy() for i in picks]
    return (np.concatenate([i.transpose(1, 2, 0) for i in images], axis=1) * 255).round().astype(np.uint8)
