"""Crosstalk: other chambers on record bend the device too, p + sum_i s_i p_other_i.

The other pressures are the recording's further `*_kpa` columns, in their order: the chambers of the segment
that hangs below, or a neighbouring finger on the same supply.
"""

from pneutac_sim.effects import BodyEffect, Parameter, kernel

OTHERS = ("other_1_kpa", "other_2_kpa", "other_3_kpa")


@kernel
def run(x, dt, theta, conditions, state):
    """No state; conditions = up to three other pressures, zero where there are fewer."""
    n, channels = x.shape
    for t in range(n):
        extra = 0.0
        for i in range(len(theta)):
            extra += theta[i] * conditions[t, i]
        for c in range(channels):
            x[t, c] += extra


EFFECT = BodyEffect(
    name="crosstalk",
    stage="drive",
    parameters=tuple(Parameter(f"share_{i + 1}", "", default=0.05, lower=-3.0, upper=3.0) for i in range(3)),
    run=run,
    columns=OTHERS,
    equation=r"p \to p + \sum_i s_i\,p_i",
    cause="crosstalk between chambers",
    summary="Other chambers bend your {device} too: each kPa there counts as {share_1:.2g}, {share_2:.2g}, "
    "{share_3:.2g} kPa here.",
    experiment="Step one chamber at a time while all others stay at zero.",
)
