"""The tactile benchmark: its numbers, that it resumes, and that no method has seen what it is scored on."""

import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from lerobot_pneutac.cli import run_verb
from pneutac_benchmarks.tactile import methods as methods
from pneutac_benchmarks.tactile.methods import FOUND_ALONE, METHODS, makes_for
from pneutac_benchmarks.tactile.table import ahead, mean_sem, shown
from pneutac_datasets.generate.gel import write_gel_recording
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
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


def test_ours_is_ahead_of_the_pasted_difference_and_of_the_rest_image(out):
    for content in result(out)["sets"].values():
        ours, pasted, rest = (
            content["methods"][m]["heldout"]["contact_rmse"][0]
            for m in ("this model", "difference pasted", "rest image")
        )
        assert ours < 0.75 * min(pasted, rest)
        assert content["times"]["this model"]["fit_s"] > content["times"]["difference pasted"]["fit_s"]


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


@pytest.mark.parametrize(
    "options, says",
    [
        (["--data=/nowhere"], "--data=/nowhere is no folder"),
        (["--methods=taxin"], "--methods is 'taxin'; it must be one of rest, pasted"),
        (["--sets=third"], "--sets is 'third'; it must be one of first, second"),
    ],
)
def test_bad_options_end_in_one_sentence(data, tmp_path, options, says):
    with pytest.raises(InputError, match=says) as e:
        run_verb("benchmark", ["tactile", f"--data={data}", f"--out={tmp_path / 'out'}", *options])
    assert "\n" not in str(e.value)


def test_bad_folders_end_in_one_sentence(data, tmp_path, monkeypatch):
    monkeypatch.delenv("PNEUTAC_DATA", raising=False)
    with pytest.raises(InputError, match="^--data is not given; .* set PNEUTAC_DATA"):
        run_verb("benchmark", ["tactile"])
    with pytest.raises(InputError, match="whose device is 'gel'"):
        run_verb("benchmark", ["tactile", f"--data={data / 'first'}"])
    with pytest.raises(InputError, match="is a file"):
        run_verb("benchmark", ["tactile", f"--data={data}", f"--out={data / 'first' / 'rest.png'}"])
    shutil.copytree(data / "first", tmp_path / "data" / "bare")
    recording = Recording.load(tmp_path / "data" / "bare")
    for roles, says in (("calibration", "bare has no held-out image"), ("heldout", "bare.*no row with role")):
        recording.samples["role"] = roles
        recording.write(tmp_path / "data" / "bare")
        with pytest.raises(InputError, match=says):
            run_verb("benchmark", ["tactile", f"--data={tmp_path / 'data'}", f"--out={tmp_path / 'out'}"])
