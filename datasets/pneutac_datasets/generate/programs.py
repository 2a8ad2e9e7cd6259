"""Pressure programs as an experimenter runs them: stairs, triangles, minor loops, holds, steps, cycles."""

from dataclasses import dataclass, field

import numpy as np

SLEW_S = 0.2  # regulators limit the slope of their set point; a true step would fall between two samples


@dataclass
class ProgramTrial:
    """One contiguous run: the commanded pressure and the circumstances.

    Attributes:
        label: name of the program at each sample.
        command: commanded pressure (n,), kPa.
        gravity: unit vector in the base frame (3,).
        temperature_c: mean temperature.
        payload_g: mass hung at the tip.
    """

    label: list[str] = field(default_factory=list)
    command: list[float] = field(default_factory=list)
    gravity: tuple[float, float, float] = (1.0, 0.0, 0.0)
    temperature_c: float = 21.0
    payload_g: float = 0.0

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


def session(top: float, seconds: float, hz: float, rng: np.random.Generator) -> list[ProgramTrial]:
    """A whole bench session of about `seconds`.

    Args:
        top: largest pressure, kPa.
        seconds: length of the session; 600 s runs everything at its natural pace, less shortens every part.
        hz: samples a second.
        rng: decides levels and orders.

    Returns:
        The main trial, two equal ones, one with the base flipped, one warm, one with a payload.
    """
    s = seconds / 600.0
    hang = (1.0, 0.0, 0.0) if rng.random() < 0.5 else (0.0, 0.0, -1.0)
    flip = tuple(-x for x in hang)
    main = ProgramTrial(gravity=hang)
    stairs(main, top, 6, 5 * s, hz)
    for label, period in (("triangle_slow", 40), ("triangle_middle", 12), ("triangle_fast", 4)):
        for _ in range(2 if period == 40 else 3):
            triangle(main, label, top, period * s, hz)
    minor_loops(main, top, 48 * s, hz, rng)
    main.hold("long_hold", 0.8 * top, 55 * s, hz)
    main.hold("long_hold", 0.0, 25 * s, hz)
    steps(main, top, round(16 * s) + 2, hz, rng)
    for _ in range(max(3, round(20 * s))):
        triangle(main, "cycles", 0.9 * top, 2.0, hz)
    runs = [main]
    short = np.random.default_rng(rng.integers(2**32))
    state = short.bit_generator.state
    for kwargs in ({}, {}, {"gravity": flip}, {"temperature_c": 30.0}, {"payload_g": 50.0}):
        trial = ProgramTrial(**{"gravity": hang, **kwargs})
        short.bit_generator.state = state  # the same program each time: two of these are repeats
        label = "repeat"
        trial.hold(label, 0.0, 1.5, hz)
        trial.to(label, top, 5 * s, hz)
        trial.hold(label, top, 4 * s, hz)
        trial.to(label, 0.3 * top, 4 * s, hz)
        for _ in range(max(3, round(4 * s))):
            trial.hold(label, float(short.uniform(0, top)), 3 * s, hz)
        trial.to(label, 0.0, 3 * s, hz)
        trial.hold(label, 0.0, 4 * s, hz)
        runs.append(trial)
    return runs


def stairs(trial: ProgramTrial, top: float, levels: int, seconds: float, hz: float) -> None:
    """Up and down again in equal steps, `seconds` on each."""
    trial.hold("stairs", 0.0, 1.5, hz)
    up = np.linspace(0, top, levels)
    for p in [*up[1:], *up[::-1][1:]]:
        trial.hold("stairs", float(p), seconds, hz)


def triangle(trial: ProgramTrial, label: str, top: float, period: float, hz: float) -> None:
    """From where it is to `top` and down to nothing."""
    trial.to(label, top, period / 2, hz)
    trial.to(label, 0.0, period / 2, hz)


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


def steps(trial: ProgramTrial, top: float, count: int, hz: float, rng: np.random.Generator) -> None:
    """Random levels held for 2 to 6 s."""
    for _ in range(count):
        trial.hold("random_steps", float(rng.uniform(0, top)), float(rng.uniform(2, 6)), hz)
    trial.hold("random_steps", 0.0, 4.0, hz)
