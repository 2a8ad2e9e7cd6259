"""Compares a gel twin with recorded images: scores, also of the contact alone, and the worst images."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from lerobot_pneutac.reports.page import Report
from lerobot_pneutac.study.gel_model import predict, seen_by
from lerobot_pneutac.verbs.fit_gel import errors_of, picture_grid, scores_of
from lerobot_pneutac.verbs.result import Comparison
from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.gel.fit import slope_light
from pneutac_sim.gel.inverse import TouchReader
from pneutac_sim.gel.layout import Layout, Orientation, recognise
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import ImageScores, disc
from pneutac_sim.twin import Twin

QUIET_RADII = 3.0  # beyond so many contact radii the image should equal the rest image
WORST = 5


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GelComparison(Comparison):
    """A gel against photographs."""

    heading = "Gel twin against recording: {0.folder.name}"

    data: GelRecording
    predicted: list[np.ndarray]  # of each, uint8 (H, W, 3)
    scores: list[ImageScores]  # of each
    rest_scores: list[ImageScores]  # of the rest image alone
    touch: list[dict]  # of each, what `TouchReader` reads from the photograph, and what its row states
    folder: Path
    twin: Twin

    unit = "levels"
    keys = (
        "unit", "error", "noise_floor", "image", "by", "worst", ("touch", "touch_error"), "history",
        ("checks", "findings"), "sentence",
    )  # fmt: skip

    def subject(self) -> tuple[Twin, Path]:
        return self.twin, self.folder

    @property
    def findings(self) -> tuple[str, ...]:
        return tuple(self.data.warnings)

    @property
    def error(self) -> dict[str, float | None]:
        return errors_of(self.scores, self.data)

    @property
    def image(self) -> dict | None:
        """Mean scores over images whose role is not calibration."""
        if not self.data.heldout:
            return None
        mean = ImageScores.mean([self.scores[i] for i in self.data.heldout])
        rest = ImageScores.mean([self.rest_scores[i] for i in self.data.heldout])
        # two equal pictures have an infinite PSNR, which JSON cannot hold; 8-bit rounding ends at 59 dB
        psnr = {"psnr": min(mean.psnr, 99.0)}
        return vars(mean) | psnr | {"rest_rmse": rest.rmse, "n": len(self.data.heldout)}

    @cached_property
    def noise_floor(self) -> float:
        """What the picture changes where nothing touches, levels: light, noise and compression."""
        squares = []
        for s in self.data.samples:
            quiet = ~disc(s.rest.shape, s.x_px, s.y_px, QUIET_RADII * s.radius_px)
            if quiet.any():
                squares.append(np.mean((s.image[quiet].astype(float) - s.rest[quiet]) ** 2))
        return float(np.sqrt(np.mean(squares))) if squares else 0.0

    @property
    def by(self) -> dict[str, list[dict]]:
        samples, unseen = self.data.samples, self.data.heldout
        return {
            "role": _by(self.scores, [s.role or "others" for s in samples]),
            "indenter": _by([self.scores[i] for i in unseen], [samples[i].press.indenter for i in unseen]),
        }

    @property
    def worst(self) -> list[dict]:
        order = sorted(range(len(self.scores)), key=lambda i: -self.scores[i].contact_rmse)
        found = [(self.data.samples[i].name, self.scores[i]) for i in order[:WORST]]
        return [{"image": name, "error": s.rmse, "contact_rmse": s.contact_rmse} for name, s in found]

    @property
    def touch_error(self) -> dict | None:
        """Root mean square error of depth and median distance of place, read from test images, mm."""
        rows = [self.touch[i] for i in self.data.heldout if self.touch[i]["depth_mm"] > 0]
        if not rows:
            return None
        depth = [row["depth_mm"] - row["stated_mm"] for row in rows]
        off = float(np.median([row["off_mm"] for row in rows]))
        return {"depth_mm": float(np.sqrt(np.mean(np.square(depth)))), "place_mm": off, "n": len(rows)}

    @property
    def sentence(self) -> str:
        image = self.image
        if image is None:
            return f"The twin misses its calibration image, the only one, by {self.train:.3g} levels."
        off = f"{image['rmse']:.3g} levels off (the rest image alone {image['rest_rmse']:.3g})"
        where = f"On {image['n']} images that the twin was not fitted to"
        return f"{where} it is {off}, in the contact {image['contact_rmse']:.3g}."

    def rows(self) -> list[dict]:
        return self.by["role"]

    def content(self) -> dict:
        how = f"change of the picture further than {QUIET_RADII:g} contact radii from the contact"
        return super().content() | {"noise": {"how": how}}

    def pictures(self) -> dict[str, np.ndarray]:
        first = next((s for s in self.data.samples if s.role == "calibration"), self.data.samples[0])
        return {"tactile.png": picture_grid(self.data, self.predicted, first)}

    def page(self) -> Report:
        page = self.lead_page()
        page.image(
            self.pictures()["tactile.png"],
            "Above the recording, in the middle the twin, below four times the difference.",
        )
        if self.image:
            page.table([self.image], "Means over the images whose role is not calibration.")
        for name, rows in self.by.items():
            page.table(rows, f"By {name}.")
        page.table(self.worst, "Worst images.")
        if self.touch_error:
            depth, place, n = self.touch_error.values()
            page.heading("Touch read back from the images")
            off = f"off by {depth:.2f} mm and the contact's centre by {place:.2f} mm"
            page.text(f"On {n} test images the depth is {off} (root mean square, median).")
            page.table(self.touch, "By image; 0 mm deep where no contact was found.")
        return page


def compare_gel(twin: Twin, recording: Recording) -> GelComparison:
    """Renders every image's indentation with the twin and scores it.

    The recording's own rest images, scale and, if it has a row of role `calibration`, half of the drift of
    light seen there are used: illumination changes between sessions, and that is no fault of the gel's model.
    """
    data = GelRecording.load(recording)
    if not twin.gel:
        raise InputError("The twin has no gel; `pneutac calibrate` it on a recording of a gel.")
    gel = seen_by(GelModel.from_twin(twin), data)
    data.warnings += turned(gel, data)
    predicted = predict(gel, data)
    return GelComparison(
        data=data,
        predicted=predicted,
        scores=scores_of(data, predicted),
        rest_scores=scores_of(data, [s.rest for s in data.samples]),
        touch=read_back(gel, data),
        folder=Path(recording.folder),
        twin=twin,
    )


def read_back(gel: GelModel, data: GelRecording) -> list[dict]:
    """Depth, area and place read from each photograph, and the stated depth and place."""
    reader, out = TouchReader(gel), []
    for s in data.samples:
        touch = reader.read(s.image, s.rest)
        row = {"image": s.name, "stated_mm": s.press.depth_mm, "depth_mm": touch.depth_mm}
        off = float(np.linalg.norm(touch.centre_mm - (s.press.x_mm, s.press.y_mm)))
        out.append(row | {"off_mm": off if touch.depth_mm else None, "area_mm2": touch.area_mm2})
    return out


def turned(gel: GelModel, data: GelRecording) -> list[str]:
    """A note where the recording's images are mirrored, or have their channels in another order."""
    pair = next((s.photograph for s in data.samples if s.role == "calibration"), None)
    if pair is None:
        return []
    far = -1e3 * gel.light / np.maximum(np.linalg.norm(gel.light, axis=1), 1e-9)[:, None]
    height, width = data.rest.shape[:2]
    own = Layout("twin", tuple(map(tuple, far)), (0.0, 0.0, 0.0), width / height)
    light = slope_light(replace(gel, effects={}), pair)
    orientation = recognise(light, pair.press.x_mm, pair.press.y_mm, (width, height), own)
    if orientation is None or orientation == Orientation():
        return []
    remedy = "turn them, or calibrate a twin of their own"
    return [f"against the twin the recording's images are {orientation}; {remedy}."]


def _by(scores: list[ImageScores], labels: list[str]) -> list[dict]:
    rows = []
    for label in sorted(set(labels)):
        mean = ImageScores.mean([s for s, x in zip(scores, labels, strict=True) if x == label])
        row = {"value": label, "error": mean.rmse, "n": labels.count(label)}
        rows.append(row | {"contact_rmse": mean.contact_rmse, "contact_dncc": mean.contact_dncc})
    return rows
