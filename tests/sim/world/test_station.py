"""A lab's own station: workspace and mount."""

import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.world.gantry import Gantry
from pneutac_sim.world.station import Station
from pneutac_sim.world.varied import VariedWorld
from pneutac_sim.world.world import World


def written(folder, text="", form="pneutac-station/1"):
    file = folder / "station.yaml"
    file.write_text(f"format: {form}\n{text}\n")
    return file


def test_what_is_left_out_is_the_papers(tmp_path):
    assert Station.load(written(tmp_path)) == Station()
    assert Station.load(written(tmp_path, "mount_mm: 35")).mount_mm == 35


def test_a_longer_mount_keeps_the_gel_where_it_was_and_the_box_holds_world_and_plans():
    station = Station((0.35, -0.1, 0.2), (0.45, 0.1, 0.4), 50.0)
    paper, own = (VariedWorld("switch", touch="none", station=s) for s in (None, station))
    for world in (paper, own):
        world.reset(3)
    np.testing.assert_allclose(own.gel_m, paper.gel_m, atol=1e-3)
    np.testing.assert_allclose(own.flange_m - paper.flange_m, [0, 0, 0.03], atol=1e-3)
    gantry = Gantry(own)
    gantry.mirror(own)
    push = np.tile([0.1, 0.0, 0.1, 0.0], (40, 1))
    planned, _ = gantry.rollout(push[:40])
    assert planned[-1][0] == pytest.approx(0.45, abs=2e-3) and planned[-1][2] == pytest.approx(0.4, abs=2e-3)
    for action in push:
        own.step(action)
    np.testing.assert_allclose(own.flange_m[[0, 2]], [0.45, 0.4], atol=2e-3)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("mount_m: 20", "no field 'mount_m'; is 'mount_mm' meant"),
        ("mount_mm: none", "mount_mm is 'none'; give 1 to 200"),
        ("mount_mm: 0.02", "mount_mm is 0.02; give 1 to 200"),
        ("workspace_low_m: [0.3, 0.1]", "workspace_low_m is .* three finite numbers"),
        ("workspace_low_m: [0.3, 0.1, .nan]", "workspace_low_m is .* three finite numbers"),
        ("latency_s: -1", "latency_s is -1; give 0 to 1"),
        ("control_hz: 4", "control_hz is 4; give a whole number from 5 to 60 Hz"),
        ("control_hz: 15.0", "control_hz is 15.0; give a whole number"),
        ("home_m: [0.9, 0, 0.3]", "home_m is .* outside the workspace"),
        ("base_m: [0, 0]", "base_m is .* three finite numbers"),
        ("workspace_low_m: [0.7, -0.1, 0.2]", "each number of the first must be below"),
    ],
)
def test_a_bad_station_is_one_sentence(tmp_path, text, says):
    with pytest.raises(InputError, match=f"station.yaml: .*{says}"):
        Station.load(written(tmp_path, text))


def test_another_format_or_no_file_is_named(tmp_path):
    with pytest.raises(InputError, match="'format' must be 'pneutac-station/1'"):
        Station.load(written(tmp_path, form="other"))
    with pytest.raises(InputError, match="There is no file"):
        Station.load(tmp_path / "none.yaml")


def test_commands_act_late_by_the_stations_latency_and_it_starts_at_its_home():
    station = Station(home_m=(0.42, 0.02, 0.33), latency_s=0.2)
    late, prompt = (
        World("card", touch="none", station=s) for s in (station, Station(home_m=(0.42, 0.02, 0.33)))
    )
    ahead = VariedWorld("card", touch="none", station=station)
    for world in (late, prompt, ahead):
        world.reset(0)
    np.testing.assert_allclose(late.flange_m, [0.42, 0.02, 0.33], atol=0.007)
    path = [[world.step([0.05, 0.0, 0.0, 3.0]).state for _ in range(8)] for world in (late, prompt, ahead)]
    np.testing.assert_array_equal(path[0], path[2])
    flange, pressure = slice(-6, -3), -1
    np.testing.assert_allclose(np.array(path[0])[3:, flange], np.array(path[1])[:-3, flange], atol=1e-4)
    assert path[0][2][pressure] == 0 < path[0][3][pressure]
    gantry = Gantry(ahead)
    gantry.mirror(ahead)
    planned, _ = gantry.rollout(np.zeros((5, 4)))
    for _ in range(5):
        ahead.step(np.zeros(4))
    np.testing.assert_allclose(planned[-1], ahead.flange_m, atol=1e-3)  # what was sent before still acts
    assert planned[-1][0] > path[2][-1][-6] + 0.008
