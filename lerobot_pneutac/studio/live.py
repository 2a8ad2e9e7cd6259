"""A finger or an arm in real time: pressures and a poke in, where every link of it is out."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pneutac_sim.finger import Pipeline, PressurePipeline
from pneutac_sim.finger.stages import FORCES, LoadLink
from pneutac_sim.mpm.solid import body_mesh
from pneutac_sim.twin import Twin


@dataclass(frozen=True)
class Shape:
    """Where a body is."""

    turns: np.ndarray  # (N + 1, 3, 3) rotations of base and links against the straight body
    places_mm: np.ndarray  # (N + 1, 3) of the joint at which each begins; the base's is the origin
    markers: np.ndarray  # (5,) the tip, x, y, z in mm, bend towards +z and +y in rad

    @property
    def bend_deg(self) -> float:
        return float(np.degrees(self.markers[3] if self.markers[4] == 0 else np.hypot(*self.markers[3:])))

    def spine_mm(self, length_mm: float, joints_mm: np.ndarray) -> np.ndarray:
        """(N + 2, 3) base, joints and the end of the last link."""
        end = self.places_mm[-1] + (length_mm - joints_mm[-1]) * self.turns[-1][:, 0]
        return np.concatenate([self.places_mm, end[None]])


def links(q: np.ndarray, joints_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turns (N + 1, 3, 3) and places (N + 1, 3) in mm of the links of a body.

    Its joints lie at (N,) mm and are bent by (N,) rad towards +z, or (N, 2) towards +z and +y.
    """
    q = np.asarray(q, float).reshape(len(joints_mm), -1)
    to_z, to_y = q[:, 0], q[:, 1] if q.shape[1] == 2 else np.zeros(len(q))
    bends = Rotation.from_rotvec(np.stack([np.zeros(len(q)), -to_z, to_y], axis=1)).as_matrix()
    turns, places = [np.eye(3)], [np.zeros(3)]
    before = 0.0
    for bend, at in zip(bends, joints_mm, strict=True):
        places.append(places[-1] + (at - before) * turns[-1][:, 0])
        turns.append(turns[-1] @ bend)
        before = at
    return np.stack(turns), np.stack(places)


@dataclass(frozen=True)
class Skin:
    """The surface of a straight body and by which links each of its points is carried."""

    vertices_mm: np.ndarray  # (V, 3)
    faces: np.ndarray  # (F, 3)
    weights: np.ndarray  # (V, N + 1), each row adds up to 1

    @classmethod
    def of(cls, twin: Twin) -> "Skin":
        """Between the middles of two links their shares change along a straight line."""
        mesh = body_mesh(twin)
        vertices = 1e3 * np.asarray(mesh.vertices)
        edges = np.array([0.0, *twin.spine_joint_positions_mm, twin.length_mm])
        middles = 0.5 * (edges[1:] + edges[:-1])
        x = np.clip(vertices[:, 0], middles[0], middles[-1])
        weights = np.stack([np.interp(x, middles, row) for row in np.eye(len(middles))], axis=1)
        return cls(vertices, np.asarray(mesh.faces), weights)

    def carried_mm(self, shape: Shape, joints_mm: np.ndarray) -> np.ndarray:
        """(V, 3) where its points are."""
        rest = np.zeros((len(joints_mm) + 1, 3))
        rest[1:, 0] = joints_mm
        local = self.vertices_mm[:, None] - rest
        moved = np.einsum("kij,vkj->vki", shape.turns, local) + shape.places_mm
        return np.einsum("vk,vki->vi", self.weights, moved)


class LiveBody:
    """One device that goes on in time; raises InputError where a condition is missing."""

    def __init__(self, twin: Twin, conditions: Mapping[str, float]):
        self._pipeline = PressurePipeline(twin, conditions)
        self._joints_mm = np.array(twin.spine_joint_positions_mm)
        model = Pipeline.of(twin)
        self._theta = model.theta(twin)
        stiffness = model.names.index("joint_stiffness_nm_per_rad")
        # as in the world: what touches the body bends it from where all else has put it
        self._poke = LoadLink(model.geometry, (), stiffness, measured=True)
        self.time_s = 0.0

    def set_conditions(self, conditions: Mapping[str, float]) -> None:
        self._pipeline.set_conditions(conditions)

    def rest(self, pressure_kpa: np.ndarray) -> None:
        """It has long been at these pressures (chambers,)."""
        self._pipeline.reset(pressure_kpa)

    def step(self, pressure_kpa: np.ndarray, force_n: np.ndarray, dt_s: float) -> Shape:
        """Goes on for `dt_s` seconds under a command (chambers,) and a force (3,) at the tip."""
        q = self._pipeline.step(pressure_kpa, dt_s)
        self.time_s += dt_s
        if np.any(force_n):
            flat = np.ravel(q)[None]
            state = np.zeros(self._poke.state_size(flat.shape[1]))

            def force(names: tuple[str, ...]) -> np.ndarray:
                return np.array([[force_n[FORCES.index(n)] for n in names]], dtype=float)

            q = self._poke(flat, np.array([dt_s]), self._theta, force, state)[0].reshape(q.shape)
        markers = self._pipeline.place(q, dt_s)
        turns, places = links(q, self._joints_mm)
        return Shape(turns, places, markers)


def shape_of(joints: np.ndarray, markers: np.ndarray, twin: Twin) -> Shape:
    at = np.array(twin.spine_joint_positions_mm)
    return Shape(*links(np.asarray(joints).reshape(len(at), -1), at), markers)


TIPS = ("tip_x_mm", "tip_y_mm", "tip_z_mm")


def measured_tips(c) -> np.ndarray | None:
    """(n, 3) mm of a `BodyComparison`; None where x or z was not measured."""
    if TIPS[0] not in c.columns or TIPS[2] not in c.columns:
        return None
    none = np.zeros(len(c.measured))
    return np.stack([c.measured[:, c.columns.index(n)] if n in c.columns else none for n in TIPS], axis=1)
