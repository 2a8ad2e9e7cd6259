"""`pneutac report`: a twin with its history as one page, or as a file for Rerun."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.study.pair import load_bench_pair
from lerobot_pneutac.verbs.report import report
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin


@dataclass
class ReportConfig:
    """Options of `pneutac report`.

    Attributes:
        twin: folder of the twin; `pneutac report DIR` is the same as `--twin=DIR`.
        out: folder for `result.json` and `report.html`; nothing is written without it.
        rrd: file ending in .rrd to write for Rerun's viewer: the finger or arm over its pressures.
        recording: with `rrd`: a recording of it instead, measured and modelled.
    """

    first: ClassVar = "twin"

    twin: Path
    out: Path | None = None
    rrd: Path | None = None
    recording: Path | None = None

    def __post_init__(self):
        if self.rrd is not None and self.rrd.suffix != ".rrd":
            raise InputError(f"rrd={self.rrd} must end in .rrd.")
        if self.recording is not None and self.rrd is None:
            raise InputError(
                f"recording={self.recording} goes with --rrd=FILE; `pneutac compare` reports on it."
            )


def command(cfg: ReportConfig, terminal: Terminal) -> None:
    """A twin with its history as one page to send to somebody, or as a file for Rerun."""
    twin, recording = Twin.load(cfg.twin), None
    if cfg.recording is not None:
        twin, recording = load_bench_pair(cfg.twin, cfg.recording, "report on")
    terminal.finish(report(twin), cfg.out)
    if cfg.rrd is not None:
        from lerobot_pneutac.studio.rerun_file import write_rrd

        cfg.rrd.parent.mkdir(parents=True, exist_ok=True)
        frames = write_rrd(cfg.rrd, twin, recording)
        terminal.say(f"{cfg.rrd}: {frames} frames; `rerun {cfg.rrd}` shows them")
