"""Whether a finger bends so much for its material, or for its twin, that its pressures can hardly be kPa."""

import math

import numpy as np

from pneutac_datasets.recording.recording import Recording
from pneutac_sim.mpm.parameters import parameter
from pneutac_sim.twin import Twin

# kappa w E / p of a bent body of width w: about 1.5 for a solid bar with a hole in it (A h w / I), 8 for the
# paper's finger, 2 to 14 for rods of 15 to 90 kPa. What is softer than the twin's modulus has more.
USUAL, MOST = 6.0, 30.0
FARTHER = 3.5  # times as far as the twin: half of what psi make
UNITS = (("psi", 6.895), ("bar", 100.0))  # kPa in one


def pressure_unit_doubts(twin: Twin) -> list[str]:
    """One sentence where a fitted gain suits another unit of pressure better, else none.

    The bend per pressure, as kappa w E / p, has no unit and hardly depends on the size of a finger.

    Args:
        twin: a calibrated finger's or arm's.
    """
    modulus = parameter(twin, "youngs_modulus_mpa")
    joints = len(twin.spine_joint_positions_mm)
    bend = abs(twin.parameter("gain_rad_per_kpa")) * joints  # rad/kPa
    ratio = bend * parameter(twin, "width_mm") / twin.length_mm * 1000 * modulus
    if not ratio > MOST:
        return []
    return [
        f"The {twin.device} bends by {bend:.2g} rad a kPa, {ratio / USUAL:.0f} times what fingers of"
        f" {modulus:.2g} MPa do: {_asked(ratio / USUAL)};"
        " else it is softer, and rows with payload_g tell how much."
    ]


def unlike_the_twin(twin: Twin, recording: Recording) -> list[str]:
    """A note where a calibrated twin would roll itself up at a recording's pressures, or hardly move."""
    gain = twin.parameters.get("gain_rad_per_kpa")
    if gain is None or gain.ci95 is None:
        return []
    top = {c: float(np.abs(recording.column(c)).max()) for c in recording.pressure_columns}
    name = max(top, key=top.__getitem__)
    turn = abs(gain.value) * top[name]  # rad a joint
    if turn > 2 * math.pi:
        return [
            f"Column '{name}' reaches {top[name]:.4g}, which would turn each joint of the calibrated twin "
            "more than once around; if it is not in kPa, convert it (pascal: divide by 1000)."
        ]
    times = _bend(recording, twin.length_mm) / max(turn * len(twin.spine_joint_positions_mm), 1e-9)
    if not times > FARTHER:
        return []
    return [
        f"At up to {top[name]:.3g} kPa in '{name}' the {twin.device} bends {times:.0f} times as far as the"
        f" calibrated twin: {_asked(times)}; else calibrate the twin to it."
    ]


def _bend(recording: Recording, length_mm: float) -> float:
    """Range of the measured bend, rad: of its angle, or by the tip, which moves half the length a rad."""
    if recording.has("bend_angle_rad"):
        return float(np.ptp(recording.column("bend_angle_rad")))
    tips = [np.ptp(recording.column(c)) for c in recording.observations if c.startswith("tip_")]
    return float(np.linalg.norm(tips)) / (length_mm / 2)


def _asked(times: float) -> str:
    """Which unit pressures that act so many times as strongly as kPa may be in."""
    unit, kpa = min(UNITS, key=lambda u: abs(math.log(times / u[1])))
    return f"are the pressures in {unit}? Then multiply the pressure columns by {kpa:g}"
