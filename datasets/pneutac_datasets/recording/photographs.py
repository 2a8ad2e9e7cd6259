"""Photographs of a bench recording, with their masks and cameras.

Finds a body in a photograph.
"""

import re

import cv2
import numpy as np

from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import listed
from pneutac_sim.errors import InputError, shown
from pneutac_sim.splat.camera import Camera

SHADOW = 0.5  # how much of a mere change of brightness counts: shadows on the backdrop are that
NOISE = 10  # median deviations of unchanged pixels that a change must exceed
CERTAIN = 2  # a change this many times over the threshold is certainly the body's
ITERATIONS = 4  # of GrabCut
LEAST = 1e-3  # of the picture that a body fills


def segment(image: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Mask (H, W) of the body, its largest piece without holes: what differs from the empty scene.

    Image and background are RGB uint8 (H, W, 3); GrabCut refines the mask. Raises InputError where their
    shapes differ, or nothing is found.
    """
    if background.shape != image.shape:
        raise InputError(
            f"The background is of shape {background.shape}, the image of {image.shape}; take both with "
            "the same camera."
        )
    lab = [cv2.cvtColor(i.astype(np.float32) / 255, cv2.COLOR_RGB2LAB) for i in (image, background)]
    difference = lab[0] - lab[1]  # CIE L*a*b*, L from 0 to 100
    difference[..., 0] *= SHADOW
    away = cv2.GaussianBlur(np.linalg.norm(difference, axis=-1), (0, 0), 1.0)
    quiet = float(np.median(away))  # most of the picture has not changed
    threshold = quiet + NOISE * max(float(np.median(np.abs(away - quiet))), 0.3)
    mask = _largest(away > threshold)
    seeds = np.where(mask, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    edge = max(3, round(0.01 * image.shape[0]))  # px, within which GrabCut may move the outline
    seeds[cv2.dilate(mask.astype(np.uint8), _disc(edge)) == 0] = cv2.GC_BGD
    seeds[(cv2.erode(mask.astype(np.uint8), _disc(2)) > 0) & (away > CERTAIN * threshold)] = cv2.GC_FGD
    if (seeds == cv2.GC_BGD).any():
        picture = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
        around, inside = np.zeros((2, 1, 65))  # GrabCut's models of the colours
        cv2.setRNGSeed(0)
        cv2.grabCut(picture, seeds, (0, 0, 0, 0), around, inside, ITERATIONS, cv2.GC_INIT_WITH_MASK)
        mask = _largest(np.isin(seeds, (cv2.GC_FGD, cv2.GC_PR_FGD)))
    return mask


def _largest(mask: np.ndarray) -> np.ndarray:
    """The largest connected piece of a mask without isolated pixels and gaps, with its holes filled."""
    clean = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, _disc(1))
    clean = cv2.morphologyEx(clean, cv2.MORPH_CLOSE, _disc(1))
    outlines, _ = cv2.findContours(clean, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    out = np.zeros_like(clean)
    if outlines:
        cv2.drawContours(out, [max(outlines, key=cv2.contourArea)], -1, 1, cv2.FILLED)
    if out.mean() < LEAST:
        raise InputError(
            "No body was found in the photograph; it looks as its background does, so use another backdrop "
            "or give a mask."
        )
    return out > 0


def _disc(radius: int) -> np.ndarray:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))


def masked_cameras(recording: Recording) -> list[str]:
    """Names of cameras that took images with masks, or with a photograph of the empty scene.

    Columns `image` and `mask` are those of the only camera that `recording.json` describes; raises InputError
    where it describes none or several.
    """
    names = [str(c).removeprefix("image_") for c in recording.samples if re.match(r"image_\w", str(c))]
    names = [n for n in names if recording.has(f"mask_{n}") or background_of(recording, n)]
    if names or not (recording.has("image") and recording.has("mask")):
        return names
    described = list(recording.meta.get("cameras", {}))
    if len(described) != 1:
        several = f"{listed(described)}; name the columns image_<camera> and mask_<camera>"
        wrong = several if described else "none; describe it"
        raise InputError(
            f"{recording.folder / 'recording.json'}: columns 'image' and 'mask' are those of one camera, but "
            f"field 'cameras' describes {wrong}."
        )
    return described


def background_of(recording: Recording, camera: str) -> str | None:
    """The photograph of the scene without the body, `background` of the camera in `recording.json`."""
    return recording.meta.get("cameras", {}).get(camera, {}).get("background")


def column_of(recording: Recording, kind: str, camera: str) -> str:
    """Column of a camera's `image` or `mask`: `image_<camera>`, or `image` where there is no such column."""
    own = f"{kind}_{camera}"
    single = not recording.has(own) and recording.has(kind) and masked_cameras(recording) == [camera]
    return kind if single else own


def read_camera(recording: Recording, name: str) -> Camera:
    """A camera of a recording, base frame; the size of its pictures is that of the first.

    Raises InputError: `recording.json` does not describe it, or does so wrongly.
    """
    described = recording.meta.get("cameras", {})
    if name not in described:
        raise InputError(
            f"{recording.folder / 'recording.json'}: field 'cameras' does not describe {shown(name)}; give "
            'it {"intrinsics": 3x3 in px, "extrinsics": 4x4 from base to camera in m}.'
        )
    height, width = recording.image(recording.column(column_of(recording, "image", name))[0]).shape[:2]
    intrinsics, extrinsics = (described[name].get(f) for f in ("intrinsics", "extrinsics"))
    try:
        return Camera(intrinsics, extrinsics, width, height, described[name].get("distortion", ()))
    except InputError as e:
        raise InputError(f"{recording.folder / 'recording.json'}: camera {shown(name)}: {e}") from e


def read_photograph(recording: Recording, row: int, camera: str) -> tuple[np.ndarray, np.ndarray]:
    """One photograph: RGB uint8 (H, W, 3) and its mask bool (H, W), by segmentation where none was recorded.

    Raises InputError: no such camera, or the mask is of another size than the image.
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
        given, wanted = (f"{a.shape[1]} x {a.shape[0]}" for a in (mask, image))
        where = f"{recording.folder}: {columns['mask']} of row {row + 1}"
        raise InputError(f"{where} has {given} pixels, its image {wanted}; give both the same size.")
    return image, mask
