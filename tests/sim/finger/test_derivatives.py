"""Derivatives taken link by link against whole simulations."""

import numpy as np
import pytest

from pneutac_sim.finger.inputs import Inputs
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.finger.problem import changes
from pneutac_sim.twin import Twin, Value

EFFECTS = (
    ["base_tilt", "elongation"],
    ["dead_time", "valve_lag", "lag(p)", "play(p)", "base_tilt"],
    ["hysteresis", "power_law_memory(p)", "tip_z += x z"],
    ["lag(p)", "creep", "tracker_lag"],
    ["gravity", "lag(p)", "base_tilt"],
    ["gravity", "payload", "lag(p)", "elongation"],
    ["gravity", "creep", "lag(p)"],
    ["thermal", "gravity", "lag(p)"],
)
VALUES = {"base_tilt": {"pitch_rad": Value(0.1)}, "lag(p)": {"weight": Value(0.2)}}


def moved(device: str, effects: list[str], columns: list[str]):
    """Changes by small steps of all free parameters: by `changes`, and by whole simulations."""
    rng = np.random.default_rng(3)
    n, axes = 400, {"finger": [""], "arm": ["_1", "_2", "_3"]}[device]
    level = np.repeat(rng.uniform(0, 20, (n // 20, len(axes))), 20, axis=0)
    samples = {"trial": np.repeat([0, 1], n // 2), "time_s": np.arange(n) * 0.05}
    samples |= {f"pressure_cmd{a}_kpa": level[:, i] for i, a in enumerate(axes)}
    samples |= {"payload_g": np.repeat([0.0, 40.0], n // 2), "temperature_c": np.linspace(20.0, 30.0, n)}
    samples |= {f"gravity_{a}": np.full(n, g) for a, g in zip("xyz", (3.0, 0.0, -9.0), strict=True)}
    twin = Twin(device=device, parameters={"gain_rad_per_kpa": Value(0.01)})
    twin.effects = {e: VALUES.get(e, {}) for e in effects}
    inputs = Inputs.from_samples(samples, device).thin(np.arange(0, n, 3))
    model = Pipeline.of(twin, inputs)
    theta = model.theta(twin, 20.0)
    bounds = np.array([p.limits(20.0) for p in model.specs])
    free = np.flatnonzero(["handedness" not in name for name in model.names])
    step = 1e-6 * (bounds[free, 2] - bounds[free, 1])
    values = np.where(theta[free] + step < bounds[free, 2], theta[free] + step, theta[free] - step)
    run = model.run(inputs, theta)
    at, expected = model.outputs(run, columns), []
    for i, value in zip(free, values, strict=True):
        other = theta.copy()
        other[i] = value
        expected.append(model.outputs(model.run(inputs, other), columns) - at)
    got = changes(model, inputs, run, columns, free, values)
    return [model.names[i] for i in free], got, np.stack(expected, axis=2)


@pytest.mark.parametrize("device", ["finger", "arm"])
@pytest.mark.parametrize("effects", EFFECTS, ids="+".join)
def test_link_by_link_is_what_whole_simulations_give(device, effects):
    names, got, expected = moved(device, effects, ["tip_x_mm", "tip_z_mm", "bend_angle_rad"])
    for j, name in enumerate(names):
        size = np.abs(expected[:, :, j]).max()
        # loads are solved to a tolerance, which shows in steps that do nearly nothing
        assert np.abs(got[:, :, j] - expected[:, :, j]).max() <= 3e-3 * size + 1e-6, name
    assert sum(np.abs(expected[:, :, j]).max() > 1e-5 for j in range(len(names))) > len(names) / 2
