import json

import numpy as np
import pandas as pd
import pytest

from lerobot_pneutac.cli import run_verb
from lerobot_pneutac.verbs.fit_body import calibrate_body
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.finger import BodyData, Inputs, Pipeline, simulate
from pneutac_sim.twin import Twin


def stairs(n=2400, hz=20):
    t = np.arange(n) / hz
    level = np.random.default_rng(5).uniform(0, 15, n // 120 + 1).repeat(120)[:n]
    return {"trial": (t // 60).astype(int), "time_s": t, "pressure_cmd_kpa": level}


def write(folder, truth, measured=False, noise=0.1):
    """A recording of a device like this twin, with the pressure as its sensor sees it."""
    table = stairs()
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
    run_verb(
        "calibrate", [f"--twin={tmp_path / 'twin'}", f"--recording={folder}", f"--out={tmp_path / 'out'}"]
    )
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
    assert "rest_pressure_kpa" in report and "held-out residual" in report


def turned_over(folder, weighs):
    """The same device with its base turned over in every second trial."""
    device = truth(*(["gravity"] if weighs else []))
    if weighs:
        device.effects["gravity"]["tip_mass_g"].value = 60.0
    table = stairs()
    over = np.where(table["trial"] % 2, 1.0, -1.0)
    table |= {"gravity_x": 0 * over, "gravity_y": 0 * over, "gravity_z": over}
    inputs = Inputs.from_samples(table)
    model = Pipeline.of(device, inputs)
    run, rng = model.run(inputs, model.theta(device, 15.0)), np.random.default_rng(1)
    for name in ("tip_x_mm", "tip_z_mm"):
        table[name] = model.outputs(run, [name])[:, 0] + 0.1 * rng.normal(size=len(over))
    meta = {"device": "finger", "length_mm": 110.0, "samples": "samples.csv"}
    return Recording(folder, meta, pd.DataFrame(table), "finger").write(folder)


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
    run_verb(
        "calibrate", [f"--twin={tmp_path / 'twin'}", f"--recording={folder}", f"--out={tmp_path / 'out'}"]
    )
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert "limit of its allowed range" in result["parameters"]["dead_time.delay_s"]["note"]
    assert "upper" in (tmp_path / "out" / "report.html").read_text()


def test_photographs_alone_are_refused(tmp_path):
    table = pd.DataFrame(stairs(100)).assign(image="a.png")
    recording = Recording(tmp_path, {"device": "finger"}, table, "finger")
    with pytest.raises(InputError, match="tip_x_mm"):
        calibrate_body(Twin.builtin(), recording)
