"""Modulus and stiffness by loaded poses.

`loaded_poses.csv` holds poses at rest of the full material points (2,000 of 1.2 MPa) under six forces at the
tip and six pressures, round a spine that a chamber of 0.2 N m/rad drives: each by its own search for rest,
with neither the energy's polynomial nor the pipeline. Solid and lattice are those of the fit, so for the
modulus it is a mirror.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from verbs import verb

from lerobot_pneutac.verbs.fit_body import MODULUS, WHOLE, calibrate_body, fit_compliance, known_forces
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects import get_effect
from pneutac_sim.effects.gravity import STANDARD_GRAVITY
from pneutac_sim.errors import InputError
from pneutac_sim.finger import BodyData, Inputs, Pipeline, equilibrium, simulate
from pneutac_sim.finger.equilibrium import SoftBody, loaded
from pneutac_sim.mpm.devices import measure
from pneutac_sim.twin import Twin, Value


def stairs(n=2400, hz=20):
    t = np.arange(n) / hz
    level = np.random.default_rng(5).uniform(0, 15, n // 120 + 1).repeat(120)[:n]
    return {"trial": (t // 60).astype(int), "time_s": t, "pressure_cmd_kpa": level}


def write(folder, truth, measured=False, noise=0.1, **columns):
    """A recording of a device like this twin, with the pressure as its sensor sees it."""
    table = stairs() | columns
    inputs = Inputs.from_samples(table)
    model = Pipeline.of(truth, inputs)
    run = model.run(inputs, model.theta(truth, 15.0))
    rng = np.random.default_rng(0)
    for name in ("tip_x_mm", "tip_z_mm"):
        table[name] = model.outputs(run, [name])[:, 0] + noise * rng.normal(size=len(table["time_s"]))
    if measured:
        table["pressure_kpa"] = run.pressure_kpa[:, 0] + 0.02 * rng.normal(size=len(table["time_s"]))
    meta = {"device": "finger", "length_mm": 110.0, "samples": "samples.csv"}
    return Recording(folder, meta, pd.DataFrame(table), "finger").write(folder)


def truth(*effects):
    twin = Twin.builtin()
    for name in effects:
        twin.effects[name] = get_effect(name).start(15.0)
    return twin


def test_calibrate_finds_the_parameters_and_writes_the_next_version(tmp_path):
    folder = write(tmp_path / "bench", truth())
    start = Twin()
    start.save(tmp_path / "twin")
    verb("calibrate", twin=tmp_path / "twin", recording=folder, out=tmp_path / "out")
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["error"]["heldout"] == pytest.approx(0.1 * np.sqrt(2), rel=0.1)
    assert result["before"]["heldout"] > 5 and result["evaluations"] > 10
    rest = result["parameters"]["rest_pressure_kpa"]
    assert rest["ci95"][0] <= 10.70 <= rest["ci95"][1] and rest["unit"] == "kPa"
    assert result["parameters"]["joint_stiffness_nm_per_rad"]["note"] == "held"
    assert "No known load bends the finger" in result["compliance"] and "payload_g" in result["compliance"]
    twin = Twin.load(tmp_path / "twin")
    assert twin.parameter("rest_pressure_kpa") == pytest.approx(10.70, abs=0.1)
    entry = twin.history[-1]
    assert entry["version"] == 0 and entry["heldout"] == pytest.approx(result["error"]["heldout"])
    # what was held out can be found again, and the saved twin has that very error there
    recording = Recording.load(folder)
    heldout = recording.split(entry["seed"])[1]
    p = simulate(twin, recording)
    assert p.data.error(p.residual, heldout) == pytest.approx(entry["heldout"], rel=1e-6)
    report = (tmp_path / "out" / "report.html").read_text()
    assert "rest_pressure_kpa" in report and "test residual" in report


def turned_over(folder, weighs):
    """The same device with its base turned over in every second trial."""
    device = truth(*(["gravity"] if weighs else []))
    if weighs:
        device.effects["gravity"]["tip_mass_g"].value = 60.0
    over = np.where(stairs()["trial"] % 2, 1.0, -1.0)
    return write(folder, device, gravity_x=0 * over, gravity_y=0 * over, gravity_z=over)


@pytest.mark.slow
def test_known_causes_that_the_recording_shows_are_fitted_first_and_no_others(tmp_path):
    found = calibrate_body(Twin(), Recording.load(turned_over(tmp_path / "heavy", True)))
    (cause,) = found.causes
    assert (cause.name, list(found.twin.effects)) == ("gravity", ["gravity"])
    assert found.error["heldout"] == pytest.approx(0.1 * np.sqrt(2), rel=0.15)
    assert cause.error_without > 2 * cause.error_with and cause.drop[1] > 0
    assert found.without_causes > 2 * found.error["heldout"]
    assert found.to_dict()["known_causes"][0]["name"] == "gravity"
    light = calibrate_body(Twin(), Recording.load(turned_over(tmp_path / "light", False)))
    assert not light.causes and not light.twin.effects


def test_measured_pressure_tells_the_valve_from_the_creep(tmp_path):
    """The fast part of creep looks like a slow valve in the pose, but not in the pressure."""
    both = truth("valve_lag", "creep")
    both.effects["valve_lag"]["fill_time_s"].value = 0.6
    both.effects["creep"]["weight_1_3s"].value = 0.4
    recording = Recording.load(write(tmp_path / "bench", both, measured=True))
    start = truth("valve_lag", "creep")
    found = calibrate_body(start, recording)
    assert [f.unit for f in found.fits] == ["kPa", "mm"]
    assert found.twin.effects["valve_lag"]["fill_time_s"].value == pytest.approx(0.6, rel=0.03)
    assert found.twin.effects["creep"]["weight_1_3s"].value == pytest.approx(0.4, abs=0.05)
    assert found.error["heldout"] < 0.3
    command = BodyData.of(recording, found.twin, source="command")
    assert command.error(simulate(found.twin, command).residual) < 0.3


def test_a_bound_is_called_out_in_table_and_result(tmp_path):
    slow = truth("dead_time")
    slow.effects["dead_time"]["delay_s"].value = 1.9
    folder = write(tmp_path / "bench", slow)
    truth("dead_time").save(tmp_path / "twin")
    verb("calibrate", twin=tmp_path / "twin", recording=folder, out=tmp_path / "out")
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert "limit of its allowed range" in result["parameters"]["dead_time.delay_s"]["note"]
    assert "upper" in (tmp_path / "out" / "report.html").read_text()


def test_photographs_alone_are_refused(tmp_path):
    table = pd.DataFrame(stairs(100)).assign(image="a.png")
    recording = Recording(tmp_path, {"device": "finger"}, table, "finger")
    with pytest.raises(InputError, match="tip_x_mm"):
        calibrate_body(Twin.builtin(), recording)


POSES = pd.read_csv(Path(__file__).parent / "loaded_poses.csv")
TRUE_MPA, CHAMBER = 1.2, 0.2
LEVERS = 110.0 - np.array(Twin.builtin().spine_joint_positions_mm)


@pytest.fixture(scope="module")
def body():
    return measure(Twin.builtin(), (0.0, 15.0), particles=2000)


@pytest.fixture
def measured_once(body, monkeypatch):
    monkeypatch.setattr("pneutac_sim.mpm.devices.measure", lambda *_: body)


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


def test_a_weight_is_a_force_along_gravity():
    r = recording(joints=True)
    force = r.samples.loc[:, ["force_x_n", "force_z_n"]].to_numpy()
    size = np.linalg.norm(force, axis=1)
    way = np.where(size[:, None] > 0, force / np.maximum(size, 1e-9)[:, None], [0.0, -1.0])
    r.samples = r.samples.drop(columns=["force_x_n", "force_y_n", "force_z_n"]).assign(
        payload_g=1e3 * size / STANDARD_GRAVITY, gravity_x=way[:, 0], gravity_y=0.0, gravity_z=way[:, 1]
    )
    np.testing.assert_allclose(known_forces(r)[:, [0, 2]], force, atol=1e-9)


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
