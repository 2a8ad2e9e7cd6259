"""Twins that an earlier version saved load for ever, and simulate what they simulated then.

`PNEUTAC_GOLDEN=write pytest tests/golden/test_old_twins.py` writes an `expected.json` that is not there yet.
"""

import json
import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import yaml

from pneutac_sim.finger import simulate
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.photograph import Predictor
from pneutac_sim.twin import Twin

pytestmark = pytest.mark.slow

TWINS = Path(__file__).parent / "twins"
PRESSURES = {"finger": [[0.0], [5.0], [10.0], [15.0]], "arm": [[0, 0, 0], [8, 0, 0], [0, 8, 0], [2, 4, 8]]}
PRESSES = [Press("sphere", 3.0, 0.5, -0.5, 0.8), Press("cube", 3.0, -3.0, 2.0, 0.5)]
OUTPUTS = ("tip_x_mm", "tip_y_mm", "tip_z_mm", "bend_angle_rad")


def bends(twin: Twin) -> list[dict]:
    """Tip and bend angle right after each pressure and 20 s later, by the pipeline."""
    rows = []
    for trial, pressure in enumerate(PRESSURES[twin.device]):
        names = [f"pressure_cmd_{i + 1}_kpa" for i in range(3)] if len(pressure) > 1 else ["pressure_cmd_kpa"]
        for time_s in (0.0, 0.5, 20.0):
            on = [float(p) * (time_s > 0) for p in pressure]
            rows.append({"trial": trial, "time_s": time_s} | dict(zip(names, on, strict=True)))
    samples = pd.DataFrame(rows).assign(**dict.fromkeys(OUTPUTS, 0.0))
    prediction = simulate(twin, SimpleNamespace(samples=samples, device=twin.device))
    assert not prediction.left_out
    return pd.DataFrame(prediction.model, columns=prediction.data.columns).to_dict("records")


def levels(twin: Twin) -> list[list[float]]:
    """Mean levels of rendered tactile images, and of their change from the image at rest, by channel."""
    gel, out = GelModel.from_twin(twin), []
    for press in PRESSES:
        image = Predictor(gel).image(press, gel.rest_image, 0.5).astype(float)
        out.append([*image.mean((0, 1)), *np.abs(image - gel.rest_image).mean((0, 1))])
    return out


@pytest.mark.parametrize("name", sorted(p.name for p in TWINS.iterdir()))
def test_an_old_twin_loads_simulates_the_same_and_is_kept(name, tmp_path):
    twin = Twin.load(TWINS / name)
    assert twin.device == name and len(twin.history) > 1 and twin.effects
    found = {"bends": bends(twin)} if name in PRESSURES else {}
    if twin.gel:
        found["levels"] = levels(twin)
    file = TWINS / name / "expected.json"
    if os.environ.get("PNEUTAC_GOLDEN") == "write" and not file.exists():
        file.write_text(json.dumps(found, indent=1) + "\n")
    expected = json.loads(file.read_text())
    for row, then in zip(found.get("bends", []), expected.get("bends", []), strict=True):
        assert row == pytest.approx(then, rel=1e-6, abs=1e-6)
    np.testing.assert_allclose(found.get("levels", []), expected.get("levels", []), atol=0.02)

    again = Twin.load(twin.save(tmp_path / "again"))
    texts = [yaml.safe_load((p / "twin.yaml").read_text()) for p in (TWINS / name, tmp_path / "again")]
    assert texts[0] == {k: texts[1][k] for k in texts[0]}, "nothing is lost"
    assert again.arrays.keys() == twin.arrays.keys()
    assert all(np.array_equal(again.arrays[k], a) for k, a in twin.arrays.items())
