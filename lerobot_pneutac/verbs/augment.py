"""`pneutac augment`: makes many demonstrations out of a few, carried out on the twin."""

import shlex
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.reports.page import SERIES, Report
from lerobot_pneutac.verbs.result import Result
from pneutac_datasets.demonstrations.augment.options import MOST_REAL, AugmentConfig, DatasetRef
from pneutac_datasets.demonstrations.augment.reference import Reference, onset_sigma_m, read_references
from pneutac_datasets.demonstrations.faults import Recorded
from pneutac_datasets.recording.wording import plural
from pneutac_sim.errors import InputError
from pneutac_sim.executor import Progress, no_progress
from pneutac_sim.features import VELOCITY_NAMES, Places
from pneutac_sim.gel.contact import without_specks
from pneutac_sim.twin import Twin
from pneutac_sim.world.station import Station, station_of

__all__ = ["Augmentation", "AugmentConfig", "DatasetRef", "augment", "command"]

FEW_ATTEMPTS, FEW_WORKED = 20, 0.15  # with demonstrations of the same finger 17 % or more do the task


@dataclass(frozen=True)
class Augmentation(Result):
    """What an augmentation came to."""

    heading = "Augmentation of {0.config.dataset.repo_id} ({0.config.method})"

    config: AugmentConfig
    summary: dict  # `kept`, `attempts`, `rejected` (reason to number), `wall_s`, and the provenance
    references: list  # the recorded demonstrations that were used
    failed: dict[int, str] = field(default_factory=dict)  # the others, number to why each was set aside
    set_aside: list[str] = field(default_factory=list)  # the same as a sentence, if there are any

    @property
    def share(self) -> float:
        """Of the variants that were tried, those that did the task."""
        return self.summary["kept"] / self.summary["attempts"]

    @property
    def made(self) -> int:
        """New demonstrations of this run, without those of one that was stopped."""
        return self.summary["kept"] - self.summary.get("earlier", 0)

    def rows(self) -> list[dict]:
        rejected = {f"rejected: {reason}": count for reason, count in self.summary["rejected"].items()}
        counts = {"accepted": self.summary["kept"]} | rejected | {"yield": f"{100 * self.share:.0f} %"}
        return [{"variants": name, "number": number} for name, number in counts.items()]

    def remarks(self) -> list[str]:
        stored, minutes = self.summary["kept"], self.summary["wall_s"] / 60
        checks, out = self.summary.get("checks", []), []
        if checks:
            agree = sum(c["success"] for c in checks)
            out.append(f"Material points do the task in {agree} of {len(checks)} of them too.")
        pace = f"{minutes:.1f} minutes, {self.made / minutes:.0f} a minute"
        before = f"{stored - self.made} of them by a run that was stopped; " * (self.made < stored)
        new = f"{stored} new ones in {self.config.output.root} ({before}{pace})"
        out.append(f"{len(self.references)} demonstrations in, {new}.")
        attempts = self.summary.get("attempts", stored)
        if attempts >= FEW_ATTEMPTS and stored < FEW_WORKED * attempts:
            out.append(
                f"Only {stored} of {attempts} attempts did the task: are the demonstrations of this task and"
                f" of the twin's finger, {self.subject()[0].length_mm:g} mm long (--twin)?"
            )
        if start_range := self.summary.get("start_range_m"):
            reach = " / ".join(f"{1e3 * each:.0f}" for each in start_range)
            out.append(f"They start up to {reach} mm (x / y / z) away from recorded starts (--start_range).")
        if late := self.summary.get("answer_delay_frames"):
            earlier = "pneutac_bc learns to answer earlier, by at most 0.2 s (--policy.answer_delay)"
            out.append(f"The demonstrator answers a touch {plural(late, 'frame')} late; {earlier}.")
        if copies := self.summary.get("copies", 0):
            mixed = "so that training on it mixes both (--real_share); do not merge it with them again"
            times = plural(copies // len(self.references), "time")
            out.append(f"The dataset holds the recorded ones {times}, {mixed}.")
        elif share := self.config.real_share:
            recorded = sum(map(len, self.references))
            one = recorded / (recorded + sum(line["frames"] for line in self.summary["provenance"]))
            none = f"The dataset holds none of the recorded ones: --real_share={share:g}"
            other = f", or give --real_share={one:.2f} and a new folder" if one <= MOST_REAL else ""
            remedy = f"Make more (--episodes){other}"
            out.append(f"{none}, and one copy of them would be {100 * one:.0f} % of its frames. {remedy}.")
        return out

    def subject(self) -> tuple[Twin, Path]:
        twin = Twin.load(self.config.twin) if self.config.twin else Twin.builtin()
        return twin, self.config.dataset.root

    @property
    def next_command(self) -> str:
        new = self.config.output
        options = [f"--dataset.repo_id={new.repo_id}", f"--dataset.root={new.root}", "--policy.device=cpu"]
        options += [f"--output_dir={new.root}_policy", "--env_eval_freq=0", "--wandb.enable=false"]
        return shlex.join(["lerobot-train", "--policy.type=pneutac_bc", *options])

    def content(self) -> dict:
        s, rmse = self.summary, [p["area_rmse"] for p in self.summary["provenance"] if "area_rmse" in p]
        out = {k: s[k] for k in ("kept", "attempts", "rejected", "wall_s", "seconds", "scenes")}
        out |= {"method": self.config.method, "copies": s.get("copies", 0), "yield": self.share}
        out |= {"start_range_m": s.get("start_range_m"), "area_rmse": float(np.mean(rmse)) if rmse else None}
        out |= {"onset_sigma_mm": 1e3 * onset_sigma_m(self.references)}
        out |= {"demonstrations_per_minute": 60 * self.made / s["wall_s"]}
        out |= {"checks": s["checks"]} if "checks" in s else {}
        return out | ({"set_aside": self.failed} if self.failed else {})

    def page(self) -> Report:
        summary, references, output = self.summary, self.references, self.config.output
        report = Report(f"{summary['kept']} demonstrations from {len(references)}")
        did = f"{summary['kept']} did the task ({100 * self.share:.0f} %)"
        minutes = f"{summary['wall_s'] / 60:.1f} minutes"
        minutes += " since it went on" * (self.made < summary["kept"])
        report.lead(f"{summary['attempts']} variants were tried and {did}, in {minutes}.")
        moved = "; objects and reference trajectories were moved together by as much in x and y"
        sigma = " / ".join(f"{s:.1f}" for s in 1e3 * onset_sigma_m(references))
        begin = f"within {sigma} mm (standard deviation in x / y / z){moved * bool(summary['scenes'])}"
        report.text(f"Contacts of the recorded demonstrations begin {begin}.")
        late = {line["late_commands"] for line in summary["provenance"] if "late_commands" in line}
        if late:
            fit = f"the recorded paths fit the twin best where commands act {max(late)} control steps late"
            report.text(f"Until the touch {fit}; so they do in the new demonstrations.")
        report.table(self.rows(), "Yield")
        if summary["scenes"]:
            scenes = [
                {"demonstration": r.source, "works in the twin": s["works"]}
                | {"contact area RMSE": s["area_rmse"]}
                | {"object moved (mm)": ", ".join(f"{1e3 * x:.1f}" for x in s["shift_m"][:2])}
                for r, s in zip(references, summary["scenes"], strict=False)
            ]
            stood = "Where the object stood: the replay of each recorded demonstration in the twin"
            report.table(scenes, stood)
        if "checks" in summary:
            checks = [
                {"demonstration": c["episode"], "does the task": c["success"]}
                | {"steps with touch, planned / checked": " / ".join(map(str, c["touched"]))}
                | {"contact area RMSE": c["area_rmse"], "largest contact area": c["area_peak"]}
                | {"image RMSE (levels)": c["image_rmse_levels"], "minutes": c["seconds"] / 60}
                for c in summary["checks"]
            ]
            report.table(checks, "Carried out once more by material points")
        report.heading("Touch")
        states = _states(output.repo_id, output.root)[: summary["kept"]]
        sources = [line["source_episode"] for line in summary["provenance"]]
        report.figure(_touch(states, sources, references), "Contact area: recorded (thick) and new (thin)")
        report.figure(_paths(states, references), "Where the contacts begin, from above")
        for sentence in self.set_aside:
            report.text(sentence)
        return report


def augment(
    config: AugmentConfig, progress: Progress = no_progress, note: Callable[[str], None] = lambda _: None
) -> Augmentation:
    """Augments a LeRobotDataset; writes the new one, and goes on where it was stopped.

    Before anything is made `note` is called with a sentence on the failed demonstrations, and one where the
    twin's gel looks otherwise at rest. Raises InputError: a dataset cannot be read or exists, names no task,
    is of another task or sensor, fewer than two demonstrations have not failed, or too few variants succeed.
    """
    from pneutac_datasets.demonstrations.reading import check_new, task_to_do

    check_new(config.output.root, config.output.repo_id)  # before imports that take seconds
    recorded = Recorded(config.dataset.root)
    progress("reading the demonstrations", 0, 1)
    from lerobot_robot_pneutac.policy.tactile_encoder import other_sensor
    from pneutac_datasets.demonstrations.augment.episode import AugmentSetup
    from pneutac_datasets.demonstrations.augment.run import augment_guided
    from pneutac_datasets.demonstrations.episodes import further_features
    from pneutac_datasets.demonstrations.naive import augment_naive
    from pneutac_sim.gel.sensor import TactileSensor

    sensor, station = None, station_of(config.dataset.root, config.station)
    if config.method != "naive":
        twin = Twin.load(config.twin) if config.twin else Twin.builtin()
        if faults := recorded.faults(twin, station):
            raise InputError(" ".join(faults))
        sensor = TactileSensor(twin)
    meta, references = read_references(recorded, config.dataset.repo_id, sensor)
    if faults := recorded.too_few():
        raise InputError(faults[0])
    onset_sigma_m(references)
    if sensor is not None and (other := other_sensor(meta, sensor)):
        note(other)
    for sentence in recorded.set_aside():
        note(sentence)
    size = sum(file.stat().st_size for file in recorded.folder.rglob("*") if file.is_file())
    needed = 2 * size / len(recorded.episodes) * config.episodes  # in the work folder and the dataset
    folder = next(p for p in config.output.root.absolute().parents if p.exists())
    if needed > (free := shutil.disk_usage(folder).free):
        raise InputError(
            f"episodes is {config.episodes}, which take about {needed / 1e9:.3g} GB, and {folder} has"
            f" {free / 1e9:.3g} GB free; give at most {int(config.episodes * free / needed)}."
        )
    if config.method == "naive":
        summary = augment_naive(recorded, config, station, progress)
    else:
        further = further_features(meta)
        if further and config.device != "cpu":
            raise InputError(f"device=cuda does not make {', '.join(further)} of {meta.root}; leave it out.")
        task = task_to_do(config.task, [r.task for r in references], config.dataset.root)
        base_m = np.array((station or Station()).base_m)  # demonstrations have positions in the arm's frame
        placed = [replace(r, flange_m=r.flange_m + base_m) for r in references]
        setup = AugmentSetup(config, placed, task, station, further, tuple(meta.video_keys))
        summary = augment_guided(meta, setup, progress)
        summary["start_range_m"] = setup.start_range_m if config.method != "planner" else None
    return Augmentation(config, summary, references, recorded.failed, recorded.set_aside())


def command(config: AugmentConfig, terminal: Terminal) -> None:
    terminal.finish(terminal.run(augment, config, note=terminal.note), config.out)


SHOWN = 4  # recorded demonstrations whose touch is drawn


def _states(repo_id: str, root: Path) -> list[np.ndarray]:
    from lerobot.datasets import LeRobotDataset
    from lerobot.utils.constants import OBS_STATE

    dataset = LeRobotDataset(repo_id, root, video_backend="pyav")
    state = np.stack(dataset.hf_dataset.with_format("numpy")[OBS_STATE][:])
    rows = (dataset.meta.episodes[i] for i in range(dataset.num_episodes))
    return [state[r["dataset_from_index"] : r["dataset_to_index"]] for r in rows]


def _places(references: list[Reference]) -> Places:
    return Places.of(references[0].action.shape[1] - len(VELOCITY_NAMES))


def _touch(states: list[np.ndarray], sources: list[int], references: list[Reference]):
    from lerobot_pneutac.reports.figures import curves  # plotly

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


def _paths(states: list[np.ndarray], references: list[Reference]):
    import plotly.graph_objects as go

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
