"""`pneutac benchmark surrogate`: a motion of the network itself, a press that holds, splats, bad input."""

import numpy as np
import pytest

from pneutac_benchmarks.surrogate.options import BenchmarkSurrogateConfig
from pneutac_benchmarks.surrogate.rows import row, table
from pneutac_sim.errors import InputError

pytestmark = pytest.mark.slow


def test_a_row_has_the_mean_and_its_standard_error():
    r = row("joint angle", "°", [1.0, 2.0, 3.0], 4.0, "≤ 0.03", "0.051", "a note")
    assert r["mean"] == 2 and r["sem"] == pytest.approx(1 / np.sqrt(3)) and r["cases"] == 3
    assert row("speed", "times", [5.0])["sem"] is None
    lines = table([r, row("steps", "steps/s", [1234.4])]).splitlines()
    assert lines[2] == "| joint angle | 2 ± 0.577 ° | 4 | ≤ 0.03 | 0.051 | a note |"
    assert lines[3] == "| steps | 1,234 steps/s |  |  |  |  |"


@pytest.mark.parametrize("options", [{"device": "tpu"}, {"contacts": 0}, {"steps": 5}, {"trajectories": 0}])
def test_bad_options_are_refused(options):
    with pytest.raises(InputError, match=next(iter(options))):
        BenchmarkSurrogateConfig(**options)
