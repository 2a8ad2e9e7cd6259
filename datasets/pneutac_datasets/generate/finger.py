"""A bench session of a finger with hidden physics, simulated by `pneutac_truths`; the answer lies apart."""

from pathlib import Path

import numpy as np

from pneutac_datasets.generate.programs import session
from pneutac_datasets.generate.truth import write_truth
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_truths import EFFECTS
from pneutac_truths import generate as simulate
from pneutac_truths.programs import DT_S, given

# Effect of the library, or disturbance that no effect describes, and the independent simulation of it.
TRUTHS = {
    "dead_time": "dead_time",
    "valve_lag": "vent_slow",
    "orifice_flow": "fill_orifice",
    "leak": "leak",
    "sensor_offset": "gauge_drifting",
    "gain_saturation": "chain_locking",
    "stiffening": "unfolding",
    "hysteresis": "hysteresis_preisach",
    "friction": "friction_maxwell",
    "creep": "creep_fractional",
    "cyclic_softening": "mullins",
    "thermal": "temperature_drift",
    "gravity": "gravity",
    "payload": "payload",
    "base_tilt": "soft_clamp",
    "camera_misalignment": "lens_distortion",
    "disturbance_walking_scale": "camera_warm_up",
    "disturbance_marker_slip": "marker_slip",
    "disturbance_vibration": "hunting",
    "disturbance_crosstalk": "regulator_zero",
    "disturbance_base_bumps": "mount_knock",
}
JOINTS = 4  # of the twin's spine, which the recording names
REST_S = 120.0  # without pressure before each trial


def generate(
    effects: str | list[str],
    out: str | Path,
    seed: int = 0,
    strength: float = 1.0,
    minutes: float = 10.0,
    hz: float = 20.0,
    measured_pressure: bool = True,
) -> dict:
    """Writes a recording into folder `out`, and the truth into `truth/<name of out>.json` beside it.

    Args:
        effects: one name, several, or `none`; those of `TRUTHS`, and of `pneutac_truths.EFFECTS` for a rod.
        out: folder of the recording.
        seed: decides finger, program, noise and everything random in an effect.
        strength: 1 leaves the plain device, fitted again, with an error of 5 times the noise, 0.5 half of
            that; an effect that cannot reach it has the largest size that devices show.
        minutes: length of the session; below about 2 the parts become very short.
        hz: samples a second.
        measured_pressure: whether the recording has `pressure_kpa`.

    Returns:
        The truth: effects with simulation and parameters; noise.

    Raises:
        InputError: an unknown effect, or a number out of its range.
    """
    names = [effects] if isinstance(effects, str) else list(effects)
    names = [] if names == ["none"] else names
    for name in names:
        if "rod" not in getattr(EFFECTS.get(TRUTHS.get(name, name)), "devices", ()):
            raise InputError(
                f"There is no hidden effect '{name}'; there are none, {', '.join(TRUTHS)}, and those of "
                "`python -m pneutac_truths --list`."
            )
    if not 0 < strength <= 3:
        raise InputError(f"strength is {strength}; it must be above 0 and at most 3.")
    if not 1 <= minutes <= 60 or not 5 <= hz <= 100:
        raise InputError(f"minutes={minutes}, hz={hz}: minutes must be 1 to 60 and hz 5 to 100.")
    trials = session(1.0, 60 * minutes, hz, np.random.default_rng([seed, 1]))
    plan = given(
        [("", *_straight(t.command, hz)) for t in trials],
        REST_S,
        1 / hz,
        {c: np.array([getattr(t, c) for t in trials]) for c in ("gravity", "payload_g", "temperature_c")},
    )
    used = [TRUTHS.get(n, n) for n in names]
    how = {"plan": plan, "strength": strength, "tell_noise": False}
    try:
        made = simulate("rod", used, seed, gauge=measured_pressure, **how)
    except (ValueError, ArithmeticError) as e:  # a gauge's fault without a gauge, loads beyond buckling
        raise InputError(f"{e} Give other effects or a lower strength.") from e
    samples = made.samples.drop(columns="time_sent_s", errors="ignore")
    samples["program"] = np.concatenate([t.label for t in trials])
    joints = [round(made.meta["length_mm"] * (k + 0.5) / JOINTS, 4) for k in range(JOINTS)]
    meta = made.meta | {"spine_joint_positions_mm": joints, "notes": "Generated."}
    Recording(Path(out), meta, samples, "finger").write(out)
    unknown = any(n.startswith("disturbance_") or (n not in TRUTHS and not EFFECTS[n].physics) for n in names)
    truth = {
        "effects": names,
        "strength": strength if names else 0.0,
        "verdict": "unknown_effect" if unknown else "missing_effect" if names else "adequate",
        "details": [
            {"name": n, "form": EFFECTS[t].summary, "simulation": t, "parameters": made.effects[t]}
            for n, t in zip(names, used, strict=True)
        ],
        "noise_floor_mm": made.noise_floor,
        "seed": seed,
        "recording": Path(out).name,
    }
    write_truth(out, truth)
    return truth


def _straight(command: list[float], hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) in s of the fine grid, and the command there, straight between its samples."""
    sampled_s = np.arange(len(command)) / hz
    time_s = np.arange(round(sampled_s[-1] / DT_S) + 1) * DT_S
    return time_s, np.interp(time_s, sampled_s, command)
