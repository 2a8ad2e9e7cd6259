import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from verbs import verb

from lerobot_pneutac.verbs.fit_gel import Drawn, wanted
from pneutac_datasets.generate.gel import HEIGHT, WIDTH, write_gel_recording
from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.gel.fit import SHADOW, fit_presses, standard_effects
from pneutac_sim.gel.layout import Orientation
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import ImageScores, PressPhotograph
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.twin import Twin

pytestmark = pytest.mark.slow
ONE_PRESS = set(standard_effects()) - {SHADOW}


@pytest.fixture(scope="module")
def generated(tmp_path_factory):
    return write_gel_recording(tmp_path_factory.mktemp("generated"), seed=0).folder


@pytest.fixture(scope="module")
def out(generated, tmp_path_factory):
    """Results of a calibration to generated images with every effect of a sensor."""
    folder = tmp_path_factory.mktemp("out")
    run(folder / "twin", generated, f"--out={folder}")
    return folder


@pytest.fixture
def twin(out):
    return out / "twin"


@pytest.fixture
def recording(generated, tmp_path):
    """A copy to spoil."""
    return Path(shutil.copytree(generated, tmp_path / "recording"))


def run(twin, recording, *more):
    verb("calibrate", *more, twin=twin, recording=recording)


def test_generated_pair_beats_rest_and_pasted_difference_on_held_out_images(out):
    result = json.loads((out / "result.json").read_text())
    ours, pasted, rest = (result["methods"][k] for k in ("this model", "difference pasted", "rest image"))
    for other in (pasted, rest):
        assert ours["rmse"] < 0.85 * other["rmse"]
        assert ours["contact_rmse"] < 0.75 * other["contact_rmse"]
    assert ours["contact_dncc"] > max(0.9, pasted["contact_dncc"])
    assert result["image"]["n"] == 6 and result["image"]["rest_rmse"] == rest["rmse"]
    assert 1 <= result["error"]["heldout"] / result["image"]["rmse"] < 1.1, "root mean square over images"
    assert set(result) >= {"parameters", "error", "evaluations", "seconds", "image"}
    page = (out / "report.html").read_text()
    assert result["make_by"] == "" and result["open_levels"]["with_next_press"] < result["open_levels"]["now"]
    assert "To know more, add a" in page and f"at the {result['next_press']['where']}" in page
    assert "data:image/png;base64" in page and "http://" not in page.replace("http://www.w3.org", "")
    assert (out / "tactile.png").is_file()


def test_the_twin_renders_what_was_calibrated(generated, twin):
    """The twin's sensor predicts a held-out photograph better than the generated DIGIT or the rest image."""
    sensor = TactileSensor(Twin.load(twin))
    recording = Recording.load(generated)
    row = recording.samples[recording.samples["role"] == "heldout"].iloc[0]
    real = recording.image(row["image"]).astype(float)
    position = np.array([row["x_mm"], row["y_mm"], 3.0 - row["depth_mm"]]) * 1e-3
    ours = sensor.image(sensor.probe([2], [[0.003, 0, 0]], [position], [np.eye(3)]))
    assert np.std(ours - real) < 0.7 * np.std(sensor.rest_image - real)
    np.testing.assert_array_equal(sensor.rest_image, recording.image("rest.png"))


def test_a_finger_twin_gets_the_gel_as_its_next_version_and_keeps_its_effects(generated, tmp_path):
    twin = Twin.builtin()
    twin.effects["creep"] = get_effect("creep").start(15.0)
    twin.save_version(tmp_path, "made", "", {"train": None, "heldout": None, "unit": "mm"})
    run(tmp_path, generated, "--effects=rest_colour")
    read = Twin.load(tmp_path)
    assert read.device == "finger" and len(read.history) == 2
    assert read.parameters == twin.parameters and read.effects["creep"] == twin.effects["creep"]
    assert list(read.effects) == ["creep", "rest_colour"]
    assert read.history[-1]["unit"] == "levels" and read.history[-1]["train"] > 0
    assert GelModel.from_twin(read).rest_image.shape == (320, 240, 3)


def test_effects_asked_for_are_fitted_and_kept_at_the_next_calibration(generated, tmp_path):
    """`none` is the paper's linear model; what a twin has decides where nothing is asked for."""
    twin = tmp_path / "twin"
    run(twin, generated, "--effects=none", f"--out={tmp_path / 'out'}")
    assert Twin.load(twin).effects == {} and GelModel.from_twin(Twin.load(twin)).effects == {}
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["make"] == "" and not any("near_light" in p for p in result["parameters"])
    assert "--effects=none" in (tmp_path / "out" / "report.html").read_text()
    run(twin, generated)
    assert Twin.load(twin).effects == {}
    run(twin, generated, "--effects=photometric_nonlinearity,rest_colour")
    run(twin, generated)
    read = Twin.load(twin)
    assert set(read.effects) == {"photometric_nonlinearity", "rest_colour"} and len(read.history) == 4


def test_a_new_twin_gets_every_effect_that_one_press_of_an_unknown_sensor_tells(twin):
    assert set(Twin.load(twin).effects) == ONE_PRESS
    assert wanted(None, Twin.builtin()) is None, "a finger without a gel has no light yet"


def test_lights_are_kept_and_recognised_by_the_next_calibration(generated, tmp_path, monkeypatch):
    monkeypatch.setenv("PNEUTAC_PRIORS", str(tmp_path / "priors"))
    few = "--effects=near_light,rest_colour"
    run(tmp_path / "one", generated, few, "--save_prior=lab sensor")
    run(tmp_path / "two", generated, few, f"--out={tmp_path / 'out'}")
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["make"] == "lab sensor" and result["make_by"] == "rest image"
    assert result["make_likeness"] > 0.99
    with pytest.raises(InputError, match="lab sensor.yaml is there already; give a new name"):
        run(tmp_path / "two", generated, few, "--save_prior=lab sensor")
    (tmp_path / "priors" / "lab sensor.yaml").write_text("format: pneutac-prior-1\nname: 3\n")
    with pytest.raises(InputError, match="lab sensor.yaml: field .proportions. is missing"):
        run(tmp_path / "three", generated)
    for name in ("../x", "DIGIT"):
        with pytest.raises(InputError, match="save_prior is"):
            run(tmp_path / "three", generated, f"--save_prior={name}")


def test_larger_images_keep_their_size_and_are_made_smaller_where_asked(recording, tmp_path):
    """Photographs at twice the resolution give the same light."""
    Recording.load(recording).keep(np.arange(7) < 2).write(recording)
    for file in recording.rglob("*.png"):
        Image.open(file).resize((2 * WIDTH, 2 * HEIGHT), Image.Resampling.BILINEAR).save(file)
    meta = json.loads((recording / "recording.json").read_text())
    (recording / "recording.json").write_text(json.dumps(meta | {"px_per_mm": 2 * meta["px_per_mm"]}))
    table = Recording.load(recording)
    table.samples["contact_radius_px"] *= 2
    table.write(recording)
    run(tmp_path / "large", recording, "--effects=rest_colour")
    run(tmp_path / "less", recording, "--effects=rest_colour", f"--image_size=[{WIDTH},{HEIGHT}]")
    large, less = (GelModel.from_twin(Twin.load(tmp_path / n)) for n in ("large", "less"))
    assert large.rest_image.shape == (640, 480, 3) and large.px_per_mm == 2 * meta["px_per_mm"]
    assert less.rest_image.shape == (320, 240, 3) and less.px_per_mm == pytest.approx(meta["px_per_mm"])
    np.testing.assert_allclose(large.light, less.light, atol=4)
    with pytest.raises(InputError, match="cannot become 320 x 240 without distortion"):
        run(tmp_path / "turned", recording, f"--image_size=[{HEIGHT},{WIDTH}]")


@pytest.mark.nightly  # every day: several presses are fitted in test_diagnose_gel
def test_all_rows_of_role_calibration_count(generated, twin, tmp_path, capsys):
    recording = Recording.load(generated)
    recording.samples.loc[:2, "role"] = "calibration"
    for f in generated.rglob("*.png"):
        (tmp_path / "r" / f.relative_to(generated)).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(f, tmp_path / "r" / f.relative_to(generated))
    recording.write(tmp_path / "r")
    run(tmp_path / "twin", tmp_path / "r", f"--out={tmp_path / 'out'}")
    said = " ".join(capsys.readouterr().out.split())
    assert "A tactile sensor from 3 presses" in said and "Fitted to 3 indentation images" in said
    alone = Twin.load(tmp_path / "twin")
    assert set(alone.effects) == set(standard_effects()), "shadows can be told from light"
    shutil.copytree(twin, tmp_path / "one_press")
    run(tmp_path / "one_press", tmp_path / "r")
    then = Twin.load(tmp_path / "one_press")
    assert then.effects == alone.effects and then.gel == alone.gel, "an earlier single press binds nothing"


@pytest.mark.parametrize(
    "name, role, rmse, contact_rmse, contact_dncc, make",
    [
        ("digit_fots", "heldout", 8.5, 14.0, 0.92, "DIGIT"),
        pytest.param("gelsight_thu", "known_depth", 4.4, 9.5, 0.96, "", marks=pytest.mark.nightly),
    ],
)
def test_real_sensors(name, role, rmse, contact_rmse, contact_dncc, make):
    """On photographs of real sensors the model beats the rest image and the pasted difference."""
    if "PNEUTAC_DATA" not in os.environ:
        pytest.skip("PNEUTAC_DATA is unset: there are no real photographs to calibrate to")
    folder = Path(os.environ["PNEUTAC_DATA"]) / "tactile" / name
    data = GelRecording.load(Recording.load(folder))
    pair = data.presses[0]
    fit = fit_presses(
        [PressPhotograph(pair.press, pair.image, pair.rest)], data.px_per_mm, thickness_mm=data.thickness_mm
    )
    assert fit.make == make and fit.orientation == Orientation()
    picks = [i for i, s in enumerate(data.samples) if s.role == role]
    drawn = Drawn(fit.gel, data)
    scores = drawn.scores, drawn.pasted_scores, drawn.rest_scores
    ours, pasted, rest = (ImageScores.mean([rows[i] for i in picks]) for rows in scores)
    assert ours.rmse < min(rmse, 0.8 * pasted.rmse, 0.7 * rest.rmse)
    assert ours.contact_rmse < min(contact_rmse, 0.75 * pasted.contact_rmse)
    assert ours.contact_dncc > max(contact_dncc, pasted.contact_dncc)
