"""What a calibration takes from a recording with photographs: pressures, photographs, which are held out."""

import re
from dataclasses import dataclass, replace

import numpy as np

from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.diagnosis.bootstrap import Parts
from pneutac_datasets.recording.photographs import (
    background_of,
    column_of,
    masked_cameras,
    read_camera,
    read_photograph,
)
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.photo_fit.objective import MaskedPhotograph
from pneutac_sim.splat.camera import Camera


@dataclass(frozen=True, eq=False)
class PhotoStudy:
    """Photographs of a body at rest under T pressures; they fit the base model and show no effect."""

    recording: Recording  # of a finger or an arm
    parts: Parts  # fitted photographs train, those at other pressures test
    pressures: np.ndarray  # (T, chambers) kPa, without repetition
    train: np.ndarray  # (T,) bool; the others are held out
    cameras: list[str]  # names of those that are fitted, then of the others
    fitted: int  # how many
    photographs: list[MaskedPhotograph]  # of all rows and fitted cameras; `state` counts `pressures`
    markers_mm: np.ndarray | None  # (T, 3) mean tip at each pressure, if recorded: to bootstrap, never to fit
    conditions: dict[str, float]  # means of the other columns that are numbers
    findings: tuple[str, ...] = ()  # where masks were found by segmentation, a sentence for each camera

    unit = "8-bit levels"

    def of(self, states: np.ndarray) -> list[MaskedPhotograph]:
        """Photographs at the pressures where `states` (T,) is true, counted among these alone."""
        index = np.cumsum(states) - 1
        return [replace(p, state=int(index[p.state])) for p in self.photographs if states[p.state]]

    @property
    def rest(self) -> MaskedPhotograph:
        """The photograph nearest to no pressure, from the first camera."""
        least = np.argsort(np.abs(self.pressures).sum(1), kind="stable")
        by_state = {p.state: p for p in reversed(self.photographs)}
        return by_state[int(next(s for s in least if self.train[s]))]


def photo_study(recording: Recording, levels_kpa: tuple[float, ...]) -> PhotoStudy:
    """Photographs of a finger or an arm.

    Of each hold of a pressure the last photograph counts, taken to be at rest. Cameras that look along the
    same line as an earlier one, from the front or from behind, are not fitted.

    Args:
        recording: of a finger or an arm.
        levels_kpa: pressures to fit, of an arm those of each chamber; all others are held out.

    Raises:
        InputError: no masks, a bad mask, a pressure that is missing or in other units, too few levels.
    """
    names = masked_cameras(recording)
    if not names:
        raise InputError(
            f"{recording.folder}: no camera has both an image_<camera> and a mask_<camera> column; add masks "
            "(white where the body is), or a photograph of the empty scene as the camera's 'background' in "
            "recording.json, to calibrate by images."
        )
    levels, rows, state = held_levels(recording)
    train = (np.abs(levels[..., None] - np.asarray(levels_kpa)).min(-1) < T.LEVEL_KPA).all(1)
    if train.sum() < 2:
        shown = ", ".join(f"{v:g}" for v in np.unique(levels)[:12])
        raise InputError(
            f"{recording.folder}: {train.sum()} of its pressures ({shown} kPa) are training levels "
            f"({', '.join(f'{v:g}' for v in levels_kpa)}); choose at least two by train_kpa."
        )
    cameras = {name: read_camera(recording, name) for name in names}
    chosen = _crossing(cameras)
    photographs = [
        read_held(recording, row, s, name, cameras[name])
        for name in chosen
        for row, s in zip(rows, state, strict=True)
    ]
    tips = [f"tip_{a}_mm" for a in "xyz"]
    markers = None
    if all(recording.has(c) for c in tips):
        seen = np.stack([recording.column(c).astype(float)[rows] for c in tips], 1)
        markers = np.stack([seen[state == s].mean(0) for s in range(len(levels))])
    others = [n for n in names if n not in chosen]
    findings = tuple(filter(None, (_segmented(recording, name) for name in chosen)))
    fitted = np.array([train[p.state] for p in photographs])
    index = np.arange(len(fitted))
    return PhotoStudy(
        recording,
        Parts(fitted, ~fitted, ~fitted, index, np.zeros_like(index)),
        levels,
        train,
        chosen + others,
        len(chosen),
        photographs,
        markers,
        mean_conditions(recording),
        findings,
    )


def _segmented(recording: Recording, camera: str) -> str:
    """A sentence where a camera's masks were found by segmentation."""
    if recording.has(column_of(recording, "mask", camera)):
        return ""
    return (
        f"There are no masks of camera '{camera}'; the body was found by segmentation, as what differs from "
        f"the empty scene '{background_of(recording, camera)}'."
    )


def held_levels(recording: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pressures under which a body was photographed at rest.

    Args:
        recording: of a finger or an arm.

    Returns:
        Pressures (T, chambers) kPa, rising and without repetition; rows (n,) that end a hold; the pressure of
        each of these rows (n,), counted in the first.

    Raises:
        InputError: a row has no pressure.
    """
    pressure = np.stack([recording.column(c).astype(float) for c in recording.pressure_columns], 1)
    if not np.isfinite(pressure).all():
        row = int(np.argmin(np.isfinite(pressure).all(1)))
        raise InputError(
            f"{recording.folder}: row {row + 1} has no pressure; every photograph needs one, in kPa."
        )
    rows = _holds(recording, pressure)
    levels, state = np.unique(pressure[rows].round(6), axis=0, return_inverse=True)
    return levels, rows, state.ravel()


def read_held(recording: Recording, row: int, state: int, name: str, camera: Camera) -> MaskedPhotograph:
    """The photograph that a camera took in a row, at pressure number `state`.

    Raises:
        InputError: an image or a mask is missing or bad.
    """
    image, mask = read_photograph(recording, row, name)
    if not 1e-3 < mask.mean() < 0.9:
        raise InputError(
            f"{recording.folder}: {column_of(recording, 'mask', name)} of row {row + 1} covers "
            f"{mask.mean():.1%} of the picture; it must be white where the body is and black elsewhere."
        )
    name_shown = f"{recording.folder}, {column_of(recording, 'image', name)} of row {row + 1}"
    return MaskedPhotograph(int(state), camera, image, mask, name_shown)


def mean_conditions(recording: Recording) -> dict[str, float]:
    """Means of the columns that are neither photographs nor pressures nor markers but numbers."""
    conditions = {}
    for name in recording.conditions:
        column = recording.samples[name]
        if column.dtype.kind in "fi" and not re.match(r"pressure|camera", name) and np.isfinite(column).all():
            conditions[name] = float(column.mean())
    return conditions


def _holds(recording: Recording, pressure: np.ndarray) -> np.ndarray:
    """Rows that end a hold of one pressure within a trial."""
    trial = recording.column("trial")
    goes_on = (trial[1:] == trial[:-1]) & (np.abs(np.diff(pressure, axis=0)) < 1e-6).all(1)
    return np.flatnonzero(np.append(~goes_on, True))


def _crossing(cameras: dict[str, Camera]) -> list[str]:
    """The first camera, and those whose line of sight crosses that of all before."""
    out: list[str] = []
    for name, camera in cameras.items():
        axis = camera.extrinsics[2, :3]
        if all(abs(axis @ cameras[o].extrinsics[2, :3]) < T.SAME_VIEW for o in out):
            out.append(name)
    return out
