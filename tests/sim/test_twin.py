"""The twin's folder: round trip, history, and one clear sentence for each kind of damage."""

import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin, Value


def test_round_trip_keeps_every_field(tmp_path):
    twin = Twin.builtin()
    twin.parameters["gain_rad_per_kpa"] = Value(0.0123, (0.012, 0.0126))
    twin.effects["creep"] = {"fraction_1": Value(0.1, (0.08, 0.12)), "tau_1_s": Value(2.0)}
    twin.pressure_range_kpa = (-20.0, 60.0)
    twin.gel = {"px_per_mm": 20.0, "light": [[1.0, 2.0], [3.0, 4.0]]}
    twin.arrays["rest_image"] = np.random.default_rng(0).integers(0, 255, (4, 3, 3), dtype=np.uint8)
    back = Twin.load(twin.save(tmp_path / "twin"))
    assert back.parameters == twin.parameters and back.effects == twin.effects and back.gel == twin.gel
    assert back.pressure_range_kpa == (-20.0, 60.0)
    assert back.spine_joint_positions_mm == twin.spine_joint_positions_mm == [13.75, 41.25, 68.75, 96.25]
    np.testing.assert_array_equal(back.arrays["rest_image"], twin.arrays["rest_image"])
    assert Twin.from_pretrained(tmp_path / "twin").parameters == twin.parameters


def test_a_twin_that_does_not_say_was_measured_over_the_papers_pressures(tmp_path):
    file = Twin.builtin().save(tmp_path) / "twin.yaml"
    text = file.read_text()
    given = "pressure_range_kpa:\n- 0.0\n- 15.0\n"
    assert given in text
    file.write_text(text.replace(given, ""))
    assert Twin.load(tmp_path).pressure_range_kpa == (0.0, 15.0)
    for wrong in ("[15, 0]", "[5, 20]", "20", "[0, .inf]", "[0, much]", "[0, 0]"):
        file.write_text(text.replace(given, f"pressure_range_kpa: {wrong}\n"))
        with pytest.raises(
            InputError, match=r"twin.yaml: .*pressure_range_kpa is .* with 0 \(vented\) among"
        ):
            Twin.load(tmp_path)


def test_versions_keep_the_earlier_twin(tmp_path):
    twin = Twin.builtin()
    twin.save_version(tmp_path, "calibrated", "bench", {"train": 2.0, "heldout": 2.2, "unit": "mm"})
    twin.effects["creep"] = {"tau_1_s": Value(3.0)}
    twin.save_version(tmp_path, "added creep", "bench", {"train": 0.5, "heldout": 0.6, "unit": "mm"})
    assert [h["heldout"] for h in Twin.load(tmp_path).history] == [2.2, 0.6]
    assert Twin.load(tmp_path / "history" / "000").effects == {}
    assert "creep" in Twin.load(tmp_path / "history" / "001").effects


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda t: "format: other\n", "field 'format'"),
        (lambda t: "a: [", "not valid YAML"),
        (lambda t: t.replace("device: finger", "device: hand"), "must be one of finger, arm, gel"),
        (lambda t: t.replace("length_mm: 110.0", "length_mm: -1"), "positive number"),
        (lambda t: t.replace("value: 0.01114", "value: .nan"), "gain_rad_per_kpa"),
        (lambda t: t.replace("effects: {}\n", ""), "effects"),
    ],
)
def test_damaged_twin_is_named(tmp_path, damage, says):
    file = Twin.builtin().save(tmp_path) / "twin.yaml"
    file.write_text(damage(file.read_text()))
    with pytest.raises(InputError, match=says) as error:
        Twin.load(tmp_path)
    assert "twin.yaml" in str(error.value)


def test_missing_and_corrupted_files(tmp_path):
    with pytest.raises(InputError, match="pneutac new"):
        Twin.load(tmp_path / "nowhere")
    twin = Twin.builtin()
    twin.arrays["rest_image"] = np.zeros((2, 2, 3), np.uint8)
    twin.save(tmp_path)
    next(tmp_path.glob("arrays-*.safetensors")).write_bytes(b"not a tensor file")
    with pytest.raises(InputError, match="arrays-.*.safetensors is corrupted"):
        Twin.load(tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("effects: {}", "effects: none", "field 'effects' is 'none'"),
        ("effects: {}", "effects:\n  shadow: 3", "field 'effects.shadow' is 3"),
        ("effects: {}", "effects:\n  creep:\n    weight_1s: 0.1", "field 'effects.creep.weight_1s' is 0.1"),
        ("effects: {}", "", "field 'effects' is missing"),
    ],
)
def test_a_malformed_twin_names_file_and_field(old, new, said, tmp_path):
    file = Twin.builtin().save(tmp_path) / "twin.yaml"
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(InputError, match=f"twin.yaml: {said}"):
        Twin.load(tmp_path)


def test_an_earlier_version_has_the_arrays_of_its_time(tmp_path):
    twin = Twin.builtin()
    for value in (1, 2):
        twin.arrays["rest_image"] = np.full((2, 2, 3), value, np.uint8)
        twin.save_version(tmp_path, f"{value}", "bench", {"train": 1.0, "heldout": 1.0, "unit": "mm"})
    first = Twin.load(tmp_path, 0)
    assert first.arrays["rest_image"].max() == 1 and len(first.history) == 1 and first.folder == tmp_path
    with pytest.raises(InputError, match="no version 7"):
        Twin.load(tmp_path, 7)
