"""Indenters of bench recordings: the shapes that the environment's objects are made of, and any other."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pneutac_sim.errors import InputError, check_choice
from pneutac_sim.gel.figure import AnyFigure
from pneutac_sim.gel.probe import BOX, COLS, CONE, CYLINDER, ROWS, SPHERE, THICKNESS_MM, WINDOW_MM, probe_grid

INDENTERS = ("sphere", "cylinder", "cube", "edge", "cone")
FIGURES = ("outline", "mesh")


@dataclass
class Press:
    """One indenter pressed into the gel, gel frame.

    Attributes:
        indenter: `sphere`; `cylinder` standing on its flat end; `cube` on a face; `edge`, a cube on one of
            its edges, which lies along x; `cone` on its apex, with a right angle of opening; `outline` and
            `mesh` as their figure says.
        size_mm: radius of sphere, cylinder or the cone's base; side of cube and edge; of a figure how far it
            reaches from its centre, which is filled in.
        x_mm: position of the contact centre along image columns, from the window's centre.
        y_mm: along image rows.
        depth_mm: how deep the lowest point lies below the resting surface, before it leans.
        yaw_rad: turn about z, from x towards y.
        figure: of `outline` and `mesh`, none of the others.
        tilt_x_rad: how far it leans about the contact's centre, deeper at larger x; small.
        tilt_y_rad: the same, deeper at larger y.
    """

    indenter: str
    size_mm: float
    x_mm: float
    y_mm: float
    depth_mm: float
    yaw_rad: float = 0.0
    figure: AnyFigure | None = None
    tilt_x_rad: float = 0.0
    tilt_y_rad: float = 0.0

    def __post_init__(self):
        check_choice("indenter", self.indenter, INDENTERS + FIGURES)
        if (self.indenter in FIGURES) != (self.figure is not None):
            raise InputError(
                f"An indenter '{self.indenter}' {'needs a' if self.figure is None else 'has no'} figure."
            )
        if self.figure is not None:
            self.size_mm = self.figure.reach_mm
        for name in ("size_mm", "depth_mm"):
            if not 0 < getattr(self, name) < np.inf:
                raise InputError(
                    f"{name} of the {self.indenter} is {getattr(self, name)}; give millimetres above zero."
                )

    @property
    def contact_radius_mm(self) -> float:
        """Nominal contact radius: Hertz' sqrt(R d) for a sphere, else that of the touching figure."""
        s, d = self.size_mm, self.depth_mm
        if self.figure is not None:
            return self.figure.radius_mm(d)
        return {
            "sphere": np.sqrt(s * d),
            "cylinder": s,
            "cube": s / np.sqrt(2),
            "edge": s / 2,
            "cone": min(d, s),
        }[self.indenter]

    @property
    def turn(self) -> Rotation:
        """From the upright indenter's frame to the gel's, about the contact's centre."""
        lean = Rotation.from_rotvec([-self.tilt_y_rad, self.tilt_x_rad, 0.0])
        return lean * Rotation.from_euler("z", self.yaw_rad)

    def depths(
        self,
        window_mm: tuple[float, float] = WINDOW_MM,
        thickness_mm: float = THICKNESS_MM,
        shape: tuple[int, int] = (ROWS, COLS),
    ) -> np.ndarray:
        """Probe grid of this indenter, float32 `shape` in mm; arguments as of `probe_grid`."""
        if self.figure is None:
            return probe_grid(*self.shapes(), window_mm=window_mm, thickness_mm=thickness_mm, shape=shape)
        x, y = (
            (np.arange(n) + 0.5) * size / n - size / 2 - at
            for n, size, at in zip(shape[::-1], window_mm, (self.x_mm, self.y_mm), strict=True)
        )
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        x, y = np.meshgrid(x, y)
        lean = np.tan(self.tilt_x_rad) * x + np.tan(self.tilt_y_rad) * y
        below = self.depth_mm + lean - self.figure.height_mm(c * x + s * y, c * y - s * x)
        return below.clip(0, thickness_mm).astype(np.float32)

    def shapes(self) -> tuple:
        """`kinds, sizes, positions, rotations` for `probe_grid`, in metres.

        Raises:
            InputError: a figure is made of no such shapes; `depths` knows it.
        """
        if self.figure is not None:
            raise InputError(f"An indenter '{self.indenter}' is made of none of the shapes {INDENTERS}.")
        s, tilt = self.size_mm, Rotation.identity()
        if self.indenter == "sphere":
            kind, size, low = SPHERE, (s, 0, 0), s
        elif self.indenter == "cylinder":
            kind, size, low = CYLINDER, (s, 5.0, 0), 5.0
        elif self.indenter == "cone":
            kind, size, low = CONE, (s, s / 2, 0), s / 2
        else:
            kind, size, low = BOX, (s / 2, s / 2, s / 2), s / 2
            if self.indenter == "edge":
                tilt, low = Rotation.from_euler("x", np.pi / 4), s / np.sqrt(2)
        position = np.array([self.x_mm, self.y_mm, -self.depth_mm]) + self.turn.apply([0.0, 0.0, low])
        return [kind], [np.array(size) * 1e-3], [position * 1e-3], [(self.turn * tilt).as_matrix()]
