"""Gel creep: what was pressed in comes back late, so that it lies under the next press.

Boltzmann's superposition with a Prony series: a surface u that was held for T leaves, s after its release,
u sum_i a_i (1 - exp(-T / tau_i)) exp(-s / tau_i). A layer whose shear modulus relaxes keeps its shape while
an indenter holds it, and once free it goes back through scaled copies of that shape (Christensen, Theory of
Viscoelasticity (1982) ch. 2), so this is all of its creep that a camera sees at stated depths. Times a
with factors of five between them leave shares as the only parameters.
"""

import math
from collections.abc import Sequence

from pneutac_sim.effects import Parameter, SensorEffect

TIMES_S = (4.0, 20.0, 100.0)


def share_left(branches: Sequence[tuple[float, float]], held_s: float, since_s: float) -> float:
    """Share of a surface that is left of it some time after its release."""
    return sum(a * -math.expm1(-held_s / tau) * math.exp(-since_s / tau) for a, tau in branches)


def late(values: dict[str, float]) -> tuple[tuple[float, float], ...]:
    """Share of the surface and time in s of each branch."""
    return tuple((values[f"late_{tau:g}s"], tau) for tau in TIMES_S)


def _derive(v: dict[str, float]) -> dict[str, float]:
    """What a minute leaves at once and after a minute, %."""
    return {f"after_{s}": 100 * share_left(late(v), 60.0, s) for s in (1, 60)}


EFFECT = SensorEffect(
    name="gel_creep",
    stage="gel",
    parameters=tuple(Parameter(f"late_{tau:g}s", "", 0.03, 0.0, 0.4) for tau in TIMES_S),
    prior_sd=(0.1, 0.1, 0.1),
    steps=lambda reach_mm: (0.02,) * len(TIMES_S),
    late=late,
    equation=r"u \to u + \sum_j u_j \sum_i a_i\,(1 - e^{-T_j / \tau_i})\,e^{-s_j / \tau_i}",
    cause="creep of the gel",
    summary="Your {device} creeps: of what was pressed in for a minute {after_1:.1f} % are still there a "
    "second after the release and {after_60:.1f} % after a minute.",
    experiment="Hold a deep press for a minute, lift it, press elsewhere within three seconds and "
    "photograph; fill in time_s and hold_s.",
    derive=_derive,
)
