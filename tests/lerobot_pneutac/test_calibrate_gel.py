import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lerobot_pneutac.calibrate import main
from lerobot_pneutac.fit_gel import shift
from pneutac_datasets.gel_generator import HEIGHT, WIDTH, write_gel_recording
from pneutac_datasets.recording import BenchRecording
from pneutac_sim.errors import InputError
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.twin import Twin


@pytest.fixture(scope="module")
def generated(tmp_path_factory):
    return write_gel_recording(tmp_path_factory.mktemp("generated"), seed=0).folder


@pytest.fixture
def recording(generated, tmp_path):
    """A copy to spoil."""
    return Path(shutil.copytree(generated, tmp_path / "recording"))


def run(twin, recording, *more):
    main([f"--twin={twin}", f"--recording={recording}", *more])


def test_generated_pair_beats_rest_and_pasted_difference_on_held_out_images(generated, tmp_path, capsys):
    run(tmp_path / "twin", generated, f"--out={tmp_path / 'out'}")
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    ours, pasted, rest = (result["methods"][k] for k in ("this model", "difference pasted", "rest image"))
    for other in (pasted, rest):
        assert ours["rmse"] < 0.85 * other["rmse"]
        assert ours["contact_rmse"] < 0.75 * other["contact_rmse"]
    assert ours["contact_dncc"] > max(0.9, pasted["contact_dncc"])
    assert result["image"]["n"] == 6 and result["image"]["rest_rmse"] == rest["rmse"]
    assert 1 <= result["error"]["heldout"] / result["image"]["rmse"] < 1.1, "root mean square over images"
    assert set(result) >= {"parameters", "error", "evaluations", "seconds", "image"}
    page = (tmp_path / "out" / "report.html").read_text()
    assert "data:image/png;base64" in page and "http://" not in page.replace("http://www.w3.org", "")
    assert (tmp_path / "out" / "tactile.png").is_file()
    text = capsys.readouterr().out
    assert "beginning one of a gel" in text and "rest image" in text


def test_the_twin_renders_what_was_calibrated(generated, tmp_path):
    """The twin's sensor predicts a held-out photograph better than the generated DIGIT or the rest image."""
    run(tmp_path / "twin", generated)
    sensor = TactileSensor(Twin.load(tmp_path / "twin"))
    recording = BenchRecording.load(generated)
    row = recording.samples[recording.samples["role"] == "heldout"].iloc[0]
    real = recording.image(row["image"]).astype(float)
    position = np.array([row["x_mm"], row["y_mm"], 3.0 - row["depth_mm"]]) * 1e-3
    ours = sensor.image(sensor.probe([2], [[0.003, 0, 0]], [position], [np.eye(3)]))
    assert np.std(ours - real) < 0.7 * np.std(sensor.rest_image - real)
    np.testing.assert_array_equal(sensor.rest_image, recording.image("rest.png"))


def test_a_finger_twin_gets_the_gel_as_its_next_version(generated, tmp_path):
    twin = tmp_path / "twin"
    Twin.builtin().save_version(twin, "made", "", {"train": None, "heldout": None, "unit": "mm"})
    run(twin, generated)
    read = Twin.load(twin)
    assert read.device == "finger" and len(read.history) == 2
    assert read.parameters == Twin.builtin().parameters
    assert read.history[-1]["unit"] == "levels" and read.history[-1]["train"] > 0
    assert GelModel.from_twin(read).rest_image.shape == (320, 240, 3)


def test_without_a_recording_the_output_says_that_the_images_are_generated(tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("PNEUTAC_DATA", raising=False)
    main([f"--twin={tmp_path / 'twin'}", f"--out={tmp_path / 'out'}"])
    said = capsys.readouterr().out
    assert "GENERATED images, not photographs" in said and "real tactile" not in said
    assert Twin.load(tmp_path / "twin").history[-1]["recording"] == "generated images (seed 0)"
    page = (tmp_path / "out" / "report.html").read_text()
    assert "from two photographs" not in page and "Above real" not in page
    assert f"--out={tmp_path / 'out'}" in page and "/generated" not in page


def test_same_recording_same_twin(generated, tmp_path):
    for name in "ab":
        run(tmp_path / name, generated)
    a, b = (Twin.load(tmp_path / name) for name in "ab")
    assert a.gel == b.gel


def test_larger_images_end_as_the_sensors_own_size(recording, tmp_path):
    """Photographs at twice the resolution give the same light, and a twin at 240 x 320."""
    run(tmp_path / "small", recording)
    for file in recording.rglob("*.png"):
        Image.open(file).resize((2 * WIDTH, 2 * HEIGHT), Image.Resampling.BILINEAR).save(file)
    meta = json.loads((recording / "recording.json").read_text())
    (recording / "recording.json").write_text(json.dumps(meta | {"px_per_mm": 2 * meta["px_per_mm"]}))
    table = BenchRecording.load(recording)
    table.samples["contact_radius_px"] *= 2
    table.write(recording)
    run(tmp_path / "large", recording)
    small, large = (GelModel.from_twin(Twin.load(tmp_path / n)) for n in ("small", "large"))
    assert large.rest_image.shape == (320, 240, 3) and large.px_per_mm == pytest.approx(small.px_per_mm)
    np.testing.assert_allclose(large.light, small.light, atol=4)


def test_shift_moves_and_fills_with_zeros():
    image = np.arange(12).reshape(3, 4, 1)
    assert shift(image, 1, -1)[..., 0].tolist() == [[0, 4, 5, 6], [0, 8, 9, 10], [0, 0, 0, 0]]
    np.testing.assert_array_equal(shift(image, 0, 0), image)


def swap(folder):
    rest, press = folder / "rest.png", folder / "images" / "ball_0.png"
    a, b = rest.read_bytes(), press.read_bytes()
    rest.write_bytes(b)
    press.write_bytes(a)


def alike(folder):
    shutil.copy(folder / "rest.png", folder / "images" / "ball_0.png")


def convert(mode):
    def spoil(folder):
        file = folder / "images" / "ball_0.png"
        Image.open(file).convert(mode).save(file)

    return spoil


def sixteen_bits(folder):
    import cv2

    file = folder / "images" / "ball_0.png"
    cv2.imwrite(str(file), cv2.imread(str(file)).astype(np.uint16) * 256)


def other_size(folder):
    file = folder / "images" / "ball_3.png"
    Image.open(file).resize((120, 160)).save(file)


def garbage(folder):
    (folder / "images" / "ball_2.png").write_text("not an image")


def missing(folder):
    (folder / "images" / "ball_2.png").unlink()


def edit_table(old, new):
    def spoil(folder):
        text = (folder / "samples.csv").read_text()
        assert old in text
        (folder / "samples.csv").write_text(text.replace(old, new))

    return spoil


def edit_meta(**fields):
    def spoil(folder):
        file = folder / "recording.json"
        meta = json.loads(file.read_text()) | fields
        file.write_text(json.dumps({k: v for k, v in meta.items() if v is not None}))

    return spoil


@pytest.mark.parametrize(
    "spoil, says",
    [
        (swap, "swapped"),
        (alike, "same picture"),
        (convert("L"), "grey"),
        (convert("RGBA"), "alpha"),
        (sixteen_bits, "16 bits"),
        (other_size, "row 4: image .* is 120 x 160 pixels"),
        (garbage, "cannot be read"),
        (missing, "is missing"),
        (edit_table("calibration", "heldout"), "no row with role 'calibration'"),
        (edit_table(",sphere,", ",thumb,"), "indenter is 'thumb'"),
        (edit_meta(px_per_mm=None), "px_per_mm"),
        (edit_meta(px_per_mm=-2), "px_per_mm"),
        (edit_meta(rest_image=None), "rest_image"),
        (edit_meta(rest_image="../secret.png"), "outside"),
    ],
)
def test_bad_recordings_get_one_sentence_and_leave_no_twin(spoil, says, recording, tmp_path):
    spoil(recording)
    with pytest.raises(InputError, match=says) as e:
        run(tmp_path / "twin", recording)
    assert "\n" not in str(e.value)
    assert not (tmp_path / "twin" / "twin.yaml").exists()


def test_a_twin_of_another_device_and_a_folder_of_other_things_are_refused(generated, tmp_path):
    Twin(device="arm").save(tmp_path / "arm")
    with pytest.raises(InputError, match="'arm'"):
        run(tmp_path / "arm", generated)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("do not touch")
    with pytest.raises(InputError, match="something else"):
        run(tmp_path / "full", generated)


def test_bad_options_get_one_sentence(generated, tmp_path):
    for argv, says in [
        ([f"--recording={generated}"], "--twin=DIR"),
        ([f"--twin={tmp_path}", "--multiply=perhaps"], "perhaps"),
        ([f"--twin={tmp_path}", f"--out={generated / 'rest.png'}"], "is a file"),
    ]:
        with pytest.raises(InputError, match=says) as e:
            main(argv)
        assert "\n" not in str(e.value)


@pytest.mark.parametrize(
    "name, rmse, psnr, ncc, contact_dncc",
    [("digit_nagoya", 6.5, 32.0, 0.976, 0.87), ("digit_fots", 9.7, 28.4, 0.96, 0.88)],
)
def test_real_digits(name, rmse, psnr, ncc, contact_dncc, tmp_path):
    """On photographs of two real DIGITs the model beats the rest image and the pasted difference."""
    if "PNEUTAC_DATA" not in os.environ:
        pytest.skip("PNEUTAC_DATA is unset: there are no real photographs to calibrate to")
    run(tmp_path / "twin", Path(os.environ["PNEUTAC_DATA"]) / "tactile" / name, f"--out={tmp_path}")
    result = json.loads((tmp_path / "result.json").read_text())
    image, pasted = result["image"], result["methods"]["difference pasted"]
    assert image["rmse"] < min(rmse, pasted["rmse"], image["rest_rmse"])
    assert image["psnr"] > psnr and image["ncc"] > ncc and image["contact_dncc"] > contact_dncc
    assert image["contact_rmse"] < pasted["contact_rmse"]
