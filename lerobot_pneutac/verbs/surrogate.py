"""`pneutac surrogate`: trains the networks that stand in for a twin's material points, from full simulations.

Trajectories and contacts are collected one by one into the twin's folder, so that an interrupted run goes on.
"""

import shutil
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.reports.page import Report, write_result
from pneutac_datasets.recording.rules import an
from pneutac_sim.errors import InputError
from pneutac_sim.surrogate.fingerprint import fingerprint, gel_fingerprint
from pneutac_sim.surrogate.networks import builtin, fits
from pneutac_sim.twin import NETWORKS, Twin

DATA = "surrogate_data"  # in the twin's folder
CARD = "networks.md"


@dataclass
class SurrogateConfig:
    """Options of `pneutac surrogate`.

    Attributes:
        twin: folder of a finger's twin; the networks are written into it.
        trajectories: motions of the full finger, of `seconds` each; two sixths of them are held out.
        seconds: of each.
        contacts: presses on the full gel; of two kinds of indenter all are held out.
        particles: of the finger, about.
        fresh: train even where the networks that are shipped were trained for such a finger and gel.
        device: auto, cpu or cuda.
        seed: decides programs, contacts and weights.
        out: folder for report.html and result.json; none where it is not given.
    """

    twin: Path | None = None
    trajectories: int = 24
    seconds: float = 1.0
    contacts: int = 100
    particles: int = 4000
    fresh: bool = False
    device: str = "auto"
    seed: int = 0
    out: Path | None = None

    def __post_init__(self):
        if self.twin is None:
            raise InputError("Give the twin's folder with --twin=DIR.")
        if self.device not in ("auto", "cpu", "cuda"):
            raise InputError(f"--device is '{self.device}'; choose auto, cpu or cuda.")


def main(argv: list[str]) -> None:
    """Runs the verb."""
    cfg = parse_options(SurrogateConfig, argv)
    train(cfg, Twin.load(cfg.twin), Console())


def train(cfg: SurrogateConfig, twin: Twin, console: Console) -> dict:
    """Trains what is missing or outdated, writes networks and their card into the twin; returns the result.

    Raises:
        InputError: the twin is no finger's or has not been calibrated, or too little is to be collected.
    """
    if twin.device != "finger":
        raise InputError(
            f"{cfg.twin} is the twin of {an(twin.device)}, but the networks are of a finger and the gel on "
            "it; give a finger's with --twin=DIR."
        )
    if "gain_rad_per_kpa" not in twin.parameters:
        raise InputError(
            f"{cfg.twin} has not been calibrated (no gain_rad_per_kpa); run `pneutac calibrate "
            f"--twin={cfg.twin} --recording=DIR` first."
        )
    _enough(cfg)
    result = {"twin": str(cfg.twin), "networks": {}}
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed}/{task.total}"))
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as bar:
        for name in NETWORKS:
            file = Path(cfg.twin) / f"{name}.safetensors"
            began = time.perf_counter()
            if not cfg.fresh and fits(builtin(name), name, twin):
                shutil.copyfile(builtin(name), file)
                found = {"source": "shipped: this finger or gel is the built-in one"}
            else:
                found = {"source": "trained"} | (_action if name == "action" else _perception)(
                    cfg, twin, file, bar
                )
            result["networks"][name] = found | {"seconds": time.perf_counter() - began}
            twin.networks[name] = file
    _tell(cfg, result, console)
    return result


def _enough(cfg: SurrogateConfig) -> None:
    """Refuses what could not be trained on, before anything is collected."""
    from pneutac_sim.gel.indenter import INDENTERS
    from pneutac_sim.surrogate.action import FEWEST
    from pneutac_sim.surrogate.gel_train import CHECK_EVERY, HELDOUT, LEAST

    if cfg.trajectories < FEWEST:
        raise InputError(f"--trajectories={cfg.trajectories} are too few to train on; give {FEWEST} or more.")
    seen = max(CHECK_EVERY, LEAST + 1)
    fewest = next(
        n
        for n in range(seen, 100)
        if sum(INDENTERS[k % len(INDENTERS)] not in HELDOUT for k in range(n)) >= seen
    )
    if cfg.contacts < fewest:
        raise InputError(
            f"--contacts={cfg.contacts} are too few to train on, since those of {' and '.join(HELDOUT)} are "
            f"held out; give {fewest} or more."
        )


def _action(cfg: SurrogateConfig, twin: Twin, file: Path, bar: Progress) -> dict:
    from pneutac_sim.surrogate.action import evaluate_action, train_action
    from pneutac_sim.surrogate.collect import Plan, collect_action

    folder = Path(cfg.twin) / DATA / f"motions_{fingerprint(twin)[:8]}"
    plan = Plan(cfg.trajectories, cfg.seconds, cfg.particles, seed=cfg.seed)
    task = bar.add_task("finger: full motions", total=cfg.trajectories)
    bar.update(task, completed=len(list(folder.glob("action_*.safetensors"))))
    collect_action(
        twin,
        folder,
        plan,
        cfg.device,
        lambda _: bar.update(task, completed=len(list(folder.glob("action_*.safetensors")))),
    )
    bar.update(task, completed=cfg.trajectories, description="finger: training")
    network = train_action(
        twin, folder, cfg.seed, tell=lambda line: bar.update(task, description=f"finger: {line}")
    )
    errors = asdict(evaluate_action(twin, network, folder))
    errors = {k: v if np.isfinite(v) else None for k, v in errors.items()}  # one motion has no standard error
    network.save(file)
    bar.update(task, description="finger: done")
    return {"errors": errors}


def _perception(cfg: SurrogateConfig, twin: Twin, file: Path, bar: Progress) -> dict:
    from pneutac_sim.surrogate.gel_collect import collect_gel, read_contacts
    from pneutac_sim.surrogate.gel_evaluate import evaluate_gel
    from pneutac_sim.surrogate.gel_train import split, train_gel

    mark = gel_fingerprint(twin)
    folder = Path(cfg.twin) / DATA / f"contacts_{mark[:8]}"
    task = bar.add_task("gel: full contacts", total=cfg.contacts)
    collected = collect_gel(
        twin,
        folder,
        cfg.contacts,
        cfg.seed,
        cfg.device,
        lambda done, total: bar.update(task, completed=done, total=total),
    )
    epochs = bar.add_task("gel: training", total=None)
    network = train_gel(
        folder,
        mark,
        seed=cfg.seed,
        device=cfg.device,
        tell=lambda done, total: bar.update(epochs, completed=done, total=total),
    )
    _, check, unseen = split(read_contacts(folder))
    network.errors = evaluate_gel(network, check + unseen, twin)
    network.save(file)
    return {"errors": network.errors, "contacts": collected.contacts, "diverged": collected.diverged}


def _tell(cfg: SurrogateConfig, result: dict, console: Console) -> None:
    """Prints the card and writes it into the twin, and the report where one is wanted."""
    from pneutac_sim.surrogate.perception import GelSurrogate

    gel = GelSurrogate.load(Path(cfg.twin) / "perception.safetensors")
    rows = []
    action = result["networks"]["action"]
    if "errors" in action:
        e = action["errors"]
        rows += [
            (
                "joint angle, held out",
                f"{e['position_deg']:.4f}{_sem(e['position_sem'], 4)}°",
                f"{e['bare_position_deg']:.3f}°",
            ),
            (
                "joint rate, held out",
                f"{e['velocity_deg_s']:.2f}{_sem(e['velocity_sem'], 2)} °/s",
                f"{e['bare_velocity_deg_s']:.2f} °/s",
            ),
        ]
    for row in gel.errors.get("rows", []):
        rows.append(
            (
                f"gel face, {row['indenter']}, {row['contacts']} contacts, {row['depth_mm']:.2f} mm deep",
                f"{row['network']['mae_mm']:.3f} mm",
                f"{row['probe']['mae_mm']:.3f} mm",
            )
        )
    table = Table("what", "network", "without")
    for row in rows:
        table.add_row(*row)
    console.print(table)
    sources = [
        f"- {name}: {found['source']}, {found['seconds']:.0f} s" for name, found in result["networks"].items()
    ]
    card = [
        "# Networks of this twin",
        "",
        "`action.safetensors` gives the soft body's torque on the joints, `perception.safetensors` the gel's "
        "face from the probe grid; both against full material points that they were not trained on.",
        "",
        *sources,
        "",
        "| what | network | without |",
        "|---|---|---|",
        *(f"| {' | '.join(row)} |" for row in rows),
    ]
    (Path(cfg.twin) / CARD).write_text("\n".join(card) + "\n")
    console.print(f"networks and {CARD} are in {cfg.twin}", highlight=False)
    if cfg.out is not None:
        write_result(cfg.out, result)
        page = Report("Networks in place of material points")
        page.lead("Errors against the full simulation, on motions and contacts that were held out.")
        page.table([dict(zip(("what", "network", "without"), row, strict=True)) for row in rows])
        console.print(f"report: {page.write(cfg.out)}", highlight=False)


def _sem(x: float | None, digits: int) -> str:
    return "" if x is None else f" ± {x:.{digits}f}"
