"""`pneutac report`: a twin with its history as one page, or as a file for Rerun."""

from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import ClassVar

import numpy as np

from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.reports.figures import session_clock
from lerobot_pneutac.studio.live import LiveBody, Skin, measured_tips, shape_of
from lerobot_pneutac.studio.plots import MEASURED, SKIN, TRAIL, rgb
from lerobot_pneutac.study.pair import load_bench_pair
from lerobot_pneutac.verbs.compare import compare
from lerobot_pneutac.verbs.history import report
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.features import CHAMBERS
from pneutac_sim.files import check_new_file, check_writable, whole
from pneutac_sim.finger import Pipeline
from pneutac_sim.twin import Twin


@dataclass
class ReportConfig:
    """Options of `pneutac report`."""

    first: ClassVar = "twin"

    twin: Path  # folder of the twin; `pneutac report DIR` is the same as `--twin=DIR`
    out: Path | None = None  # folder for `result.json` and `report.html`; nothing is written without it
    rrd: Path | None = None  # file ending in .rrd to write for Rerun's viewer: the body over its pressures
    recording: Path | None = None  # with `rrd`: a recording of it instead, measured and modelled

    def __post_init__(self):
        if self.rrd is not None and self.rrd.suffix != ".rrd":
            raise InputError(f"rrd={self.rrd} must end in .rrd.")
        if self.rrd is not None:
            check_writable(self.rrd.parent, f"{self.rrd.parent}, the folder of --rrd={self.rrd},")
            check_new_file(self.rrd, f"rrd={self.rrd}")
        if self.recording is not None and self.rrd is None:
            raise InputError(
                f"recording={self.recording} goes with --rrd=FILE; `pneutac compare` reports on it."
            )


def command(cfg: ReportConfig, terminal: Terminal) -> None:
    twin, recording = Twin.load(cfg.twin), None
    if cfg.recording is not None:
        twin, recording = load_bench_pair(cfg.twin, cfg.recording, "report on")
    if cfg.rrd is not None:
        with whole(cfg.rrd) as part:
            frames = write_rrd(part, twin, recording)
    terminal.finish(report(twin), cfg.out)
    if cfg.rrd is not None:
        terminal.say(f"{cfg.rrd}: {frames} frames; `rerun {quote(str(cfg.rrd))}` shows them")


MOST_FRAMES = 1500
SWEEP_S, HZ = 10.0, 20.0


def write_rrd(file: Path, twin: Twin, recording: Recording | None = None) -> int:
    """Writes a twin on a recording and the measurement, or up and down its pressures; returns frames.

    Lengths are in mm, time is that of the recording with its trials laid end to end.
    """
    if twin.device not in CHAMBERS:
        raise InputError(f"The twin is of a {twin.device}; --rrd takes a finger or an arm.")
    import rerun as rr  # which the bench, without LeRobot, writes its pages without

    stream = rr.RecordingStream("pneutac")
    stream.save(str(file))
    skin, joints = Skin.of(twin), np.array(twin.spine_joint_positions_mm)

    surface = {"triangle_indices": skin.faces, "albedo_factor": (*SKIN, 140)}
    stream.set_time("time", duration=0.0)
    stream.log("body/skin", rr.Mesh3D(vertex_positions=skin.vertices_mm, **surface))

    def show(time_s: float, shape) -> None:
        stream.set_time("time", duration=time_s)
        vertices, spine = skin.carried_mm(shape, joints), shape.spine_mm(twin.length_mm, joints)
        stream.log("body/skin", rr.Mesh3D.from_fields(vertex_positions=vertices))
        stream.log("body/spine", rr.LineStrips3D([spine]))
        stream.log("body/tip", rr.Points3D([shape.markers[:3]], colors=[TRAIL], radii=[2.0]))
        stream.log("bend_deg", rr.Scalars(shape.bend_deg))

    if recording is None:  # slowly up and down the pressures that it was measured over, chamber by chamber
        low, high = twin.pressure_range_kpa
        body, chambers = LiveBody(twin, {}), CHAMBERS[twin.device]
        ramp = low + (high - low) * (1 - np.abs(np.linspace(-1, 1, int(SWEEP_S * HZ))))
        commands = np.concatenate([np.outer(ramp, row) for row in np.eye(chambers)])
        for i, command in enumerate(commands):
            show((i + 1) / HZ, body.step(command, np.zeros(3), 1 / HZ))
            stream.log("pressure_kpa", rr.Scalars(command))
        stream.flush()
        return len(commands)
    c = compare(twin, recording)
    pipeline = Pipeline.of(twin, c.bench.inputs)
    run = pipeline.run(c.bench.inputs, pipeline.theta(twin, c.bench.inputs.pressure_range_kpa))
    error, (time_s, _), tips = np.sqrt(c.squared), session_clock(c.recording), measured_tips(c)
    shown = range(0, len(error), -(-len(error) // MOST_FRAMES))
    for i in shown:
        show(time_s[i], shape_of(run.joints[i], run.markers[i], twin))
        if tips is not None:
            stream.log("body/measured_tip", rr.Points3D(tips[i : i + 1], colors=[rgb(MEASURED)], radii=[2.0]))
        stream.log(f"error_{c.unit}", rr.Scalars(error[i]))
        for k, name in enumerate(c.columns[: c.counted]):
            stream.log(f"{name}/measured", rr.Scalars(c.measured[i, k]))
            stream.log(f"{name}/model", rr.Scalars(c.model[i, k]))
    stream.flush()
    return len(shown)
