"""The full material point gel in the world: pressed by the very shapes of the task's objects.

Each control step the gel is brought to rest against the signed distance of all objects near it, sampled on a
cube round its face, starting from the step before. A press that goes deeper than a particle in one step is
driven in by several.

The soft body round the world's spine, of material points: what `surrogate.finger` stands in for.

A stiff servo holds the spine of the material points where the world's is, and f is the torque of the body on
its joints there. Each control step two bodies are brought to rest, one as the world's finger is bent and one
as pressure alone would bend it, starting from the step before: 25 substeps while nothing moves, about 650
(0.25 s) while it does. Moving them through the same 1/15 s in true time takes 2,200, always; what
that would add, the slow motion of the finger with the mass of its sensor, is the world's own.

What is missing: the soft body does not feel where it is touched, so its skin is not dented. The gel is
`world.mpm_gel`'s.
"""

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.gel.indenter import surface_distance
from pneutac_sim.gel.probe import BOX, CAPSULE, CYLINDER, ELLIPSOID, MESH, NO_TRIANGLES, SPHERE
from pneutac_sim.mpm import devices
from pneutac_sim.mpm.solve import MpmDiverged, solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads
from pneutac_sim.mpm.user_mesh import lattice_inside
from pneutac_sim.surrogate.finger import controller_stiffness, joint_targets
from pneutac_sim.twin import Twin
from pneutac_sim.world.soft_finger import GEL_FRICTION

SAMPLES = 49  # of the cube, along each edge
CENTRE_M = 0.004  # of the cube, above the gel's face
STEP_M = 0.3e-3  # by which objects go in at most at a time


class MpmGel:
    """One gel of a finger's or gel's twin, at rest under what touches it in this control step.

    Attributes:
        friction: Coulomb's coefficient between objects and gel.
        force_n: (3,) on the gel at the last rest, gel frame.
    """

    def __init__(self, twin: Twin, device: str = "auto"):
        from pneutac_sim.gel.model import GelModel

        model = GelModel.from_twin(twin)
        self._window, self._scale = model.window_mm, model.depth_scale
        self._half = 0.6e-3 * max(self._window)
        table = np.zeros((SAMPLES,) * 3)
        self.solver = devices.gel(twin, device=device, table=table)
        line = np.linspace(-self._half, self._half, SAMPLES)
        self._points = np.stack(np.meshgrid(line, line, line, indexing="ij"), -1) + [0.0, 0.0, CENTRE_M]
        self.friction, self.force_n = GEL_FRICTION, np.zeros(3)
        self._deep = 0.0  # of the objects in the resting gel at the last rest, m

    def release(self) -> None:
        """Nothing touches: the next contact starts from the resting gel."""
        self._deep = 0.0

    def show(
        self, kinds, sizes, positions, rotations, gel_position, gel_rotation, triangles=NO_TRIANGLES
    ) -> None:
        """Sets the objects; arguments as in `gel.probe.probe_grid`, meshes closed."""
        R = np.asarray(gel_rotation).reshape(3, 3)
        points = self._points.reshape(-1, 3) @ R.T + gel_position
        nearest = np.full(len(points), 1.0)
        reach = np.sqrt(3) * self._half
        for kind, size, at, turn in zip(kinds, sizes, positions, rotations, strict=True):
            reaches = size[2] if kind == MESH else np.linalg.norm(size)
            if np.linalg.norm(at - gel_position) > reach + reaches + abs(CENTRE_M):
                continue
            turn = np.asarray(turn).reshape(3, 3)
            if kind == MESH:
                first, count = int(size[0]), int(size[1])
                placed = (triangles[first : first + count] @ turn.T + at - gel_position) @ R
                distance = self._to_mesh(placed)
            else:
                distance = signed_distance(int(kind), size, (points - at) @ turn)
            nearest = np.minimum(nearest, distance)
        self._table = nearest

    def _to_mesh(self, triangles: np.ndarray) -> np.ndarray:
        """(n,) m from a closed mesh (m, 3, 3) to the points of the cube, negative inside, gel frame."""
        h = 2 * self._half / (SAMPLES - 1)
        inside = lattice_inside(triangles, self._points[0, 0, 0] - h / 2, np.full(3, SAMPLES), h).ravel()
        far = 1e-3 * surface_distance(1e3 * triangles, 1e3 * self._points.reshape(-1, 3))
        return np.where(inside, -far, far)

    def displacement(self, depth_mm: np.ndarray) -> np.ndarray:
        """Displacement of the gel's face under the objects shown last, mm, float32 (80, 59).

        Their imprint (`GelModel.imprint` of the probe grid) says how deep they lie.

        Raises InputError where the gel finds no rest.
        """
        deep = 1e-3 * float(depth_mm.max())
        less = deep / self._scale - deep  # by which an imprint is less deep than the object
        self.solver.set_table(self._table)
        steps = max(1, int(np.ceil((deep - self._deep) / STEP_M)))
        warm = self._deep > 0
        back = np.linspace(max(deep - self._deep, 0.0), 0.0, steps + 1)[1:]
        try:
            for b in back:
                at = np.array([0.0, 0.0, CENTRE_M + less + b])
                size = np.full(3, self._half)
                loads = Loads(indenter="mesh", size_m=size, position_m=at, friction=self.friction)
                rest = solve_equilibrium(self.solver, loads, warm=warm)
                self.force_n, warm = rest.contact_force[0].astype(float), True
        except MpmDiverged as e:
            self._deep = 0.0
            raise InputError(f"{e.finding}; move slower, or press less deep than {1e3 * deep:.2g} mm.") from e
        self._deep = deep
        return devices.surface_displacement(self.solver, self._window)[0].astype(np.float32)


def signed_distance(kind: int, size: np.ndarray, p: np.ndarray) -> np.ndarray:
    """(n,) m from a shape of MuJoCo's at the origin to points (n, 3), negative inside.

    An ellipsoid's is of first order, exact on its surface. Raises InputError for another shape.
    """
    if kind == SPHERE:
        return np.linalg.norm(p, axis=1) - size[0]
    if kind == CAPSULE:
        along = p[:, 2].clip(-size[1], size[1])
        return np.linalg.norm(p - np.stack([0 * along, 0 * along, along], 1), axis=1) - size[0]
    if kind == ELLIPSOID:
        near, far = np.linalg.norm(p / size, axis=1), np.linalg.norm(p / size**2, axis=1)
        return near * (near - 1) / np.maximum(far, 1e-9)
    if kind == CYLINDER:
        q = np.stack([np.hypot(p[:, 0], p[:, 1]) - size[0], np.abs(p[:, 2]) - size[1]], 1)
    elif kind == BOX:
        q = np.abs(p) - size
    else:
        raise InputError(
            f"The full gel knows spheres, capsules, ellipsoids, cylinders and boxes; not {kind}."
        )
    return np.linalg.norm(q.clip(0), axis=1) + q.max(1).clip(None, 0)


NEAR_RAD = 0.1  # of the bends by which the body's stiffness is measured
TOLERANCE = 1e-3  # of unbalanced forces; torques are then known to 1 mN m, 0.2 mm at the tip


class MpmFinger:
    """The soft body of one finger, of about so many particles.

    Attributes:
        controller_nm_per_rad: K_c, see `surrogate.finger.controller_stiffness`.
        solver: the bodies, for pictures; the first is the one that is loaded.
        substeps: taken in the last step.
        in_range: always; there is no range to leave.

    Raises InputError: the body is stiffer than the whole finger.
    """

    in_range = True

    def __init__(self, twin: Twin, particles: int = 4000, device: str = "auto"):
        self.solver = devices.finger(twin, batch=2, particles=particles, device=device)
        self._servo = float(self.solver.spine.stiffness_nm_per_rad)
        n = len(twin.spine_joint_positions_mm)
        self._J, self.substeps = np.zeros((n, n)), 0
        self.reset()
        # A neo-Hookean body's own stiffness hardly changes with its bend (10 % up to 15 kPa): once is enough.
        columns, at = [], joint_targets(twin, 0.0)
        for i in range(n):
            offset = NEAR_RAD * np.eye(n)[i]
            q, f = self._hold(at + np.stack([offset, -offset]))
            self.reset()
            columns.append((q[0] - q[1], f[0] - f[1]))
        dq, df = (np.stack(c) for c in zip(*columns, strict=True))
        J = np.linalg.solve(dq, df).T
        self._J = 0.5 * (J + J.T)
        self.controller_nm_per_rad = controller_stiffness(twin, self._J)

    def reset(self) -> None:
        self._f, self._begun = np.zeros((2, len(self._J))), False

    def torque(self, q_free: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Torques of the body at joint angles `q` beyond those at `q_free`, where it rests unloaded.

        Of (N,) rad both; returns (N,) in N m and the derivative by `q` (N, N) in N m/rad.
        """
        wanted = np.stack([q, q_free]).astype(float)
        held, f = self._hold(wanted)
        at = f + (wanted - held) @ self._J  # the servo holds slightly off
        return at[0] - at[1], self._J

    def _hold(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Joint angles (2, N) near those wanted, and the body's torques there (2, N) in N m."""
        target = q - self._f / self._servo
        rest = solve_equilibrium(self.solver, Loads(q_cmd=target), TOLERANCE, warm=self._begun)
        self._begun, self.substeps, self._f = True, rest.substeps, rest.body_torque.astype(float)
        return rest.q.astype(float), self._f
