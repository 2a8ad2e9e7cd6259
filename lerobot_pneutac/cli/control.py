"""`pneutac control`: makes a pressure program that bends a finger as asked, and shows how it followed."""

from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.cli.show import finish
from lerobot_pneutac.study.pair import same_body
from lerobot_pneutac.verbs.control import control
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.twin import Twin


@dataclass
class ControlConfig:
    """Options of `pneutac control`.

    Attributes:
        twin: folder of a finger's calibrated twin.
        bend: `steps`, `sine` or `loops` inside the finger's reach, or a CSV with `time_s` and
            `bend_angle_rad`.
        hz: control steps a second.
        conditions: what the twin's effects ask for, such as {temperature_c: 22}.
        recording: folder of a recording in which the program was driven; shows how well the finger followed.
        out: folder for `program.csv`, `result.json` and `report.html`; nothing is written without it.
    """

    twin: Path
    bend: str = "sine"
    hz: float = 20.0
    conditions: dict[str, float] = field(default_factory=dict)
    recording: Path | None = None
    out: Path | None = None


def main(argv: list[str]) -> None:
    """Runs the verb."""
    cfg, console = parse_options(ControlConfig, argv), Console()
    twin = Twin.load(cfg.twin)
    recording = Recording.load(cfg.recording) if cfg.recording else None
    if recording is not None:
        same_body(twin, recording, "control")
    result = control(twin, cfg.bend, cfg.hz, cfg.conditions, recording)
    finish(result, console, cfg.out, "control", argv)
