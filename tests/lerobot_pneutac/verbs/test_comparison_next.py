"""A recording that a twin was never fitted to judges it: `compare` does not propose to diagnose it."""

import shlex

import pytest

from lerobot_pneutac.verbs.comparison import Comparison
from pneutac_sim.twin import Twin


class Compared(Comparison):
    """A comparison of which only the subject counts."""

    error, by, worst = {}, {}, []

    def __init__(self, twin, recording):
        self.twin, self._recording = twin, recording

    def subject(self):
        """The twin and the recording."""
        return self.twin, self._recording


@pytest.mark.parametrize(
    ("fitted", "compared", "diagnosed"),
    [("monday", "friday", "monday"), ("monday", "monday", "monday"), (None, "friday", "friday")],
)
def test_a_judging_day_is_not_diagnosed(fitted, compared, diagnosed):
    twin = Twin("finger", 73.0)
    twin.history = [{"version": 0, "change": "calibrated", "recording": fitted}] if fitted else []
    assert shlex.split(Compared(twin, compared).next_command)[-1] == f"--recording={diagnosed}"
