"""From a twin to material points: finger, arm and gel, their joint targets and their loads.

    solver = finger(twin, batch=4)
    rest = solve_equilibrium(solver, Loads(q_cmd=joint_targets(twin, [0, 5, 10, 15])))

The twin's pipeline gives the joint targets, so every effect up to its joints acts here too. One that moves
the tip alone (`elongation`) acts where the tip is what counts, in `compare` and in the world; where the
body's shape does, as in pictures, it is refused by name. Observation is no matter of the body.

The torque of a finger's soft body, measured on material points that are held in many poses.

The face of a gel of material points under the presses of a bench recording.

A press at a share of its depth is what `GelModel.depth_scale` means: the camera sees the indenter as if it
had gone in by that share.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.features import CHAMBERS
from pneutac_sim.finger.equilibrium import SoftBody
from pneutac_sim.finger.inputs import Inputs, pressure_columns
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.probe import COLS, ROWS
from pneutac_sim.mpm.body import Body, Spine
from pneutac_sim.mpm.indenter import SAMPLES, centre_m, distances_m, half_edge_m
from pneutac_sim.mpm.solid import bending_body, material_of, parameter
from pneutac_sim.mpm.solve import MpmDiverged, halved_once, solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads, TotalLagrangian
from pneutac_sim.twin import Twin

# The rigid end that closes the chambers and carries the sensor or the marker. Without it the soft end lags
# behind the last link by as much as its lattice happens to leave free.
CAP_M = 5e-3
LAYERS = 13  # of a gel


def finger(twin: Twin, batch: int = 1, particles: int = 4000, mesh=None, device: str = "auto"):
    """Fingers: a soft body that is held at its base, with a hinge at each of the twin's joints.

    Args:
        twin: a finger's.
        batch: how many.
        particles: of each, about.
        mesh: closed `trimesh.Trimesh` in m, x along the finger from its base, the neutral axis at y = z = 0;
            None for the twin's own, or bellows with a flat back, `width_mm` wide, where it has none.
        device: see `runtime.start`.

    Returns:
        `TotalLagrangian`.

    Raises InputError: another device's twin, a mesh that is shorter than the spine, an impossible parameter.
    """
    return _bending("finger", twin, batch, particles, device, mesh)


def arm(twin: Twin, batch: int = 1, particles: int = 4000, device: str = "auto"):
    """Arms: as `finger`, with three chambers round the axis and two hinges a joint, towards +z and +y."""
    return _bending("arm", twin, batch, particles, device)


BODIES = {"finger": finger, "arm": arm}  # by the twin's device


def _bending(kind, twin, batch, particles, device, mesh=None) -> TotalLagrangian:
    if twin.device != kind:
        raise InputError(f"The twin is of a {twin.device}; this model is of a {kind}.")
    length = 1e-3 * twin.length_mm
    body = bending_body(twin, particles, mesh)
    end = float(body.positions[:, 0].max())
    joints = 1e-3 * np.asarray(twin.spine_joint_positions_mm)
    if not joints[-1] < end < 1.1 * length:
        raise InputError(
            f"The mesh of the {kind} reaches x = {1e3 * end:.4g} mm; the twin is {twin.length_mm:g} mm long "
            f"with its last joint at {1e3 * joints[-1]:.4g} mm: give a mesh in metres, its base at x = 0."
        )
    spine = Spine(
        tuple(joints.tolist()),
        length,
        0.0,
        0.0,
        radius_m=0.75 * 2 * body.spacing_m,  # in any lattice the axis has a node this near
        axes=2 if kind == "arm" else 1,
        stiffness_nm_per_rad=parameter(twin, "spine_stiffness_nm_per_rad"),
        damping_nms_per_rad=parameter(twin, "spine_damping_nms_per_rad"),
        cap_m=min(CAP_M, length - joints[-1]),
    )
    return TotalLagrangian(body, spine, batch=batch, device=device)


def gel(
    twin: Twin, batch: int = 1, counts=(COLS, ROWS, LAYERS), device: str = "auto", table=None
) -> TotalLagrangian:
    """Gels, held at their back; gel frame of `gel.probe`: z out of the sensor, resting surface at z = 0.

    Particle (i, j, k) of the lattice stands for column i and row j of the probe grid (x along image columns,
    y along rows), layer k from the back. The lattice, `counts` particles along x, y and z, is equal along all
    axes and covers the window; a built-in gel is 12.0 x 16.3 x 2.6 mm. `table` is that of the indenter
    `mesh`, see `TotalLagrangian`.
    """
    if twin.device == "arm":
        raise InputError("The twin is of an arm, which carries no gel.")
    counts = np.asarray(counts, int)
    if counts.shape != (3,) or (counts < 2).any():
        raise InputError(f"counts is {counts.tolist()}; give three numbers of particles, each at least 2.")
    window = 1e-3 * np.array(GelModel.from_twin(twin).window_mm)
    spacing = float((window / counts[:2]).max())
    origin = -spacing * counts * [0.5, 0.5, 1.0]
    body = Body.box("gel", counts, spacing, material_of(twin, "gel_"), origin, clamp="z-")
    return TotalLagrangian(body, batch=batch, device=device, table=table)


def surface_displacement(solver: TotalLagrangian, window_mm: tuple[float, float] | None = None) -> np.ndarray:
    """How far a resting gel's face has moved into the gel, (B, 80, 59) mm on the probe grid.

    The face lies half a spacing above the uppermost particles and moves with their deformation. A point keeps
    its place in the grid, also where it moves sideways. The grid covers the window's width and height; None
    for all of the gel's width, and the same spacing along rows and columns where the gel is as tall as its
    window asks.
    """
    body = solver.body
    positions, gradients = solver.particles()
    nx, ny, nz = body.cells.max(0) + 1
    top = np.flatnonzero(body.cells[:, 2] == nz - 1)
    top = top[np.lexsort((body.cells[top, 0], body.cells[top, 1]))]  # row by row
    half = 0.5 * body.spacing_m
    z = positions[:, top, 2] + half * gradients[:, top, 2, 2]
    down = 1e3 * (body.positions[top, 2] + half - z).reshape(-1, ny, nx)
    width, height = window_mm or (1e3 * nx * body.spacing_m, 1e3 * nx * body.spacing_m * ROWS / COLS)
    rows = _places(ROWS, height, ny, 1e3 * body.spacing_m)
    cols = _places(COLS, width, nx, 1e3 * body.spacing_m)
    return np.einsum("ri,bij,cj->brc", rows, down, cols)


def _places(points: int, extent: float, count: int, spacing: float) -> np.ndarray:
    """(points, count) weights of linear interpolation from lattice rows to cell centres over `extent`."""
    place = ((np.arange(points) + 0.5) / points - 0.5) * extent / spacing + (count - 1) / 2
    low = np.clip(np.floor(place).astype(int), 0, count - 2)
    share = np.clip(place - low, 0, 1)
    out = np.zeros((points, count))
    out[np.arange(points), low], out[np.arange(points), low + 1] = 1 - share, share
    return out


def joint_targets(
    twin: Twin, pressure_kpa, time_s=None, conditions: Mapping[str, float] | None = None
) -> np.ndarray:
    """Joint targets (T, H) in rad, hinge by hinge as in `Spine`, from the twin's own pipeline.

    At commands (T,) for a finger, (T, 3) for an arm, at rising times (T,); None where each has been held for
    long by itself. `conditions` are what effects ask for, such as `temperature_c`, `gravity_x` or
    `payload_g`. Weight and payload bend the joints by their torque over the twin's
    `joint_stiffness_nm_per_rad`, as in the skeleton; the spine's controller is a stiff servo and not what
    yields to them.

    Raises InputError: a pressure is not a finite number; an effect of the twin cannot act here.
    """
    if twin.device not in CHAMBERS:
        raise InputError(f"The twin is of a {twin.device}, which has no joints.")
    for name in twin.effects:
        effect = get_effect(name)
        if effect.stage == "material" and effect.signal == "markers":
            raise InputError(
                f"The twin's effect '{name}' moves the tip against its joints, which the shape of the "
                "material points does not follow; take the effect out to go on without it."
            )
    pressure, chambers = np.asarray(pressure_kpa, float), CHAMBERS[twin.device]
    pressure = pressure[:, None] if pressure.ndim == 1 and chambers == 1 else pressure
    if pressure.ndim != 2 or pressure.shape[1] != chambers or not np.isfinite(pressure).all():
        raise InputError(
            f"pressure_kpa is {pressure.tolist()}; a {twin.device} takes {chambers} finite number"
            f"{'s' if chambers > 1 else ''} at a time."
        )
    n = len(pressure)
    rows = {
        "trial": np.arange(n) if time_s is None else np.zeros(n, int),
        "time_s": np.zeros(n) if time_s is None else np.asarray(time_s, float),
        **{name: np.full(n, float(value)) for name, value in (conditions or {}).items()},
        **dict(zip(pressure_columns(twin.device)[0], pressure.T, strict=True)),
    }
    return sampled_targets(twin, rows)


def sampled_targets(twin: Twin, samples: Mapping) -> np.ndarray:
    """Joint targets (n, H) in rad at each sample of a recording, as it went; raises as `joint_targets`."""
    inputs = Inputs.from_samples(samples, twin.device, twin.length_mm, source="command", start="held")
    pipeline = Pipeline.of(twin, inputs)
    for name, why in pipeline.left_out.items():
        raise InputError(
            f"The twin's effect '{name}' cannot act: {why.replace('the recording has no column', 'give')}."
        )
    return pipeline.run(inputs, pipeline.theta(twin)).joints


def press_loads(press: Press) -> Loads:
    """Loads of an indenter on a gel, the same as `Press.depths` puts onto the probe grid.

    A figure needs a solver with the table of `mpm.indenter`.
    """
    s = 1e-3 * press.size_mm
    tip = 1e-3 * np.array([press.x_mm, press.y_mm, -press.depth_mm])
    if press.figure is not None:
        size, at = np.full(3, half_edge_m(press.figure)), tip + press.turn.apply(centre_m(press.figure))
        return Loads(indenter="mesh", size_m=size, position_m=at, rotation=press.turn.as_matrix())
    sizes = {"cylinder": (s, 0.01, s), "cube": (s / 2, s / 2, s / 2), "edge": (s, s / 2, s / np.sqrt(2))}
    size = np.array(sizes.get(press.indenter, (s, s, s)))
    own = np.pi / 2 if press.indenter == "edge" else 0.0  # its ridge lies along its own y
    rotation = (press.turn * Rotation.from_euler("z", own)).as_matrix()
    return Loads(indenter=press.indenter, size_m=size, position_m=tip, rotation=rotation)


def spine_points(solver: TotalLagrangian, q: np.ndarray) -> np.ndarray:
    """(B, N + 2, 3) m: base, joints and tip of the spine at joint angles `q` (B, H)."""
    spine = solver.spine
    poses = spine.poses(q)[:, :: spine.axes]
    places = np.array([0.0, *spine.joint_positions_m, spine.length_m])
    rest = np.stack([places, np.full_like(places, spine.y_m), np.full_like(places, spine.z_m)], 1)
    link = np.array([0, *range(len(places) - 1)])  # a joint belongs to the link before it
    own = poses[:, link]
    return np.einsum("bkij,kj->bki", own[..., :3], rest) + own[..., 3]


POSES_A_JOINT = 4
# How far a joint is bent by itself, at most; loads of half a newton bend the first by so much.
ALONE_RAD = 0.2
TOLERANCE = 1e-3  # of unbalanced forces


def measure(
    twin: Twin, pressures_kpa: tuple[float, float], particles: int = 4000, device: str = "auto"
) -> SoftBody:
    """Holds a finger bent by pressures, each joint slightly perturbed, and fits its torque.

    The twin's modulus does not count, for torques are proportional to it.
    """
    n = len(twin.spine_joint_positions_mm)
    poses, rng = POSES_A_JOINT * n, np.random.default_rng(0)
    free = joint_targets(without_effects(twin), np.linspace(*pressures_kpa, poses))
    solver = finger(twin, batch=poses, particles=particles, device=device)
    alone = rng.uniform(-ALONE_RAD, ALONE_RAD, free.shape)
    held = solve_equilibrium(solver, Loads(q_cmd=free + alone), TOLERANCE)
    torque = held.body_torque.astype(float) / parameter(twin, "youngs_modulus_mpa")
    rest = joint_targets(without_effects(twin), [0.0])[0]
    return SoftBody.fit(held.q.astype(float), torque, rest)


def without_effects(twin: Twin) -> Twin:
    """The same finger by pressure alone."""
    plain = twin.copy()
    plain.effects = {}
    return plain


STEP_MM = 0.35  # that an indenter goes in by at a time, since friction makes the gel remember its way
SHARES = np.linspace(0.5, 1.0, 6)  # of a press's depth, between which `between` interpolates


class PressedGel:
    """One gel, pressed again and again, each time from rest; the lattice is that of `gel`.

    The model gives the window, the twin elasticity, Poisson's ratio and density, where it has them.
    """

    def __init__(self, model: GelModel, twin: Twin, device: str = "auto"):
        own = twin.copy()
        model.into_twin(own)
        self._window = model.window_mm
        self._solver = gel(own, device=device, table=np.zeros((SAMPLES,) * 3))
        self._seen: list[tuple[Press, np.ndarray]] = []

    def surface(self, press: Press, share: float = 1.0) -> np.ndarray:
        """Displacement in mm, float32 (80, 59), under a press at a share of its depth.

        Raises InputError where the gel finds no rest.
        """
        return self._surfaces(press, np.array([share]))[0]

    def between(self, press: Press, share: float) -> np.ndarray:
        """The same for a share from 0.5 to 1, interpolated between six that are stored for each press."""
        found = [surfaces for seen, surfaces in self._seen if seen is press]
        if not found:
            found = [self._surfaces(press, SHARES)]
            self._seen.append((press, found[0]))
        k = int(np.clip(np.searchsorted(SHARES, share) - 1, 0, len(SHARES) - 2))
        part = np.float32((share - SHARES[k]) / (SHARES[k + 1] - SHARES[k]))
        return (1 - part) * found[0][k] + part * found[0][k + 1]

    def _surfaces(self, press: Press, shares: np.ndarray) -> np.ndarray:
        if press.figure is not None:
            self._solver.set_table(distances_m(press.figure))
        try:
            return halved_once(self._solver, lambda: self._driven(press, shares))
        except MpmDiverged as e:
            raise InputError(
                f"{e.finding}, under the {press.indenter} pressed {press.depth_mm:.3g} mm deep; correct its "
                "depth, or calibrate without through=mpm."
            ) from e

    def _driven(self, press: Press, shares: np.ndarray) -> np.ndarray:
        out, at = [], 0.0
        for depth in shares * press.depth_mm:
            for d in np.linspace(at, depth, int(np.ceil((depth - at) / STEP_MM)) + 1)[1:]:
                part = press_loads(replace(press, depth_mm=float(d)))
                solve_equilibrium(self._solver, part, warm=at > 0)
                at = float(d)
            out.append(surface_displacement(self._solver, self._window)[0].astype(np.float32))
        return np.stack(out)
