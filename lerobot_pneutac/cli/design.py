"""`pneutac design`: the program, a gel's press or an arm's motions that tell most of what is missing."""

from dataclasses import dataclass, fields
from pathlib import Path

from rich.console import Console

from lerobot_pneutac.cli.options import TableOptions, parse_options
from lerobot_pneutac.cli.progress import progress_bar
from lerobot_pneutac.cli.show import finish
from lerobot_pneutac.diagnosis.hands import GRAVITY, Hands, named
from lerobot_pneutac.study.pair import load_bench_pair, load_pair
from lerobot_pneutac.verbs.design import design
from lerobot_pneutac.verbs.design_press import design_press
from pneutac_datasets.demonstrations.replay.reading import is_dataset
from pneutac_sim.errors import InputError


@dataclass
class DesignConfig(TableOptions):
    """Options of `pneutac design`.

    Attributes:
        twin: folder of the twin that was diagnosed.
        recording: folder of the recording that was diagnosed, or its tables; or of a LeRobotDataset of
            demonstrations, or its name on the Hub, for which the next motions of the arm are chosen.
        diagnosis: folder that `pneutac diagnose --out=` wrote; demonstrations need none.
        task: of demonstrations: what stood in front of the robot, where their instruction does not tell.
        station: of demonstrations: `station.yaml`, where their robot left none in them.
        out: folder for `program.csv` (of a gel `press.csv`), `result.json` and `report.html`; nothing is
            written without it.
        max_kpa: highest set-point, one for all chambers or one for each; that of the recording where none is
            given.
        min_kpa: lowest set-point, likewise; that of the recording, 0 at most, where none is given.
        budget_s: longest program.
        program_s: length of a program of the common kinds.
        hz: samples a second.
        hands: what may be changed for it: `none`, or `flip` (turn the base over), `payload` (hang a weight at
            the tip) and `warm`, with commas.
        payload_g: weight that can be hung.
        warm_c: to which the finger can be warmed.
    """

    twin: Path
    recording: Path
    diagnosis: Path | None = None
    out: Path | None = None
    task: str = ""
    station: Path | None = None
    max_kpa: float | tuple[float, ...] | None = None
    min_kpa: float | tuple[float, ...] | None = None
    budget_s: float = 600.0
    program_s: float = 60.0
    hz: float = 20.0
    hands: str = "none"
    payload_g: float = 20.0
    warm_c: float = 35.0

    def __post_init__(self):
        for name in ("budget_s", "program_s", "hz", "payload_g"):
            if not 0 < getattr(self, name) < float("inf"):
                raise InputError(f"{name}={getattr(self, name)} must be positive.")


def main(argv: list[str]) -> None:
    """Runs the verb."""
    cfg, console = parse_options(DesignConfig, argv), Console()
    if is_dataset(cfg.recording):
        from lerobot_pneutac.verbs.design_motion import design_motion  # MuJoCo, which benches do not need

        _take_no_more(cfg, "max_kpa", "the next demonstrations have")
        if cfg.diagnosis:
            raise InputError("diagnosis: motions are chosen by the twin alone; leave it out.")
        twin, shown = load_pair(cfg.twin, cfg.recording, "design by", cfg.task, cfg.station)
        with progress_bar(Console(stderr=True)) as progress:
            motion = design_motion(twin, shown, progress)
        return finish(motion, console, cfg.out, "design", argv)
    twin, recording = load_bench_pair(cfg.twin, cfg.recording, "design by")
    if cfg.diagnosis is None:
        raise InputError("Give the folder that `pneutac diagnose --out=DIR` wrote, as --diagnosis=DIR.")
    limits = (cfg.max_kpa, cfg.min_kpa, cfg.budget_s, cfg.program_s, cfg.hz)
    if recording.device == "gel":
        _take_no_more(cfg, "task", "a press of a gel has")
        press = design_press(twin, recording, cfg.diagnosis)
        return finish(press, console, cfg.out, "design", argv)
    usual = {
        c: float(recording.column(c)[0]) for c in (*GRAVITY, "payload_g", "temperature_c") if recording.has(c)
    }
    hands = Hands.of(named(cfg.hands), usual, cfg.payload_g, cfg.warm_c)
    result = design(twin, recording, cfg.diagnosis, *limits, hands)
    finish(result, console, cfg.out, "design", argv)


def _take_no_more(cfg: DesignConfig, first: str, has: str) -> None:
    """Raises InputError where an option from the first on is given."""
    options = fields(cfg)
    for option in options[[o.name for o in options].index(first) :]:
        if getattr(cfg, option.name) != option.default:
            raise InputError(f"{option.name}: {has} no such option; leave it out.")
