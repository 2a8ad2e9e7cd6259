"""`pneutac benchmark surrogate`: the networks against the material points that they stand in for.

Motions and contacts are of another seed than those of the training. They are collected one by one into the
output folder, so that an interrupted run goes on.
"""

from dataclasses import dataclass
from pathlib import Path

from pneutac_sim.errors import InputError

FRESH_SEED = 1000  # far from those that people train with


@dataclass
class BenchmarkSurrogateConfig:
    """Options of `pneutac benchmark surrogate`.

    Attributes:
        twin: a finger's twin with networks; the built-in one where it is not given.
        out: folder of the table; motions and contacts in it are not collected again.
        fast: one short motion, two contacts, few steps: shows that all works.
        trajectories: held-out motions of the finger.
        seconds: of each.
        contacts: held-out presses on the gel; the five indenters take turns.
        steps: control steps that each rate of the environment is measured over.
        environments: in the batch, each in a process of its own.
        particles: of the finger, about.
        device: of the material points, `auto`, `cpu` or `cuda`; the networks run on the CPU.
        seed: of motions and contacts; another one than that of the training.
    """

    twin: Path | None = None
    out: Path = Path("outputs/benchmark_surrogate")
    fast: bool = False
    trajectories: int = 4
    seconds: float = 0.5
    contacts: int = 20
    steps: int = 200
    environments: int = 2
    particles: int = 4000
    device: str = "auto"
    seed: int = FRESH_SEED

    def __post_init__(self):
        self.out = Path(self.out)
        if self.device not in ("auto", "cpu", "cuda"):
            raise InputError(f"--device is '{self.device}'; choose auto, cpu or cuda.")
        if self.fast:
            self.trajectories, self.seconds, self.contacts, self.steps = 1, 0.06, 2, 40
        if min(self.trajectories, self.contacts, self.environments) < 1 or self.steps < 20:
            raise InputError(
                "--trajectories, --contacts and --environments must be 1 or more, and --steps 20 or more."
            )
        if self.out.exists() and not self.out.is_dir():
            raise InputError(f"--out={self.out} is a file; give a folder.")


def main(argv: list[str]) -> None:
    """Runs the benchmark."""
    from rich.console import Console
    from rich.markdown import Markdown

    from lerobot_pneutac.benchmarks.surrogate.picture import picture
    from lerobot_pneutac.cli.options import parse_options
    from lerobot_pneutac.reports.page import write_result

    cfg = parse_options(BenchmarkSurrogateConfig, argv)
    console = Console()
    with console.status("") as status:
        result, shown = measure(cfg, status.update)
    cfg.out.mkdir(parents=True, exist_ok=True)
    write_result(cfg.out, result)
    (cfg.out / "table.md").write_text(table(result["rows"]))
    picture(*shown).save(cfg.out / "contact.png")
    console.print(Markdown(table(result["rows"])))
    console.print(f"result.json, table.md and contact.png are in {cfg.out}", highlight=False)


def measure(cfg: BenchmarkSurrogateConfig, tell=lambda text: None) -> tuple[dict, tuple]:
    """Everything; returns the result, with `rows` of the table, and what the picture shows.

    Raises:
        InputError: the twin is no finger's or has no networks of its own or that fit.
    """
    from lerobot_pneutac.benchmarks.surrogate import errors as errors
    from lerobot_pneutac.benchmarks.surrogate import speed as speed
    from pneutac_sim.mpm import runtime
    from pneutac_sim.surrogate.networks import Networks
    from pneutac_sim.twin import Twin

    twin = Twin.load(cfg.twin) if cfg.twin else Twin.builtin()
    if twin.device != "finger":
        raise InputError(f"{cfg.twin} is a twin of the device '{twin.device}'; give a finger's.")
    networks = Networks.of(twin)
    device = runtime.start(cfg.device)
    rows = errors.finger_rows(cfg, twin, networks.action, tell)
    gel, shown = errors.gel_rows(cfg, twin, networks.gel, tell)
    rows += gel
    rows += speed.against_full(cfg, twin, networks, tell)
    rows += speed.environment_rows(cfg, twin, tell)
    return {"device": device, "seed": cfg.seed, "fast": cfg.fast, "rows": rows}, shown


def row(what: str, unit: str, values, without=None, goal=None, paper=None, note: str = "") -> dict:
    """A row of the table from values of independent cases (n,): their mean and its standard error.

    Args:
        what: is measured.
        unit: of it.
        values: one a case.
        without: mean of the same without the network.
        goal: what it should be.
        paper: what the paper has.
        note: more.
    """
    import numpy as np

    values = np.asarray(values, float)
    sem = float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else None
    return {
        "what": what, "unit": unit, "mean": float(values.mean()), "sem": sem, "cases": len(values),
        "without": without, "goal": goal, "paper": paper, "note": note,
    }  # fmt: skip


def table(rows: list[dict]) -> str:
    """Rows as markdown."""
    lines = ["| what | measured | without network | goal | paper | |", "|---|---|---|---|---|---|"]
    for r in rows:
        spread = "" if r["sem"] is None else f" ± {_short(r['sem'])}"
        cells = [
            _short(r[k]) if isinstance(r[k], float) else r[k] or "" for k in ("without", "goal", "paper")
        ]
        lines.append(
            f"| {r['what']} | {_short(r['mean'])}{spread} {r['unit']} | {' | '.join(cells)} | {r['note']} |"
        )
    return "\n".join(lines) + "\n"


def _short(x: float) -> str:
    return f"{x:,.0f}" if abs(x) >= 100 else f"{x:.3g}"
