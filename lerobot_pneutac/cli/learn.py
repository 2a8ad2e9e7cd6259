"""`pneutac learn`: asks the bench, program by program, until it is known what a twin lacks."""

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from lerobot_pneutac.cli.bench import check_bench, make_bench
from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.cli.progress import progress_bar
from lerobot_pneutac.cli.show import finish
from lerobot_pneutac.diagnosis.hands import Hands, named
from lerobot_pneutac.verbs.learn import learn
from lerobot_pneutac.verbs.learning import Round
from lerobot_robot_pneutac.hardware.parts import HardwareFault
from pneutac_sim.errors import InputError, check_least
from pneutac_sim.twin import Twin


@dataclass
class LearnConfig:
    """Options of `pneutac learn`.

    Attributes:
        twin: folder of the finger's or arm's twin, which is not changed.
        out: folder of programs, recordings and the learnt twin; a call with a folder that holds rounds goes
            on after them.
        bench: `standin`, the finger or the arm that stands in for a real one, or `measure`, your bench.
        measure: YAML file with the options of `pneutac measure` for your bench, without `program` and `out`.
        hands: what a person may be asked to change: `none`, or `flip` (turn the base over), `payload` (hang a
            weight at the tip) and `warm`, with commas; the stand-in does the first two by itself.
        payload_g: weight that can be hung.
        warm_c: to which the finger can be warmed.
        budget_min: minutes of programs, together.
        program_s: length of a program of the common kinds.
        seed: seed of the choice of what is held out, and of the stand-in's noise.
        jobs: number of threads of the search; 0 for all cores.
    """

    twin: Path
    out: Path
    bench: str = "standin"
    measure: Path | None = None
    hands: str = "none"
    payload_g: float = 20.0
    warm_c: float = 35.0
    budget_min: float = 15.0
    program_s: float = 60.0
    seed: int = 0
    jobs: int = 0

    def __post_init__(self):
        check_bench(self.bench, self.measure)
        check_least(5, program_s=self.program_s)
        check_least(1, payload_g=self.payload_g)


def main(argv: list[str]) -> None:
    """Runs the verb."""
    cfg, console = parse_options(LearnConfig, argv), Console()
    twin = Twin.load(cfg.twin)
    bench, usual = make_bench(cfg.measure, cfg.out, cfg.seed, twin.device)

    def ask(sentence: str) -> None:
        if cfg.measure is None:
            return
        try:
            console.input(f"[yellow]{sentence}[/] Then press Enter: ")
        except EOFError as e:
            raise InputError(f"{sentence} Nobody answers; give --hands=none, or a terminal.") from e

    hands = Hands.of(named(cfg.hands), usual, cfg.payload_g, cfg.warm_c, ask)

    def tell(r: Round) -> None:
        foreseen = "" if r.predicted_error is None else f", foreseen to {r.predicted_error:.3g}"
        console.print(
            f"round {r.number}, {r.program} ({r.seconds:.0f} s){foreseen}: {r.error:.3g} {r.unit} (noise "
            f"{r.noise:.3g}) with {', '.join(r.selected) or 'nothing'}, {r.verdict}",
            highlight=False,
        )

    try:
        with progress_bar(Console(stderr=True)) as progress:
            result = learn(
                twin, bench, cfg.out, budget_s=60 * cfg.budget_min, program_s=cfg.program_s, seed=cfg.seed,
                jobs=cfg.jobs, hands=hands, progress=progress, on_round=tell,
            )  # fmt: skip
    except HardwareFault as e:
        raise InputError(f"{e} Finished rounds are kept; the same command goes on after them.") from e
    finish(result, console, cfg.out, "learn", argv)
