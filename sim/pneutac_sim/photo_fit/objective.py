"""How far renderings are from photographs: masked L1 difference and silhouettes' overlap, paper Sec. IV.

Bodies at rest for many candidates at many pressures, all in one batch of material points.

What photographs are fitted by: parameters of drive and material, with bounds and first steps.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numba import njit

from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.finger.stages import base_parameters
from pneutac_sim.mpm import devices
from pneutac_sim.mpm.body import Body, Material
from pneutac_sim.mpm.solid import body_mesh, parameter
from pneutac_sim.mpm.solve import MpmDiverged, solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads, TotalLagrangian
from pneutac_sim.splat.body import Carrier
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.rasteriser import Rendering, Splats
from pneutac_sim.splat.render import Gaussians
from pneutac_sim.twin import Twin, Value

STEP = 0.15  # of each gain, the paper's
# What soft prints and castings are made of, from Ecoflex to stiff Agilus30; near 0.5 steps get too small.
MATERIAL = {"youngs_modulus_mpa": (0.2, 4.0), "poissons_ratio": (0.38, 0.49)}


@dataclass(frozen=True)
class BodyParameters:
    """Parameters in the coordinates that a fit moves in: logarithms where only the magnitude counts."""

    twin: Twin  # whose other parameters stay as they are
    names: tuple[str, ...]  # (P,) the material's two last
    units: tuple[str, ...]  # (P,) as shown to people
    log: np.ndarray  # (P,) bool
    lower: np.ndarray  # (P,) bounds, coordinates
    upper: np.ndarray  # (P,) bounds, coordinates
    step: np.ndarray  # (P,) first step of a search, coordinates

    def __len__(self):
        return len(self.names)

    @property
    def of_pose(self) -> np.ndarray:
        """(P,) bool: those of the drive, which a body without material points has too."""
        return np.array([name not in MATERIAL for name in self.names])

    @property
    def prior_sd(self) -> np.ndarray:
        """(P,) standard deviation of the uniform distribution between the bounds, coordinates."""
        return (self.upper - self.lower) / np.sqrt(12)

    def coordinates(self, twin: Twin) -> np.ndarray:
        """(P,) of a twin's values, inside the bounds."""
        pipeline = Pipeline.of(twin)
        own = dict(zip(pipeline.names, pipeline.theta(twin), strict=True))
        values = np.array([own[n] if n in own else parameter(twin, n) for n in self.names])
        return np.clip(_coordinates(values, self.log), self.lower, self.upper)

    def values(self, x: np.ndarray) -> np.ndarray:
        """(..., P) physical values of coordinates (..., P)."""
        return np.where(self.log, np.exp(np.where(self.log, x, 0.0)), x)

    def twin_at(self, x: np.ndarray, ci95: dict | None = None) -> Twin:
        """A copy of the twin with the values at coordinates `x` (P,)."""
        new = self.twin.copy()
        for name, value in zip(self.names, self.values(x), strict=True):
            new.parameters[name] = Value(float(value), (ci95 or {}).get(name))
        return new


def body_parameters(twin: Twin, pressure_range_kpa: float) -> BodyParameters:
    """The drive parameters that data identify, and the material's two; of a recording up to this pressure.

    The first step is 15 % of each gain: of the overall gain by its own size, of the profile's parameters and
    the rest pressure by what changes a joint by about as much.
    """
    geometry = Pipeline.of(twin).geometry
    free = [p for p in base_parameters(geometry) if not p.fixed]
    limits = np.array([p.limits(pressure_range_kpa) for p in free])
    log = np.array([p.log for p in free])
    bounds = np.stack([_coordinates(column, log) for column in limits.T[1:]], 1)
    own = twin.parameters.get("gain_rad_per_kpa")
    half = max((geometry.n_joints - 1) / 2, 1.0)
    step = {
        "gain_rad_per_kpa": STEP * (abs(own.value) if own and own.value else limits[0, 0]),
        "gain_alpha": STEP / half,
        "gain_beta": STEP / half**2,
    }
    others = {p.name: STEP * (0.5 * pressure_range_kpa if p.range_power else 1.0) for p in free}
    material = np.array([np.log(MATERIAL["youngs_modulus_mpa"]), MATERIAL["poissons_ratio"]])
    return BodyParameters(
        twin,
        (*(p.name for p in free), *MATERIAL),
        (*(p.unit for p in free), "MPa", ""),
        np.array([*log, True, False]),
        np.concatenate([bounds[:, 0], material[:, 0]]),
        np.concatenate([bounds[:, 1], material[:, 1]]),
        np.array([*((others | step)[p.name] for p in free), STEP, STEP * np.ptp(material[1])]),
    )


def _coordinates(values: np.ndarray, log: np.ndarray) -> np.ndarray:
    """Logarithms of (P,) values where `log`; a value there that is not positive becomes a very small one."""
    return np.where(log, np.log(np.where(log, np.maximum(values, 1e-12), 1.0)), values)


def joint_targets(twin: Twin, pressures: np.ndarray, conditions: dict | None) -> np.ndarray:
    """(T, H) rad at pressures (T, chambers) kPa that have been held for long."""
    columns = pressures[:, 0] if pressures.shape[1] == 1 else pressures
    return devices.joint_targets(twin, columns, conditions=conditions)


class Bodies(NamedTuple):
    """K candidates at T pressures."""

    positions: np.ndarray  # (K, T, P, 3) of the particles, m
    gradients: np.ndarray  # (K, T, P, 3, 3) deformation gradients
    q: np.ndarray  # (K, T, H) joint angles, rad
    tips: np.ndarray  # (K, T, 3) of the spine, m


class Equilibria:
    """Finds bodies at rest, always from the same solved state, so that no answer depends on history.

    That is at coordinates `start` (P,), near which candidates lie, and pressures (T, chambers) kPa;
    `conditions` are what effects of the twin ask for.

    Attributes:
        body: the straight one.
        spine: of every body.
    """

    def __init__(
        self,
        parameters: BodyParameters,
        start: np.ndarray,
        pressures: np.ndarray,
        conditions: dict | None = None,
        particles: int = 4000,
        device: str = "auto",
    ):
        self.parameters, self.conditions = parameters, conditions
        self.pressures = np.asarray(pressures, float)
        one = devices.BODIES[parameters.twin.device](parameters.twin, particles=particles, device=device)
        self.body, self.spine, self.device = one.body, one.spine, one.device
        self._target = self.targets(start[None])[0]
        solver = self._solver(start[None], len(self._target))
        state = solve_equilibrium(solver, Loads(q_cmd=self._target))
        self._nodes, self._q = solver.nodes(), state.q
        self.first = self._bodies(solver, state, 1)

    def targets(self, x: np.ndarray) -> np.ndarray:
        """(K, T, H) rad of candidates (K, P)."""
        twins = map(self.parameters.twin_at, x)
        return np.stack([joint_targets(t, self.pressures, self.conditions) for t in twins])

    def solve(self, x: np.ndarray) -> Bodies:
        """Candidates (K, P) in coordinates, at every pressure.

        Raises MpmDiverged: a body found no rest.
        """
        k, t = len(x), len(self.pressures)
        solver = self._solver(x, k * t)
        # Each body begins as the solved one at its pressure, bent on by the difference of joint targets.
        tile = (k, 1, 1)
        solver.apply(Loads(q_cmd=np.tile(self._target, tile[:2])))
        solver.set_q(np.tile(self._q, tile[:2]))
        solver.set_nodes(np.tile(self._nodes, tile))
        target = self.targets(x).reshape(k * t, -1)
        return self._bodies(solver, solve_equilibrium(solver, Loads(q_cmd=target), warm=True), k)

    def _solver(self, x: np.ndarray, batch: int) -> TotalLagrangian:
        density = devices.parameter(self.parameters.twin, "density_kg_m3")
        named = [dict(zip(self.parameters.names, v, strict=True)) for v in self.parameters.values(x)]
        each = [Material(1e6 * n["youngs_modulus_mpa"], n["poissons_ratio"], density) for n in named]
        materials = [m for m in each for _ in range(batch // len(x))]
        return TotalLagrangian(self.body, self.spine, batch, materials, self.device)

    def _bodies(self, solver, state, k: int) -> Bodies:
        tips = devices.spine_points(solver, state.q)[:, -1]
        return Bodies(
            *(a.reshape(k, -1, *a.shape[1:]) for a in (state.positions, state.gradients, state.q, tips))
        )


SHARP = 4  # pixels drawn a pixel of the picture, each way, of silhouettes


def cover(camera: Camera, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(H, W) float32 share of each pixel that triangles (F, 3) of vertices (V, 3) m cover."""
    pixels, depth = camera.project(vertices)
    seen = faces[(depth[faces] > 0).all(1)]
    canvas = np.zeros((SHARP * camera.height, SHARP * camera.width), np.uint8)
    _cover(SHARP * pixels, seen, canvas)
    size = camera.width, camera.height
    return cv2.resize(canvas, size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255


@njit(cache=True)
def _cover(pixels, faces, canvas):
    """Row by row: between the crossings of a triangle's edges with the line of pixel centres."""
    height, width = canvas.shape
    for f in range(len(faces)):
        low, high = np.inf, -np.inf
        for k in range(3):
            low, high = min(low, pixels[faces[f, k], 1]), max(high, pixels[faces[f, k], 1])
        for i in range(max(0, int(np.ceil(low - 0.5))), min(height - 1, int(np.floor(high - 0.5))) + 1):
            y = i + 0.5
            left, right = np.inf, -np.inf
            for k in range(3):
                x0, y0 = pixels[faces[f, k]]
                x1, y1 = pixels[faces[f, (k + 1) % 3]]
                if min(y0, y1) <= y <= max(y0, y1) and y0 != y1:
                    x = x0 + (y - y0) / (y1 - y0) * (x1 - x0)
                    left, right = min(left, x), max(right, x)
            for j in range(max(0, int(np.ceil(left - 0.5))), min(width - 1, int(np.floor(right - 0.5))) + 1):
                canvas[i, j] = 255


# The surface of a body, and the silhouette that it shows to a camera.
#
# Thresholded splats are wider than the body by a part of their lattice's spacing, the more the thicker it is.
# That makes a body longer, to which a fit answers with its last joint. The surface has no such width.


EDGE = 0.05  # longest edge of a triangle, over the body's length, so that the surface can bend


class Outline:
    """The closed mesh of the body of a twin, a finger or an arm.

    Attributes:
        vertices: (V, 3) of the straight body, m.
        faces: (F, 3).
    """

    def __init__(self, twin: Twin):
        mesh = body_mesh(twin).subdivide_to_size(EDGE * 1e-3 * twin.length_mm)
        self.vertices, self.faces = np.array(mesh.vertices), np.array(mesh.faces)

    def on(self, body: Body) -> Carrier:
        """What carries the vertices along with a body's particles."""
        return Carrier(self.vertices, body.positions)

    def coverage(self, vertices: np.ndarray, camera: Camera) -> np.ndarray:
        """(H, W) share of each pixel that the body with these vertices (V, 3) in m covers."""
        return cover(camera, vertices, self.faces)


SILHOUETTE = 2.0  # lambda_s
WORST = 1.0 + SILHOUETTE  # of a body that finds no rest
SOLID = 0.5  # coverage from which a pixel belongs to the silhouette


@dataclass(frozen=True)
class MaskedPhotograph:
    """One segmented photograph of a body at rest under a pressure."""

    state: int  # index of the pressure
    camera: Camera  # from where, base frame
    image: np.ndarray  # RGB uint8 (H, W, 3)
    mask: np.ndarray  # bool (H, W), where the body is
    name: str = "a photograph"  # shown in errors


class Scores(NamedTuple):
    """Of K candidates on n photographs."""

    appearance: np.ndarray  # (K, n) mean absolute difference inside the mask, 0 to 1
    iou: np.ndarray  # (K, n) overlap of the silhouettes over their union
    # (K, n) root mean square difference over the union of both silhouettes, on black, 8-bit levels
    rmse: np.ndarray

    @property
    def objective(self) -> np.ndarray:
        """(K,) J = mean over photographs of L_app + lambda_s (1 - IoU), eq. 1 of the paper."""
        return (self.appearance + SILHOUETTE * (1 - self.iou)).mean(-1)


def score(
    drawn: np.ndarray, covered: np.ndarray, image: np.ndarray, mask: np.ndarray
) -> tuple[float, float, float]:
    """Appearance, IoU and RMSE of one rendering on black, (H, W, 3), 0 to 1, with its silhouette (H, W) bool.

    Against a photograph, RGB uint8 (H, W, 3), and where its body is, `mask` (H, W) bool, not empty.
    """
    union = mask | covered
    level = drawn.clip(0, 1)[union] - np.where(mask[union][:, None], image[union] / np.float32(255), 0)
    appearance = float(np.abs(level[mask[union]]).mean())  # L_app, eq. 2 of the paper
    iou = float((mask & covered).sum() / union.sum())  # eq. 3
    return appearance, iou, float(255 * np.sqrt((level.astype(float) ** 2).mean()))


class Objective:
    """Scores candidates by full material points: looks by splats, silhouettes by the body's surface.

    The photographs' `state` counts the pressures of the equilibria; looks are a Gaussian for each particle,
    in the particles' order.

    Attributes:
        best: (T, P, 3) particles of the best candidate so far, m; None before the first.
        outline: the body's surface.
    """

    def __init__(self, equilibria: Equilibria, photographs: list[MaskedPhotograph], looks: Gaussians):
        self.equilibria, self.photographs, self.looks = equilibria, photographs, looks
        # A round Gaussian stays the same however it turns.
        self._covariances = looks.covariances()
        self.outline = Outline(equilibria.parameters.twin)
        self.surface = self.outline.on(equilibria.body)
        self.best, self._least = None, np.inf

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """(K,) objective of candidates (K, P) in coordinates; `WORST` of one that finds no rest."""
        try:
            bodies = self.equilibria.solve(x)
        except MpmDiverged:
            return np.concatenate([self(one[None]) for one in x]) if len(x) > 1 else np.array([WORST])
        values = self.scores(bodies).objective
        if values.min() < self._least:
            self.best, self._least = bodies.positions[values.argmin()], values.min()
        return values

    def scores(self, bodies: Bodies) -> Scores:
        rows = [
            [self._score(p, at[p.state], edge[p.state]) for p in self.photographs]
            for at, edge in zip(bodies.positions, map(self.surface, *bodies[:2]), strict=True)
        ]
        return Scores(*np.moveaxis(np.array(rows), 2, 0))

    def _score(self, p: MaskedPhotograph, positions: np.ndarray, vertices: np.ndarray) -> tuple:
        covered = self.outline.coverage(vertices, p.camera) > SOLID
        return score(self.render(positions, p.camera).image, covered, p.image, p.mask)

    def render(self, positions: np.ndarray, camera: Camera) -> Rendering:
        """One body, particles at (P, 3) m, on black."""
        return Splats(camera, positions, self._covariances, self.looks.opacities).render(self.looks.colours)
