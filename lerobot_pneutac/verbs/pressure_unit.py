"""Whether a finger bends so much for its material that its pressures can hardly have been kPa."""

import math

from pneutac_sim.mpm.solid import parameter
from pneutac_sim.twin import Twin

# kappa w E / p of a bent body of width w: about 1.5 for a solid bar with a hole in it (A h w / I), 8 for the
# paper's finger, 2 to 14 for rods of 15 to 90 kPa. What is softer than the twin's modulus has more.
USUAL, MOST = 6.0, 30.0
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
    unit, kpa = min(UNITS, key=lambda u: abs(math.log(ratio / u[1] / USUAL)))
    return [
        f"The {twin.device} bends by {bend:.2g} rad a kPa, {ratio / USUAL:.0f} times what fingers of"
        f" {modulus:.2g} MPa do: are the pressures in {unit}? Then multiply the pressure columns by {kpa:g};"
        " else it is softer, and rows with payload_g tell how much."
    ]
