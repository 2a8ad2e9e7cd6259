"""A proportional valve: full flow while the error is large, proportional flow near the goal.

p' = sign(e) min(|e| / b, 1) b k with e = p_cmd - p, b the proportional band; venting is quicker from a higher
pressure by the factor 1 + h p / P. Exact for a command that is held; it is taken at the middle of each of
four pieces of the straight line between samples.
"""

import math

from pneutac_sim.effects import BodyEffect, Parameter, kernel

_PIECES = 4
_SETTLED = 1e-12  # of the band: nearer to its goal a pressure has arrived


@kernel
def run(x, dt, theta, conditions, state):
    """State = per channel pressure and command before."""
    fill, vent, band, higher, scale = theta[0], theta[1], theta[2], theta[3], theta[4]
    n, channels = x.shape
    p, before = state[:channels], state[channels:]
    known, keep_fill = -1.0, 0.0
    for t in range(n):
        h = dt[t] / _PIECES
        if h != known:  # most samples follow each other after the same time
            known, keep_fill = h, math.exp(-fill * h / band)
        for c in range(channels):
            command = x[t, c]
            if math.isinf(fill * h):
                p[c] = command
            else:
                for i in range(_PIECES):
                    e = before[c] + (command - before[c]) * (i + 0.5) / _PIECES - p[c]
                    size = abs(e)
                    if size < _SETTLED * band:
                        p[c] += e
                        continue
                    rate = fill if e > 0 else vent * (1.0 + higher * max(p[c], 0.0) / scale)
                    if size > band:
                        left = size - rate * h
                        if left < band:
                            left = band * math.exp(-(rate * h - (size - band)) / band)
                    elif e > 0:
                        left = size * keep_fill
                    else:
                        left = size * math.exp(-rate * h / band)
                    p[c] += e - math.copysign(left, e)
            before[c] = command
            x[t, c] = p[c]


EFFECT = BodyEffect(
    name="valve_slew",
    stage="pneumatics",
    parameters=(
        Parameter(
            "fill_rate_kpa_per_s", "kPa/s", 3.0, 0.05, 100.0, neutral=math.inf, log=True, range_power=1
        ),
        Parameter(
            "vent_rate_kpa_per_s", "kPa/s", 2.0, 0.05, 100.0, neutral=math.inf, log=True, range_power=1
        ),
        Parameter("band_kpa", "kPa", 0.15, 0.005, 1.5, log=True, range_power=1),
        Parameter("vent_growth", "", 0.5, 0.0, 10.0),
        Parameter("scale_kpa", "kPa", 1.0, 1e-3, 3.0, neutral=1.0, fixed=True, range_power=1),
    ),
    run=run,
    apart=True,
    state_size=lambda channels: 2 * channels,
    equation=r"\dot p = k\,\mathrm{clip}((p_{cmd} - p)/b,\, -1,\, 1), \quad "
    r"k = k_{fill} \text{ or, venting, } k_{vent}\,(1 + h\,\max(p, 0)/P)",
    cause="a valve of limited flow, filling at {fill_rate_kpa_per_s:.3g} kPa/s at most",
    summary="Your valve is slow for large steps: at most {fill_rate_kpa_per_s:.3g} kPa/s in and "
    "{vent_rate_kpa_per_s:.3g} kPa/s out, proportional within {band_kpa:.2g} kPa.",
    experiment="Step to several pressures and log the measured pressure: it rises in straight lines.",
)
