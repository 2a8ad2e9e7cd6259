"""The report of an augmentation: yield, reasons, how the new touch follows the recorded one."""

from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from lerobot.datasets import LeRobotDataset
from lerobot.utils.constants import OBS_STATE

from lerobot_pneutac.reports.figures import curves
from lerobot_pneutac.reports.page import SERIES, Report
from pneutac_datasets.demonstrations.augment.reference import Reference, onset_sigma_m
from pneutac_datasets.demonstrations.faults import set_aside
from pneutac_sim.features import VELOCITY_NAMES, Places
from pneutac_sim.gel.contact import without_specks

SHOWN = 4  # recorded demonstrations whose touch is drawn


def augment_page(result) -> Report:
    """The page of an `Augmentation`."""
    summary, references, output = result.summary, result.references, result.config.output
    report = Report(f"{summary['kept']} demonstrations from {len(references)}")
    report.lead(
        f"{summary['attempts']} variants were tried and {summary['kept']} did the task "
        f"({100 * result.share:.0f} %), in {summary['wall_s'] / 60:.1f} minutes."
    )
    moved = "; objects and reference trajectories were moved together by as much in x and y"
    report.text(
        f"Contacts of the recorded demonstrations begin within "
        f"{' / '.join(f'{s:.1f}' for s in 1e3 * onset_sigma_m(references))} mm (standard deviation in "
        f"x / y / z){moved if summary['scenes'] else ''}."
    )
    late = {line["late_commands"] for line in summary["provenance"] if "late_commands" in line}
    if late:
        report.text(
            "Until the touch the recorded paths fit the twin best where commands act"
            f" {max(late)} control steps late; so they do in the new demonstrations."
        )
    report.table(result.rows(), "Yield")
    if summary["scenes"]:
        scenes = [
            {"demonstration": r.source, "works in the twin": s["works"], "contact area RMSE": s["area_rmse"]}
            | {"object moved (mm)": ", ".join(f"{1e3 * x:.1f}" for x in s["shift_m"][:2])}
            for r, s in zip(references, summary["scenes"], strict=False)
        ]
        report.table(scenes, "Where the object stood: the replay of each recorded demonstration in the twin")
    if "checks" in summary:
        report.table([_check_row(c) for c in summary["checks"]], "Carried out once more by material points")
    report.heading("Touch")
    states = _states(output.repo_id, output.root)[: summary["kept"]]
    sources = [line["source_episode"] for line in summary["provenance"]]
    report.figure(_touch(states, sources, references), "Contact area: recorded (thick) and new (thin)")
    report.figure(_paths(states, references), "Where the contacts begin, from above")
    if result.failed:
        recorded = len(references) + len(result.failed)
        report.text(set_aside(result.config.dataset.root, recorded, result.failed))
    return report


def _check_row(check: dict) -> dict:
    return {
        "demonstration": check["episode"],
        "does the task": check["success"],
        "steps with touch, planned / checked": " / ".join(map(str, check["touched"])),
        "contact area RMSE": check["area_rmse"],
        "largest contact area": check["area_peak"],
        "image RMSE (levels)": check["image_rmse_levels"],
        "minutes": check["seconds"] / 60,
    }


def _states(repo_id: str, root: Path) -> list[np.ndarray]:
    dataset = LeRobotDataset(repo_id, root, video_backend="pyav")
    state = np.stack(dataset.hf_dataset.with_format("numpy")[OBS_STATE][:])
    rows = (dataset.meta.episodes[i] for i in range(dataset.num_episodes))
    return [state[r["dataset_from_index"] : r["dataset_to_index"]] for r in rows]


def _places(references: list[Reference]) -> Places:
    return Places.of(references[0].action.shape[1] - len(VELOCITY_NAMES))


def _touch(states: list[np.ndarray], sources: list[int], references: list[Reference]) -> go.Figure:
    places = _places(references)
    lines = []
    for state, source in zip(states, sources, strict=True):
        if source in [r.source for r in references[:SHOWN]]:
            t = np.arange(len(state)) / references[0].control_hz
            style = {"color": SERIES[source % len(SERIES)], "width": 0.7}
            lines.append(("", t, state[:, places.area], style))
    for r in references[:SHOWN]:
        t, style = np.arange(len(r)) / r.control_hz, {"color": SERIES[r.source % len(SERIES)], "width": 3}
        lines.append((f"demonstration {r.source}", t, r.area, style))
    figure = curves(lines, "time (s)", "contact area (share of the image)")
    return figure.for_each_trace(lambda trace: trace.update(showlegend=bool(trace.name)))


def _paths(states: list[np.ndarray], references: list[Reference]) -> go.Figure:
    places = _places(references)
    touched = [(s, np.flatnonzero(without_specks(s[:, places.area]))) for s in states]
    new = [s[frames[0], places.ee] for s, frames in touched if len(frames)]
    old = [r.flange_m[r.onset] for r in references]
    figure = go.Figure()
    for name, points, size in (("new", new, 6), ("recorded", old, 12)):
        x, y, _ = 1e3 * np.array(points).T
        figure.add_scatter(x=x, y=y, mode="markers", name=name, marker={"size": size})
    figure.update_layout(xaxis_title="flange x (mm)", yaxis_title="flange y (mm)")
    return figure
