"""The tip of a finger in a film: ArUco markers in a calibrated camera, or dots in the bending plane."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from lerobot_pneutac.measuring.camera import Intrinsics, MarkerTracker
from pneutac_datasets.recording.sources.tracks import Track
from pneutac_sim.errors import InputError
from pneutac_sim.files import refuse_pointer

BASE_FRAMES = 10  # first frames, of which the base's place is the mean
HUE_DEGREES, LEAST_SATURATION, LEAST_VALUE = 15.0, 90, 60  # of a dot's pixels: from its colour, of 255
LEAST_PIXELS = 12


def frames(file: Path) -> Iterator[tuple[float, np.ndarray]]:
    """Times, s, and images RGB (H, W, 3) of a film; raises InputError where it cannot be read.

    The times are the film's own stamps: phones take frames unevenly.
    """
    refuse_pointer(file)
    film = cv2.VideoCapture(str(file))
    fps = film.get(cv2.CAP_PROP_FPS)
    if not (film.isOpened() and fps > 0):
        raise InputError(f"{file} is no film that OpenCV reads; convert it to MP4 (H.264).")
    try:
        number, last_s = 0, -1.0
        while True:
            good, image = film.read()
            if not good:
                break
            time_s = film.get(cv2.CAP_PROP_POS_MSEC) / 1000
            if not time_s > last_s:  # a container without stamps
                time_s = number / fps if number / fps > last_s else last_s + 1 / fps
            yield time_s, cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
            number, last_s = number + 1, time_s
    finally:
        film.release()
    if not number:
        raise InputError(f"{file} holds no picture.")


def track_aruco(file: Path, tracker: MarkerTracker) -> Track:
    """The tip marker in the base frame, which the base marker of the first frames defines."""
    times, places, begin = [], [], []
    for time_s, image in frames(file):
        times.append(time_s)
        if len(begin) < BASE_FRAMES:
            begin.append(image)
            if len(begin) == BASE_FRAMES:
                tracker.see_base(begin)
                places = [tracker.tip_mm(i) for i in begin]
        else:
            places.append(tracker.tip_mm(image))
    if len(times) < BASE_FRAMES:
        raise InputError(f"{file} has {len(times)} pictures; {BASE_FRAMES} or more are needed.")
    nowhere = np.full(3, np.nan)
    return Track(np.array(times), np.array([nowhere if p is None else p for p in places]))


def track_dots(
    file: Path, tip_rgb: tuple[int, int, int], base_rgb: tuple[int, int, int], dots_mm: float,
    camera: Intrinsics | None = None,
) -> Track:  # fmt: skip
    """A dot at the tip in the plane of the picture, as (x, 0, z) in the base frame, z upwards in the picture.

    Two dots of one colour lie on the straight finger's axis: the one farther from the tip at the finger's
    base, the other `dots_mm` ahead of it. Camera and bending plane must be parallel.

    Args:
        file: the film.
        tip_rgb: colour of the tip's dot, 0 to 255 each.
        base_rgb: of the two at the base; another hue.
        dots_mm: between these two.
        camera: takes out the lens's distortion; without it there is none.

    Raises:
        InputError: the colours are too similar or grey, or the base's dots are not seen in the first frames.
    """
    tip_hue, base_hue = _hue(tip_rgb, "tip_rgb"), _hue(base_rgb, "base_rgb")
    if _apart(np.array(tip_hue), base_hue) < 2 * HUE_DEGREES:
        raise InputError(f"tip_rgb {tip_rgb} and base_rgb {base_rgb} are of nearly one hue; use another dot.")
    times, tips, bases = [], [], []
    for time_s, image in frames(file):
        hsv = cv2.cvtColor(image, cv2.COLOR_RGB2HSV)
        times.append(time_s)
        tips.append(_dots(hsv, tip_hue, 1, camera))
        if len(bases) < BASE_FRAMES:
            bases.append(_dots(hsv, base_hue, 2, camera))
    tip = np.concatenate(tips)
    base = np.nanmedian(np.stack(bases), 0)
    if not (np.isfinite(base).all() and np.isfinite(tip[0]).all()):
        raise InputError(f"{file}: the first pictures must show the tip's dot and both at the base.")
    if np.linalg.norm(base[0] - tip[0]) < np.linalg.norm(base[1] - tip[0]):
        base = base[::-1]
    along = base[1] - base[0]
    scale = dots_mm / np.linalg.norm(along)
    x = along / np.linalg.norm(along)
    z = np.array([x[1], -x[0]])  # rows grow downwards
    away = (tip - base[0]) * scale
    return Track(np.array(times), np.stack([away @ x, 0 * away[:, 0], away @ z], 1))


def _dots(hsv: np.ndarray, hue: float, count: int, camera: Intrinsics | None) -> np.ndarray:
    """Middles (count, 2), px, of the largest dots of a hue; NaN where there are fewer."""
    far = _apart(2.0 * hsv[..., 0].astype(float), hue) > HUE_DEGREES
    mask = (~far & (hsv[..., 1] > LEAST_SATURATION) & (hsv[..., 2] > LEAST_VALUE)).astype(np.uint8)
    _, _, stats, middles = cv2.connectedComponentsWithStats(mask)
    sizes = stats[1:, cv2.CC_STAT_AREA]
    order = [k for k in np.argsort(-sizes)[:count] if sizes[k] >= LEAST_PIXELS]
    if len(order) < count:
        return np.full((count, 2), np.nan)
    found = middles[1:][order]
    if camera is not None:
        given = camera.matrix, camera.distortion
        found = cv2.undistortPoints(found[:, None], *given, P=camera.matrix)[:, 0]
    return found


def _hue(rgb: tuple[int, int, int], option: str) -> float:
    hue, saturation, _ = cv2.cvtColor(np.uint8([[rgb]]), cv2.COLOR_RGB2HSV)[0, 0]
    if saturation <= LEAST_SATURATION:
        raise InputError(f"{option} is {rgb}, which is nearly grey; use a coloured dot.")
    return 2.0 * float(hue)


def _apart(hues: np.ndarray, hue: float) -> np.ndarray:
    """Degrees between hues round the circle."""
    return np.abs((hues - hue + 180.0) % 360.0 - 180.0)
