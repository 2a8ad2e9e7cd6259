"""Where the tip is: ArUco markers in a calibrated camera, and the camera's calibration by a chessboard.

The tip of a finger in a film: ArUco markers in a calibrated camera, or dots in the bending plane.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from pneutac_datasets.recording.sources.readers import Track
from pneutac_sim.errors import InputError
from pneutac_sim.files import read_image, read_json, refuse_pointer, write_json

DICTIONARY, MARKERS = cv2.aruco.DICT_4X4_50, 50
CELLS = 6  # of a marker's side, its dark rim included
MIN_VIEWS = 8
MOST_MOVED = 0.05  # of its side: how far edges that are all seen move a marker's corner, at most

# The base marker lies in the bending plane: its right is the finger's x, its upper side z, and it faces -y.
BASE_FROM_MARKER = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera."""

    matrix: np.ndarray  # (3, 3), px
    distortion: np.ndarray  # (5,) OpenCV's k1, k2, p1, p2, k3
    size_px: tuple[int, int]  # width and height of the images that it holds for
    rms_px: float  # reprojection error of the calibration

    @classmethod
    def load(cls, path: str | Path) -> "Intrinsics":
        """Reads what `save` wrote; raises InputError where something is missing."""
        try:
            d = read_json(Path(path))
            matrix, distortion = np.array(d["intrinsics"], float), np.array(d["distortion"], float)
            size, rms = (int(d["width"]), int(d["height"])), float(d["rms_px"])
        except (ValueError, KeyError, TypeError) as e:
            remedy = "make one with pneutac measure --chessboard=FOLDER"
            raise InputError(f"intrinsics={path} is no camera calibration ({e}); {remedy}.") from e
        if matrix.shape != (3, 3) or distortion.shape != (5,) or not np.isfinite(matrix).all():
            raise InputError(f"{path}: 'intrinsics' must be 3 x 3 and 'distortion' have 5 numbers.")
        return cls(matrix, distortion, size, rms)

    def save(self, path: str | Path) -> None:
        d = {"intrinsics": self.matrix.tolist(), "distortion": self.distortion.tolist()}
        d |= dict(zip(("width", "height"), self.size_px, strict=True)) | {"rms_px": self.rms_px}
        write_json(Path(path), d)


def calibrate_camera(
    folder: Path, inner_corners: tuple[int, int], square_mm: float
) -> tuple[Intrinsics, int]:
    """Calibrates a camera by photographs of a chessboard (Zhang 2000, as in OpenCV), each of another pose.

    Returns the camera, and in how many photographs the whole board of `inner_corners` was found.
    """
    files = sorted(p for p in Path(folder).glob("*") if p.suffix.lower() in (".png", ".jpg", ".jpeg"))
    board = np.zeros((inner_corners[0] * inner_corners[1], 3), np.float32)
    board[:, :2] = np.mgrid[: inner_corners[0], : inner_corners[1]].T.reshape(-1, 2) * square_mm
    seen, size = [], None
    for file in files:
        image = cv2.cvtColor(read_image(file), cv2.COLOR_RGB2GRAY)
        if size not in (None, image.shape[::-1]):
            raise InputError(f"{file} is {image.shape[::-1]} px, the photographs before {size}.")
        size = image.shape[::-1]
        found, corners = cv2.findChessboardCornersSB(image, inner_corners)
        if found:
            seen.append(corners)
    if len(seen) < MIN_VIEWS:
        board = "a board of {} x {} inner corners".format(*inner_corners)
        whole = f"{board} is whole in {len(seen)} of {len(files)} photographs"
        raise InputError(f"{folder}: {whole}; {MIN_VIEWS} are needed, near and far and tilted.")
    rms, matrix, distortion, _, _ = cv2.calibrateCamera([board] * len(seen), seen, size, None, None)
    return Intrinsics(matrix, distortion.ravel()[:5], size, float(rms)), len(seen)


class MarkerTracker:
    """Position of the tip marker in the finger's base frame, which a second marker at the base defines.

    Both are of OpenCV's 4 x 4 dictionary of 50, squares of `marker_mm`. `base_offset_mm` leads from the
    finger's base to the base marker's centre, in the base frame.
    """

    def __init__(
        self, camera: Intrinsics, marker_mm: float, base_id: int, tip_id: int, base_offset_mm: np.ndarray
    ):
        self.camera, self._base_id, self._tip_id = camera, base_id, tip_id
        self._offset = np.asarray(base_offset_mm, float)
        h = marker_mm / 2
        self._square = np.array([[-h, h, 0], [h, h, 0], [h, -h, 0], [-h, -h, 0]])
        self._detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(DICTIONARY))
        self._base = None

    def see_base(self, images: list[np.ndarray]) -> None:
        """Takes the base marker's pose from images (H, W, 3) RGB, by the mean of its corners."""
        size = images[0].shape[1::-1]
        if size != self.camera.size_px:
            given, right = (f"{w} x {h}" for w, h in (size, self.camera.size_px))
            raise InputError(f"The camera gives images of {given} px, its calibration is for {right}.")
        found = [c for c in (self._corners(i, self._base_id) for i in images) if c is not None]
        if 2 * len(found) < len(images):
            seen = f"The base marker {self._base_id} is seen in {len(found)} of {len(images)} images"
            raise InputError(f"{seen}; light it evenly and keep a white border around it.")
        self._base = self._pose(np.mean(found, axis=0))

    def tip_mm(self, image: np.ndarray) -> np.ndarray | None:
        """Centre of the tip marker (3,) in the base frame, mm, or None where it is not seen."""
        corners = self._corners(image, self._tip_id)
        if corners is None:
            return None
        R, t = self._base
        _, tip = self._pose(corners, R[:, 2])  # the finger bends in the plane of both markers
        return BASE_FROM_MARKER @ (R.T @ (tip - t)) + self._offset

    def extrinsics(self) -> np.ndarray:
        """From the finger's base frame to the camera (4, 4), metres."""
        R, t = self._base
        out = np.eye(4)
        out[:3, :3] = R @ BASE_FROM_MARKER.T
        out[:3, 3] = (t - out[:3, :3] @ self._offset) / 1000
        return out

    def _corners(self, image: np.ndarray, number: int) -> np.ndarray | None:
        """Corners (4, 2), px, of one marker by its edges; None where one cannot be seen, as at the border."""
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        corners, ids, _ = self._detector.detectMarkers(grey)
        for i, c in zip([] if ids is None else ids.ravel(), corners, strict=True):
            if i == number:
                found = c[0].astype(float)
                fitted = fit_edges(grey.astype(np.float32), found)
                side = np.linalg.norm(found - np.roll(found, 1, axis=0), axis=1).mean()
                moved = np.linalg.norm(fitted - found, axis=1).max()
                return fitted if moved <= max(MOST_MOVED * side, 2.0) else None
        return None

    def _pose(self, corners: np.ndarray, facing: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Rotation (3, 3) and shift (3,) mm, marker to camera, by its corners (4, 2) px.

        A square seen from the front has two solutions whose errors hardly differ: the one is taken that
        rather faces the direction `facing` (3,) in the camera's frame, else the one of smaller error.
        """
        given = corners.astype(float), self.camera.matrix, self.camera.distortion
        _, turns, shifts, errors = cv2.solvePnPGeneric(self._square, *given, flags=cv2.SOLVEPNP_IPPE_SQUARE)
        normals = [cv2.Rodrigues(t)[0][:, 2] for t in turns]
        best = int(np.argmin(errors if facing is None else [-n @ facing for n in normals]))
        turn, shift = cv2.solvePnPRefineLM(self._square, *given, turns[best], shifts[best])
        return cv2.Rodrigues(turn)[0], shift.ravel()


def fit_edges(grey: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Corners (4, 2) px of a dark square on light ground, as intersections of lines fitted to its edges.

    Refining single corners shrinks a marker of 40 px by 1 %, which moves it away by as much; whole edges do
    not. Along profiles across an edge, brightness is read as the share of the profile outside the square.
    """
    along = np.linspace(0.12, 0.88, 24)[:, None]
    for _ in range(3):  # each starts from the corners of the one before
        lines = []
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            edge = (b - a) / np.linalg.norm(b - a)
            out = np.array([edge[1], -edge[0]])
            out *= np.sign(out @ (a - corners.mean(0)))
            reach = 0.8 * np.linalg.norm(b - a) / CELLS  # within the dark and the light rim
            u = np.linspace(-reach, reach, 33)
            at = (a + along * (b - a))[:, None] + u[:, None] * out  # (24, 33, 2)
            profile = cv2.remap(grey, at.astype(np.float32), None, cv2.INTER_LINEAR)
            dark, light = profile[:, :6].mean(), profile[:, -6:].mean()
            share = (profile - dark).mean(1) / max(light - dark, 1.0)
            points = a + along * (b - a) + ((1 - 2 * share) * reach)[:, None] * out
            vx, vy, x, y = cv2.fitLine(points.astype(np.float32), cv2.DIST_HUBER, 0, 0.01, 0.01).ravel()
            lines.append([-vy, vx, vy * x - vx * y])
        corners = np.array([np.cross(lines[k - 1], lines[k]) for k in range(4)])
        corners = corners[:, :2] / corners[:, 2:]
    return corners


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
    film = frames(file)
    begin = list(itertools.islice(film, BASE_FRAMES))
    if len(begin) < BASE_FRAMES:
        raise InputError(f"{file} has {len(begin)} pictures; {BASE_FRAMES} or more are needed.")
    tracker.see_base([image for _, image in begin])
    found = [(time_s, tracker.tip_mm(image)) for time_s, image in itertools.chain(begin, film)]
    times, places = zip(*found, strict=True)
    return Track(np.array(times), np.array([np.full(3, np.nan) if p is None else p for p in places]))


def track_dots(
    file: Path, tip_rgb: tuple[int, int, int], base_rgb: tuple[int, int, int], dots_mm: float,
    camera: Intrinsics | None = None,
) -> Track:  # fmt: skip
    """A dot at the tip in the plane of the picture, as (x, 0, z) in the base frame, z upwards in the picture.

    Two dots of one colour lie on the straight finger's axis: the one farther from the tip at the finger's
    base, the other `dots_mm` ahead of it. Camera and bending plane must be parallel. Raises InputError where
    the colours are too similar or grey, or the base's dots are not seen in the first frames.
    """
    tip_hue, base_hue = _hue(tip_rgb, "tip_rgb"), _hue(base_rgb, "base_rgb")
    if _hue_difference(np.array(tip_hue), base_hue) < 2 * HUE_DEGREES:
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
    far = _hue_difference(2.0 * hsv[..., 0].astype(float), hue) > HUE_DEGREES
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


def _hue_difference(hues: np.ndarray, hue: float) -> np.ndarray:
    return np.abs((hues - hue + 180.0) % 360.0 - 180.0)
