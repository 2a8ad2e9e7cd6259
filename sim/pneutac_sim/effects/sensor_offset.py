"""Pressure sensor error: it reads p_read = s p + o + d t, and the regulator believes it.

The true pressure is (p_read - o - d t) / s, with t the time since the recording began. Scale and offset are
identified apart from the gain and the rest pressure only where something else depends on the true pressure.
"""

from pneutac_sim.effects import BodyEffect, Parameter, kernel


@kernel
def run(x, dt, theta, conditions, state):
    """No state; conditions = session_time_s."""
    scale, offset, drift = theta[0], theta[1], theta[2]
    n, channels = x.shape
    for t in range(n):
        for c in range(channels):
            x[t, c] = (x[t, c] - offset - drift * conditions[t, 0]) / scale


EFFECT = BodyEffect(
    name="sensor_offset",
    stage="pneumatics",
    parameters=(
        Parameter("scale", "", default=1.0, lower=0.5, upper=2.0, neutral=1.0, fixed=True),
        Parameter("offset_kpa", "kPa", default=0.0, lower=-0.5, upper=0.5, range_power=1, fixed=True),
        Parameter("drift_kpa_per_s", "kPa/s", default=1e-4, lower=-1e-2, upper=1e-2, range_power=1),
    ),
    run=run,
    apart=True,
    columns=("session_time_s",),
    of_gauge=True,
    equation=r"p = (p_{read} - o - d\,t) / s",
    cause="drift of the pressure sensor, {per_hour:.2g} kPa per hour",
    summary="Your pressure sensor drifts: its zero moves by {per_hour:.2g} kPa an hour.",
    experiment="Vent to the surroundings (0 kPa) every few minutes: a drift moves the bend at rest.",
    derive=lambda v: {"per_hour": 3600 * v["drift_kpa_per_s"]},
)
