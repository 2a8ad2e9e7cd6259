"""Photographs of a bench recording, with their masks and cameras."""

import re

import numpy as np

from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import listed, shown
from pneutac_sim.errors import InputError
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.segment import segment


def masked_cameras(recording: Recording) -> list[str]:
    """Names of cameras that took images with masks, or with a photograph of the empty scene.

    Columns `image` and `mask` are those of the only camera that `recording.json` describes.

    Raises:
        InputError: there are columns `image` and `mask`, but not one camera only.
    """
    names = [str(c).removeprefix("image_") for c in recording.samples if re.match(r"image_\w", str(c))]
    names = [n for n in names if recording.has(f"mask_{n}") or background_of(recording, n)]
    if names or not (recording.has("image") and recording.has("mask")):
        return names
    cameras = recording.meta.get("cameras")
    described = list(cameras) if isinstance(cameras, dict) else []
    if len(described) != 1:
        wrong = (
            f"{listed(described)}; name the columns image_<camera> and mask_<camera>"
            if described
            else "none; describe it"
        )
        raise InputError(
            f"{recording.folder / 'recording.json'}: columns 'image' and 'mask' are those of one camera, but "
            f"field 'cameras' describes {wrong}."
        )
    return described


def background_of(recording: Recording, camera: str) -> str | None:
    """The photograph of the scene without the body, `background` of the camera in `recording.json`."""
    cameras = recording.meta.get("cameras")
    described = cameras.get(camera) if isinstance(cameras, dict) else None
    return described.get("background") if isinstance(described, dict) else None


def column_of(recording: Recording, kind: str, camera: str) -> str:
    """Column of a camera's `image` or `mask`: `image_<camera>`, or `image` where there is no such column.

    Args:
        recording: with photographs.
        kind: `image` or `mask`.
        camera: its name.
    """
    own = f"{kind}_{camera}"
    single = not recording.has(own) and recording.has(kind) and masked_cameras(recording) == [camera]
    return kind if single else own


def read_camera(recording: Recording, name: str) -> Camera:
    """A camera of a recording, base frame; the size of its pictures is that of the first.

    Raises:
        InputError: `recording.json` does not describe it, or does so wrongly.
    """
    described = recording.meta.get("cameras")
    if not isinstance(described, dict) or name not in described or not isinstance(described[name], dict):
        raise InputError(
            f"{recording.folder / 'recording.json'}: field 'cameras' does not describe {shown(name)}; give "
            'it {"intrinsics": 3x3 in px, "extrinsics": 4x4 from base to camera in m}.'
        )
    height, width = recording.image(recording.column(column_of(recording, "image", name))[0]).shape[:2]
    lens = described[name].get("distortion", ())
    try:
        return Camera(
            described[name].get("intrinsics"), described[name].get("extrinsics"), width, height, lens
        )
    except InputError as e:
        raise InputError(f"{recording.folder / 'recording.json'}: camera {shown(name)}: {e}") from e


def read_photograph(recording: Recording, row: int, camera: str) -> tuple[np.ndarray, np.ndarray]:
    """One photograph: RGB uint8 (H, W, 3) and its mask bool (H, W), by segmentation where none was recorded.

    Raises:
        InputError: no such camera, or the mask is of another size than the image.
    """
    columns = {kind: column_of(recording, kind, camera) for kind in ("image", "mask")}
    image = recording.image(recording.column(columns["image"])[row])
    if not recording.has(columns["mask"]) and (background := background_of(recording, camera)):
        try:
            return image, segment(image, background=recording.image(background))
        except InputError as e:
            raise InputError(f"{recording.folder}: {columns['image']} of row {row + 1}: {e}") from e
    mask = recording.image(recording.column(columns["mask"])[row])[..., 0] > 127
    if mask.shape != image.shape[:2]:
        sizes = (f"{a.shape[1]} x {a.shape[0]}" for a in (mask, image))
        raise InputError(
            "{}: {} of row {} has {} pixels, its image {}; give both the same size.".format(
                recording.folder, columns["mask"], row + 1, *sizes
            )
        )
    return image, mask
