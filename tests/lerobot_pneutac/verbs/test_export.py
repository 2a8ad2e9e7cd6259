"""`pneutac export`: the Python file steps as the pipeline does, the body rests where the world's does."""

import re
import subprocess
import sys
import types

import mujoco
import numpy as np
import pytest
from verbs import refused, verb

from lerobot_pneutac.verbs.check import check_path
from lerobot_pneutac.verbs.export import python_file, write_mjcf
from pneutac_sim.effects.laws import law_names
from pneutac_sim.effects.registry import body_effects, get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.finger import Inputs, Pipeline
from pneutac_sim.twin import Twin, Value
from pneutac_sim.world.spine import Spine
from pneutac_sim.world.world import World

TOP_KPA = 12.0
RNG = np.random.default_rng(4)
N, DT_S = 60, 0.05
CONDITIONS = {
    "temperature_c": 31.0, "gravity_x": 0.3, "gravity_y": -0.5, "gravity_z": -0.81, "payload_g": 40.0,
    "other_1_kpa": 4.0, "other_2_kpa": -2.0, "other_3_kpa": 1.0,
}  # fmt: skip


def load(text: str) -> dict:
    """What a module of this text has."""
    module = sys.modules["exported"] = types.ModuleType("exported")
    exec(compile(text, "exported.py", "exec"), vars(module))
    return vars(module)


def twin_with(*names: str, device: str = "finger") -> Twin:
    twin = Twin.builtin()
    if device == "arm":
        arm = {"gain_rad_per_kpa": 0.01, "chamber_2_gain": 1.1, "rest_pressure_y_kpa": 0.4, "curl_rad": 0.1}
        twin = Twin("arm", 200.0, parameters={k: Value(v) for k, v in arm.items()})
        twin.parameters["joint_stiffness_nm_per_rad"] = Value(0.9, (0.8, 1.0))
    for name in names:
        twin.effects[name] = get_effect(name).start(TOP_KPA)
    return twin


def program(chambers: int) -> np.ndarray:
    """(N, chambers) kPa that rise, hold, turn back and jump."""
    p = TOP_KPA * np.abs(np.interp(np.arange(N), [0, 12, 25, 40, 41, N], [0.2, 1, 1, 0.1, 0.7, 0.4]))
    return np.stack([np.roll(p, 7 * c) for c in range(chambers)], axis=1)


def pipeline_run(twin: Twin, pressure: np.ndarray):
    names = ["pressure_cmd_kpa"] if len(pressure[0]) == 1 else [f"pressure_cmd_{c}_kpa" for c in (1, 2, 3)]
    samples = {"time_s": DT_S * np.arange(N), **dict(zip(names, pressure.T, strict=True))}
    inputs = Inputs.from_samples(samples, twin.device, twin.length_mm, start="held")
    inputs.columns.update({k: np.full(N, v) for k, v in CONDITIONS.items()})
    model = Pipeline.of(twin, inputs)
    assert not model.left_out
    return model, model.run(inputs, model.theta(twin))


def chambers_kpa(pose) -> np.ndarray:
    """What a file knows of the chambers' pressure: its own model, or the command."""
    return pose.command_kpa if hasattr(pose, "command_kpa") else pose.pressure_kpa


def assert_equal(twin: Twin) -> str:
    pressure = program(1 if twin.device == "finger" else 3)
    model, expected = pipeline_run(twin, pressure)
    text = python_file(twin)
    finger = load(text)["finger"](**CONDITIONS)
    poses = [finger.reset(pressure[0]), *(finger.step(p, DT_S) for p in pressure[1:])]
    loaded = {"gravity", "payload"} & set(twin.effects)  # the pipeline reads these off a curve
    for got, of in ((np.stack([p.measured for p in poses]), expected.markers),
                    (np.stack([p.joints_rad.ravel() for p in poses]), expected.joints),
                    (np.stack([chambers_kpa(p) for p in poses]), expected.pressure_kpa),
                    (np.stack([p.tip for p in poses]), expected.signals[model.observes])):  # fmt: skip
        np.testing.assert_allclose(got, of, rtol=1e-9, atol=2e-5 if loaded else 1e-9)
    return text


@pytest.mark.parametrize("name", [*body_effects(), *law_names()[::3]])
def test_the_file_steps_as_the_pipeline_does(name):
    text = assert_equal(twin_with(name, device="arm" if get_effect(name).several else "finger"))
    found = set(re.findall(r"^(?:import|from) (\S+)", text, re.M))
    assert found <= {"__future__", "collections.abc", "dataclasses", "functools", "math", "numpy", "warnings"}
    assert f"{name}.{get_effect(name).parameters[0].name}" in text


@pytest.mark.parametrize("device", ["finger", "arm"])
def test_effects_of_every_stage_act_together(device):
    names = (
        "valve_lag",
        "sensor_offset",
        "hysteresis",
        "lag(p)",
        "lag(p) #2",
        "gravity",
        "creep",
        "elongation",
    )
    assert_equal(twin_with(*names, "base_tilt", "tracker_lag", device=device))


def test_the_command_writes_a_file_that_runs_by_itself(tmp_path, capsys):
    twin = twin_with("creep", "thermal")
    twin.effects["creep"]["weight_4s"] = Value(0.11, (0.09, 0.13))
    twin.save_version(
        tmp_path / "finger", "added creep", "bench", {"train": 0.5, "heldout": 0.62, "unit": "mm"}
    )
    out = tmp_path / "finger.py"
    verb("export", twin=tmp_path / "finger", out=out)
    text = out.read_text()
    assert "95 % interval 0.09 to 0.13" in text and "0.62 mm off on test blocks, of bench" in text
    run = subprocess.run([sys.executable, "-I", str(out)], capture_output=True, text=True, check=True)
    assert run.stdout.startswith("Pose(command_kpa=array([")
    refused("is there already; give a new name", "export", twin=tmp_path / "finger", out=out)
    with pytest.raises(InputError, match="must name a file that ends in .py or in .xml"):
        verb("export", f"--out={out}.txt", twin=tmp_path / "finger")
    with pytest.raises(ValueError, match="temperature_c is None; give a finite number"):
        load(text)["finger"]()
    finger = load(text)["finger"](temperature_c=20.0)
    for command, dt_s, says in (
        (float("nan"), 0.02, "The command is nan kPa; give a finite number"),
        ([1.0, 2.0], 0.02, "or one for each of 1 chambers"),
        ("a", 0.02, "The command 'a' kPa .* must be numbers"),
        (7.5, None, "the step None s must be numbers"),
        (7.5, 0, "The step dt_s is 0.0 s; give a finite number above 0"),
    ):
        with pytest.raises(ValueError, match=says):
            finger.step(command, dt_s)
    with pytest.warns(UserWarning, match=r"15.5 kPa lies beyond 0 to 15 kPa, .* extrapolated") as warned:
        for command in (14.9, 15.5, 20.0, -1.0):
            finger.step(command, 0.02)
    assert len(warned) == 1 and warned[0].filename == __file__


def test_a_file_without_the_gain_is_not_exported(tmp_path):
    twin = Twin.builtin()
    del twin.parameters["gain_rad_per_kpa"]
    twin.save(tmp_path / "finger")
    with pytest.raises(InputError, match="twin.yaml: body: gain_rad_per_kpa is missing; `pneutac calib"):
        verb("export", twin=tmp_path / "finger", out=tmp_path / "finger.py")
    assert not (tmp_path / "finger.py").exists()
    faults = check_path(tmp_path / "finger").faults
    assert len(faults) == 1 and faults[0].count("twin.yaml") == 1 and "gain_rad_per_kpa" in faults[0]


def test_a_gel_is_refused():
    with pytest.raises(InputError, match="no pressure that bends it"):
        python_file(Twin(device="gel"))


@pytest.mark.parametrize("device", ["finger", "arm"])
def test_the_body_rests_where_the_worlds_does(device, tmp_path):
    twin = twin_with(device=device)
    write_mjcf(twin, tmp_path / "body.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "body.xml"))
    data, spine = mujoco.MjData(model), Spine(model, twin)
    world = World(twin=twin, touch="none", fidelity="probe")
    finger = load(python_file(twin))["finger"]()
    assert model.opt.timestep == pytest.approx(world.model.opt.timestep, rel=1e-5)
    for name in ("sensor", "pad", "spine_1"):
        own, theirs = model.body(name), world.model.body(name)
        np.testing.assert_allclose(own.mass, theirs.mass, rtol=1e-5)
        np.testing.assert_allclose(own.inertia, theirs.inertia, rtol=1e-5)
    np.testing.assert_allclose(
        model.dof_damping[spine.dofs], world.model.dof_damping[world._spine], rtol=1e-6
    )
    model.dof_damping[spine.dofs] *= 20  # where it rests is asked, not how long it swings
    for pressure in (np.zeros(world.chambers), 0.6 * TOP_KPA * np.eye(world.chambers)[0]):
        q = finger.reset(pressure).joints_rad
        data.ctrl[:] = q if device == "finger" else np.stack([0 * q[:, 0], -q[:, 0], q[:, 1]], 1).ravel()
        for _ in range(3000):
            mujoco.mj_step(model, data)
        for _ in range(60):
            world.step(np.r_[0.0, 0.0, 0.0, pressure])
        np.testing.assert_allclose(spine.read(data), world.spine_rad, atol=2e-3)
        flange = data.body("flange")
        tip = 1e3 * flange.xmat.reshape(3, 3).T @ (data.site("tip").xpos - flange.xpos)
        turn = world.data.site("flange").xmat.reshape(3, 3)
        theirs = 1e3 * turn.T @ (world.data.site("tip").xpos - world.data.site("flange").xpos)
        np.testing.assert_allclose(tip, theirs, atol=0.3)
    assert np.linalg.norm(q) > 0.1


def test_pressure_is_that_in_the_finger_and_else_named_command():
    """Closed form: after a step to 10 kPa held for 0.15 s, a valve of 0.15 s has let in 1 - 1/e of it."""
    twin = twin_with()
    twin.effects["valve_lag"] = {"fill_time_s": Value(0.15), "vent_time_s": Value(0.15)}
    finger = load(python_file(twin))["finger"]()
    finger.step(10.0, 1e-9)
    assert finger.step(10.0, 0.15).pressure_kpa[0] == pytest.approx(10 * (1 - np.exp(-1)), rel=1e-6)
    slow = {"weight": Value(1.0), "scale_kpa": Value(12.0), "time_s": Value(0.15)}
    for effects in ({}, {"lag(p)": slow}):  # a slow valve as part of the bend is no pressure
        twin.effects = effects
        text = python_file(twin)
        pose = load(text)["finger"]().step(10.0, 0.02)
        assert pose.command_kpa[0] == 10.0 and "pose.joints_rad, pose.command_kpa" in text
        with pytest.warns(FutureWarning, match="read command_kpa"):
            assert pose.pressure_kpa[0] == 10.0


def test_what_is_fitted_at_a_limit_is_no_fact():
    twin = twin_with()
    twin.effects["creep"] = get_effect("creep").start(TOP_KPA)
    twin.effects["elongation"] = {"strain_1_per_kpa": Value(0.001, (0.0008, 0.0012))}
    twin.effects["valve_lag"] = {"fill_time_s": Value(0.2, (0.1, 3.0)), "vent_time_s": Value(0.2, (0.1, 0.3))}
    said = " ".join(python_file(twin).split('"""')[1].split())
    assert "by +0.1 % for each kPa. This is fitted, not measured" in said
    assert "venting 0.2 s. The recording does not determine fill_time_s, at the limit of the allowed" in said
    assert said.count("does not determine") == 1
