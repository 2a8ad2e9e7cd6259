"""Cyclic softening (Mullins): strained material is softer than new, and each cycle softens it further.

Two forms, either of which may be zero. Below its largest bend so far, the body bends 1 / eta times, with
eta = 1 - m erf((1 - W / W_max) / u) after Ogden and Roxburgh (Proc. R. Soc. A 455, 1999) and the stored
energy W ∝ bend^2. And after n cycles it bends 1 + g (1 - exp(-n / n0)) times. Largest bend and cycles are
kept from trial to trial.
"""

import math

from pneutac_sim.effects import BodyEffect, Parameter, kernel

_IGNORED = 0.05  # back-and-forth below this share of the largest bend is noise, not a cycle


@kernel
def run(x, dt, theta, conditions, state):
    """State = largest bend, cycles, and the bend followed with a small play to count cycles."""
    below, width, per_cycle, cycles = theta[0], theta[1], theta[2], theta[3]
    n, channels = x.shape
    largest, count, trail = state[0], state[1], state[2]
    for t in range(n):
        bend = 0.0
        for c in range(channels):
            bend += x[t, c] * x[t, c]
        bend = math.sqrt(bend / channels)
        largest = max(largest, bend)
        if largest == 0.0:
            continue
        moved = min(max(trail, bend - _IGNORED * largest), bend + _IGNORED * largest)
        if bend < largest or moved < trail:  # the first loading is no cycle
            count += abs(moved - trail) / (2.0 * largest)
        trail = moved
        eta = 1.0 - below * math.erf((1.0 - (bend / largest) ** 2) / width) if below > 0.0 else 1.0
        factor = (
            (1.0 + per_cycle * (1.0 - math.exp(-count / cycles))) / eta if per_cycle != 0.0 else 1.0 / eta
        )
        for c in range(channels):
            x[t, c] *= factor
    state[0], state[1], state[2] = largest, count, trail


EFFECT = BodyEffect(
    name="cyclic_softening",
    stage="material",
    parameters=(
        Parameter("below_maximum", "", default=0.05, lower=0.0, upper=0.7),
        Parameter("below_maximum_width", "", default=0.5, lower=0.05, upper=3.0, neutral=0.5, log=True),
        Parameter("per_cycle", "", default=0.05, lower=-0.3, upper=1.0),
        Parameter("cycles", "", default=3.0, lower=0.3, upper=100.0, neutral=3.0, log=True),
    ),
    run=run,
    state_size=lambda channels: 3,
    equation=r"q \to \frac{q}{\eta}\,\left(1 + g\,(1 - e^{-n / n_0})\right), \quad \eta = 1 - "
    r"m\,\mathrm{erf}\left(\frac{1 - W / W_{max}}{u}\right)",
    cause="softening with use, {percent:.0f} %",
    summary="Your {device} softens with use: below its largest bend so far it bends up to {percent:.0f} % "
    "more, and {cycle_percent:+.0f} % after many cycles.",
    experiment="After a night's rest go up and down ten times, to half the pressure, then to the full one.",
    derive=lambda v: {
        "percent": 100 * (1 / (1 - v["below_maximum"] * math.erf(1 / v["below_maximum_width"])) - 1),
        "cycle_percent": 100 * v["per_cycle"],
    },
)
