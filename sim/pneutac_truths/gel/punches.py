"""Rigid indenters as signed distances, and how far each mesh must reach for them.

Distances of boxes, prisms and cones: Hart, The Visual Computer 12 (1996) 527. Edges are broken by a small
radius, as machined ones are. All in mm, in the indenter's frame: its lowest point is at the origin, z up.
"""

from dataclasses import dataclass, field

import numpy as np

BROKEN_EDGE_MM = 0.12
KINDS = ("sphere", "cylinder", "cube", "edge", "cone", "outline")


@dataclass(frozen=True)
class Punch:
    """A rigid indenter.

    Attributes:
        kind: one of `KINDS`; `cylinder` stands on its flat end, `edge` is a cube on an edge along x, `cone`
            has a right angle at its apex, `outline` is a prism that stands on a polygon.
        size_mm: radius of sphere and cylinder, side of cube and edge; unused for cone and outline.
        outline_mm: (n, 2) corners of the polygon, in order.
    """

    kind: str
    size_mm: float = 3.0
    outline_mm: tuple[tuple[float, float], ...] = field(default=())

    def __post_init__(self):
        if self.kind not in KINDS:
            raise ValueError(f"There is no indenter '{self.kind}'; it must be one of {', '.join(KINDS)}.")
        if self.kind == "outline" and len(self.outline_mm) < 3:
            raise ValueError("An outline needs three corners or more.")

    @property
    def mirrored(self) -> tuple[bool, bool]:
        """Whether it is its own mirror image in x and in y, so that half or a quarter of the gel will do."""
        if self.kind != "outline":
            return True, True
        corners = np.array(self.outline_mm)

        def same(flipped):
            return all(np.abs(corners - c).sum(1).min() < 1e-6 for c in flipped)

        return same(corners * [-1, 1]), same(corners * [1, -1])

    def reach_mm(self, depth_mm: float) -> tuple[float, float]:
        """How far it touches along x and y at most."""
        s, d = self.size_mm, depth_mm
        if self.kind == "outline":
            x, y = np.abs(self.outline_mm).max(0)
            return float(x), float(y)
        ball = float(np.sqrt(1.2 * s * d))
        return {
            "sphere": (ball, ball),
            "cylinder": (s, s),
            "cube": (s / 2, s / 2),
            "edge": (s / 2, d),
            "cone": (d, d),
        }[self.kind]

    def distance(self, p: np.ndarray) -> np.ndarray:
        """Signed distance (n,) of points (n, 3) to its surface; negative inside."""
        x, y, z = p.T
        s, r = self.size_mm, BROKEN_EDGE_MM
        if self.kind == "sphere":
            return np.sqrt(x**2 + y**2 + (z - s) ** 2) - s
        if self.kind == "cylinder":
            return _prism(np.hypot(x, y) - s, z, r)
        if self.kind == "cube":
            return _prism(_corner(np.abs(x) - s / 2, np.abs(y) - s / 2), z, r)
        if self.kind == "outline":
            return _prism(polygon_distance(np.stack([x, y], 1), np.array(self.outline_mm)), z, r)
        if self.kind == "edge":
            half = s / 2 - r
            up = z - r - half * np.sqrt(2)  # over the cube's middle
            a, b = (y + up) / np.sqrt(2), (up - y) / np.sqrt(2)
            q = np.stack([np.abs(x) - half, np.abs(a) - half, np.abs(b) - half])
            return np.linalg.norm(np.maximum(q, 0), axis=0) + np.minimum(q.max(0), 0) - r
        rho, up = np.hypot(x, y), z - r
        flank = (rho - up) / np.sqrt(2)
        return np.where(rho + up > 0, flank, np.hypot(rho, up)) - r

    def outward(self, p: np.ndarray) -> np.ndarray:
        """Gradient (n, 3) of the distance, by central differences."""
        h = 1e-5
        steps = h * np.eye(3)
        return np.stack([(self.distance(p + e) - self.distance(p - e)) / (2 * h) for e in steps], 1)


def _corner(u, v):
    """Distance to a right-angled corner, beyond whose sides a point lies by u and v."""
    return np.hypot(np.maximum(u, 0), np.maximum(v, 0)) + np.minimum(np.maximum(u, v), 0)


def _prism(outside, z, r: float):
    """A prism that stands on z = 0, its lower edge broken by r; `outside` is the distance to its outline."""
    return _corner(outside + r, r - z) - r


def polygon_distance(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Signed distance (n,) of points (n, 2) to a polygon; negative inside."""
    nearest = np.full(len(points), np.inf)
    inside = np.zeros(len(points), bool)
    for a, b in zip(corners, np.roll(corners, -1, 0), strict=True):
        along, to = b - a, points - a
        t = np.clip(to @ along / (along @ along), 0, 1)
        nearest = np.minimum(nearest, np.linalg.norm(to - t[:, None] * along, axis=1))
        crosses = (points[:, 1] < a[1]) != (points[:, 1] < b[1])
        if along[1]:
            inside ^= crosses & (to[:, 0] < to[:, 1] * along[0] / along[1])
    return np.where(inside, -nearest, nearest)
