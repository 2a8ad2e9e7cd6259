"""The networks against the material points that they stand in for."""

from rich.console import Console
from rich.markdown import Markdown

from lerobot_pneutac.reports.page import write_result
from pneutac_benchmarks.surrogate.errors import finger_rows, gel_rows
from pneutac_benchmarks.surrogate.options import BenchmarkSurrogateConfig
from pneutac_benchmarks.surrogate.picture import picture
from pneutac_benchmarks.surrogate.rows import table
from pneutac_benchmarks.surrogate.speed import against_full, environment_rows
from pneutac_sim.errors import InputError
from pneutac_sim.mpm import runtime
from pneutac_sim.surrogate.finger import Networks
from pneutac_sim.twin import Twin


def benchmark_surrogate(cfg: BenchmarkSurrogateConfig) -> None:
    """Runs the benchmark."""
    console = Console()
    with console.status("") as status:
        result, shown = measure(cfg, status.update)
    cfg.out.mkdir(parents=True, exist_ok=True)
    write_result(cfg.out, result)
    (cfg.out / "table.md").write_text(table(result["rows"]))
    picture(*shown).save(cfg.out / "contact.png")
    console.print(Markdown(table(result["rows"])))
    console.print(f"result.json, table.md and contact.png are in {cfg.out}", highlight=False)


def measure(cfg: BenchmarkSurrogateConfig, progress=lambda text: None) -> tuple[dict, tuple]:
    """Everything; returns the result, with `rows` of the table, and what the picture shows.

    Raises:
        InputError: the twin is no finger's or has no networks of its own or that fit.
    """
    twin = Twin.load(cfg.twin) if cfg.twin else Twin.builtin()
    if twin.device != "finger":
        raise InputError(f"{cfg.twin} is a twin of the device '{twin.device}'; give a finger's.")
    networks = Networks.of(twin)
    device = runtime.start(cfg.device)
    rows = finger_rows(cfg, twin, networks.action, progress)
    gel, shown = gel_rows(cfg, twin, networks.gel, progress)
    rows += gel + against_full(cfg, twin, networks, progress) + environment_rows(cfg, twin, progress)
    return {"device": device, "seed": cfg.seed, "fast": cfg.fast, "rows": rows}, shown
