"""A finger or an arm in its own looks beside the photographs of a recording, from one of their cameras."""

from dataclasses import dataclass

import cv2
import numpy as np

from lerobot_pneutac.rendering import particles as draw
from lerobot_pneutac.rendering.film import Painter, Pose, pressure_text
from lerobot_pneutac.rendering.options import RenderConfig
from lerobot_pneutac.rendering.silhouettes import differing
from lerobot_pneutac.study.photographs import (
    NEAR_KPA,
    held_levels,
    masked_cameras,
    mean_conditions,
    read_held,
)
from pneutac_datasets.recording.photographs import read_camera
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import an
from pneutac_sim.errors import InputError, option
from pneutac_sim.mpm.body import Body
from pneutac_sim.photo_fit.objective import SOLID, MaskedPhotograph
from pneutac_sim.splat.body import looks_from_twin
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.follow import carried
from pneutac_sim.splat.render import rasterise
from pneutac_sim.twin import Twin

HEIGHT, GAP, CAPTION = 400, 8, 40  # px of a panel, between panels, and below
MARGIN = 0.12  # round the body, over its length
LEAD = (
    "Left the photograph at the nearest pressure, in the middle the twin in its own looks from the same "
    "camera, right their silhouettes: red where only the photograph, blue where only the twin."
)


@dataclass(frozen=True)
class Recorded:
    """What one camera of a recording saw.

    Attributes:
        pressures: (T, chambers) kPa, rising.
        photographs: (T,) the last one at each.
        camera: from where.
        conditions: means of the recording's other columns.
    """

    pressures: np.ndarray
    photographs: list[MaskedPhotograph]
    camera: Camera
    conditions: dict[str, float]


def read_recorded(twin: Twin, config: RenderConfig) -> Recorded:
    """Reads the photographs of the chosen camera, the first one where none is chosen.

    Raises:
        InputError: another device's recording, a camera that it does not have, a twin without looks.
    """
    recording = Recording.load(config.recording)
    if recording.device != twin.device:
        raise InputError(
            f"{recording.folder} is of {an(recording.device)} and {config.twin} of {an(twin.device)}; give a "
            "recording of the twin's own device."
        )
    try:
        looks_from_twin(twin)
    except InputError as e:
        raise InputError(
            f"The twin at {config.twin} has no looks; fit them with "
            f"`pneutac calibrate {option('twin', config.twin)} "
            f"--recording={recording.folder} --by=images`."
        ) from e
    names = masked_cameras(recording)
    name = config.camera or next(iter(names), None)
    if name not in names:
        raise InputError(
            f"{recording.folder} has no camera '{name}' with masks; it has {', '.join(names)}."
            if names
            else f"{recording.folder} has no photographs with masks; give a recording that has."
        )
    camera = read_camera(recording, name)
    levels, rows, state = held_levels(recording)
    last = {int(s): int(row) for row, s in zip(rows, state, strict=True)}
    photographs = [read_held(recording, last[s], s, name, camera) for s in range(len(levels))]
    return Recorded(levels, photographs, camera, mean_conditions(recording))


def photograph_painter(twin: Twin, body: Body, recorded: Recorded, spines: np.ndarray) -> tuple[Painter, str]:
    """Draws poses beside photographs, and says what one sees.

    Args:
        twin: with looks.
        body: its straight particles.
        recorded: the photographs.
        spines: (T, K, 3) about where the spine will be, m.

    Raises:
        InputError: the camera sees nothing of the spine.
    """
    camera, looks = recorded.camera, looks_from_twin(twin)
    window = _window(recorded, spines, 1e-3 * twin.length_mm)

    def paint(pose: Pose) -> tuple[np.ndarray, dict]:
        nearest = int(np.abs(recorded.pressures - pose.pressure).sum(1).argmin())
        photograph, pressure = recorded.photographs[nearest], recorded.pressures[nearest]
        seen = rasterise(carried(looks, body, pose.positions, pose.gradients), camera)
        light = seen.image.clip(0, 1) + (1 - seen.alpha.clip(0, 1))[..., None]
        mask, solid = photograph.mask, seen.alpha > SOLID
        panels = (photograph.image, 255 * light.clip(0, 1), differing(mask, solid))
        iou = float((mask & solid).sum() / (mask | solid).sum())
        same = bool(np.abs(pressure - pose.pressure).max() < NEAR_KPA)
        captions = (
            f"photograph, {pressure_text(pressure)}",
            f"twin, {pressure_text(pose.pressure)}",
            f"overlap {iou:.1%}" if same else "silhouettes",
        )
        return _beside(panels, captions, window), {"iou": iou if same else None}

    return paint, LEAD


def _window(recorded: Recorded, spines: np.ndarray, length_m: float) -> tuple[slice, slice]:
    """Rows and columns of the pictures that show the body at all times."""
    camera = recorded.camera
    pixels, depth = camera.project(spines.reshape(-1, 3))
    size = np.array([camera.width, camera.height])
    seen = (depth > 0) & (pixels >= 0).all(1) & (pixels < size).all(1)
    if not seen.any():
        raise InputError(
            "The camera does not see the body; check that its extrinsics in recording.json lead from base to "
            "camera, in metres."
        )
    masks = np.concatenate([np.argwhere(p.mask)[:, ::-1] for p in recorded.photographs])
    corners = np.concatenate([pixels[seen], masks.min(0)[None], masks.max(0)[None]])
    margin = MARGIN * length_m * camera.intrinsics[0, 0] / float(np.median(depth[seen]))
    low = np.maximum(corners.min(0) - margin, 0).astype(int)
    high = np.minimum(corners.max(0) + margin, size).astype(int)
    return slice(low[1], high[1]), slice(low[0], high[0])


def _beside(panels, captions, window: tuple[slice, slice]) -> np.ndarray:
    """Pictures (H, W, 3) side by side, uint8, with a line below each."""
    parts = []
    for panel, caption in zip(panels, captions, strict=True):
        cut = np.ascontiguousarray(panel[window], np.uint8)
        width = round(HEIGHT * cut.shape[1] / cut.shape[0])
        part = draw.blank(width + width % 2 + GAP, HEIGHT + CAPTION)
        part[:HEIGHT, :width] = cv2.resize(cut, (width, HEIGHT), interpolation=cv2.INTER_AREA)
        draw.write(part, caption, 4, HEIGHT + CAPTION - 14)
        parts.append(part)
    return np.concatenate(parts, 1)
