"""The sentence of a comparison, and names of the bins of an axis in it.

`c` is a `BodyComparison` throughout.
"""

import numpy as np

from lerobot_pneutac.diagnosis.thresholds import NOISE
from pneutac_datasets.recording.axes import Axis
from pneutac_datasets.recording.wording import plural
from pneutac_sim.finger.quantities import root_mean

FEW_ROWS = 50  # below this no place where the error is large says anything


def sentence(c) -> str:
    """What a newcomer should take away."""
    squared = c.squared
    heldout, where = squared[~c.train_samples], " where it was not fitted"
    if not len(heldout) or len(heldout) == len(squared):
        heldout, where = squared, ""
    error = root_mean(heldout)
    what = {"mm": "tip", "rad": "bend", "1/m": "curvature"}.get(c.unit, "device")
    who = "The twin" if c.fidelity == "pipeline" else "The twin's full simulation"
    text = f"{who} misses the measured {what} by {error:.3g} {c.unit}{where}"
    commanded = c.recording.samples[c.recording.pressure_columns].to_numpy(float)
    if np.ptp(commanded, axis=0).max() <= 1e-3:
        return (
            "The commanded pressure never moves in this recording, so nothing about bending can be learnt "
            f"from it; record steps or ramps. {text}."
        )
    if c.noise.value:
        times = error / c.noise.value
        if times <= NOISE:
            return f"{text}: at the noise ({c.noise.value:.2g} {c.unit})."
        text += f", {times:.3g} times the noise of the measurement ({c.noise.value:.2g} {c.unit})"
    if len(squared) < FEW_ROWS:
        return f"{text}; {plural(len(squared), 'row')} are too few to show where it is worst; record longer."
    peak = _peak(c)
    return f"{text}; it is worst {peak}." if peak else f"{text}."


def inside_band(c) -> str:
    """The coverage, which must not be None, in words."""
    values = "values" if c.train is None else "held-out values"
    return (
        f"{100 * c.coverage:.0f} % of the {values}; about 95 % is expected, less means that the model claims "
        "to know more than it does"
    )


_PHRASES = {
    ("direction", "loading"): "while the pressure rises",
    ("direction", "unloading"): "while the pressure falls",
    ("direction", "hold"): "while the pressure is held",
    ("rate", "hold"): "while the pressure is held",
    "hold_time_s": "after a hold of {0}",
    "program": "in program '{0}'",
    "gravity": "with gravity along ({0})",
    "trial": "in trial {0}",
    "pressure_cmd_kpa": "at {0} kPa",
    "pressure_kpa": "where the measured pressure is {0} kPa",
    "temperature_c": "at {0} °C",
}


def phrase(axis: Axis, i: int) -> str:
    """Bin `i` of an axis in words."""
    label = axis.labels[i]
    if axis.name == "rate" and label != "hold":
        moving = [x for x in axis.labels if x != "hold"]
        how = {moving[0]: " slowly", moving[-1]: " fast"}.get(label, " at middle speed")
        return f"when the pressure moves{how if len(moving) > 1 else ''}"
    text = _PHRASES.get((axis.name, label)) or _PHRASES.get(axis.name, "where {1} is {0}")
    return text.format(label, axis.name)


def _peak(c) -> str:
    """Where the error stands out most against all the rest."""
    squared = c.squared
    best, where = 1.5, ""
    for axis in (a for a in c.axes if len(a.labels) > 1):
        for i in range(len(axis.labels)):
            at = axis.bin == i
            if at.mean() < 0.02 or at.all():
                continue
            ratio = np.sqrt(squared[at].mean() / max(squared[~at].mean(), 1e-300))
            if ratio > best:
                best, where = ratio, phrase(axis, i)
    return where
