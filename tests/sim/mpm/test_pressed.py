"""The face of a gel of material points under bench presses."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.mpm import devices, pressed
from pneutac_sim.mpm.pressed import PressedGel
from pneutac_sim.mpm.solve import MpmDiverged
from pneutac_sim.twin import Twin

pytestmark = pytest.mark.slow
BALL = Press("sphere", 3.0, 1.0, -1.5, 0.6)


@pytest.fixture
def points(monkeypatch):
    """A gel of few particles."""
    monkeypatch.setattr(devices, "gel", partial(devices.gel, counts=(24, 32, 5)))
    return PressedGel(GelModel.builtin(), Twin("gel"), device="cpu")


def test_a_share_of_a_press_is_a_less_deep_press_and_the_gel_rises_around_it(points):
    whole, half = points.surface(BALL), points.surface(BALL, 0.5)
    np.testing.assert_allclose(half, points.surface(replace(BALL, depth_mm=0.3)), atol=1e-6)
    row, column = np.unravel_index(whole.argmax(), whole.shape)
    assert abs((column + 0.5) / 59 * 12 - 6 - BALL.x_mm) < 0.3 and abs((row + 0.5) / 5 - 8 - BALL.y_mm) < 0.3
    assert whole.max() == pytest.approx(0.6, abs=0.08) and half.max() == pytest.approx(0.3, abs=0.05)
    assert -0.15 < whole.min() < -0.005, "a gel that hardly changes its volume bulges, the closed form never"


def test_no_rest_ends_in_one_sentence_and_leaves_the_steps_as_they_were(points, monkeypatch):
    def fail(solver, *_, **__):
        raise MpmDiverged("Body 'gel' is not at rest", "wait")

    before = points._solver.stable_dt
    monkeypatch.setattr(pressed, "solve_equilibrium", fail)
    with pytest.raises(InputError, match="not at rest, under the sphere pressed 0.6 mm deep; correct"):
        points.surface(BALL)
    assert points._solver.stable_dt == before
