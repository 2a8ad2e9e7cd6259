"""Pictures of particles: lit balls sorted by depth, seen from one side, without a graphics library."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from pneutac_sim.splat.follow import strain, stretch_colours

STRETCH = "Colour is the largest stretch of the material, from calm to warm."


@dataclass
class FilmFrame:
    """One picture of the film; where `row` is a line of the table, the picture is a still too."""

    picture: np.ndarray
    row: dict | None = None


class Film(NamedTuple):
    """A film that is yet to be drawn.

    Attributes:
        device: of the twin.
        frames: computed one by one.
        count: how many there will be.
        lead: what they show, in a sentence.
        about: which twin and recording, for the report.
    """

    device: str
    frames: Iterator[FilmFrame]
    count: int
    lead: str
    about: str = ""


class Pose(NamedTuple):
    """A body at rest.

    Attributes:
        pressure: (chambers,) kPa.
        positions: (P, 3) of the particles, m.
        gradients: (P, 3, 3) deformation gradients.
        spine: (K, 3) base, joints and tip, m.
    """

    pressure: np.ndarray
    positions: np.ndarray
    gradients: np.ndarray
    spine: np.ndarray


# Draws a pose; the dictionary is what it adds to the table.
Painter = Callable[[Pose], tuple[np.ndarray, dict]]


def pressure_text(pressure: np.ndarray) -> str:
    """Pressures (chambers,) as a caption has them."""
    return f"{', '.join(f'{p:.1f}' for p in pressure)} kPa"


def caption(pose: Pose) -> str:
    """Pressure and tip of a pose."""
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
    """Draws balls into `image`, the farthest first.

    Args:
        image: uint8 (H, W, 3), changed in place.
        points: (P, 3) m.
        rgb: (P, 3) colours.
        radius: of a ball, m.
        view: unit vectors (3,) in the scene that point right and up in the picture; one looks from the third
            side, against their cross product.
        scale: px per m.
        origin: where the scene's origin is, px right and down.
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
    """An empty picture, uint8 (height, width, 3)."""
    return np.full((height, width, 3), PAPER, np.uint8)


def write(image: np.ndarray, text: str, x: int, y: int, size: float = 0.5) -> None:
    """Writes a line of text with its left end at (x, y)."""
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

    Args:
        pose: of the body; its gradients give the colour.
        length_m: of the straight body; sets the scale.
        radius: of a particle, m.
        caption: written below.
        top_strain: strain of the warmest colour.
        turns: one view for each angle, degrees about the body's length; a little, so that one sees its depth.
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

    Args:
        moved_mm: (rows, columns) how far the face has moved into the gel.
        particles_mm: (K, 3) particles of the lattice's cut, mm in the gel frame.
        strains: (K,) of these.
        spacing_mm: between particles.
        window_mm: width and height of the face.
        top_mm: depth of the warmest colour.
        top_strain: strain of the warmest colour in the cut.
        caption: written below.
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
