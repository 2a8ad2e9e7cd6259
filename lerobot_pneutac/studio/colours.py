"""Colours of the studio: those of the reports, distinct for the colour-blind, on light and on dark."""

from lerobot_pneutac.reports.colours import FLOOR, MODEL

MEASURED = "#7a8794"  # the reports' is near black, which a dark page swallows
PRESSURE = "#2389bd"  # as that of the reports, lighter, for lines on dark
BRAND = (12, 116, 162)  # the viewer makes it lighter on light, so that both are seen at about 3 : 1
SKIN, BASE = (120, 170, 200), (90, 100, 112)
SPINE, JOINTS, TRAIL = (27, 36, 48), (255, 214, 102), (209, 73, 91)
__all__ = [
    "BASE",
    "BRAND",
    "FLOOR",
    "JOINTS",
    "MEASURED",
    "MODEL",
    "PRESSURE",
    "SKIN",
    "SPINE",
    "TRAIL",
    "rgb",
]


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue of `#rrggbb`."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
