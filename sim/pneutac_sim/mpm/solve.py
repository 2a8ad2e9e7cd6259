"""What a user calls: equilibrium under loads, and motion over time."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.executor import Progress, no_progress
from pneutac_sim.mpm.kernels import LEAST_J
from pneutac_sim.mpm.total_lagrangian import Loads, TotalLagrangian

CHUNK = {"cpu": 25, "cuda": 50}  # substeps between two looks at the residual
SLOWEST = 12  # times slower than the guess may the slowest motion be; a rate too low lets all swing on
RAMP = 160  # substeps in which an indenter that begins inside the body is driven in


class MpmDiverged(RuntimeError):  # noqa: N818
    """The material points found no equilibrium, or left the finite numbers.

    Attributes:
        finding: which body and what became of it, without what a caller of this module can change.
    """

    def __init__(self, finding: str, remedy: str):
        super().__init__(f"{finding}; {remedy}.")
        self.finding = finding


@dataclass(frozen=True)
class Equilibrium:
    """Bodies at rest under load."""

    positions: np.ndarray  # (B, P, 3) of the particles, m
    gradients: np.ndarray  # (B, P, 3, 3) deformation gradients
    q: np.ndarray  # (B, H) joint angles, rad
    controller_torque: np.ndarray  # (B, H) of the controller, N m
    body_torque: np.ndarray  # (B, H) of body and gravity on the joints, N m; the two add up to nearly nothing
    contact_force: np.ndarray  # (B, 3) of the indenter on the body, N
    penetration_m: np.ndarray  # (B,) deepest surface point inside the indenter, m
    residual: np.ndarray  # (B,) unbalanced forces over those from outside
    substeps: int  # taken


def solve_equilibrium(
    solver: TotalLagrangian,
    loads: Loads,
    tolerance: float = 1e-2,
    max_substeps: int = 20_000,
    warm: bool = False,
    progress: Progress = no_progress,
) -> Equilibrium:
    """Lets bodies come to rest under loads by damped stepping, near critical damping of the slowest motion.

    Args:
        solver: holds the bodies; their state is where the search begins if `warm`.
        loads: what acts.
        tolerance: of the unbalanced forces over those from outside.
        max_substeps: after so many the search is given up.
        warm: go on from the present state (a neighbouring pressure, say) instead of from rest.
        progress: called with the percentage by which the unbalanced forces have fallen, on a
            logarithmic scale, since they die away exponentially.

    Raises MpmDiverged: no equilibrium was found; says which body and what to change.
    """
    _begin(solver, loads, warm)
    solver.heavy_edges(True)
    try:
        residual, substeps = _settle(solver, loads, tolerance, max_substeps, progress)
    finally:
        solver.heavy_edges(False)
    positions, gradients = _particles(solver)
    force, depth = solver.contact()
    q, _, soft = solver.angles()
    torques, contact = (_controller_torque(solver, loads, q), soft), (force.sum(1), depth.max(1, initial=0.0))
    return Equilibrium(positions, gradients, q, *torques, *contact, residual, substeps)


def halved_once[T](solver: TotalLagrangian, drive: Callable[[], T]) -> T:
    """What `drive` gives; again with half the explicit step where that is too long for a squeezed body.

    Raises MpmDiverged as `drive` does at last.
    """
    longest = solver.stable_dt
    try:
        return drive()
    except MpmDiverged:
        solver.stable_dt = 0.5 * longest
        return drive()
    finally:
        solver.stable_dt = longest


def _begin(solver: TotalLagrangian, loads: Loads, warm: bool) -> None:
    """Puts bodies where the search starts: at rest, or where they are, moved on by the change of targets."""
    if warm and solver.spine:
        q = solver.angles()[0]
        solver.shift_q(q + (loads.targets(*q.shape) - solver.drive_target))
    elif not warm:
        solver.reset()
        if solver.spine and loads.q_cmd is not None:
            solver.set_q(loads.q_cmd)


def _settle(
    solver: TotalLagrangian, loads: Loads, tolerance: float, max_substeps: int, progress: Progress
) -> tuple[np.ndarray, int]:
    """Dynamic relaxation: x'' + 2 w x' = f / m dies away fastest where w is the slowest motion's frequency.

    Returns:
        (B,) unbalanced forces over those from outside, and the substeps taken.
    """
    rate = _round(solver.slowest_rate())
    least = rate / SLOWEST
    solver.apply(loads, damping=2 * rate, contact_rate=2 * rate)
    taken = 0
    chunk = CHUNK[solver.device]
    away = _retreat(solver, loads)
    if away is not None:
        start = replace(loads, position_m=loads.position_m + away)
        solver.apply(start, damping=2 * rate, contact_rate=2 * rate, drift_m=-away / RAMP)
        solver.step(RAMP)
        taken += RAMP
        solver.apply(loads, damping=2 * rate, contact_rate=2 * rate)
    begun, percent = 0.0, 0
    while True:
        solver.step(chunk)
        m = solver.measure()
        taken += chunk
        _finite(solver, m["residual"], taken)
        residual = m["residual"] / np.maximum(m["scale"], solver.least_force())
        now = max(float(residual.max()), tolerance)
        begun = begun or now
        percent = max(percent, round(100 * np.log(begun / now) / max(np.log(begun / tolerance), 1e-9)))
        progress(f"unbalanced forces are {now:.2g} of the loads, {tolerance:.2g} is at rest", percent, 100)
        # A motion slower than the guess shows once the fast ones have died away; where hardly anything
        # moves any more, what shows is rounding.
        moves = (m["rate"] > 0) & (residual >= tolerance)
        slower = np.maximum(_round(np.where(moves, np.minimum(rate, m["rate"]), rate)), least)
        if (slower < rate).any():
            rate = slower
            solver.pace(rate)
        if (residual < tolerance).all() and _joints_rest(solver, loads, tolerance):
            return residual, taken
        if taken >= max_substeps:
            worst = int(np.argmax(residual))
            raise MpmDiverged(
                f"Body '{solver.body.name}' (number {worst} of the batch) is not at rest after {taken} "
                f"substeps: unbalanced forces are {residual[worst]:.2g} of those from outside, "
                f"{tolerance:.2g} is the tolerance",
                "allow more substeps, or approach the load in steps with warm=True",
            )


def _particles(solver: TotalLagrangian) -> tuple[np.ndarray, np.ndarray]:
    """Positions and deformation gradients; raises MpmDiverged where they are beyond the material law."""
    positions, gradients = solver.particles()
    least = np.linalg.det(gradients).min(1)
    if (least < LEAST_J).any():
        worst = int(least.argmin())
        raise MpmDiverged(
            f"Body '{solver.body.name}' (number {worst} of the batch) has a particle squeezed to "
            f"{least[worst]:.2g} of its volume, which this law is not made for",
            "load it less, or use finer particles",
        )
    return positions, gradients


def _controller_torque(solver: TotalLagrangian, loads: Loads, q: np.ndarray) -> np.ndarray:
    stiffness = solver.spine.stiffness_nm_per_rad if solver.spine else 0.0
    return stiffness * (loads.targets(*q.shape) - q)


@dataclass(frozen=True)
class Trajectory:
    """Bodies in motion, T frames."""

    time_s: np.ndarray  # (T,)
    q: np.ndarray  # (T, B, H) rad
    q_vel: np.ndarray  # (T, B, H) rad/s
    body_torque: np.ndarray  # (T, B, H) N m
    contact_force: np.ndarray  # (T, B, 3) N
    positions: np.ndarray | None  # (T, B, P, 3) m, or None where particles were not asked for


def simulate(
    solver: TotalLagrangian,
    loads: Callable[[float], Loads] | Loads,
    duration_s: float,
    frame_s: float,
    damping: float = 0.0,
    dt: float | None = None,
    particles: bool = True,
) -> Trajectory:
    """Moves bodies on from their present state; the first frame is that state, the others `frame_s` apart.

    Args:
        solver: holds the bodies.
        loads: what acts, or a function of time; held constant during a frame.
        duration_s: s.
        frame_s: s.
        damping: of the momentum by a surrounding medium, 1/s.
        dt: largest step, s; None for the largest stable one of the batch.
        particles: keep their positions.

    Raises:
        InputError: a duration or a step that makes no sense, or an indenter that begins inside a body.
        MpmDiverged: a body left the finite numbers.
    """
    if not (duration_s > 0 and 0 < frame_s <= duration_s):
        raise InputError(
            f"duration_s {duration_s} and frame_s {frame_s} must be positive, the second smaller."
        )
    limit = float(solver.stable_dt.min()) if dt is None else dt
    substeps = int(np.ceil(frame_s / limit))
    step = frame_s / substeps
    frames = int(round(duration_s / frame_s))
    at = loads if callable(loads) else lambda _: loads
    out: dict[str, list] = {k: [] for k in ("q", "q_vel", "body_torque", "contact_force", "positions")}
    solver.heavy_edges(False)
    solver.apply(at(0.0), damping=damping, dt=step)
    _outside(solver)
    for frame in range(frames + 1):
        q, qd, soft = solver.angles()
        force = solver.contact()[0].sum(1)
        values = (q, qd, soft, force, solver.particles()[0] if particles else None)
        for key, value in zip(out, values, strict=True):
            out[key].append(value)
        if frame < frames:
            # Pushing penetration out adds up over time and feeds a motion that is damped more slowly (Routh).
            solver.apply(at(frame * frame_s), damping=damping, dt=step, contact_rate=0.5 * damping)
            solver.step(substeps)
            _finite(solver, solver.energy(), (frame + 1) * substeps)
    stacked = {k: np.stack(v) if v[0] is not None else None for k, v in out.items()}
    return Trajectory(time_s=np.arange(frames + 1) * frame_s, **stacked)


def _round(rate: np.ndarray) -> np.ndarray:
    """To quarter octaves, so that the rounding of a sum does not change what follows."""
    return 2.0 ** (np.floor(4 * np.log2(rate)) / 4)


def _outside(solver: TotalLagrangian) -> None:
    if not solver.touching:
        return
    overlap = solver.overlap()
    if overlap.max() >= 0.25 * solver.body.spacing_m:
        worst = int(overlap.argmax())
        raise InputError(
            f"Body '{solver.body.name}' (number {worst} of the batch): the indenter begins "
            f"{overlap[worst]:.3g} m inside the body; start it outside, or press it in with "
            "solve_equilibrium first."
        )


def _retreat(solver: TotalLagrangian, loads: Loads) -> np.ndarray | None:
    """(B, 3) m by which an indenter that overlaps the body must go back along its axis, or None."""
    if not solver.touching:
        return None
    solver.step(0)
    overlap = solver.overlap()
    if overlap.max() < 0.25 * solver.body.spacing_m:
        return None
    axis = np.broadcast_to(loads.rotation, (solver.batch, 3, 3))[:, :, 2]
    return overlap[:, None] * axis


def _joints_rest(solver: TotalLagrangian, loads: Loads, tolerance: float) -> bool:
    if not solver.spine:
        return True
    q, _, soft = solver.angles()
    torque = _controller_torque(solver, loads, q)
    scale = np.abs(soft).max(1, keepdims=True) + 1e-9
    return bool((np.abs(torque + soft) < max(tolerance, 1e-3) * scale + 1e-7).all())


def _finite(solver: TotalLagrangian, value: np.ndarray, substeps: int) -> None:
    if not np.isfinite(value).all():
        worst = int(np.argmin(np.isfinite(value)))
        raise MpmDiverged(
            f"Body '{solver.body.name}' (number {worst} of the batch) left the finite numbers within "
            f"{substeps} substeps: a particle was turned inside out",
            "load it more slowly, or use finer particles",
        )
