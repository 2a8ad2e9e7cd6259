"""Made-up bench recordings for the tests of the pipeline: programs, conditions and a noisy simulation.

The fixtures hand out functions.
"""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from pneutac_sim.effects import get_effect
from pneutac_sim.finger import Inputs, Pipeline
from pneutac_sim.twin import Twin


def _program(n=2400, hz=20, seed=0, top=15.0):
    """A table (dict of columns) with holds, triangles and stairs in trials of 40 s, and all conditions."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) / hz
    p = np.zeros(n)
    i = 0
    while i < n:
        m = min(n - i, int(rng.uniform(4, 20) * hz))
        s = np.arange(m)
        kind = rng.integers(3)
        if kind == 0:
            p[i : i + m] = rng.uniform(0, top)
        elif kind == 1:
            p[i : i + m] = rng.uniform(0.3, 1) * top * np.abs((s / hz / rng.uniform(4, 12)) % 1 * 2 - 1)
        else:
            p[i : i + m] = np.floor(6 * s / m) * rng.uniform(0.05, 0.18) * top
        i += m
    trial = (t // 40).astype(int)
    return {
        "trial": trial,
        "time_s": t - 40 * trial,
        "pressure_cmd_kpa": np.minimum(p, top),
        "gravity_x": np.zeros(n),
        "gravity_y": np.zeros(n),
        "gravity_z": np.where(trial % 3 == 0, 1.0, -1.0),
        "temperature_c": 20.0 + 8 * (trial % 2) + 0.01 * t,
        "payload_g": np.where(trial % 4 == 1, 40.0, 0.0),
    }


def _recording(twin, table, columns=("tip_x_mm", "tip_z_mm"), noise=0.2, seed=1, source="command"):
    """What a device like this twin would give on this program."""
    inputs = Inputs.from_samples(table, twin.device, twin.length_mm, source)
    model = Pipeline.of(twin, inputs)
    run = model.run(inputs, model.theta(twin, inputs.pressure_range_kpa))
    y = model.outputs(run, columns)
    y = y + noise * np.random.default_rng(seed).normal(size=y.shape)
    samples = pd.DataFrame(table | dict(zip(columns, y.T, strict=True)))
    return SimpleNamespace(device=twin.device, samples=samples, meta={})


def _with_effects(twin: Twin, values: dict[str, dict[str, float]], pressure_range_kpa=15.0) -> Twin:
    """The twin with these effects; parameters not given take their starting value."""
    twin = twin.copy()
    for name, given in values.items():
        twin.effects[name] = get_effect(name).start(pressure_range_kpa)
        for key, value in given.items():
            twin.effects[name][key].value = value
    return twin


@pytest.fixture
def program():
    return _program


@pytest.fixture
def recording():
    return _recording


@pytest.fixture
def with_effects():
    return _with_effects
