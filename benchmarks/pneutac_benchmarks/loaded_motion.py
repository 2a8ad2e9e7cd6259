"""A finger that moves under loads: material points against the world's finger with and without its network.

Pressures as in the training of the action network, newly drawn, and forces at the tip that are held for some
control steps, change or are let go. Loads act as torques on the joints, the same for all.
"""

import time
from dataclasses import dataclass

import numpy as np

from pneutac_benchmarks.swing import DAMPING, STIFFNESS, carry
from pneutac_sim.features import MAX_PRESSURE_KPA
from pneutac_sim.mpm import devices
from pneutac_sim.mpm.solve import simulate
from pneutac_sim.mpm.total_lagrangian import Loads
from pneutac_sim.surrogate import collect as programs
from pneutac_sim.surrogate.finger import SurrogateFinger
from pneutac_sim.twin import Twin, Value
from pneutac_sim.world.scene import PHYSICS_HZ, SUBSTEPS
from pneutac_sim.world.soft_finger import sensor
from pneutac_sim.world.station import Station
from pneutac_sim.world.world import World

DT = Station().dt_s

FORCE_N, LOADED = (0.2, 0.6), 0.75  # of a load, and how often there is one
SETTLE_S, SETTLE_PER_S = 0.4, 80.0


@dataclass(frozen=True)
class Program:
    """Pressures (T + 1,) in kPa, one a control step, and torques (T, N) in N m of the loads between them."""

    pressure_kpa: np.ndarray
    torque_nm: np.ndarray

    @classmethod
    def draw(cls, twin: Twin, kind: str, steps: int, seed: int) -> "Program":
        """One of a kind of `programs.KINDS`."""
        rng = np.random.default_rng(seed)
        pressure = programs.program(kind, steps, 0.0, MAX_PRESSURE_KPA, rng)
        pressure[0] = 0.0
        force, k = np.zeros(steps, complex), 0
        while k < steps:
            held = int(rng.integers(2, 5))
            size = rng.uniform(*FORCE_N) * (rng.random() < LOADED)
            force[k : k + held] = size * np.exp(1j * rng.uniform(0, 2 * np.pi))
            k += held
        poses = programs.joint_targets(twin, pressure[1:])
        torque = [(to_tip(twin, q).conj() * f).imag for q, f in zip(poses, force, strict=True)]
        return cls(pressure, np.array(torque))


def to_tip(twin: Twin, q: np.ndarray) -> np.ndarray:
    """x + i z in m from each joint to the tip at joint angles (N,)."""
    ways = np.diff(np.append(twin.spine_joint_positions_mm, twin.length_mm)) * 1e-3
    return (np.exp(1j * np.cumsum(q)) * ways)[::-1].cumsum()[::-1]


def tips_mm(twin: Twin, q: np.ndarray) -> np.ndarray:
    """x + i z (...) in mm from the first joint to the tip at joint angles (..., N)."""
    return 1e3 * np.apply_along_axis(lambda one: to_tip(twin, one)[0], -1, q)


def by_world(world: World, program: Program) -> np.ndarray:
    """Joint angles (T + 1, N) of the world's finger."""
    world.reset(0)
    out = [world.spine_rad]
    for pressure, torque in zip(program.pressure_kpa[1:], program.torque_nm, strict=True):
        world.data.qfrc_applied[world._spine] = torque
        world.step(np.array([0.0, 0.0, 0.0, pressure]))
        out.append(world.spine_rad)
    world.data.qfrc_applied[:] = 0.0
    return np.array(out)


def by_material_points(world: World, body: SurrogateFinger, drawn: list[Program]) -> tuple[np.ndarray, float]:
    """Joint angles (B, T + 1, N) of the full finger with its sensor, and processor seconds a simulated one.

    The chamber leads the free finger as the world does, by the same torques; all that the soft body does
    beside is the material points' own.

    Args:
        world: whose finger it is.
        body: of the same finger, for the torque that keeps the free body bent.
        drawn: programs of one length.
    """
    twin, K = world.twin, body.controller_nm_per_rad
    damping = world.twin.parameter("joint_damping_nms_per_rad")
    targets = np.stack([_targets(world, body, p, damping) for p in drawn])
    free = twin.copy()
    free.parameters |= {STIFFNESS: Value(K), DAMPING: Value(damping)}
    solver = devices.finger(free, batch=len(drawn))
    carry(solver, sensor(twin))
    began = time.process_time()
    at = programs.joint_targets(twin, np.array([p.pressure_kpa[0] for p in drawn]))
    solver.set_q(at)
    still = Loads(q_cmd=np.stack([q - _torque(body, q[None])[0] / K for q in at]))
    simulate(solver, still, SETTLE_S, SETTLE_S / 20, damping=SETTLE_PER_S, particles=False)

    def loads(time_s: float) -> Loads:
        return Loads(q_cmd=targets[:, min(round(time_s * PHYSICS_HZ), targets.shape[1] - 1)])

    moved_s = DT * (len(drawn[0].pressure_kpa) - 1)
    run = simulate(solver, loads, moved_s, 1 / PHYSICS_HZ, particles=False)
    seconds = (time.process_time() - began) / (len(drawn) * (SETTLE_S + moved_s))
    return run.q[::SUBSTEPS].transpose(1, 0, 2).astype(float), seconds


def _targets(world: World, body: SurrogateFinger, program: Program, damping: float) -> np.ndarray:
    """(T S, N) rad: where a chamber of stiffness K_c must point in each substep."""
    q = programs.joint_targets(world.twin, program.pressure_kpa)
    none, one, rate, out = np.zeros((len(q[0]),) * 2), np.eye(len(q[0])), np.zeros(len(q[0])), []
    for k, load in enumerate(program.torque_nm):
        follow = world._follower.torques
        torque, end = follow(q[k], rate, q[k + 1], none, damping * one, SUBSTEPS)
        path = follow(q[k], rate, q[k + 1], one, damping * one, SUBSTEPS)[0] - torque
        out.append(path + (torque + load - _torque(body, path)) / body.controller_nm_per_rad)
        rate = end
    return np.concatenate(out)


def _torque(body: SurrogateFinger, q: np.ndarray) -> np.ndarray:
    """f_r(q, 0, p) (T, N) in N m at joint angles (T, N) of pressure alone."""
    return body.network.torque(q, np.zeros_like(q), body.network.pressure_kpa(q))


def compare(kinds: tuple[str, ...], steps: int, seed: int) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """The built-in finger in motions of all kinds.

    Args:
        kinds: of programs.
        steps: control steps of each.
        seed: of the first; the others follow.

    Returns:
        Distances (kinds, steps) of the tip from the material points', mm, of the world's finger with the
        `network`, with `springs` of the whole stiffness at every joint, and of the `skeleton` that the
        chamber drives alone, f_r = 0; and processor seconds a simulated second of `material points` and
        `network`.
    """
    twin = Twin.builtin()
    world = World("switch", twin, "none", "surrogate")
    springs, skeleton = (World("switch", twin, "none", "probe") for _ in range(2))
    body = world.finger
    assert isinstance(body, SurrogateFinger)
    skeleton._controller = body.controller_nm_per_rad * np.eye(body.network.joints)
    drawn = [Program.draw(twin, kind, steps, seed + i) for i, kind in enumerate(kinds)]
    full, seconds = by_material_points(world, body, drawn)
    truth, out = tips_mm(twin, full), {}
    for name, each in (("network", world), ("springs", springs), ("skeleton", skeleton)):
        moved = tips_mm(twin, np.stack([by_world(each, p) for p in drawn]))
        out[name] = np.abs(moved - truth)[:, 1:]
    began, q = time.process_time(), full[0, 0]
    for _ in range(1000):
        body.torque(q, q)
    return out, {"material points": seconds, "network": (time.process_time() - began) / 1000 / DT}
