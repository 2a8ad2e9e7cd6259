"""Networks that stand in for a twin's material points, trained from full simulations.

Trajectories and contacts are collected one by one into the twin's folder, so that an interrupted run goes on.
"""

import shlex
import shutil
import time
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np

from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.verbs.result import Result
from pneutac_datasets.recording.wording import an
from pneutac_sim.errors import InputError, check_between, check_choice, refuse_given
from pneutac_sim.executor import ExecutorOptions, Progress, no_progress
from pneutac_sim.files import locked, whole, write_text
from pneutac_sim.surrogate.finger import builtin, fingerprint, fits, gel_fingerprint
from pneutac_sim.twin import NETWORKS, Twin

DATA = "surrogate_data"  # in the twin's folder
CARD = "networks.md"
HEADER = ("what", "network", "without")
# Seconds of processor time for a finger of six joints (`benchmarks/surrogate.md`): of a simulated second of
# motion and the fit to it; of a contact and the fit to it.
MOTION_S, FIT_S, CONTACT_S, GEL_FIT_S = 14.0, 8.0, 4.5, 2.5
FROM_NOTHING = 10  # times as long takes a fit for the gel whose network is shipped: it begins with none
REFINED = "--trajectories=24 --seconds=1 --contacts=100"


@dataclass
class SurrogateConfig(ExecutorOptions):
    """Options of `pneutac surrogate`; without workers or executor this process collects, on all cores."""

    outputs: ClassVar = ("twin",)

    twin: Path  # folder of a finger's twin; the networks are written into it
    trajectories: int = 12  # number of motions of the full finger; two sixths of them are held out
    seconds: float = 0.5  # length of each motion
    contacts: int = 24  # number of presses on the full gel; of two kinds of indenter all are held out
    particles: int = 4000  # number of material points of the finger, about
    fresh: bool = False  # trains also where the shipped networks were trained for such a finger and gel
    device: str = "auto"  # `auto`, `cpu` or `cuda`
    seed: int = 0  # seed of programs, contacts and weights
    out: Path | None = None  # folder for `result.json` and `report.html`; nothing is written without it

    def __post_init__(self):
        self.check_executor()
        if not 0.02 <= self.seconds <= 600:
            raise InputError(f"seconds is {self.seconds}; it must lie in [0.02, 600].")
        check_between(100, 1_000_000, particles=self.particles)
        check_between(1, 100_000, trajectories=self.trajectories, contacts=self.contacts)

    def to_train(self, twin: Twin) -> list[str]:
        """Those of `NETWORKS` that are not shipped for such a finger or gel; all of them where `fresh`."""
        return [name for name in NETWORKS if self.fresh or not fits(builtin(name), name, twin)]

    def minutes(self, twin: Twin) -> float:
        """How long two cores take for it, about, if nothing else runs there; 0 where all is shipped."""
        if twin.device != "finger":  # which training refuses
            return 0.0
        missing = self.to_train(twin)
        finger = self.trajectories * self.seconds * (MOTION_S * self.particles / 4000 + FIT_S)
        shipped = fits(builtin("perception"), "perception", twin)
        gel = self.contacts * (CONTACT_S + GEL_FIT_S * (FROM_NOTHING if shipped else 1))
        return sum(s for name, s in (("action", finger), ("perception", gel)) if name in missing) / 60

    def check(self) -> None:
        """Refuses what could not be trained on, before anything is collected; raises InputError."""
        from pneutac_sim.gel.indenter import INDENTERS
        from pneutac_sim.surrogate.action import FEWEST
        from pneutac_sim.surrogate.gel_train import CHECK_EVERY, HELDOUT, LEAST

        check_choice("device", self.device, ("auto", "cpu", "cuda"))
        few = "are too few to train on"
        if self.trajectories < FEWEST:
            raise InputError(f"trajectories={self.trajectories} {few}; give {FEWEST} or more.")
        seen, fewest, used = max(CHECK_EVERY, LEAST + 1), 0, 0
        while used < seen:
            used += INDENTERS[fewest % len(INDENTERS)] not in HELDOUT
            fewest += 1
        if self.contacts < fewest:
            why = f"since those of {' and '.join(HELDOUT)} are held out"
            raise InputError(f"contacts={self.contacts} {few}, {why}; give {fewest} or more.")


@dataclass(frozen=True)
class TrainedNetworks(Result):
    """What was trained."""

    twin: Twin  # whose folder has the networks
    networks: dict  # name to `source`, `seconds` and, of those trained, `errors`
    errors: list[tuple[str, str, str]]  # on what was held out: what, with the network, without

    heading = "Networks in place of material points"
    sentence = "Errors against the full simulation, on motions and contacts that were held out."
    keys = (("twin", "twin.folder"), "networks")

    def rows(self) -> list[dict]:
        return [dict(zip(HEADER, row, strict=True)) for row in self.errors]

    def remarks(self) -> list[str]:
        finer = f"For finer ones repeat with {REFINED}; contacts that were collected are used again."
        return [finer] * any(found["source"] == "trained" for found in self.networks.values())

    @property
    def next_command(self) -> str:
        return shlex.join(["pneutac", "benchmark", "surrogate", f"--twin={self.twin.folder}"])


def train_networks(config: SurrogateConfig, twin: Twin, progress: Progress = no_progress) -> TrainedNetworks:
    """Trains what is missing or outdated, and writes networks and their card into the twin's folder.

    Raises InputError: the options do not fit, or another process trains networks of this twin.
    """
    folder = Path(config.twin)
    if twin.device != "finger":
        of = f"{folder} is the twin of {an(twin.device)}, but the networks are of a finger and the gel on it"
        raise InputError(f"{of}; give a finger's twin.")
    config.check()
    networks, missing = {}, config.to_train(twin)
    with locked(folder / DATA, wait_s=0.0) if missing else nullcontext():
        for name in NETWORKS:
            file, start = folder / f"{name}.safetensors", time.perf_counter()
            if name not in missing:
                with whole(file) as part:
                    shutil.copyfile(builtin(name), part)
                found = {"source": "shipped: this finger or gel is the built-in one"}
            else:
                train = _train_action if name == "action" else _train_perception
                found = {"source": "trained"} | train(config, twin, file, progress)
            networks[name] = found | {"seconds": time.perf_counter() - start}
            twin.networks[name] = file
    twin.folder = folder
    trained = TrainedNetworks(twin, networks, _errors(networks, folder))
    sources = (f"- {name}: {found['source']}, {found['seconds']:.0f} s" for name, found in networks.items())
    about = (
        "`action.safetensors` gives the soft body's torque on the joints, `perception.safetensors` the gel's "
        "face from the probe grid; both against full material points that they were not trained on."
    )
    rows = (f"| {' | '.join(row)} |" for row in (HEADER, ("---",) * 3, *trained.errors))
    card = ["# Networks of this twin", "", about, "", *sources, "", *rows, ""]
    write_text(folder / CARD, "\n".join(card))
    return trained


def _executor(config: SurrogateConfig) -> SurrogateConfig | None:
    """Where motions and contacts are collected, each on one core; None for this process."""
    return None if config.executor == "local" and config.workers is None else config


def _train_action(c: SurrogateConfig, twin: Twin, file: Path, progress: Progress) -> dict:
    from pneutac_sim.surrogate.action import evaluate_action, train_action
    from pneutac_sim.surrogate.collect import Plan, collect_action

    total = c.trajectories
    folder = file.parent / DATA / f"motions_{fingerprint(twin)[:8]}_{total}x{c.seconds:g}s"

    def show(*_) -> None:
        progress("finger: full motions", len(list(folder.glob("action_*.safetensors"))), total)

    show()
    plan = Plan(total, c.seconds, c.particles, seed=c.seed)
    collect_action(twin, folder, plan, c.device, show, _executor(c))
    network = train_action(twin, folder, c.seed, progress=lambda s: progress(f"finger: {s}", total, total))
    errors = asdict(evaluate_action(twin, network, folder))
    network.save(file)
    # one motion has no standard error
    return {"errors": {k: v if np.isfinite(v) else None for k, v in errors.items()}}


def _train_perception(c: SurrogateConfig, twin: Twin, file: Path, progress: Progress) -> dict:
    from pneutac_sim.surrogate.gel_collect import collect_gel, read_contacts
    from pneutac_sim.surrogate.gel_train import EPOCHS, EPOCHS_ON, evaluate_gel, split, train_gel
    from pneutac_sim.surrogate.perception import GelSurrogate

    mark, contacts = gel_fingerprint(twin), partial(progress, "gel: full contacts")
    folder = file.parent / DATA / f"contacts_{mark[:8]}"
    collected = collect_gel(twin, folder, c.contacts, c.seed, c.device, contacts, _executor(c))
    shipped = None if fits(builtin("perception"), "perception", twin) else builtin("perception")
    start, epochs = (GelSurrogate.load(shipped), EPOCHS_ON) if shipped else (None, EPOCHS)
    how = {"seed": c.seed, "epochs": epochs, "device": c.device, "start": start}
    network = train_gel(folder, mark, **how, progress=partial(progress, "gel: training"))
    _, check, unseen = split(read_contacts(folder))
    network.errors = evaluate_gel(network, check + unseen, twin)
    network.save(file)
    return {"errors": network.errors, "contacts": collected.contacts, "diverged": collected.diverged}


def _errors(networks: dict, folder: Path) -> list[tuple[str, str, str]]:
    from pneutac_sim.surrogate.perception import GelSurrogate

    rows = []
    if "errors" in networks["action"]:
        e = networks["action"]["errors"]
        angle = f"{e['position_deg']:.4f}{_sem(e['position_sem'], 4)}°"
        rate = f"{e['velocity_deg_s']:.2f}{_sem(e['velocity_sem'], 2)} °/s"
        rows.append(("joint angle, held out", angle, f"{e['bare_position_deg']:.3f}°"))
        rows.append(("joint rate, held out", rate, f"{e['bare_velocity_deg_s']:.2f} °/s"))
    for row in GelSurrogate.load(folder / "perception.safetensors").errors.get("rows", []):
        what = f"gel face, {row['indenter']}, {row['contacts']} contacts, {row['depth_mm']:.2f} mm deep"
        rows.append((what, f"{row['network']['mae_mm']:.3f} mm", f"{row['probe']['mae_mm']:.3f} mm"))
    return rows


def _sem(x: float | None, digits: int) -> str:
    return "" if x is None else f" ± {x:.{digits}f}"


def command(config: SurrogateConfig, terminal: Terminal) -> None:
    twin = Twin.load(config.twin)
    config.check()
    if twin.device == "finger" and not config.to_train(twin):
        size = ("trajectories", "seconds", "contacts", "particles")
        refuse_given(config, size, "has no use where such networks are shipped (--fresh trains all the same)")
    if minutes := config.minutes(twin):
        about = f"about {max(1, round(minutes))} min on two cores of their own"
        stored = f"Finished simulations are stored in {config.twin / DATA}"
        again = "after an interruption the same command goes on from them, and trains the networks anew"
        terminal.say(f"Full simulations and training: {about}. {stored}: {again}.")
    trained = terminal.run(train_networks, config, twin)
    terminal.finish(trained, config.out)
    terminal.say(f"networks and {CARD} are in {config.twin}")
