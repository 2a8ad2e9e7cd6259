"""Benches by `pneutac_truths`: a session of a finger with hidden physics, a device that follows programs.

What is hidden lies next to the recording's folder, never in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from pneutac_datasets.recording.axes import command_columns
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError, check_between
from pneutac_sim.files import write_json
from pneutac_truths import EFFECTS, write
from pneutac_truths import generate as simulate
from pneutac_truths.programs import DT_S, given
from pneutac_truths.world import CHAMBERS, Body


def truth_file(recording: str | Path) -> Path:
    """`truth/NAME.json` next to the folder `NAME` of a recording."""
    recording = Path(recording)
    return recording.parent / "truth" / f"{recording.name}.json"


def write_truth(recording: str | Path, truth: dict) -> None:
    """Writes the hidden truth of a recording."""
    write_json(truth_file(recording), truth)


SLEW_S = 0.2  # regulators limit the slope of their set point; a true step would fall between two samples


@dataclass
class ProgramTrial:
    """One contiguous run: the commanded pressure and the circumstances."""

    label: list[str] = field(default_factory=list)  # name of the program at each sample
    command: list[float] = field(default_factory=list)  # commanded pressure (n,), kPa
    gravity: tuple[float, float, float] = (1.0, 0.0, 0.0)  # unit vector in the base frame (3,)
    temperature_c: float = 21.0  # mean temperature
    payload_g: float = 0.0  # mass hung at the tip

    def to(self, label: str, pressure: float, seconds: float, hz: float) -> None:
        """Moves linearly to `pressure` within `seconds`."""
        n = max(1, round(seconds * hz))
        start = self.command[-1] if self.command else 0.0
        self.command += list(start + (pressure - start) * np.arange(1, n + 1) / n)
        self.label += [label] * n

    def hold(self, label: str, pressure: float, seconds: float, hz: float) -> None:
        """Goes to `pressure` at once (within `SLEW_S`) and stays, `seconds` in all."""
        if self.command and self.command[-1] != pressure:
            self.to(label, pressure, SLEW_S, hz)
            seconds -= SLEW_S
        n = max(1, round(seconds * hz))
        self.command += [pressure] * n
        self.label += [label] * n

    def triangle(self, label: str, top: float, period: float, hz: float) -> None:
        """From where it is to `top` and down to nothing."""
        self.to(label, top, period / 2, hz)
        self.to(label, 0.0, period / 2, hz)


def session(top: float, seconds: float, hz: float, rng: np.random.Generator) -> list[ProgramTrial]:
    """A whole bench session of about `seconds`, hz samples a second; `rng` decides levels and orders.

    600 s run everything at its natural pace, less shortens every part; the largest pressure is `top`, kPa.
    The main trial comes first, then two equal ones, one with the base flipped, one warm, one with a payload.
    """
    s = seconds / 600.0
    hang = (1.0, 0.0, 0.0) if rng.random() < 0.5 else (0.0, 0.0, -1.0)
    flip = tuple(-x for x in hang)
    main = ProgramTrial(gravity=hang)
    main.hold("stairs", 0.0, 1.5, hz)
    up = np.linspace(0, top, 6)
    for p in [*up[1:], *up[::-1][1:]]:
        main.hold("stairs", float(p), 5 * s, hz)
    for label, period in (("triangle_slow", 40), ("triangle_middle", 12), ("triangle_fast", 4)):
        for _ in range(2 if period == 40 else 3):
            main.triangle(label, top, period * s, hz)
    minor_loops(main, top, 48 * s, hz, rng)
    main.hold("long_hold", 0.8 * top, 55 * s, hz)
    main.hold("long_hold", 0.0, 25 * s, hz)
    for _ in range(round(16 * s) + 2):
        main.hold("random_steps", float(rng.uniform(0, top)), float(rng.uniform(2, 6)), hz)
    main.hold("random_steps", 0.0, 4.0, hz)
    for _ in range(max(3, round(20 * s))):
        main.triangle("cycles", 0.9 * top, 2.0, hz)
    runs = [main]
    short = np.random.default_rng(rng.integers(2**32))
    state = short.bit_generator.state
    for kwargs in ({}, {}, {"gravity": flip}, {"temperature_c": 30.0}, {"payload_g": 50.0}):
        trial = ProgramTrial(**{"gravity": hang, **kwargs})
        short.bit_generator.state = state  # the same program each time: two of these are repeats
        trial.hold("repeat", 0.0, 1.5, hz)
        trial.to("repeat", top, 5 * s, hz)
        trial.hold("repeat", top, 4 * s, hz)
        trial.to("repeat", 0.3 * top, 4 * s, hz)
        for _ in range(max(3, round(4 * s))):
            trial.hold("repeat", float(short.uniform(0, top)), 3 * s, hz)
        trial.to("repeat", 0.0, 3 * s, hz)
        trial.hold("repeat", 0.0, 4 * s, hz)
        runs.append(trial)
    return runs


def minor_loops(trial: ProgramTrial, top: float, seconds: float, hz: float, rng: np.random.Generator) -> None:
    """Ramps between random turning points that lie inside the range, at a middle rate."""
    rate = 1.2 * top / 10
    left = seconds
    while left > 0:
        here = trial.command[-1]
        goal = rng.uniform(0.5, 1.0) * top if here < 0.5 * top else rng.uniform(0.0, 0.5) * top
        duration = max(abs(goal - here) / rate, 0.5)
        trial.to("minor_loops", float(goal), duration, hz)
        left -= duration


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
    """Writes a recording into `out`, and the truth, which is returned, into `truth/<name of out>.json`.

    Args:
        effects: one name, several, or `none`; those of `TRUTHS`, and of `pneutac_truths.EFFECTS` for a rod.
        out: folder of the recording.
        seed: decides finger, program, noise and everything random in an effect.
        strength: 1 leaves the plain device, fitted again, with an error of 5 times the noise, 0.5 half of
            that; an effect that cannot reach it has the largest size that devices show.
        minutes: length of the session; below about 2 the parts become very short.
        hz: samples a second.
        measured_pressure: whether the recording has `pressure_kpa`.

    Raises InputError: an unknown effect, or a number out of its range.
    """
    names = [effects] if isinstance(effects, str) else list(effects)
    names = [] if names == ["none"] else names
    for name in names:
        if "rod" not in getattr(EFFECTS.get(TRUTHS.get(name, name)), "devices", ()):
            known = f"{', '.join(TRUTHS)}, and those of `python -m pneutac_truths --list`"
            raise InputError(f"There is no hidden effect '{name}'; there are none, {known}.")
    check_between(0.01, 3, strength=strength)
    check_between(1, 60, minutes=minutes)
    check_between(5, 100, hz=hz)
    trials = session(1.0, 60 * minutes, hz, np.random.default_rng([seed, 1]))
    fine = []  # times and commands on the simulation's grid, straight between samples
    for t in trials:
        sampled_s = np.arange(len(t.command)) / hz
        time_s = np.arange(round(sampled_s[-1] / DT_S) + 1) * DT_S
        fine.append(("", time_s, np.interp(time_s, sampled_s, t.command)))
    conditions = ("gravity", "payload_g", "temperature_c")
    plan = given(fine, REST_S, 1 / hz, {c: np.array([getattr(t, c) for t in trials]) for c in conditions})
    used, how = [TRUTHS.get(n, n) for n in names], {"strength": strength, "state_noise": False}
    try:
        made = simulate("rod", used, seed, gauge=measured_pressure, plan=plan, **how)
    except (ValueError, ArithmeticError) as e:  # a gauge's fault without a gauge, loads beyond buckling
        raise InputError(f"{e} Give other effects or a lower strength.") from e
    samples = made.samples.drop(columns="time_sent_s", errors="ignore")
    samples["program"] = np.concatenate([t.label for t in trials])
    joints = [round(made.meta["length_mm"] * (k + 0.5) / JOINTS, 4) for k in range(JOINTS)]
    meta = made.meta | {"spine_joint_positions_mm": joints, "notes": "Generated."}
    Recording(Path(out), meta, samples, "finger").write(out)
    unknown = any(n.startswith("disturbance_") or (n not in TRUTHS and not EFFECTS[n].physics) for n in names)
    details = [
        {"name": n, "form": EFFECTS[t].summary, "simulation": t, "parameters": made.effects[t]}
        for n, t in zip(names, used, strict=True)
    ]
    verdict = "unknown_effect" if unknown else "missing_effect" if names else "adequate"
    truth = {"effects": names, "strength": strength if names else 0.0, "verdict": verdict, "details": details}
    truth |= {"noise_floor_mm": made.noise_floor, "seed": seed, "recording": Path(out).name}
    write_truth(out, truth)
    return truth


DRAWN = ("temperature_c",)  # logged by the draw of a recording, not by every one
RESTED_S = 120.0
ARM_SEED, ARM_EFFECTS = 5, ("creep_fractional",)  # of the arm that stands in for a real one


class TruthBench:
    """A truth, `rod` or `arm` of three chambers, that remembers the programs before, in order.

    A `rested` one has long been without pressure before each; another number `noise` is another day.
    """

    hz = 20.0

    def __init__(
        self, effects: Sequence[str], seed: int, device: str = "rod", rested: bool = False, noise: int = 0
    ):
        self._effects, self._seed, self._device, self._rested = tuple(effects), seed, device, rested
        self._noise, self._programs = noise, []
        self.pause_s: float | None = None
        self._top_kpa = Body.draw(device, seed).top_kpa
        chambers = CHAMBERS[device]
        self.range_kpa = np.zeros(chambers), np.full(chambers, self._top_kpa)

    def follow(self, program: Path, out: Path, number: int) -> Recording:
        """See `lerobot_pneutac.verbs.benches.Bench`."""
        table = pd.read_csv(program)
        commands = table[command_columns(CHAMBERS[self._device])].to_numpy(float)
        shares = np.round(commands / self._top_kpa, 5)
        one = str(table["program"].iloc[0]), table["time_s"].to_numpy(float), shares
        if self._rested:
            return self._recorded([one], out, 1 + 1000 * self._noise + number)
        self.pause_s = RESTED_S if number else None
        self._programs = [*self._programs[:number], one]
        r = self._recorded(self._programs, out, 1 + 1000 * self._noise, state_pauses=False)
        r = r.keep(r.column("trial") == number)
        r.write(out)
        return Recording.load(out)

    def measure(self, trials: Sequence[tuple[str, np.ndarray, np.ndarray]], out: Path) -> Recording:
        """A recording of several trials, each a name, (n,) s and (n, chambers) kPa, one after the other.

        Raises InputError where a trial leaves the device's pressures.
        """
        for name, _, p in trials:
            if p.min() < 0 or p.max() > self._top_kpa:
                raise InputError(f"'{name}' leaves 0 to {self._top_kpa:g} kPa, the range of the stand-in.")
        programs = [(name, t, np.round(p / self._top_kpa, 5)) for name, t, p in trials]
        return self._recorded(programs, out, 1 + 1000 * self._noise)

    def _recorded(self, programs: list, out: Path, day: int, state_pauses: bool = True) -> Recording:
        options = {"log_sent": True, "state_pauses": state_pauses, "plan": given(programs, RESTED_S)}
        truth = simulate(self._device, self._effects, self._seed, day, **options)
        write(truth, out)
        r = Recording.load(out)
        r.samples = r.samples.drop(columns=[c for c in DRAWN if r.has(c)])
        r.write(out)
        return Recording.load(out)


def standin_arm(seed: int = 0) -> TruthBench:
    """The arm that stands in for a real one, rested before each program; `seed` is of the noise."""
    return TruthBench(ARM_EFFECTS, ARM_SEED, "arm", rested=True, noise=seed)
