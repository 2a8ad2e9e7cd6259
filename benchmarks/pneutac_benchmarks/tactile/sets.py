"""Recordings of gels that methods are scored on."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from pneutac_datasets.recording.gel import GelRecording, GelSample
from pneutac_datasets.recording.recording import Recording, read_meta
from pneutac_sim.errors import InputError, check_choice

THUMB_PX = 96  # height of the pictures in the grid


@dataclass
class TactileSet:
    """One recording.

    Attributes:
        name: of its folder.
        data: its images.
        key: hash of all that a score depends on.
    """

    name: str
    data: GelRecording
    key: str

    @classmethod
    def load(cls, folder: Path) -> "TactileSet":
        """Reads a recording that has a calibration row and others.

        Raises:
            InputError: it has not, or cannot be read.
        """
        data = GelRecording.load(Recording.load(folder))
        try:
            first = data.presses[0]
        except InputError as e:
            raise InputError(f"{folder}: {e}") from e
        if all(s.role == first.role for s in data.samples):
            raise InputError(
                f"{folder} has no held-out image; add rows whose role is not 'calibration', e.g. 'heldout'."
            )
        key = hashlib.sha256(repr((data.px_per_mm, data.thickness_mm)).encode())
        for s in data.samples:
            key.update(repr((s.role, s.press, s.x_px, s.y_px, s.radius_px, s.clock)).encode())
            key.update(s.image.tobytes() + s.rest.tobytes())
        return cls(folder.name, data, key.hexdigest())

    @property
    def heldout(self) -> list[GelSample]:
        """Images that no method was fitted to."""
        return [s for s in self.data.samples if s.role != "calibration"]


def find_sets(data: Path, names: str | None) -> list[TactileSet]:
    """The recordings of gels in a folder.

    Raises:
        InputError: there is none, or one that was asked for is not there.
    """
    there = sorted(
        f.parent for f in data.glob("*/recording.json") if read_meta(f.parent).get("device") == "gel"
    )
    if not there:
        raise InputError(f"{data} holds no folder with a recording.json whose device is 'gel'.")
    wanted = [f.name for f in there] if names is None else names.split(",")
    for name in wanted:
        check_choice("sets", name, [f.name for f in there])
    return [TactileSet.load(f) for f in there if f.name in wanted]


def thumbnail(image: np.ndarray) -> np.ndarray:
    """The image at the height of the picture grid, uint8."""
    size = (round(THUMB_PX * image.shape[1] / image.shape[0]), THUMB_PX)
    return np.asarray(Image.fromarray(image).resize(size, Image.Resampling.BOX))
