"""Calibrates a finger or an arm to photographs alone (paper, Sec. III-B): silhouettes, then CMA-ES."""

import time
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from lerobot_pneutac.reports.page import write_result
from lerobot_pneutac.reports.photographs import UNIT, outcome, photo_report, show, strip
from lerobot_pneutac.study.photographs import PhotoSession, read_session
from pneutac_sim.errors import InputError
from pneutac_sim.finger.fit import BY_IMAGES
from pneutac_sim.photo_fit.coarse import Coarse, coarse_fit
from pneutac_sim.photo_fit.confidence import Confidence, confidence
from pneutac_sim.photo_fit.equilibria import Bodies, Equilibria
from pneutac_sim.photo_fit.objective import Objective, Photograph, Scores
from pneutac_sim.photo_fit.parameters import BodyParameters, body_parameters
from pneutac_sim.photo_fit.search import EVALUATIONS, Search, search
from pneutac_sim.splat.body import fit_body_looks, looks_into_twin
from pneutac_sim.splat.gaussians import Gaussians
from pneutac_sim.twin import Twin

TRAIN_KPA = (0.0, 3.0, 6.0, 9.0, 12.0, 15.0)
PARTICLES = 4000
DETAIL = 2  # of the looks that the twin keeps: sharper than one Gaussian a particle, which the search takes


@dataclass(frozen=True)
class PhotoFit:
    """A body calibrated to photographs.

    Attributes:
        twin: the next version, not yet written.
        parameters: what was fitted.
        session: the photographs.
        start: from silhouettes alone.
        search: all that was tried.
        confidence: of each parameter.
        objective: of all photographs, fitted and held out.
        bodies: at rest at every pressure, with the best parameters.
        scores: of the bodies on all photographs, (1, n).
        tip_error_mm: (T,) distance to the markers, or None where the recording has none.
        seconds: wall time.
    """

    twin: Twin
    parameters: BodyParameters
    session: PhotoSession
    start: Coarse
    search: Search
    confidence: Confidence
    objective: Objective
    bodies: Bodies
    scores: Scores
    tip_error_mm: np.ndarray | None
    seconds: float

    def mean(self, values: np.ndarray, train: bool) -> float | None:
        """Mean of (n,) values over fitted or held-out photographs, None where there are none."""
        chosen = [
            v
            for p, v in zip(self.session.photographs, values, strict=True)
            if self.session.train[p.state] == train
        ]
        return float(np.mean(chosen)) if chosen else None


def fit_photographs(
    twin: Twin,
    recording,
    levels_kpa: tuple[float, ...] = TRAIN_KPA,
    evaluations: int = EVALUATIONS,
    particles: int = PARTICLES,
    seed: int = 0,
    file: Path | None = None,
    tell=lambda done, objective, value: None,
    device: str = "auto",
) -> PhotoFit:
    """Fits actuation and material to the photographs at the training levels.

    Args:
        twin: of the recording's device; what is not fitted stays.
        recording: with `image_<camera>` and `mask_<camera>` columns.
        levels_kpa: to fit; all other pressures are held out.
        evaluations: of the objective.
        particles: of the body, about.
        seed: decides the search.
        file: keeps the search so that an interrupted one goes on; None for nowhere.
        tell: called after each generation with the evaluations so far, the objective and its least value.
        device: of the material points, see `mpm.runtime.start`.

    Raises:
        InputError: photographs, masks, cameras or pressures do not serve.
    """
    began = time.perf_counter()
    session = read_session(recording, levels_kpa)
    span = float(np.abs(session.pressures).max())
    first = body_parameters(twin, span)
    pressures, photographs = session.pressures[session.train], session.of(session.train)
    start = coarse_fit(first, pressures, photographs, session.conditions, device)
    parameters = body_parameters(first.twin_at(start.x), span)
    equilibria = Equilibria(parameters, start.x, pressures, session.conditions, particles, device)
    rest = session.rest  # the photograph nearest to no pressure gives the looks
    looks = _looks(rest, equilibria, int(np.cumsum(session.train)[rest.state]) - 1)
    objective = Objective(equilibria, photographs, looks)
    key = search_key(recording, twin, photographs, particles)
    found = search(
        objective,
        parameters,
        start,
        evaluations,
        seed=seed,
        file=file,
        key=key,
        tell=lambda done, best, value: tell(done, objective, value),
    )
    sure = confidence(objective, found.x)
    everywhere = Equilibria(parameters, found.x, session.pressures, session.conditions, particles, device)
    whole = Objective(everywhere, session.photographs, looks)
    tips = None
    if session.markers_mm is not None:
        tips = np.linalg.norm(1e3 * everywhere.first.tips[0] - session.markers_mm, axis=1)
    new = parameters.twin_at(found.x, sure.ci95)
    looks_into_twin(new, _looks(rest, everywhere, rest.state, DETAIL))
    return PhotoFit(
        twin=new,
        parameters=parameters,
        session=session,
        start=start,
        search=found,
        confidence=sure,
        objective=whole,
        bodies=everywhere.first,
        scores=whole.scores(everywhere.first),
        tip_error_mm=tips,
        seconds=time.perf_counter() - began,
    )


def search_key(recording, twin: Twin, photographs: list[Photograph], particles: int) -> str:
    """What a search depends on beside where it starts: one of another key does not go on.

    Args:
        recording: of the photographs.
        twin: to be fitted.
        photographs: that are fitted.
        particles: of the body, about.
    """
    pictures = [(p.state, zlib.crc32(p.image.tobytes()), zlib.crc32(p.mask.tobytes())) for p in photographs]
    return f"{recording.folder.resolve()} {pictures} {particles} {len(twin.history)}"


def _looks(photograph: Photograph, equilibria: Equilibria, state: int, detail: int = 1) -> Gaussians:
    """From one photograph of the body at pressure number `state` of the equilibria."""
    p, first = photograph, equilibria.first
    pose = (first.positions[0, state], first.gradients[0, state])
    return fit_body_looks(equilibria.body, *pose, p.image, p.mask, p.camera, detail=detail)


def calibrate_photographs(twin: Twin, recording, cfg, console: Console) -> dict:
    """Fits, saves the twin's next version, prints the table, writes result, report and pictures.

    Args:
        twin: of the recording's device.
        recording: of a finger or an arm, with photographs.
        cfg: `CalibrateConfig`.
        console: where the table goes.

    Returns:
        The content of `result.json`.
    """
    file = (cfg.out or cfg.twin) / "evaluations.json"
    levels = training_levels(cfg.train_kpa)
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed}/{task.total}"))
    evaluated = 0
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as bar:
        task = bar.add_task("silhouettes and looks", total=cfg.evaluations)

        def tell(done, objective, value):
            nonlocal evaluated
            evaluated = done
            bar.update(task, completed=done, description=f"best objective {value:.4f}")
            if cfg.out is not None and objective.best is not None:
                picture = strip(objective, objective.best, objective.photographs)
                Image.fromarray(picture).save(cfg.out / "best.png")

        try:
            found = fit_photographs(
                twin, recording, levels, cfg.evaluations, cfg.particles, cfg.seed, file, tell
            )
        except KeyboardInterrupt:
            bar.stop()
            console.print(_stopped(evaluated, file), highlight=False, soft_wrap=True)
            raise
    result = outcome(found)
    found.twin.save_version(
        cfg.twin,
        BY_IMAGES,
        str(recording.folder),
        {**result["error"], "unit": UNIT, "seed": cfg.seed},
    )
    result |= {
        "recording": str(recording.folder),
        "twin": str(cfg.twin),
        "version": found.twin.history[-1]["version"],
    }
    if cfg.out is None:
        file.unlink()
    show(found, result, console)
    if cfg.out is not None:
        write_result(cfg.out, result)
        console.print(f"report: {photo_report(found, result).write(cfg.out)}", highlight=False)
    return result


def _stopped(evaluated: int, file: Path) -> str:
    if not evaluated:
        return "Stopped before the first candidates were evaluated; the twin is as it was."
    return (
        f"Stopped after {evaluated} evaluations, kept in {file}; the twin is as it was, and the same command "
        "goes on from here."
    )


def training_levels(text: str) -> tuple[float, ...]:
    """Pressures of `--train_kpa`, with commas between; raises InputError where one is no number."""
    try:
        levels = tuple(float(v) for v in text.split(","))
    except ValueError:
        levels = ()
    if len(levels) < 2 or not np.isfinite(levels).all():
        raise InputError(f"--train_kpa={text} must be at least two pressures in kPa, such as 0,3,6,9,12,15.")
    return levels
