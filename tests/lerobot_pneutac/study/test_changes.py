"""A device that changes once for good, and one that changes all the while."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from lerobot_pneutac.study import data_breaks
from lerobot_pneutac.study.body_base import BodyBase, can_act
from lerobot_pneutac.study.data_breaks import change_break, find_change
from pneutac_datasets.recording.recording import Recording

N, NOISE = 1500, 0.4


def model(change):
    """A linear model of three outputs, fitted to a device with a law of its own from each row on."""
    rng = np.random.default_rng(1)
    drive = np.repeat(rng.uniform(0, 1, 100), 15)
    J = np.stack(
        [np.outer(np.ones(N), [1, 0, 0]), np.outer(drive, [0, 1, 2]), np.outer(drive**2, [1, 1, 0])], 2
    )
    truth = np.array([0.5, -4.0, 2.0]) + change[:, None] * np.array([1.5, 3.0, 0.0])
    seen = np.einsum("ndf,nf->nd", J, truth) + rng.normal(0, NOISE, (N, 3))
    flat = J.reshape(-1, 3)
    theta = np.linalg.lstsq(flat, seen.ravel(), rcond=None)[0]
    residual = (flat @ theta).reshape(N, 3) - seen
    zero = np.zeros(3)
    return SimpleNamespace(residual=residual, v=zero, jacobian=flat, weight=np.diag(zero), pull=zero)


def least(m):
    return 0.5 * ((m.residual**2).sum(axis=1).mean() - 3 * NOISE**2)


@pytest.mark.parametrize("at", [300, 777, 1200])
def test_the_moment_is_found_to_a_sample(at):
    m = model((np.arange(N) >= at).astype(float))
    assert abs(find_change(m, least(m)) - at) <= 2


def test_what_changes_all_the_while_or_for_a_while_has_no_moment():
    t = np.arange(N)
    for change in (2 * t / N, 1 - np.exp(-t / 400), np.sin(t / 60), ((t > 500) & (t < 700)).astype(float)):
        m = model(change)
        assert find_change(m, least(m)) is None


def test_nothing_is_found_in_noise():
    m = model(np.zeros(N))
    assert find_change(m, 0.05 * NOISE**2) is None


@pytest.mark.parametrize(("sideways", "told"), [((0, 1), False), ((0, 1, 0), True), ((0, 0), True)])
def test_what_begins_with_another_load_is_no_change_of_the_device(monkeypatch, tmp_path, sideways, told):
    g, n = np.repeat(sideways, 60).astype(float), 60 * len(sideways)
    columns = {"time_s": 0.1 * np.arange(n), "trial": 0.0, "gravity_y": g, "gravity_z": 1 - g}
    columns |= {"pressure_cmd_kpa": 0.0, "tip_x_mm": 0.0}
    study = SimpleNamespace(
        recording=Recording(tmp_path, {}, pd.DataFrame(columns), "finger"),
        twin=None,
        noise=SimpleNamespace(floor=0.1),
        unit="mm",
    )
    monkeypatch.setattr(data_breaks, "_change", lambda study, found: 60)

    class Fitter:
        def __init__(self, recording, twin, rows):
            self.rows = rows

        def fit(self, *args):
            return SimpleNamespace(residual=np.full((len(self.rows), 1), 0.1), counted=1)

    monkeypatch.setattr(data_breaks, "BodyFitter", Fitter)
    found = SimpleNamespace(model=SimpleNamespace(structure=None, values={}), cv_squared=np.ones(n))
    found.value = 1.0
    assert (change_break(study, np.arange(n), found) is not None) == told


@pytest.mark.parametrize(("heavy_on_its_side", "told"), [(0.0, True), (50.0, False)])
def test_the_answer_holds_for_loads_in_the_directions_in_which_they_hung(tmp_path, heavy_on_its_side, told):
    columns = {
        "trial": 0,
        "time_s": np.arange(4.0),
        "pressure_cmd_kpa": [0.0, 9.0] * 2,
        "gravity_x": 0.0,
        "gravity_y": [0.0, 0.0, 1.0, 1.0],
    }
    columns |= {"gravity_z": [1.0, 1.0, 0.0, 0.0], "payload_g": [0.0, 50.0, 0.0, heavy_on_its_side]}
    study = SimpleNamespace(recording=Recording(tmp_path, {}, pd.DataFrame(columns), "finger"))
    study._heaviest_everywhere = lambda: BodyBase._heaviest_everywhere(study)
    recorded = BodyBase.recorded.fget(study)
    assert "payload of 0 to 50 g" in recorded and ("not in every direction" in recorded) == told


@pytest.mark.parametrize(
    ("command_kpa", "said"),
    [
        (np.repeat([0.0, 4.0, 8.0, 12.0, 8.0, 4.0] * 10, 20), "at 4 pressures up to 12 kPa"),
        (np.repeat(np.arange(60) * 7 % 60 / 59 * 12, 20), "up to 12 kPa"),
        (6 - 6 * np.cos(np.arange(1200) / 50), "up to 12 kPa, changing by up to 1.2 kPa/s"),
        (np.r_[6 - 6 * np.cos(np.arange(1150) / 50), np.full(50, 12.0)], "up to 12 kPa"),
    ],
)
def test_the_answer_holds_for_the_pressures_and_rates_that_were_driven(tmp_path, command_kpa, said):
    columns = {"trial": 0, "time_s": np.arange(1200) / 10, "pressure_cmd_kpa": command_kpa}
    recording = Recording(tmp_path, {}, pd.DataFrame(columns), "finger")
    assert BodyBase.recorded.fget(SimpleNamespace(recording=recording)) == said
    assert can_act("round(p)", recording, True, set()) == ("at 4" not in said)
