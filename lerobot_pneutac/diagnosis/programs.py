"""The menu of experiments that can be proposed: two minutes each, made from the recording's own range."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from pneutac_datasets.recording.pressures import supply_limits
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.finger.switches import steps

SECONDS = 120.0
HZ = 10.0
HIGHER = "higher"
GOLDEN = 0.618034  # its multiples' fractions fill an interval as evenly as any


@dataclass
class Program:
    """One experiment.

    Attributes:
        name: short, for tables.
        advice: an imperative sentence for the person at the bench.
        samples: what would be commanded, one row a sample, with the recording's conditions.
    """

    name: str
    advice: str
    samples: pd.DataFrame


def menu(recording: Recording) -> list[Program]:
    """All experiments that make sense for this recording's columns."""
    low, top = pressure_span(recording)
    t = np.arange(round(SECONDS * HZ)) / HZ
    made = _pressure_programs(t, low, top) + _condition_programs(recording, _triangle(t, 60.0, low, top))
    beside = beside_one(recording)
    return [
        Program(name, advice + beside, table(recording, t, p, change))
        for name, advice, p, change in made
        if name != HIGHER or not supply_limits(recording)  # no supply gives more
    ]


def beside_one(recording: Recording) -> str:
    """A sentence on which chamber is meant, with a space before it; empty where there is one."""
    first, *others = recording.pressure_columns
    if not others:
        return ""
    stay = " and ".join(f"{recording.samples[c].median():.3g}" for c in others)
    return f" Do so in chamber 1, while the others stay at {stay} kPa."


def pressure_span(recording: Recording) -> tuple[float, float]:
    """Lowest (zero at most) and highest commanded pressure, kPa."""
    command = recording.samples[recording.pressure_columns].to_numpy(float)
    low, top = float(min(command.min(), 0.0)), float(command.max())
    return low, top if top - low >= 1e-6 else low + 50.0


def _triangle(t: np.ndarray, period: float, low: float, high: float) -> np.ndarray:
    return low + (high - low) * (1 - np.abs(1 - 2 * ((t / period) % 1)))


def _stairs(t: np.ndarray, low: float, high: float) -> np.ndarray:
    levels = np.concatenate([np.linspace(low, high, 7), np.linspace(high, low, 7)[1:]])
    return levels[np.minimum((t / SECONDS * len(levels)).astype(int), len(levels) - 1)]


def _pressure_programs(t: np.ndarray, low: float, top: float) -> list[tuple[str, str, np.ndarray, dict]]:
    """Name, advice, command (n,) and no change of conditions."""
    span, loop = top - low, 120.0
    whole = f"between {low:.3g} and {top:.3g} kPa"
    high, most, higher = low + 0.8 * span, low + 0.9 * span, low + 1.3 * span
    steps = np.where(t % 20 < 10, low + 0.9 * span, low)
    middle = low + 0.5 * span + 0.08 * span * np.sin(2 * np.pi * t / 8) + 0.3 * span * (t > 60)
    zero = np.where(t % 30 < 10, 0.0, low + span * (0.4 + 0.6 * ((t // 30) % 2)))
    warmup = np.where(t < 60, _triangle(t, 4.0, low, low + 0.5 * span), _triangle(t, 4.0, low, top))
    return [
        ("slow loop", f"Run one loop {whole} ten times slower, in {loop:.0f} s.",
         _triangle(t, loop, low, top), {}),
        ("fast loops", f"Run loops {whole} in 4 s each.", _triangle(t, 4.0, low, top), {}),
        ("long hold", f"Step to {high:.3g} kPa, hold 80 s, step to {low:.3g} kPa and hold 40 s.",
         np.where(t < 80, high, low), {}),
        ("steps", f"Step between {low:.3g} and {most:.3g} kPa every 10 s.", steps, {}),
        (HIGHER, f"Go up in stairs to {higher:.3g} kPa if the device may bear it, and down again.",
         _stairs(t, low, higher), {}),
        ("small reversals", "Make small back-and-forth moves around two pressures.", middle, {}),
        ("back to zero", "Come back to 0 kPa for 10 s every half minute.", zero, {}),
        ("cycles", "After a rest make fifteen cycles to half the pressure and fifteen to the full one.",
         warmup, {}),
    ]  # fmt: skip


def _condition_programs(recording: Recording, loop: np.ndarray) -> list[tuple[str, str, np.ndarray, dict]]:
    """Name, advice, command (n,) and the conditions that change, of those that were recorded."""
    s, made = recording.samples, []
    if recording.has("gravity_x"):
        columns = ["gravity_x", "gravity_y", "gravity_z"]
        flipped = dict(zip(columns, -s[columns].iloc[0].to_numpy(float), strict=True))
        made.append(("flip the base", "Turn the base upside down and run one loop.", loop, flipped))
    if recording.has("temperature_c"):
        warm = float(s["temperature_c"].median()) + 8.0
        advice = f"Repeat a loop with the device at {warm:.0f} °C."
        made.append(("warm", advice, loop, {"temperature_c": warm}))
    if recording.has("payload_g"):
        heavy = float(s["payload_g"].max()) + 50.0
        made.append(
            ("payload", f"Hang {heavy:.0f} g at the tip and run one loop.", loop, {"payload_g": heavy})
        )
    return made


def table(recording: Recording, t: np.ndarray, p: np.ndarray, change: dict) -> pd.DataFrame:
    """All columns of the recording: conditions and markers at their usual value, the command as given.

    Args:
        recording: gives the columns.
        t: (n,) s.
        p: (n, chambers) commanded, kPa; (n,) is the first chamber's, while others stay at their median.
        change: columns that are otherwise, and their values.
    """
    table = pd.DataFrame({"trial": np.zeros(len(t), int), "time_s": t})
    if recording.has("time_sent_s"):
        table["time_sent_s"] = sent_s(t, p)
    for i, c in enumerate(recording.pressure_columns):
        table[c] = p[:, i] if p.ndim > 1 else p if i == 0 else float(recording.samples[c].median())
    for c in recording.samples.columns:
        if c in table or c in ("program", "image", "mask"):
            continue
        x = recording.samples[c]
        if pd.api.types.is_numeric_dtype(x):
            table[c] = float(x.iloc[0]) if c.startswith("gravity") else float(x.median())
    for c in [c for c in table if c.startswith("pressure_") and "cmd" not in c]:
        command = c.replace("pressure_", "pressure_cmd_")
        if command in table:
            table[c] = table[command]
    for c, v in change.items():
        table[c] = v
    return table


def sent_s(t: np.ndarray, p: np.ndarray) -> np.ndarray:
    """When the command of each sample is sent, (n,) s: at the sample, but a step up to a sample before it.

    Each step keeps another lead, so that together they are seen at all ages: samples that come at one age
    alone tell a delay no better than to the time between two of them (equivalent-time sampling).

    Args:
        t: (n,) s of the samples.
        p: (n, chambers) commanded, or (n,) of one chamber.
    """
    p = np.reshape(p, (len(t), -1))
    at = steps(p, np.arange(len(t)) == 0)
    lead = (np.random.default_rng(at).random() + GOLDEN * np.arange(len(at))) % 1
    out = np.array(t, float)
    out[at] -= lead * (t[at] - t[at - 1])
    return out
