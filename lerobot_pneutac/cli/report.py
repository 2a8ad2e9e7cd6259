"""`pneutac report DIR`: a twin with its history as one page to send to somebody, or as a file for Rerun."""

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.cli.show import finish
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
        recording: with `rrd`: a recording of it instead, measured beside modelled.
    """

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


def main(argv: list[str]) -> None:
    """Runs the verb."""
    given = [f"--twin={argv[0]}", *argv[1:]] if argv and not argv[0].startswith("-") else argv
    cfg, console = parse_options(ReportConfig, given), Console()
    twin, recording = Twin.load(cfg.twin), None
    if cfg.recording is not None:
        twin, recording = load_bench_pair(cfg.twin, cfg.recording, "report on")
    result = report(twin)
    finish(result, console, cfg.out, "report", given)
    if cfg.rrd is not None:
        from lerobot_pneutac.studio.rerun_file import write_rrd

        cfg.rrd.parent.mkdir(parents=True, exist_ok=True)
        frames = write_rrd(cfg.rrd, twin, recording)
        console.print(
            f"{cfg.rrd}: {frames} frames; `rerun {cfg.rrd}` shows them", highlight=False, soft_wrap=True
        )
