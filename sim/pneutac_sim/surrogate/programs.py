"""What moves the finger while its network learns: bending pressures and tip loads, drawn at random.

The bending pressure is the one that the joint targets stand for, p = mean(q_cmd) / G - p0. Every effect of
the twin before the body, from a slow valve to creep, acts on it, so one network serves whatever history led
there; without effects it is the commanded pressure.
"""

import numpy as np

from pneutac_sim.effects.registry import get_effect, of_body
from pneutac_sim.features import CONTROL_HZ
from pneutac_sim.finger.online import COMPUTED, PressurePipeline
from pneutac_sim.finger.stages import gain_profile
from pneutac_sim.twin import Twin

KINDS = ("steps", "ramps", "chirp", "random")
LOAD_RAD = 0.3  # how far a load bends the joint at the base, at most; tasks reach 0.25
OWN_RAD = 0.1  # how far each joint is bent by itself, at most
CHIRP_HZ = (0.3, 3.0)


def bending_pressure(twin: Twin, q_cmd: np.ndarray) -> np.ndarray:
    """Bending pressure (...) in kPa of joint targets `q_cmd` (..., N) in rad."""
    gain = twin.parameter("gain_rad_per_kpa")
    return np.asarray(q_cmd).mean(-1) / gain - twin.parameter("rest_pressure_kpa")


def joint_targets(twin: Twin, pressure_kpa: np.ndarray) -> np.ndarray:
    """Joint targets (..., N) in rad at bending pressures (...)."""
    n = len(twin.spine_joint_positions_mm)
    profile = gain_profile(n, *(twin.parameters[k].value if k in twin.parameters else 0.0 for k in _SHAPE))
    drive = np.asarray(pressure_kpa, float) + twin.parameter("rest_pressure_kpa")
    return twin.parameter("gain_rad_per_kpa") * drive[..., None] * profile


_SHAPE = ("gain_alpha", "gain_beta")


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
