import numpy as np
import pytest

from pneutac_truths import make
from pneutac_truths.online import OnlineRod
from pneutac_truths.programs import DT_S
from pneutac_truths.world import World

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
    make.act(w, EFFECTS)
    rows = np.arange(0, min(12000, len(w.time_s)), 50)
    return w, rows, make.pose(w, rows)


def test_step_by_step_it_is_where_a_recording_has_it(recorded):
    w, rows, tips = recorded
    rod, out = online(w.body), []
    for i in range(rows[-1] + 1):
        rod.step(w.sent[i, 0] * w.body.top_kpa, DT_S)
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
