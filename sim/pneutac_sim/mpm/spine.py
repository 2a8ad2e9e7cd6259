"""The spine: rigid links with hinges in the neutral axis of a body, driven by a controller."""

from dataclasses import dataclass

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.mpm.body import Body, RestGrid


@dataclass(frozen=True)
class Spine:
    """A chain of hinges along x; a positive angle bends towards +z (and, with two axes, towards +y).

    Torque of the controller: stiffness (q_cmd - q) - damping q'.

    Attributes:
        joint_positions_m: (N,) along x, m.
        length_m: where the last link ends, m.
        y_m: of the axis, m.
        z_m: of the axis, m.
        radius_m: nodes of the body within this distance of the axis move with the links, m.
        axes: hinges a joint: 1 (in the plane) or 2.
        stiffness_nm_per_rad: of the controller.
        damping_nms_per_rad: of the controller.
        cap_m: length at the far end over which the whole body moves with the last link, m.
    """

    joint_positions_m: tuple[float, ...]
    length_m: float
    y_m: float
    z_m: float
    radius_m: float
    axes: int = 1
    stiffness_nm_per_rad: float = 10.0
    damping_nms_per_rad: float = 0.01
    cap_m: float = 0.0

    def __post_init__(self):
        places = np.asarray(self.joint_positions_m, float)
        if places.ndim != 1 or len(places) < 1 or (np.diff(places) <= 0).any() or places[0] < 0:
            raise InputError(
                f"Spine: joint_positions_m is {places.tolist()}; give positions from base to tip, ascending."
            )
        if not self.length_m > places[-1]:
            raise InputError(
                f"Spine: length_m is {self.length_m}; it must exceed the last joint's {places[-1]} m."
            )
        if self.axes not in (1, 2):
            raise InputError(f"Spine: axes is {self.axes}; choose 1 (finger) or 2 (arm).")
        for name in ("radius_m", "stiffness_nm_per_rad"):
            if not getattr(self, name) > 0:
                raise InputError(f"Spine: {name} is {getattr(self, name)}; it must be positive.")
        if not 0 <= self.cap_m <= self.length_m - places[-1]:
            raise InputError(
                f"Spine: cap_m is {self.cap_m}; it must lie between 0 and the last link's length."
            )

    @property
    def hinges(self) -> int:
        """Number of hinges: joints times axes, numbered joint by joint, towards +z first."""
        return len(self.joint_positions_m) * self.axes

    @property
    def chain(self) -> np.ndarray:
        """(H, 6) origin (m) and axis of each hinge at rest."""
        rows = []
        for x in self.joint_positions_m:
            for axis in ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0))[: self.axes]:
                rows.append((x, self.y_m, self.z_m, *axis))
        return np.array(rows)

    def bind(self, body: Body, grid: RestGrid) -> np.ndarray:
        """(N,) link that carries each node, -1 for none; link 0 stands still.

        Raises InputError where a link lies outside the body.
        """
        away = np.hypot(grid.nodes[:, 1] - self.y_m, grid.nodes[:, 2] - self.z_m)
        x = grid.nodes[:, 0]
        inside = (away <= self.radius_m) & (x <= self.length_m) & ~grid.mirrored
        inside &= grid.volume > 0.25 * grid.dx**3  # the others are at the edge of a cell that is nearly empty
        link = np.searchsorted(np.asarray(self.joint_positions_m), x) * self.axes
        link = np.where(inside, link, -1)
        if self.cap_m:
            capped = (x >= self.length_m - self.cap_m) & (grid.volume > 0) & ~grid.mirrored
            link = np.where(capped, self.hinges, link)
        for joint in range(len(self.joint_positions_m)):
            if not (link == (joint + 1) * self.axes).any():
                raise InputError(
                    f"Body '{body.name}': the spine's link after joint {joint + 1} (x from "
                    f"{self.joint_positions_m[joint]:.4g} m, y {self.y_m:.4g} m, z {self.z_m:.4g} m, radius "
                    f"{self.radius_m:.4g} m) lies outside the body; move the axis inside or "
                    "use a larger radius."
                )
        return link.astype(np.int32)

    def poses(self, q: np.ndarray) -> np.ndarray:
        """(..., H + 1, 3, 4) rotation and shift of each link at joint angles `q` (..., H) in rad."""
        q = np.asarray(q, float)
        out = np.zeros((*q.shape[:-1], self.hinges + 1, 3, 4))
        out[..., 0, :, :3] = np.eye(3)
        for h, row in enumerate(self.chain):
            a = row[3:]
            K = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
            s, c = np.sin(q[..., h, None, None]), np.cos(q[..., h, None, None])
            R, t = out[..., h, :, :3], out[..., h, :, 3]
            # Rodrigues: R <- R (1 + sin q K + (1 - cos q) K^2), about the hinge's origin
            turned = R @ (np.eye(3) + s * K + (1 - c) * (K @ K))
            out[..., h + 1, :, :3] = turned
            out[..., h + 1, :, 3] = np.einsum("...ij,j->...i", R - turned, row[:3]) + t
        return out

    def lumps(self, grid: RestGrid, link: np.ndarray) -> np.ndarray:
        """(H + 1, 13) mass, centre (m) and inertia about it of each link's nodes, at unit density."""
        out = np.zeros((self.hinges + 1, 13))
        for i in range(self.hinges + 1):
            m, p = grid.volume[link == i], grid.nodes[link == i]
            if not len(m):
                continue
            centre = (m[:, None] * p).sum(0) / m.sum()
            r = p - centre
            # I = sum m (|r|^2 1 - r r^T)
            inertia = (
                m[:, None, None] * ((r**2).sum(1)[:, None, None] * np.eye(3) - r[:, :, None] * r[:, None])
            ).sum(0)
            out[i] = np.concatenate([[m.sum()], centre, inertia.ravel()])
        return out

    def skin(self, q: np.ndarray, points: np.ndarray) -> np.ndarray:
        """(..., P, 3) rest points (P, 3), m, carried along smoothly by the links at angles (..., H) rad.

        It starts the search of equilibrium. Between the middles of two links poses are blended linearly.
        """
        poses = self.poses(q)[..., :: self.axes, :, :]
        ends = np.concatenate([[0.0], self.joint_positions_m, [self.length_m]])
        middle = (ends[:-1] + ends[1:]) / 2
        place = np.clip(np.interp(points[:, 0], middle, np.arange(len(middle))), 0, len(middle) - 1)
        low = np.minimum(place.astype(int), len(middle) - 2)
        w = (place - low)[:, None, None]
        blend = (1 - w) * poses[..., low, :, :] + w * poses[..., low + 1, :, :]
        return np.einsum("...pij,pj->...pi", blend[..., :3], points) + blend[..., 3]
