"""Makes a bench recording with hidden effects, and stores the answer separately."""

import zlib
from pathlib import Path

import numpy as np
import pandas as pd

from pneutac_datasets.generate.hidden import (  # noqa: F401  they register their effects
    actuation,
    disturbances,
    load,
    material,
    observation,
    pneumatics,
)
from pneutac_datasets.generate.hidden.bench import HiddenBench, fit_plain, make_bench, rms_distance
from pneutac_datasets.generate.hidden.foreign import REGISTRY, Foreign, is_disturbance
from pneutac_datasets.generate.truth import write_truth
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError

# A full effect leaves the plain model at this many times the noise floor.
FULL_MISFIT = 5.0
PRESSURE_NOISE = 5e-4  # of the largest pressure: a good gauge


def effect_names() -> list[str]:
    """Hidden forms of effects that a library may hold."""
    return [n for n in REGISTRY if not is_disturbance(n)]


def disturbance_names() -> list[str]:
    """Hidden disturbances that no library holds."""
    return [n for n in REGISTRY if is_disturbance(n)]


def generate(
    effects: str | list[str],
    out: str | Path,
    seed: int = 0,
    strength: float = 1.0,
    minutes: float = 10.0,
    hz: float = 20.0,
    measured_pressure: bool = True,
) -> dict:
    """Writes a recording into folder `out`, and the answer into `truth/<name of out>.json` next to it.

    Args:
        effects: one name, several, or `none`; see `effect_names` and `disturbance_names`.
        out: folder of the recording.
        seed: decides finger, program, noise and everything random in an effect.
        strength: 1 leaves the plain model with an error of `FULL_MISFIT` times the noise, 0.5 half of that.
        minutes: length of the session; below about 2 the parts become very short.
        hz: samples a second.
        measured_pressure: whether the recording has `pressure_kpa`.

    Returns:
        The truth: effects with form, size, misfit alone and accepted names; noise; the finger.

    Raises:
        InputError: an unknown effect, or a number out of its range.
    """
    names = _known(effects)
    if not 0 < strength <= 3:
        raise InputError(f"strength is {strength}; it must be above 0 and at most 3.")
    if not 1 <= minutes <= 60 or not 5 <= hz <= 100:
        raise InputError(f"minutes={minutes}, hz={hz}: minutes must be 1 to 60 and hz 5 to 100.")
    bench = make_bench(seed, minutes, hz)
    rng = np.random.default_rng([seed, 2])
    noise = float(rng.uniform(0.2, 0.4))
    floor = noise * np.sqrt(3)
    active = [REGISTRY[n] for n in names]
    details = [_sized(effect, bench, seed, strength, floor) for effect in active]
    reading, tip = simulate(bench, active, {d["name"]: d["size"] for d in details}, seed)
    samples = _samples(bench, reading if measured_pressure else None, tip, noise, rng)
    _write_recording(Path(out), bench, samples)
    truth = {
        "effects": names,
        "strength": strength if names else 0.0,
        "verdict": _verdict(names),
        "details": details,
        "marker_noise_mm": noise,
        "noise_floor_mm": float(floor),
        "misfit_mm": rms_distance(tip, fit_plain(bench, tip)),
        "seed": seed,
        "finger": bench.base,
        "recording": Path(out).name,
    }
    write_truth(out, truth)
    return truth


def _known(effects: str | list[str]) -> list[str]:
    names = [effects] if isinstance(effects, str) else list(effects)
    names = [] if names == ["none"] else names
    for name in names:
        if name not in REGISTRY:
            raise InputError(f"There is no hidden effect '{name}'; there are none, {', '.join(REGISTRY)}.")
    return names


def _sized(effect: Foreign, bench: HiddenBench, seed: int, strength: float, floor: float) -> dict:
    """What the truth says of one effect, its size with it."""
    size, misfit = find_size(effect, bench, seed, strength * FULL_MISFIT * floor, strength * effect.least)
    return {
        "name": effect.name,
        "form": effect.form,
        "accepts": list(effect.accepts),
        "size": size,
        "misfit_alone_mm": misfit,
    }


def _samples(
    bench: HiddenBench,
    reading: np.ndarray | None,
    tip: np.ndarray,
    noise_mm: float,
    rng: np.random.Generator,
) -> pd.DataFrame:
    """The recording's columns, with the noise of gauge and tracker."""
    table = {
        "trial": bench.trial,
        "program": bench.label,
        "time_s": np.round(bench.time_s, 4),
        "pressure_cmd_kpa": bench.command[bench.logged],
    }
    if reading is not None:
        table["pressure_kpa"] = reading + PRESSURE_NOISE * bench.top * rng.normal(size=len(reading))
    measured = tip + noise_mm * rng.normal(size=tip.shape)
    table |= {f"tip_{a}_mm": measured[:, i] for i, a in enumerate("xyz")}
    table |= {f"gravity_{a}": bench.gravity[bench.logged, i] for i, a in enumerate("xyz")}
    table["temperature_c"] = np.round(bench.temperature_c[bench.logged], 3)
    table["payload_g"] = bench.payload_g[bench.logged]
    return pd.DataFrame(table)


def _write_recording(out: Path, bench: HiddenBench, samples: pd.DataFrame) -> None:
    meta = {
        "device": "finger",
        "length_mm": bench.base["length_mm"],
        "spine_joint_positions_mm": [round(float(1000 * x), 4) for x in bench.joint_positions_m],
        "samples": "samples.csv",
        "notes": "Generated.",
    }
    Recording(out, meta, samples, "finger").write(out)


def _verdict(names: list[str]) -> str:
    if not names:
        return "adequate"
    return "unknown_effect" if any(map(is_disturbance, names)) else "missing_effect"


def simulate(
    bench: HiddenBench, effects: list[Foreign], sizes: dict[str, float], seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Runs the chain of stages.

    Returns:
        What the gauge reads (m,), kPa, and the tip as it is seen (m, 3), mm, both without noise.
    """

    def act(stage, signal):
        for e in effects:
            if e.stage == stage:
                rng = np.random.default_rng([seed, zlib.crc32(e.name.encode())])
                signal = e.apply(signal, bench, sizes[e.name], rng)
        return signal

    reading = act("pressure", act("command", bench.command))
    drive = act("material", act("drive", act("gauge", reading)))
    free = bench.angles(drive[bench.logged])
    q = free
    loads = [e for e in effects if e.stage == "load"]
    if loads:
        stiffness = bench.base["joint_stiffness_nm_per_rad"]
        for _ in range(40):  # fixed point with half steps: the weight moves with the finger
            torque = np.zeros_like(q)
            for e in loads:
                rng = np.random.default_rng([seed, zlib.crc32(e.name.encode())])
                torque += e.apply(q, bench, sizes[e.name], rng)
            move = free + torque / stiffness - q
            q = q + 0.6 * move
            if np.abs(move).max() < 1e-5:
                break
        else:
            raise InputError("The hidden load is too heavy for the finger's joints; lower the strength.")
    return reading[bench.logged], act("marker", bench.tip(q))


def find_size(
    effect: Foreign, bench: HiddenBench, seed: int, target_mm: float, least: float
) -> tuple[float, float]:
    """Size of an effect that alone leaves the refitted plain model with this error.

    The error grows with the size, nearly in proportion, so a secant search needs few runs. It stops at the
    largest size that is physical; a size below `least` is raised to it.

    Returns:
        The size, and the error that it causes, mm.
    """

    def misfit(size):
        try:
            tip = simulate(bench, [effect], {effect.name: size}, seed)[1]
        except InputError:
            return np.inf
        error = rms_distance(tip, fit_plain(bench, tip))
        return error if np.isfinite(error) else np.inf

    low, high, size = 0.0, effect.largest, min(effect.nominal, effect.largest)
    error = np.inf
    for _ in range(14):
        error = misfit(size)
        if abs(error - target_mm) < 0.05 * target_mm or (error < target_mm and size >= effect.largest):
            break
        low, high = (size, high) if error < target_mm else (low, size)
        guess = size * target_mm / error if np.isfinite(error) and error > 0 else 0.0
        size = guess if low < guess < high else 0.5 * (low + high) if np.isfinite(high) else 2 * size
    if size < least:
        size = least
        error = misfit(size)
    return float(size), float(error)
