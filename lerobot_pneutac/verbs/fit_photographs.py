"""Calibrates a finger or an arm to photographs alone (paper, Sec. III-B): silhouettes, then CMA-ES."""

import time
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lerobot_pneutac.rendering.body import strip
from lerobot_pneutac.reports.page import AFTER, OTHER, Report
from lerobot_pneutac.study.photographs import PhotoStudy, photo_study
from lerobot_pneutac.verbs.result import Calibration, rms_of
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.executor import Progress, no_progress
from pneutac_sim.files import write_image
from pneutac_sim.finger.fit import BY_IMAGES
from pneutac_sim.photo_fit import objective as photo
from pneutac_sim.photo_fit import search as cma
from pneutac_sim.splat.body import fit_body_looks, looks_into_twin
from pneutac_sim.splat.render import Gaussians
from pneutac_sim.twin import Twin

TRAIN_KPA = (0.0, 3.0, 6.0, 9.0, 12.0, 15.0)
PARTICLES = 4000
DETAIL = 2  # of the looks that the twin keeps: sharper than one Gaussian a particle, which the search takes


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class PhotoCalibration(Calibration):
    """A body calibrated to photographs."""

    heading = "Calibrated {0.twin.device} by images"

    fitted: photo.BodyParameters
    study: PhotoStudy
    start: cma.Coarse  # from silhouettes alone
    search: cma.Search
    confidence: cma.Posterior
    objective: photo.Objective  # of all photographs, fitted and held out
    bodies: photo.Bodies  # at rest at every pressure, with the best parameters
    scores: photo.Scores  # of the bodies on all photographs, (1, n)
    tip_error_mm: np.ndarray | None  # (T,) distance to the markers, or None where the recording has none

    @property
    def iou(self) -> dict[str, float | None]:
        """Mean overlap of silhouettes over fitted and held-out photographs."""
        return _parts(self.study, self.scores.iou[0])

    @property
    def tip_mm(self) -> dict[str, float | None] | None:
        """Root mean square distance to the markers, where there are any."""
        if self.tip_error_mm is None:
            return None
        square, train = self.tip_error_mm**2, self.study.train
        return {"train": rms_of(square[train]), "heldout": rms_of(square[~train])}

    @property
    def sentence(self) -> str:
        tip, iou = self.tip_mm, self.iou
        text = f"Silhouettes overlap by {iou['train']:.1%} where the twin was fitted"
        if iou["heldout"] is not None:
            text += f" and by {iou['heldout']:.1%} at pressures that it has not seen"
        if tip is not None and tip["heldout"] is not None:
            text += f"; there its tip misses the marker, which was not fitted, by {tip['heldout']:.2g} mm"
        return text + "."

    def remarks(self) -> list[str]:
        iou, tip = self.iou, self.tip_mm
        tested = "nothing was held out" if iou["heldout"] is None else f"held-out IoU {iou['heldout']:.4f}"
        if tip is not None and tip["heldout"] is not None:
            share = 100 * tip["heldout"] / self.twin.length_mm
            tested += f", held-out tip error {tip['heldout']:.3g} mm ({share:.2g} % of length)"
        before = f" ({self.search.resumed} of them from before)" if self.search.resumed else ""
        return [
            f"IoU {iou['train']:.4f} where it was fitted, {tested}; {self.evaluations} evaluations{before} "
            f"in {self.seconds:.0f} s{self._now()}"
        ]

    def content(self) -> dict:
        loss = self.scores.appearance[0] + photo.SILHOUETTE * (1 - self.scores.iou[0])
        names, study = self.fitted.names, self.study
        tip = {} if self.tip_mm is None else {"tip_error_mm": self.tip_mm}
        coarse = dict(zip(names, self.fitted.values(self.start.x).tolist(), strict=True))
        out = super().content() | tip | {"objective": _parts(study, loss), "iou": self.iou}
        out |= {"not_identified": self.confidence.not_identified, "coarse": coarse}
        out |= {"cameras": study.cameras[: study.fitted], "train_kpa": study.pressures[study.train]}
        return out | {"resumed": self.search.resumed}

    def page(self) -> Report:
        import plotly.graph_objects as go

        page = self.lead_page()
        page.table(
            self.rows(),
            "Intervals show how well the silhouettes determine each parameter. A body whose shape or neutral "
            "axis is not the twin's shifts all of them together, by more than that.",
        )
        page.heading("Photographs and renderings")
        page.text(
            "Above the photograph, below the twin; then red where only the photograph, blue where only the "
            "twin."
        )
        study = self.study
        shown = sorted(study.photographs, key=lambda p: p.state)
        for some in (shown[i : i + 6] for i in range(0, len(shown), 6)):
            kpa = ["/".join(f"{v:g}" for v in study.pressures[p.state]) + " kPa" for p in some]
            labels = [k + " (held out)" * (not study.train[p.state]) for k, p in zip(kpa, some, strict=True)]
            if len({p.mask.shape for p in some}) == 1:
                page.image(strip(self.objective, self.bodies.positions[0], some), ", ".join(labels))
        page.heading("How the objective fell")
        tried, best = self.search.objectives, {"color": AFTER}
        figure = go.Figure()
        figure.add_scatter(y=tried, mode="markers", name="candidates", marker={"color": OTHER})
        figure.add_scatter(y=np.minimum.accumulate(tried), mode="lines", name="best", line=best)
        axes = {"xaxis_title": "evaluation", "yaxis_title": "L1 + 2 (1 - IoU)", "yaxis_type": "log"}
        page.figure(figure.update_layout(**axes))
        return page


def calibrate_photographs(
    twin: Twin,
    recording: Recording,
    levels_kpa: Sequence[float] = TRAIN_KPA,
    evaluations: int = cma.EVALUATIONS,
    particles: int = PARTICLES,
    seed: int = 0,
    file: Path | None = None,
    best: Path | None = None,
    device: str = "auto",
    progress: Progress = no_progress,
) -> PhotoCalibration:
    """Fits drive and material to the photographs with masks at pressures `levels_kpa`; the rest stays.

    The search evaluates so many bodies of about so many `particles` on a `device` (see `mpm.runtime.start`);
    `file` stores it so that an interrupted one goes on, `best` a picture of the best rendering.
    """
    began = time.perf_counter()
    progress("silhouettes and looks", 0, evaluations)
    study = photo_study(recording, levels_kpa)
    span = float(np.abs(study.pressures).max())
    first = photo.body_parameters(twin, span)
    pressures, photographs = study.pressures[study.train], study.of(study.train)
    start = cma.coarse_fit(first, pressures, photographs, study.conditions, device)
    fitted = photo.body_parameters(first.twin_at(start.x), span)

    def bodies(x: np.ndarray, pressures: np.ndarray) -> photo.Equilibria:
        return photo.Equilibria(fitted, x, pressures, study.conditions, particles, device)

    equilibria, rest = bodies(start.x, pressures), study.rest  # the photograph nearest to no pressure
    looks = _looks(rest, equilibria, int(np.cumsum(study.train)[rest.state]) - 1)
    objective = photo.Objective(equilibria, photographs, looks)

    def report(done: int, _: np.ndarray, value: float) -> None:
        progress(f"best objective {value:.4f}", done, evaluations)
        if best is not None and objective.best is not None:
            write_image(best, strip(objective, objective.best, photographs))

    record = cma.SearchRecord(file, search_key(recording, twin, photographs, particles))
    how = {"seed": seed, "record": record, "progress": report}
    found = cma.search(objective, fitted, start, evaluations, **how)
    posterior, everywhere = cma.confidence(objective, found.x), bodies(found.x, study.pressures)
    new = fitted.twin_at(found.x, posterior.ci95)
    looks_into_twin(new, _looks(rest, everywhere, rest.state, DETAIL))
    whole = photo.Objective(everywhere, study.photographs, looks)
    scores, tip_error_mm = whole.scores(everywhere.first), None
    if study.markers_mm is not None:
        tip_error_mm = np.linalg.norm(1e3 * everywhere.first.tips[0] - study.markers_mm, axis=1)
    rows = {}
    for name, unit, value in zip(fitted.names, fitted.units, fitted.values(found.x), strict=True):
        unclear = name in posterior.not_identified
        note = "not identified: open by more than a tenth of its range" if unclear else ""
        rows[name] = {"value": float(value), "ci95": list(posterior.ci95[name]), "unit": unit, "note": note}
    return PhotoCalibration(
        twin=new,
        parameters=rows,
        error=_parts(study, scores.rmse[0]),
        unit=PhotoStudy.unit,
        evaluations=len(found.objectives),
        seconds=time.perf_counter() - began,
        recording=str(recording.folder),
        change=BY_IMAGES,
        seed=seed,
        findings=(*recording.warnings, *study.findings),
        fitted=fitted,
        study=study,
        start=start,
        search=found,
        confidence=posterior,
        objective=whole,
        bodies=everywhere.first,
        scores=scores,
        tip_error_mm=tip_error_mm,
    )


def _parts(study: PhotoStudy, values: np.ndarray) -> dict[str, float | None]:
    """Mean of (n,) values over fitted and over held-out photographs, None where there are none."""
    parts = {"train": study.parts.train, "heldout": study.parts.heldout}
    return {k: float(np.mean(values[m])) if m.any() else None for k, m in parts.items()}


def search_key(recording: Recording, twin: Twin, photographs: list, particles: int) -> str:
    """What a search depends on besides its start: one with another key is not continued."""
    pictures = [(p.state, zlib.crc32(p.image.tobytes()), zlib.crc32(p.mask.tobytes())) for p in photographs]
    return f"{recording.folder.resolve()} {pictures} {particles} {len(twin.history)}"


def _looks(p: photo.MaskedPhotograph, equilibria: photo.Equilibria, state: int, detail=1) -> Gaussians:
    """From one photograph of the body at pressure number `state` of the equilibria."""
    first = equilibria.first
    pose = (first.positions[0, state], first.gradients[0, state])
    return fit_body_looks(equilibria.body, *pose, p.image, p.mask, p.camera, detail=detail)
