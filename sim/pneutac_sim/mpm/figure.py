"""An indenter of any form for the material points: its signed distance on a cube."""

import numpy as np

from pneutac_sim.gel.figure import AnyFigure

SAMPLES = 49  # along each edge of the cube
BELOW = 0.4  # of half its edge lies below the figure's lowest point


def half_edge_m(figure: AnyFigure) -> float:
    """Half the edge of the cube around a figure's tip, m."""
    return 1.25e-3 * figure.reach_mm


def centre_m(figure: AnyFigure) -> np.ndarray:
    """(3,) of the cube, from the figure's tip."""
    return np.array([0.0, 0.0, (1 - BELOW) * half_edge_m(figure)])


def distances_m(figure: AnyFigure) -> np.ndarray:
    """(n, n, n) signed distances over the cube: the table of `TotalLagrangian` for the indenter `mesh`."""
    line = np.linspace(-1, 1, SAMPLES) * half_edge_m(figure)
    points = np.stack(np.meshgrid(line, line, line, indexing="ij"), -1) + centre_m(figure)
    return 1e-3 * figure.distance_mm(1e3 * points.reshape(-1, 3)).reshape(points.shape[:3])
