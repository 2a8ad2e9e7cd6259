"""The tactile benchmark: its numbers, that it resumes, and that no method has seen what it is scored on."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from lerobot_pneutac.cli import run_verb
from pneutac_benchmarks.tactile import methods as methods
from pneutac_benchmarks.tactile.methods import FOUND_ALONE, METHODS, makes_for
from pneutac_benchmarks.tactile.table import ahead, mean_sem, shown
from pneutac_datasets.generate.gel import write_gel_recording
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.gel.layout import DIGIT
from pneutac_sim.gel.pair import rmse

pytestmark = pytest.mark.nightly

FAST = "rest,pasted,model"


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Two sessions of one generated sensor."""
    folder = tmp_path_factory.mktemp("tactile")
    for seed, name in enumerate(("first", "second")):
        write_gel_recording(folder / name, seed, heldout=3)
    (folder / "notes").mkdir()
    return folder


@pytest.fixture(scope="module")
def out(data, tmp_path_factory):
    """Where the verb was run once."""
    folder = tmp_path_factory.mktemp("out")
    run_verb("benchmark", ["tactile", f"--data={data}", f"--methods={FAST}", f"--out={folder}"])
    return folder


def result(out: Path) -> dict:
    return json.loads((out / "result.json").read_text())


def test_scores_are_means_over_held_out_images_alone(data, out):
    recording = Recording.load(data / "first")
    rest = recording.image("rest.png")
    held = recording.samples[recording.samples["role"] == "heldout"]["image"]
    errors = [rmse(rest, recording.image(i)) for i in held]
    found = result(out)["sets"]["first"]
    assert found["images"] == {"heldout": 3}
    mean, sem = found["methods"]["rest image"]["heldout"]["rmse"]
    assert mean == pytest.approx(np.mean(errors))
    assert sem == pytest.approx(np.std(errors, ddof=1) / math.sqrt(3))
    assert found["methods"]["rest image"]["heldout"]["contact_dncc"][0] == 0


def test_a_digit_is_never_lent_constants_that_were_found_on_it():
    assert makes_for("digit_nagoya", "digit_fots") == (FOUND_ALONE["digit_nagoya"],)
    assert not makes_for("digit_nagoya", "digit_fots")[0].units, "it would lend the target's own field"
    assert makes_for("digit_fots", "gelsight_thu") == (DIGIT,)
    for name, other in methods.OTHER_UNIT.items():
        assert other != name and FOUND_ALONE[other] != FOUND_ALONE[name]
    assert METHODS["other_unit"].sets == METHODS["no_make"].sets == tuple(FOUND_ALONE)


def test_who_is_ahead_is_told_by_paired_differences():
    def row(values):
        return {"images": [{"role": "heldout", "rmse": v, "contact_rmse": 5.0} for v in values]}

    rows = {"model": row([4.0, 6.0, 8.0]), "taxim": row([3.0, 5.0, 7.0]), "tacchi": row([5.0, 6.0, 9.0])}
    rows["no_make"] = row([0.0, 0.0, 0.0])
    assert ahead(rows) == [{"method": "Taxim", "role": "heldout", "score": "rmse", "by": [1.0, 0.0]}]
    assert mean_sem([2.0]) == [2.0, None] and shown([2.0, None], 1) == "2.0"
