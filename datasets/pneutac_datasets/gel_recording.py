"""A gel's bench recording, ready to fit and to score: checked images and what pressed each of them."""

import math
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from PIL import Image

from pneutac_datasets.recording import BenchRecording
from pneutac_sim.errors import InputError
from pneutac_sim.gel.indenter import INDENTERS, Press
from pneutac_sim.gel.probe import THICKNESS_MM

ASSUMED_RADIUS_MM = 3.0  # of a ball that the recording does not tell: the scale of the light takes it up


@dataclass
class GelSample:
    """One photograph under an indenter.

    Attributes:
        name: the image's path as the recording names it.
        role: `calibration`, `heldout`, `known_depth` or another label.
        image: uint8 (H, W, 3).
        press: what pressed where.
        x_px: column of the contact centre.
        y_px: row of the contact centre.
        radius_px: contact radius.
    """

    name: str
    role: str
    image: np.ndarray
    press: Press
    x_px: float
    y_px: float
    radius_px: float


@dataclass
class GelRecording:
    """Photographs of one gel at one size.

    Attributes:
        rest: image without contact, uint8 (H, W, 3).
        px_per_mm: scale of the images.
        thickness_mm: gel thickness.
        samples: one photograph each.
        warnings: one sentence for each thing that had to be assumed.
    """

    rest: np.ndarray
    px_per_mm: float
    thickness_mm: float
    samples: list[GelSample]
    warnings: list[str] = field(default_factory=list)

    @classmethod
    def load(cls, recording: BenchRecording) -> "GelRecording":
        """Reads and checks every image and indenter of a gel's recording.

        Raises:
            InputError: one sentence naming the file, the row (the first is row 1) or field, and the remedy.
        """
        file, meta = recording.folder / "recording.json", recording.meta
        scale = meta.get("px_per_mm")
        if isinstance(scale, bool) or not isinstance(scale, int | float) or not 0 < scale < math.inf:
            raise InputError(
                f"{file}: field 'px_per_mm' is {scale!r}; give the images' pixels per millimetre."
            )
        if not meta.get("rest_image"):
            raise InputError(f"{file}: field 'rest_image' is missing; name the image without contact.")
        size = meta.get("gel_size_mm")
        thickness = float(size[2]) if isinstance(size, list) and len(size) == 3 else THICKNESS_MM
        out = cls(_rgb(recording, meta["rest_image"]), float(scale), thickness, [], list(recording.warnings))
        for i, row in recording.samples.iterrows():
            out.samples.append(_sample(recording, row, f"{recording.folder}, row {i + 1}", out))
        return out

    @property
    def calibration(self) -> GelSample:
        """The sample to fit to: the first with role `calibration`."""
        for sample in self.samples:
            if sample.role == "calibration":
                return sample
        raise InputError(
            "The recording has no row with role 'calibration'; "
            "add a column 'role' and mark one indentation with it."
        )


def _rgb(recording: BenchRecording, value) -> np.ndarray:
    """Reads an image that must be RGB with 8 bits a channel."""
    image = recording.image(value)
    if isinstance(value, str):
        with Image.open(recording.folder / value) as im:
            deep = "16" in im.mode or any("16" in str(tile[3]) for tile in im.tile)
            what = {"L": "grey", "1": "black and white", "P": "a palette", "I": "grey with 32 bits"}.get(
                im.mode
            )
            what = "16 bits a channel" if deep else "with an alpha channel" if "A" in im.mode else what
            if what or im.mode not in ("RGB", "YCbCr"):
                raise InputError(
                    f"{recording.folder / value} is {what or im.mode}; "
                    "convert it to plain RGB with 8 bits a channel."
                )
    return image


def _sample(recording: BenchRecording, row: pd.Series, where: str, gel: GelRecording) -> GelSample:
    image = _rgb(recording, row["image"])
    if image.shape != gel.rest.shape:
        raise InputError(
            f"{where}: image '{row['image']}' is {image.shape[1]} x {image.shape[0]} pixels but the rest "
            f"image is {gel.rest.shape[1]} x {gel.rest.shape[0]}; give images of one size."
        )

    def value(name: str) -> float | None:
        return float(row[name]) if name in row and pd.notna(row[name]) else None

    def one(*names: str) -> float | None:
        return next((v for v in map(value, names) if v is not None), None)

    kind = str(row["indenter"])
    if kind not in INDENTERS:
        raise InputError(f"{where}: indenter is '{kind}'; it must be one of {', '.join(INDENTERS)}.")
    h, w = image.shape[:2]
    x_px, x_mm = value("contact_x_px"), value("x_mm")
    y_px, y_mm = value("contact_y_px"), value("y_mm")
    if (x_px is None and x_mm is None) or (y_px is None and y_mm is None):
        raise InputError(
            f"{where}: the contact's place is empty; fill x_mm and y_mm, or contact_x_px, contact_y_px."
        )
    x_px = w / 2 + x_mm * gel.px_per_mm if x_px is None else x_px
    y_px = h / 2 + y_mm * gel.px_per_mm if y_px is None else y_px
    size = one("indenter_radius_mm", "indenter_size_mm")
    if kind in ("cube", "edge"):
        size = one("indenter_size_mm", "indenter_radius_mm")
    radius_px, depth = value("contact_radius_px"), value("depth_mm")
    if size is None and kind == "sphere" and radius_px is not None:
        size = ASSUMED_RADIUS_MM
        note = f"indenter_radius_mm is empty; a ball of {size:g} mm is assumed, which scales the light alone."
        if note not in gel.warnings:
            gel.warnings.append(note)
    if size is None:
        raise InputError(f"{where}: indenter_radius_mm or indenter_size_mm is empty; give the {kind}'s size.")
    if depth is None and kind == "sphere" and radius_px is not None:
        depth = (radius_px / gel.px_per_mm) ** 2 / size  # Hertz: a^2 = R d
    if depth is None:
        raise InputError(f"{where}: depth_mm is empty; give it, or contact_radius_px of a sphere.")
    try:
        x, y = (x_px - w / 2) / gel.px_per_mm, (y_px - h / 2) / gel.px_per_mm
        press = Press(kind, size, x, y, depth, value("yaw_rad") or 0.0)
    except InputError as e:
        raise InputError(f"{where}: {e}") from e
    if radius_px is None:
        radius_px = press.contact_radius_mm * gel.px_per_mm
    return GelSample(str(row["image"]), str(row.get("role", "")), image, press, x_px, y_px, radius_px)
