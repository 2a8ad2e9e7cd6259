"""The gel's spring: the law's force and slope, wherever and however the gel is turned."""

import numpy as np
import pytest

from pneutac_sim.gel.force import GelForce
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.probe import probe_grid
from pneutac_sim.gel.spring import GelSpring
from pneutac_sim.twin import Twin

HERE = np.zeros(3), np.eye(3)


@pytest.fixture(scope="module")
def law():
    return GelForce.of(Twin.builtin())


@pytest.fixture(scope="module")
def springs(law):
    return GelSpring(law)


@pytest.mark.parametrize(
    "indenter, size, near",
    [("sphere", 4.0, 0.04), ("sphere", 8.0, 0.05), ("cylinder", 3.0, 0.03), ("cube", 5.0, 0.03),
     ("edge", 6.0, 0.15)],
)  # fmt: skip
def test_force_and_slope_are_the_laws(law, springs, indenter, size, near):
    def force(depth):
        shapes = Press(indenter, size, 0.0, 0.0, depth).shapes()
        return law.force(probe_grid(*shapes, window_mm=law.window_mm, thickness_mm=law.thickness_mm))

    for depth in (0.4, 0.8, 1.2):
        spring = springs.of(*Press(indenter, size, 0.0, 0.0, depth).shapes(), *HERE)
        assert spring.force(1e-3 * depth) == pytest.approx(force(depth), rel=near)
        slope = (force(depth + 0.1) - force(depth - 0.1)) / 0.2e-3
        assert spring.slope(1e-3 * depth) == pytest.approx(slope, rel=2 * near)


def test_a_flat_end_is_a_straight_spring_and_a_ball_is_not(springs):
    flat, ball = (springs.of(*Press(k, 3.0, 0, 0, 0.4).shapes(), *HERE) for k in ("cylinder", "sphere"))
    assert flat.k1 * 0.4e-3 > 0.9 * flat.force(0.4e-3)
    assert ball.k1 * 0.4e-3 < 0.7 * ball.force(0.4e-3)


def test_what_is_near_has_a_spring_and_what_is_far_none(springs):
    def before_the_face(mm):
        kinds, sizes, (at,), turns = Press("sphere", 4.0, 0, 0, 0.3).shapes()
        return springs.of(kinds, sizes, [at + [0, 0, 1e-3 * (0.3 + mm)]], turns, *HERE)

    touching = springs.of(*Press("sphere", 4.0, 0, 0, 0.3).shapes(), *HERE)
    near = before_the_face(2.0)
    assert near.force(3e-4) == pytest.approx(touching.force(3e-4), rel=0.02)
    assert before_the_face(20.0) is None
