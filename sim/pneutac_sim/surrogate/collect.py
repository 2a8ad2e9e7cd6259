"""Collects how the full material-point finger moves: joint angles and rates under pressures and tip loads.

Trajectories are files of their own, `action_000.safetensors` and so on, written at once or not at all: a
collection that was interrupted goes on where it stopped.

What moves the finger while its network learns: bending pressures and tip loads, drawn at random.

The bending pressure is the one that the joint targets stand for, p = mean(q_cmd) / G - p0. Every effect of
the twin before the body, from a slow valve to creep, acts on it, so one network serves whatever history led
there; without effects it is the commanded pressure.
"""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from pneutac_sim.effects.registry import get_effect, of_body
from pneutac_sim.errors import InputError
from pneutac_sim.executor import ExecutorOptions, run_pieces
from pneutac_sim.features import CONTROL_HZ
from pneutac_sim.files import whole
from pneutac_sim.finger.online import COMPUTED, PressurePipeline
from pneutac_sim.mpm import devices, runtime
from pneutac_sim.mpm.solve import simulate, solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads
from pneutac_sim.surrogate.finger import bending_pressure, fingerprint, joint_targets
from pneutac_sim.twin import Twin

KINDS = ("steps", "ramps", "chirp", "random")
LOAD_RAD = 0.3  # how far a load bends the joint at the base, at most; tasks reach 0.25
OWN_RAD = 0.1  # how far each joint is bent by itself, at most
CHIRP_HZ = (0.3, 3.0)


def bending_range(twin: Twin) -> tuple[float, float]:
    """Least and largest bending pressure that commands within the twin's range lead to within hours.

    Effects that ask for conditions (temperature, loads) are left out: what they add depends on where the twin
    will stand, and `World.out_of_range` counts the steps in which it leads beyond the network's range.
    """
    twin = twin.copy()
    for effect in of_body(twin.effects):
        if any(c not in COMPUTED for c in get_effect(effect).columns):
            del twin.effects[effect]
    pipeline = PressurePipeline(twin)
    seen = [bending_pressure(twin, pipeline.rest())]
    low, high = twin.pressure_range_kpa
    for command in (high, low, 0.0) if low else (high, 0.0):
        for dt in np.geomspace(1 / CONTROL_HZ, 3600.0, 60):
            seen.append(bending_pressure(twin, pipeline.step(command, float(dt))))
    return float(min(seen)), float(max(seen))


def program(kind: str, steps: int, low: float, high: float, rng: np.random.Generator) -> np.ndarray:
    """Bending pressures (steps + 1,) in kPa from `low` to `high`, one a control step.

    They are to be joined by straight lines. The kind is one of `KINDS`; `rng` draws the program.
    """
    if kind == "chirp":
        t = np.arange(steps + 1) / CONTROL_HZ
        f0, f1 = CHIRP_HZ
        phase = 2 * np.pi * (f0 * t + (f1 - f0) * t**2 / max(2 * t[-1], 1e-9)) + rng.uniform(0, 2 * np.pi)
        middle = rng.uniform(0.35, 0.65)
        return low + (high - low) * (middle + rng.uniform(0.5, 1.0) * min(middle, 1 - middle) * np.sin(phase))
    shortest, longest = {"steps": (4, 9), "ramps": (3, 8), "random": (1, 3)}[kind]
    out = []
    level = rng.uniform(low, high)
    while len(out) <= steps:
        length = int(rng.integers(shortest, longest))
        new = rng.uniform(low, high)
        out += [level] * length if kind == "steps" else np.linspace(level, new, length + 1)[:-1].tolist()
        level = new
    return np.array(out[: steps + 1])


def load(twin: Twin, q_cmd: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Deflections (T, N) in rad by a force on the tip that wanders in the plane, and of each joint by itself.

    At joint targets (T, N) in rad, one a control step. The largest force bends the joint at the base by
    `LOAD_RAD`, the others by less as its lever is shorter. Without the second part joints would always move
    together, and data would not show how the body resists where one bends alone: its derivative would be
    smeared over neighbours.
    """
    joints = np.append(twin.spine_joint_positions_mm, twin.length_mm)
    heading = np.exp(1j * np.cumsum(q_cmd, axis=1))  # x + i z
    ways = (heading * np.diff(joints))[:, ::-1].cumsum(1)[:, ::-1]  # from each joint to the tip
    knots = np.arange(0, len(q_cmd) + 4, 4)

    def wander() -> np.ndarray:
        return np.interp(np.arange(len(q_cmd)), knots, rng.uniform(-1, 1, len(knots)))

    moment = -ways.imag * wander()[:, None] + ways.real * wander()[:, None]
    own = np.stack([wander() for _ in q_cmd.T], 1)
    return LOAD_RAD * moment / (twin.length_mm - joints[0]) + OWN_RAD * own


FRAME_S = 0.002  # a tenth of the period of the slowest swing of the spine with its body
HOLDS = 8  # steps in which the targets follow their straight lines within a frame; a joint settles in 0.5 ms
FORMAT = "pneutac-action-data/2"
SIDE_BY_SIDE = {"cpu": 4, "cuda": 64}


@dataclass(frozen=True)
class Plan:
    """What is collected."""

    trajectories: int = 24  # the last sixth is for the evaluation, the sixth before it for early stopping
    duration_s: float = 1.0  # of each; 24 of 1 s give 8,000 state-torque pairs to train on
    particles: int = 4000  # of the finger, about
    # of the body's momentum. A neo-Hookean solid has no losses and would ring on for ever after each step;
    # 60/s is a tenth of critical at its slowest swing, 50 Hz, as is the twin's joint damping in the world.
    damping_per_s: float = 60.0
    seed: int = 0  # of the programs

    def __post_init__(self):
        if self.trajectories < 1 or self.particles < 1:
            raise InputError(
                f"trajectories is {self.trajectories} and particles {self.particles}; both must be positive."
            )
        if not 0.02 <= self.duration_s <= 600:
            raise InputError(f"duration_s is {self.duration_s}; it must lie in [0.02, 600] seconds.")
        if not 0 <= self.damping_per_s < 1e4:
            raise InputError(f"damping_per_s is {self.damping_per_s}; it must lie in [0, 10000).")

    @property
    def pairs(self) -> int:
        return int(round(self.duration_s / FRAME_S))


@dataclass(frozen=True)
class Motion:
    """One trajectory of T frames, `FRAME_S` apart."""

    q: np.ndarray  # (T, N) rad
    q_vel: np.ndarray  # (T, N) rad/s
    target: np.ndarray  # (T, N) joint targets, rad; straight lines between frames
    pressure_kpa: np.ndarray  # (T,) bending pressure

    def accelerations(self) -> np.ndarray:
        """(T - 2, N) rad/s2 of the frames but the first and last.

        Angles and rates together give the fourth order:
        q'' = 2 (q+ - 2 q + q-) / h^2 - (q'+ - q'-) / (2 h).
        """
        h, q, v = FRAME_S, self.q, self.q_vel
        return 2 * (q[2:] - 2 * q[1:-1] + q[:-2]) / h**2 - (v[2:] - v[:-2]) / (2 * h)


def collect_action(
    twin: Twin,
    out_dir: str | Path,
    plan: Plan | None = None,
    device: str = "auto",
    progress: Callable[[str], None] = lambda _: None,
    executor: ExecutorOptions | None = None,
) -> list[Path]:
    """Moves the full finger under all programs of the plan and keeps its trajectories; returns their files.

    Those in the folder that belong to this twin and plan are not collected again. `progress` is given a line
    after each batch. An `executor` collects one by one, each on one core; None takes batches on all cores, or
    the GPU, of this process.

    Raises:
        InputError: the twin is not a finger's, or the folder holds trajectories of another twin or plan.
        pneutac_sim.mpm.solve.MpmDiverged: the finger left the finite numbers.
    """
    plan = plan or Plan()
    if twin.device != "finger":
        raise InputError(f"The action network is of a finger; this twin's device is '{twin.device}'.")
    folder = Path(out_dir)
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"action_{i:03d}.safetensors" for i in range(plan.trajectories)]
    label = {"format": FORMAT, "fingerprint": fingerprint(twin), "drive": _drive(twin)}
    label["plan"] = json.dumps(asdict(plan), sort_keys=True)
    missing = []
    for i, file in enumerate(files):
        if not file.is_file():
            missing.append(i)
        elif _label(file) != label:
            raise InputError(
                f"{file} was collected for another twin or plan; delete it, or collect into another folder."
            )
    if not missing:
        return files
    if executor is not None:
        collect = partial(_collect, twin, plan, files, label, device)
        report = lambda _, done, total: progress(f"collected {done} of {total} trajectories")  # noqa: E731
        run_pieces(collect, files, folder / "logs", executor, report, "trajectories")
        return files
    running = runtime.start(device)
    size = SIDE_BY_SIDE[running]
    while missing:
        batch, missing = missing[:size], missing[size:]
        for i, motion in zip(batch, _move(twin, plan, batch, running), strict=True):
            _write(files[i], motion, label)
        progress(f"collected {plan.trajectories - len(missing)} of {plan.trajectories} trajectories")
    return files


def _collect(
    twin: Twin, plan: Plan, files: list[Path], label: dict[str, str], device: str, number: int
) -> None:
    (motion,) = _move(twin, plan, [number], runtime.start(device))
    _write(files[number], motion, label)


def read_motions(out_dir: str | Path, twin: Twin) -> tuple[Plan, list[Motion]]:
    """Reads what `collect_action` has written for this twin.

    Raises InputError where trajectories are missing, corrupted, or of another twin.
    """
    first = Path(out_dir) / "action_000.safetensors"
    if not first.is_file():
        raise InputError(f"There are no trajectories in '{out_dir}'; collect them with `pneutac surrogate`.")
    label = _label(first)
    try:
        plan = Plan(**json.loads(label["plan"]))
    except (TypeError, ValueError) as e:
        raise InputError(f"{first}: 'plan' is malformed ({e}); delete the file and collect it again.") from e
    if label["fingerprint"] != fingerprint(twin) or label["drive"] != _drive(twin):
        raise InputError(
            f"The trajectories in '{out_dir}' are of another twin; collect again with `pneutac surrogate`."
        )
    motions = []
    for i in range(plan.trajectories):
        file = Path(out_dir) / f"action_{i:03d}.safetensors"
        if not file.is_file():
            raise InputError(
                f"{file} is missing, {i} of {plan.trajectories} trajectories are there; go on collecting "
                "with `pneutac surrogate`."
            )
        if _label(file) != label:
            raise InputError(
                f"{file} was collected for another twin or plan; delete it and collect it again."
            )
        motions.append(_read(file, plan, len(twin.spine_joint_positions_mm)))
    return plan, motions


def _move(twin: Twin, plan: Plan, batch: list[int], device: str) -> list[Motion]:
    solver = devices.finger(twin, batch=len(batch), particles=plan.particles, device=device)
    frames, hold = plan.pairs + 2, FRAME_S / HOLDS
    fine = np.arange((frames - 1) * HOLDS + 1) * hold
    drawn = [draw(twin, plan, i, fine) for i in batch]
    target = np.stack([t for t, _ in drawn], 1)
    solve_equilibrium(solver, Loads(q_cmd=target[0]))

    def loads(time_s: float) -> Loads:
        k = round(time_s / hold)
        return Loads(q_cmd=0.5 * (target[k] + target[min(k + 1, len(target) - 1)]))

    run = simulate(solver, loads, (frames - 1) * FRAME_S, hold, damping=plan.damping_per_s, particles=False)
    # A joint's rate falls off within each hold, so its momentary value would depend on when it is read.
    q_vel = np.gradient(run.q.astype(float), hold, axis=0)
    q, q_vel, target = (x[::HOLDS] for x in (run.q, q_vel, target))
    pressures = [pressure[::HOLDS] for _, pressure in drawn]
    return [Motion(q[:, b], q_vel[:, b], target[:, b], kpa) for b, kpa in enumerate(pressures)]


def draw(twin: Twin, plan: Plan, index: int, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Joint targets (T, N) in rad and bending pressures (T,) in kPa of one trajectory of the plan.

    Kinds of program take turns, and of each kind every other one is with loads.
    """
    rng = np.random.default_rng([plan.seed, index])
    steps = int(np.ceil(plan.duration_s * CONTROL_HZ)) + 1
    pressure = program(KINDS[index % len(KINDS)], steps, *bending_range(twin), rng)
    target = joint_targets(twin, pressure)
    if (index // len(KINDS) + index) % 2:
        target = target + load(twin, target, rng)
    knots = np.arange(steps + 1) / CONTROL_HZ
    along = np.stack([np.interp(time_s, knots, column) for column in target.T], 1)
    return along, np.interp(time_s, knots, pressure)


def _write(file: Path, motion: Motion, label: dict[str, str]) -> None:
    arrays = {k: np.ascontiguousarray(v, np.float64) for k, v in asdict(motion).items()}
    with whole(file) as part:
        part.write_bytes(save(arrays, label))


def _drive(twin: Twin) -> str:
    return json.dumps([twin.parameter("gain_rad_per_kpa"), twin.parameter("rest_pressure_kpa")])


def _label(file: Path) -> dict[str, str]:
    try:
        with safe_open(file, "np") as f:
            label = f.metadata() or {}
    except (SafetensorError, OSError) as e:
        raise InputError(f"{file} is corrupted ({e}); delete it and collect it again.") from e
    if label.get("format") != FORMAT or not {"fingerprint", "drive", "plan"} <= set(label):
        raise InputError(f"{file} is no trajectory of the format '{FORMAT}'; delete it and collect it again.")
    return label


def _read(file: Path, plan: Plan, joints: int) -> Motion:
    wanted = dict.fromkeys(("q", "q_vel", "target"), (plan.pairs + 2, joints))
    wanted["pressure_kpa"] = (plan.pairs + 2,)
    with safe_open(file, "np") as f:
        arrays = {k: f.get_tensor(k) for k in f.keys()}  # noqa: SIM118
    for name, shape in wanted.items():
        if name not in arrays or arrays[name].shape != shape or not np.isfinite(arrays[name]).all():
            raise InputError(f"{file}: array '{name}' must be finite numbers of shape {shape}.")
    return Motion(**{name: arrays[name] for name in wanted})
