"""An interval that says nothing is called so: it covers the allowed range, or leaves size or sign open."""

import pytest

from lerobot_pneutac.study.base import not_identifiable
from pneutac_sim.effects.effect import Parameter

GAIN = Parameter("gain_rad_per_kpa", "rad/kPa", 0.15, -2.0, 2.0, range_power=-1)
REST = Parameter("rest_pressure_kpa", "kPa", 0.0, -3.0, 3.0, range_power=1)
MASS = Parameter("tip_mass_g", "g", 20.0, 0.0, 3000.0)
TIME = Parameter("time_s", "s", 1.0, 0.01, 100.0, log=True)
TILT = Parameter("pitch_rad", "rad", 0.0, -0.5, 0.5)


@pytest.mark.parametrize(
    ("spec", "value", "ci95", "nothing"),
    [
        (GAIN, 0.0054, (-0.041, 0.041), True),
        (GAIN, 0.0054, (-0.002, 0.012), True),  # its sign is open
        (GAIN, 0.0054, (0.004, 0.007), False),
        (REST, 1.8, (-145.0, 145.0), True),
        (REST, 1.8, (0.5, 3.0), False),
        (MASS, 0.15, (0.0, 130.0), True),
        (MASS, 0.5, (0.0, 1.4), False),
        (TIME, 1.0, (0.012, 90.0), True),
        (TIME, 1.0, (0.5, 2.0), False),
        (TILT, -0.0046, (-0.044, 0.035), False),
        (TILT, 0.0, None, False),
    ],
)
def test_an_interval_that_says_nothing_is_known(spec, value, ci95, nothing):
    assert not_identifiable(value, ci95, spec, 48.0) is nothing
