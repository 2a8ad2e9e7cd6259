"""The static rod against closed solutions."""

import numpy as np
import pytest

from pneutac_truths import rod as rods
from pneutac_truths.online import OnlineRod
from pneutac_truths.programs import DT_S
from pneutac_truths.rod import COLUMNS, SOFT, Rod
from pneutac_truths.truth import act, pose
from pneutac_truths.world import World

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


EFFECTS = {
    "fill_orifice": {"critical": 0.3, "supply": 2.0, "growth": 0.8, "size": 0.4},
    "creep_fractional": {"order": 0.25, "size": 0.06},
    "hysteresis_preisach": {"width": 0.2, "size": 0.3},
}


def online(body) -> OnlineRod:
    return OnlineRod(body.rod, body.top_kpa, float(body.bend_rad[0]), 0.0, *EFFECTS.values())


@pytest.fixture(scope="module")
def recorded():
    """A minute of a recording, its rows and its markers."""
    w = World.start("rod", 3, 1, 1.5)
    act(w, EFFECTS)
    rows = np.arange(0, min(12000, len(w.time_s)), 50)
    return w, rows, pose(w, rows)


def test_step_by_step_it_is_where_a_recording_has_it(recorded):
    w, rows, tips = recorded
    rod, out = online(w.body), []
    for i in range(rows[-1] + 1):
        if i > 0:  # what was asked for at a row moves the air from there to the next one
            rod.step(w.sent[i - 1, 0] * w.body.top_kpa, DT_S)
        if i % 50 == 0:
            out.append(rod.tip_mm())
    assert np.ptp(tips[:, 2]) > 20
    assert np.array(out) == pytest.approx(tips, abs=1e-6)


def test_long_steps_are_short_ones_under_a_held_command(recorded):
    w = recorded[0]
    long, short = online(w.body), online(w.body)
    for command in (12.0, 3.0, 8.0):
        for _ in range(15):
            long.step(command, 1 / 15)
        for _ in range(200):
            short.step(command, DT_S)
    assert long.pressure_kpa == pytest.approx(short.pressure_kpa, abs=1e-12)
    assert long.tip_mm() == pytest.approx(short.tip_mm(), abs=1e-9)


def test_its_parts_bend_as_much_as_the_whole(recorded):
    rod = online(recorded[0].body)
    rod.step(10.0, 3.0)
    assert rod.bends_rad(10).sum() == pytest.approx(rod.drive_rad + rod.memory_rad)
    assert rod.bends_rad(10).std() > 0.01 * rod.drive_rad  # no arc of a circle


def test_a_cantilever_gives_way_as_the_beam_formula_says(recorded):
    rod, body = online(recorded[0].body), recorded[0].body
    force = 1e-3 / body.length_mm**2
    assert rod.tip_mm([0, 0, force])[2] == pytest.approx(force * body.length_mm**3 / 3, rel=0.02)


def test_rest_forgets(recorded):
    rod = online(recorded[0].body)
    before = rod.tip_mm()
    rod.step(10.0, 2.0)
    rod.step(0.0, 2.0)
    assert np.linalg.norm(rod.tip_mm() - before) > 0.1
    rod.rest()
    assert (rod.tip_mm() == before).all()
