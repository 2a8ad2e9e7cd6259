"""Dry friction: the joint sticks until the pressure has changed by a threshold, then slides behind it.

Coulomb friction with a Stribeck drop: a joint at rest needs coulomb + breakaway to start, a sliding one only
coulomb (Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30, 1994). Friction is given as the
pressure that it eats up. The joint stays where it was between trials.
"""

from pneutac_sim.effects import BodyEffect, Parameter, kernel


@kernel
def run(x, dt, theta, conditions, state):
    """State = per channel where the joint is and which way it slides (0 at rest)."""
    coulomb, breakaway = theta[0], theta[1]
    n, channels = x.shape
    at, way = state[:channels], state[channels:]
    for t in range(n):
        for c in range(channels):
            pull = x[t, c] - at[c]
            side = 1.0 if pull > 0 else -1.0
            hold = coulomb if side == way[c] else coulomb + breakaway
            if abs(pull) > hold:
                at[c] = x[t, c] - side * coulomb
                way[c] = side
            else:
                way[c] = 0.0
            x[t, c] = at[c]


EFFECT = BodyEffect(
    name="friction",
    stage="drive",
    parameters=(
        Parameter("coulomb_kpa", "kPa", default=0.03, lower=0.0, upper=0.4, range_power=1),
        Parameter("breakaway_kpa", "kPa", default=0.01, lower=0.0, upper=0.3, range_power=1, step=0.03),
    ),
    run=run,
    apart=True,
    state_size=lambda channels: 2 * channels,
    equation=r"x \to p - c\,\mathrm{sign}(p - x) \text{ where } |p - x| > c "
    r"\text{ (from rest or the other way: } c + b)",
    cause="friction, dead band {band:.2g} kPa",
    summary="Your {device} sticks: on each reversal it waits until the pressure has changed by {band:.2g} "
    "kPa.",
    experiment="Make small back-and-forth moves around one pressure: below the dead band nothing moves.",
    derive=lambda v: {"band": 2 * v["coulomb_kpa"] + v["breakaway_kpa"]},
)
