"""The static rod against closed solutions."""

import numpy as np
import pytest

from pneutac_truths import rod as rods
from pneutac_truths.rod import COLUMNS, SOFT, Rod

LENGTH = 100.0


def straight(elements: int = 80) -> Rod:
    """Without tip piece, curved evenly, and so thin that it hardly stretches."""
    rod = Rod.of(LENGTH, 0.0, 0.0, 1.0, 0.0, 1e-4, elements)
    even = np.full((3, elements), 1 / LENGTH)
    return Rod(LENGTH, 0.0, even, np.ones(elements), rod.axial)


def solve(rod: Rod, **told) -> np.ndarray:
    u = np.zeros((1, COLUMNS))
    u[:, SOFT] = 1
    for name, value in told.items():
        u[:, getattr(rods, name)] = value
    return rod.solve(u)[0][0]


def test_air_alone_bends_it_into_an_arc_of_the_commanded_angle():
    bend = 1.3
    tip = solve(straight(), BEND_Z=bend)
    np.testing.assert_allclose(tip, LENGTH / bend * np.array([np.sin(bend), 0, 1 - np.cos(bend)]), rtol=1e-3)
    aside = solve(straight(), BEND_Y=bend)
    np.testing.assert_allclose(aside, tip[[0, 2, 1]], atol=1e-9)


def test_small_loads_sag_as_a_cantilever():
    """P L^3 / 3 at the tip, q L^4 / 8 spread (over the bending stiffness)."""
    force, weight = 1e-2 / LENGTH**2, 1e-2 / LENGTH**3
    assert solve(straight(), TIP_FORCE=[0, 0, -force])[2] == pytest.approx(-force * LENGTH**3 / 3, rel=1e-3)
    assert solve(straight(), WEIGHT=[0, 0, -weight])[2] == pytest.approx(-weight * LENGTH**4 / 8, rel=1e-3)


@pytest.mark.parametrize(
    "load, down, short", [(1, 0.30172, 0.05643), (2, 0.49346, 0.16064), (10, 0.81061, 0.55500)]
)
def test_large_loads_follow_the_elastica(load, down, short):
    """Source: Bisshopp and Drucker, Quart. Appl. Math. 3 (1945) 272; table of P L^2 / EI."""
    tip = solve(straight(), TIP_FORCE=[0, 0, load / LENGTH**2])
    assert tip[2] / LENGTH == pytest.approx(down, abs=1e-3)
    assert 1 - tip[0] / LENGTH == pytest.approx(short, abs=1e-3)


def test_the_error_falls_with_the_square_of_the_elements():
    told = {"BEND_Z": 1.2, "BEND_Y": 0.4, "TIP_FORCE": np.array([0.3, 1.0, -1.5]) / LENGTH**2}
    exact = solve(straight(2560), **told)
    coarse, fine = (np.linalg.norm(solve(straight(n), **told) - exact) for n in (80, 160))
    assert np.log2(coarse / fine) == pytest.approx(2, abs=0.2)


def test_turned_about_its_axis_it_is_the_same_rod():
    tip = solve(straight(), BEND_Z=0.9, WEIGHT=[0.2e-6, 0, -0.5e-6])
    aside = solve(straight(), BEND_Y=0.9, WEIGHT=[0.2e-6, -0.5e-6, 0])
    np.testing.assert_allclose(aside, tip[[0, 2, 1]], atol=1e-6)


def test_a_load_without_equilibrium_nearby_is_refused():
    u = np.full((1, COLUMNS), np.nan)
    with pytest.raises(ArithmeticError, match="no equilibrium in row 0"):
        straight().solve(u)
