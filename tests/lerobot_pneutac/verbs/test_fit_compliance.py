"""Modulus and stiffness by loaded poses.

`loaded_poses.csv` holds poses at rest of the full material points (2,000 of 1.2 MPa) under six forces at the
tip and six pressures, round a spine that a chamber of 0.2 N m/rad drives: each by its own search for rest,
with neither the energy's polynomial nor the pipeline. Solid and lattice are those of the fit, so for the
modulus it is a mirror.
"""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from lerobot_pneutac.verbs import fit_compliance as module
from lerobot_pneutac.verbs.fit_compliance import MODULUS, WHOLE, fit_compliance
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.gravity import STANDARD_GRAVITY
from pneutac_sim.finger import equilibrium
from pneutac_sim.finger.soft_body import SoftBody, loaded
from pneutac_sim.mpm.soft_body import measure
from pneutac_sim.twin import Twin, Value

POSES = pd.read_csv(Path(__file__).parent / "loaded_poses.csv")
TRUE_MPA, CHAMBER = 1.2, 0.2
LEVERS = 110.0 - np.array(Twin.builtin().spine_joint_positions_mm)


@pytest.fixture(scope="module")
def body():
    return measure(Twin.builtin(), (0.0, 15.0), particles=2000)


@pytest.fixture
def measured_once(body, monkeypatch):
    monkeypatch.setattr("pneutac_sim.mpm.soft_body.measure", lambda *_: body)


def recording(joints, times=10):
    """Every pose held for so many samples, seen with noise of 0.1 mm and 1 mrad."""
    table = POSES.loc[POSES.index.repeat(times)].reset_index(drop=True)
    rng = np.random.default_rng(0)
    for name in ("tip_x_mm", "tip_z_mm", "q_1_rad", "q_2_rad", "q_3_rad", "q_4_rad"):
        table[name] += (1e-3 if name.startswith("q") else 0.1) * rng.normal(size=len(table))
    table = table.drop(columns=[] if joints else [c for c in table if c.startswith("q_")])
    table.insert(0, "trial", np.repeat(np.arange(len(POSES)), times))
    table.insert(1, "time_s", 0.05 * np.arange(len(table)))
    return Recording(Path("bench"), {"device": "finger", "length_mm": 110.0}, table, "finger")


def whole(body):
    K = CHAMBER * np.eye(4) + TRUE_MPA * body.resting
    return LEVERS @ LEVERS / (LEVERS @ np.linalg.solve(K, LEVERS))


def everything(r):
    return np.ones(len(r.samples), bool)


@pytest.mark.slow
def test_joint_angles_tell_the_modulus_from_the_chamber(body, measured_once):
    r = recording(joints=True)
    found = fit_compliance(Twin.builtin(), r, everything(r))
    assert found.twin.parameter(MODULUS) == pytest.approx(TRUE_MPA, rel=0.1)
    assert found.twin.parameter(WHOLE) == pytest.approx(whole(body), rel=0.01)
    low, high = found.twin.parameters[MODULUS].ci95
    assert low < TRUE_MPA < high < 1.5 * low


@pytest.mark.slow
def test_the_tip_alone_tells_the_whole_and_says_so(body, measured_once):
    r = recording(joints=False)
    found = fit_compliance(Twin.builtin(), r, everything(r))
    assert found.twin.parameter(WHOLE) == pytest.approx(whole(body), rel=0.01)
    assert found.twin.parameter(MODULUS) == Twin.builtin().parameter(MODULUS)
    assert found.parameters[MODULUS]["note"].startswith("fixed") and "q_1_rad" in found.remark


@pytest.mark.slow
def test_a_weight_is_a_force_along_gravity(measured_once):
    r = recording(joints=True)
    force = r.samples.loc[:, ["force_x_n", "force_z_n"]].to_numpy()
    size = np.linalg.norm(force, axis=1)
    way = np.where(size[:, None] > 0, force / np.maximum(size, 1e-9)[:, None], [0.0, -1.0])
    r.samples = r.samples.drop(columns=["force_x_n", "force_y_n", "force_z_n"]).assign(
        payload_g=1e3 * size / STANDARD_GRAVITY, gravity_x=way[:, 0], gravity_y=0.0, gravity_z=way[:, 1]
    )
    pushed = module.known_forces(r)
    np.testing.assert_allclose(pushed[:, [0, 2]], force, atol=1e-9)
    found = fit_compliance(Twin.builtin(), r, everything(r))
    assert found.twin.parameter(MODULUS) == pytest.approx(TRUE_MPA, rel=0.1)


def test_without_loads_it_says_what_to_hang():
    r = recording(joints=True)
    r.samples = r.samples.drop(columns=["force_x_n"])
    found = fit_compliance(Twin.builtin(), r, everything(r))
    assert not found.parameters and "hang about 30 g on the tip" in found.remark
    softer = Twin.builtin()
    softer.parameters[WHOLE] = Value(0.1)
    assert "hang about 7 g" in fit_compliance(softer, r, everything(r)).remark


@pytest.mark.slow
def test_without_a_body_springs_bend_as_springs(body):
    links = np.array([27.5, 27.5, 27.5, 13.75]) * 1e-3
    links = np.concatenate([links, links / 0.11])
    free = np.array([[0.1, 0.2, 0.15, 0.3], [0.3, 0.2, 0.3, 0.1]])
    loads = np.array([[0.1, 0.0, 0.3, 0.2, 0.0, -0.4], [-0.3, 0.0, -0.3, 0.0, 0.0, 0.1]])
    bent = free.copy()
    equilibrium.solve(bent, loads, 0.3, links, np.zeros(4))
    nothing = SoftBody(body.powers, 0 * body.weights, body.rest, 0.0)
    np.testing.assert_allclose(loaded(free, loads, links, 0.3, 1.0, nothing), bent, atol=1e-6)
