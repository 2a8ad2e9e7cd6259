"""`pneutac compare --fidelity=mpm`: effects act in the full simulation, which samples it takes."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from generated import once
from verbs import refused, verb

from lerobot_pneutac.verbs.compare_body import markers_by_mpm, spread
from lerobot_pneutac.verbs.fit_body import calibrate_body
from pneutac_datasets.generate.finger import generate
from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.finger import BodyData, simulate
from pneutac_sim.gel.model import GelModel
from pneutac_sim.mpm import devices
from pneutac_sim.twin import Twin, Value

pytestmark = pytest.mark.slow

GOLDEN = Path(__file__).parents[2] / "golden"
SAMPLES = 25


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    few = {"finger": partial(devices.finger, particles=600), "arm": partial(devices.arm, particles=600)}
    monkeypatch.setattr(devices, "BODIES", few)


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A recording of a finger that creeps, a twin without and one with creep, both fitted to it."""
    root = tmp_path_factory.mktemp("creeping")
    recording = once(generate, "creep", root / "creep", seed=3, minutes=2, hz=10)
    twin = Twin.builtin()
    twin.length_mm = recording.length_mm
    twin.spine_joint_positions_mm = recording.spine_joint_positions_mm
    for name, effects in (("without", []), ("with", ["creep"])):
        twin.effects = {e: {p.name: Value(p.default) for p in get_effect(e).parameters} for e in effects}
        calibrate_body(twin, recording).twin.save(root / name)
    return root


@pytest.mark.nightly  # every day: one golden result
def test_an_effect_acts_in_the_full_simulation(bench, tmp_path):
    error = {}
    for twin in ("without", "with"):
        for fidelity, options in (("pipeline", []), ("mpm", [f"--samples={SAMPLES}"])):
            out = tmp_path / twin / fidelity
            common = [f"--twin={bench / twin}", f"--recording={bench / 'creep'}", f"--out={out}"]
            verb("compare", *common, f"--fidelity={fidelity}", *options)
            result = json.loads((out / "result.json").read_text())
            assert result["fidelity"] == fidelity
            error[twin, fidelity] = result["error"]["all"]
    assert result["samples"] == SAMPLES
    of_all = f"at {SAMPLES} of {len(check(Recording.load(bench / 'creep'))[0])} samples"
    assert of_all in result["simulated"] and of_all in (out / "report.html").read_text()
    assert result["sentence"].startswith("The twin's full simulation misses")
    for rows in (result["by"][n] for n in ("direction", "program", "pressure_cmd_kpa")):
        assert sum(r["n"] for r in rows) == SAMPLES and all(r["n"] for r in rows)
    fall = {f: error["without", f] - error["with", f] for f in ("pipeline", "mpm")}
    assert fall["pipeline"] > 1.0 and fall["mpm"] > 0.5 * fall["pipeline"]


@pytest.mark.parametrize("device", ["finger", "arm"])
def test_a_stiff_spine_follows_the_pipeline(device):
    """Where the controller is stiff against the body, both simulations are the same, observation and all."""
    chambers = 1 if device == "finger" else 3
    names = ["pressure_cmd_kpa"] if chambers == 1 else [f"pressure_cmd_{i}_kpa" for i in (1, 2, 3)]
    pressure = np.zeros((6, chambers))
    pressure[:, 0] = np.linspace(0, 8, 6)
    pressure[3:, 1:] = 6.0 * np.arange(chambers - 1)
    table = pd.DataFrame(dict(zip(names, pressure.T, strict=True)) | {"trial": 0, "time_s": np.arange(6.0)})
    table = table.assign(**dict.fromkeys(("tip_x_mm", "tip_y_mm", "tip_z_mm"), 0.0))
    table = table.assign(curvature_x_1_per_m=0.0) if device == "arm" else table.assign(bend_angle_rad=0.0)
    twin = Twin(device, 110.0 if device == "finger" else 200.0)
    twin.parameters["gain_rad_per_kpa"] = Value(0.02)
    twin.parameters["spine_stiffness_nm_per_rad"] = Value(2000.0)
    twin.effects["base_tilt"] = {p.name: Value(0.1) for p in get_effect("base_tilt").parameters}
    twin.effects["elongation"] = {"strain_1_per_kpa": Value(0.005)}
    bench = BodyData.of(Recording(None, {}, table, device), twin, source="command")
    model = simulate(twin, bench).model
    rows = np.array([0, 2, 4, 5, 5])
    seen, poses = markers_by_mpm(twin, bench, rows)
    assert poses == 4
    np.testing.assert_allclose(seen[:, :3], model[rows, :3], atol=5e-3 * twin.length_mm)
    np.testing.assert_allclose(seen[:, 3], model[rows, 3], rtol=5e-3, atol=1e-3)

    soft = twin.copy()
    soft.parameters["spine_stiffness_nm_per_rad"] = Value(20.0)
    bent = rows[1:]
    back = 1 - markers_by_mpm(soft, bench, bent)[0][:, 3] / model[bent, 3]
    assert (back > 0.003).all() and (back < 0.1).all(), "a softer controller gives way to the body"
    straight = twin.copy()
    straight.effects = {}
    moved = seen[:, :3] - markers_by_mpm(straight, bench, rows)[0][:, :3]
    np.testing.assert_allclose(moved, (model - simulate(straight, bench).model)[rows, :3], atol=0.2)
    assert np.abs(moved).max() > 1.0, "and tilt and stretch are seen"


def test_samples_are_spread(tmp_path):
    assert spread(7, 10).tolist() == list(range(7))
    at = spread(1000, 50, seed=1)
    assert len(at) == 50 and (at // 20 == np.arange(50)).all()
    assert len(np.unique(np.diff(at))) > 10  # no period


def test_what_cannot_be_simulated_is_told(tmp_path):
    recording = f"--recording={GOLDEN / 'recordings/finger_creep'}"
    for options, said in (
        (["--fidelity=exact"], "it must be one of pipeline, mpm"),
        (["--samples=50"], "together with fidelity=mpm"),
        (["--fidelity=mpm", "--samples=1"], "2 or more"),
    ):
        refused(said, "compare", recording, *options, twin=GOLDEN / "twins/finger")
    gel = Twin("gel", 16.0)
    GelModel.builtin().into_twin(gel)
    gel.save(tmp_path / "gel")
    refused("give|own device", "compare", recording, twin=tmp_path / "gel", fidelity="mpm")
