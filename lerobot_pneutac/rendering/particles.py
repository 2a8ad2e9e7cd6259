"""Pictures of bodies and gels: lit balls sorted by depth, seen from one side, or splats from any side."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from lerobot_pneutac.rendering.options import RenderView
from pneutac_sim.mpm.body import Body
from pneutac_sim.splat.body import ARRAYS, blank_looks, carried, looks_from_twin, strain, stretch_colours
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.gaussians import Gaussians
from pneutac_sim.splat.render import rasterise
from pneutac_sim.twin import Twin

STRETCH = "Colour is the largest stretch of the material, from calm to warm."


@dataclass
class FilmFrame:
    """One picture of the film; where `row` is a line of the table, the picture is a still too."""

    picture: np.ndarray
    row: dict | None = None


class Film(NamedTuple):
    """A film that is yet to be drawn."""

    device: str  # of the twin
    frames: Iterator[FilmFrame]  # computed one by one
    count: int  # how many there will be
    lead: str  # what they show, in a sentence
    about: str = ""  # which twin and recording, for the report


class Pose(NamedTuple):
    """A body at rest."""

    pressure: np.ndarray  # (chambers,) kPa
    positions: np.ndarray  # (P, 3) of the particles, m
    gradients: np.ndarray  # (P, 3, 3) deformation gradients
    spine: np.ndarray  # (K, 3) base, joints and tip, m


# Draws a pose; the dictionary is what it adds to the table.
Painter = Callable[[Pose], tuple[np.ndarray, dict]]


def pressure_text(pressure: np.ndarray) -> str:
    return f"{', '.join(f'{p:.1f}' for p in pressure)} kPa"


def caption(pose: Pose) -> str:
    tip = 1e3 * pose.spine[-1]
    return f"{pressure_text(pose.pressure)}   tip x {tip[0]:.1f}  y {tip[1]:.1f}  z {tip[2]:.1f} mm"


BODY_PX, GEL_PX = (640, 480), (800, 480)  # width and height of pictures
PAPER, INK = (246, 248, 250), (27, 36, 48)


def draw_particles(
    image: np.ndarray,
    points: np.ndarray,
    rgb: np.ndarray,
    radius: float,
    view: tuple[np.ndarray, np.ndarray],
    scale: float,
    origin: tuple[float, float],
) -> None:
    """Draws balls at points (P, 3) m with colours (P, 3) into an image, uint8 (H, W, 3), the farthest first.

    `view` are the unit vectors in the scene that point right and up in the picture; one looks against their
    cross product. `scale` is in px a metre, and `origin` where the scene's origin is, px right and down.
    """
    right, up = (np.asarray(v, float) for v in view)
    at = points @ np.stack([right, -up, np.cross(right, up)], 1)  # the last grows towards the eye
    x, y = origin[0] + scale * at[:, 0], origin[1] + scale * at[:, 1]
    nearness = (at[:, 2] - at[:, 2].min()) / max(np.ptp(at[:, 2]), 1e-9)
    r = max(1, round(scale * radius))
    for i in np.argsort(at[:, 2]):
        shade = 0.55 + 0.45 * nearness[i]
        centre = (round(x[i]), round(y[i]))
        cv2.circle(image, centre, r, (0.78 * shade * rgb[i]).tolist(), -1, cv2.LINE_AA)
        light, bright = (centre[0] - r // 3, centre[1] - r // 3), np.minimum(1.08 * shade * rgb[i], 255)
        cv2.circle(image, light, max(1, r // 2), bright.tolist(), -1, cv2.LINE_AA)


def blank(width: int, height: int) -> np.ndarray:
    return np.full((height, width, 3), PAPER, np.uint8)


def write(image: np.ndarray, text: str, x: int, y: int, size: float = 0.5) -> None:
    cv2.putText(image, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, size, INK, 1, cv2.LINE_AA)


def body_picture(
    pose: Pose,
    length_m: float,
    radius: float,
    caption: str,
    top_strain: float,
    turns: tuple[float, ...] = (24.0,),
) -> np.ndarray:
    """A bending body from its side (x down, so that it hangs; z to the right), its spine drawn over it.

    Colour is the strain, the warmest that of `top_strain`. There is a view for each of `turns`, degrees about
    the body's length; a little, so that one sees its depth.
    """
    width, height = BODY_PX
    image = blank(width, height)
    rgb = stretch_colours(strain(pose.gradients), top_strain)
    scale = 0.74 * height / length_m
    for k, degrees in enumerate(turns):
        tilt = np.radians(degrees)
        view = (np.array([0.0, np.sin(tilt), np.cos(tilt)]), np.array([-1.0, 0.0, 0.0]))
        origin = ((k + 0.36) * width / len(turns), 0.09 * height)
        draw_particles(image, pose.positions, rgb, 0.62 * radius, view, scale, origin)
        x, y = int(origin[0]), int(origin[1])
        cv2.rectangle(image, (x - 60, y - 16), (x + 60, y - 2), (90, 100, 112), -1)  # what holds the base
        at = np.stack([origin[0] + scale * pose.spine @ view[0], origin[1] - scale * pose.spine @ view[1]], 1)
        xy = at.round().astype(int)
        cv2.polylines(image, [xy], False, INK, 2, cv2.LINE_AA)
        for p in xy[1:-1]:
            cv2.circle(image, tuple(p.tolist()), 5, (255, 214, 102), -1, cv2.LINE_AA)
            cv2.circle(image, tuple(p.tolist()), 5, INK, 1, cv2.LINE_AA)
    write(image, caption, 16, height - 18, 0.55)
    return image


def gel_picture(
    moved_mm: np.ndarray,
    particles_mm: np.ndarray,
    strains: np.ndarray,
    spacing_mm: float,
    window_mm: tuple[float, float],
    top_mm: float,
    top_strain: float,
    caption: str,
) -> np.ndarray:
    """The face of a gel from above, lit from one side, and a cut along its deepest row.

    The face (rows, columns) has moved into the gel by so many mm; the cut has particles (K, 3) mm in the gel
    frame and their strains (K,). Colours are warmest at `top_mm` and at `top_strain`.
    """
    width, height = GEL_PX
    image = blank(width, height)
    face_height = height - 90
    face_width = round(face_height * window_mm[0] / window_mm[1])
    rows, cols = moved_mm.shape
    slope_y, slope_x = np.gradient(-moved_mm, window_mm[1] / rows, window_mm[0] / cols)
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    light = np.array([-0.45, -0.55, 0.70])
    shade = np.clip(normal @ light / 0.70, 0.25, 1.35)[..., None]
    face = np.clip(stretch_colours(moved_mm, top_mm) * shade, 0, 255).astype(np.uint8)
    face = cv2.resize(face, (face_width, face_height), interpolation=cv2.INTER_CUBIC)
    image[24 : 24 + face_height, 16 : 16 + face_width] = face
    line = 24 + round((np.unravel_index(moved_mm.argmax(), moved_mm.shape)[0] + 0.5) / rows * face_height)
    cv2.line(image, (16, line), (16 + face_width, line), (255, 255, 255), 1, cv2.LINE_AA)
    left = 16 + face_width + 36
    scale = (width - left - 16) / (1.06 * window_mm[0])
    origin = (left + 0.53 * window_mm[0] * scale, 0.5 * height)
    view = (np.array([1.0, 0, 0]), np.array([0, 0, 1.0]))
    draw_particles(
        image, particles_mm, stretch_colours(strains, top_strain), 0.55 * spacing_mm, view, scale, origin
    )
    write(image, "cut along the white line", left, 40)
    write(image, caption, 16, height - 22, 0.55)
    return image


def beside(picture: np.ndarray, tactile: np.ndarray) -> np.ndarray:
    """A gel's picture with a tactile image (H, W, 3) uint8 to its right, as high as the face."""
    height = len(picture) - 90
    width = round(height * tactile.shape[1] / tactile.shape[0])
    panel = blank(width + 16 + width % 2, len(picture))
    panel[24 : 24 + height, :width] = cv2.resize(tactile, (width, height), interpolation=cv2.INTER_AREA)
    write(panel, "tactile image", 0, len(picture) - 22, 0.55)
    return np.concatenate([picture, panel], 1)


CAPTION = 44  # px below the picture
FOV_DEG = 20.0  # so that four lengths away the straight body fills seven tenths of the height


def view_camera(view: RenderView, aim: np.ndarray, length_m: float) -> Camera:
    """The camera of a view to `aim` (3,) m; the body hangs, and at no angle bends to the right."""
    around, above = np.radians([view.azimuth_deg, view.elevation_deg])
    side = np.array([0.0, -np.cos(around), np.sin(around)])
    base = np.array([-1.0, 0.0, 0.0])
    away = np.cos(above) * side + np.sin(above) * base
    eye = aim + view.distance_lengths * length_m * away
    return Camera.look_at(eye, aim, np.cos(above) * base - np.sin(above) * side, FOV_DEG, *BODY_PX)


def view_painter(twin: Twin, body: Body, view: RenderView, spines: np.ndarray) -> tuple[Painter, str]:
    """Draws poses from a view, and says what one sees; in the middle is that of `spines` (T, K, 3) m."""
    points = spines.reshape(-1, 3)
    camera = view_camera(view, (points.min(0) + points.max(0)) / 2, 1e-3 * twin.length_mm)
    looks_of = body_looks(twin, body)

    def paint(pose: Pose) -> tuple[np.ndarray, dict]:
        now = looks_of(pose.positions, pose.gradients)
        seen = rasterise(now, camera, np.array(PAPER) / 255)
        width, height = BODY_PX
        image = blank(width, height + CAPTION)
        image[:height] = (255 * seen.image.clip(0, 1)).round()
        write(image, caption(pose), 16, height + CAPTION - 18, 0.55)
        return image, {}

    own = "The body in its own looks, by Gaussian splats on the particles."
    return paint, own if has_looks(twin) else STRETCH


def has_looks(twin: Twin) -> bool:
    """Whether a photograph gave the twin its looks."""
    return all(array in twin.arrays for array in ARRAYS)


def body_looks(twin: Twin, body: Body) -> Callable[[np.ndarray, np.ndarray], Gaussians]:
    """What gives the Gaussians of a body for its particles' positions (P, 3), m, and gradients (P, 3, 3).

    They are in the twin's looks, or coloured by stretch where it has none.
    """
    own = has_looks(twin)
    looks = looks_from_twin(twin) if own else blank_looks(body)

    def now(positions: np.ndarray, gradients: np.ndarray) -> Gaussians:
        moved = carried(looks, body, positions, gradients)
        return moved if own else replace(moved, colours=stretch_colours(strain(gradients)) / 255)

    return now
