"""Photographs of a bench recording, with their masks and cameras."""

import numpy as np

from pneutac_datasets.recording import BenchRecording
from pneutac_sim.errors import InputError
from pneutac_sim.splat.camera import Camera


def read_camera(recording: BenchRecording, name: str) -> Camera:
    """A camera of a recording, base frame; the size of its pictures is that of the first.

    Raises:
        InputError: `recording.json` does not describe it, or does so wrongly.
    """
    told = recording.meta.get("cameras")
    if not isinstance(told, dict) or name not in told or not isinstance(told[name], dict):
        raise InputError(
            f"{recording.folder / 'recording.json'}: field 'cameras' does not describe '{name}'; give it "
            '{"intrinsics": 3x3 in px, "extrinsics": 4x4 from base to camera in m}.'
        )
    height, width = recording.image(recording.column(f"image_{name}")[0]).shape[:2]
    lens = told[name].get("distortion", ())
    try:
        return Camera(told[name].get("intrinsics"), told[name].get("extrinsics"), width, height, lens)
    except InputError as e:
        raise InputError(f"{recording.folder / 'recording.json'}: camera '{name}': {e}") from e


def read_photograph(recording: BenchRecording, row: int, camera: str) -> tuple[np.ndarray, np.ndarray]:
    """One photograph: RGB uint8 (H, W, 3) and its mask bool (H, W).

    Raises:
        InputError: no such camera, or the mask is of another size than the image.
    """
    image = recording.image(recording.column(f"image_{camera}")[row])
    mask = recording.image(recording.column(f"mask_{camera}")[row])[..., 0] > 127
    if mask.shape != image.shape[:2]:
        sizes = (f"{a.shape[1]} x {a.shape[0]}" for a in (mask, image))
        raise InputError(
            "{}: mask_{} of row {} has {} pixels, its image {}; give both the same size.".format(
                recording.folder, camera, row + 1, *sizes
            )
        )
    return image, mask
