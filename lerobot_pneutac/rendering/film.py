"""What a film is made of, shared by those who draw one."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

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
