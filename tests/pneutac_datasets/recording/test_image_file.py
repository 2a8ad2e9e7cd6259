"""Damaged and malicious images end in one sentence, within a second and 500 MB."""

import random

import pytest
from PIL import Image

from pneutac_benchmarks.robustness.images import bomb, damage_images, read_bombs, scans
from pneutac_datasets.recording.image_file import FORMATS, read_image
from pneutac_sim.errors import InputError


@pytest.mark.parametrize("number", [120, pytest.param(10_000, marks=pytest.mark.nightly)])
def test_a_damaged_image_is_read_or_refused_in_a_sentence(number):
    outcome = damage_images(number)
    assert outcome.broken == () and 0.3 * number < outcome.refused < number


@pytest.mark.slow
def test_small_files_that_stand_for_huge_pictures_cost_little():
    assert read_bombs().broken == ()


def test_limits_are_told(tmp_path):
    with pytest.raises(InputError, match="huge.png states 9000 x 9000 pixels, above the limit of 25 million"):
        read_image(bomb(9000, 9000), "huge.png")
    with pytest.raises(InputError, match="scans"):
        read_image(scans(100), "slow.jpg")
    (tmp_path / "large.png").touch()
    with (tmp_path / "large.png").open("r+b") as file:
        file.truncate(81 * 2**20)  # a hole, which takes no space
    with pytest.raises(InputError, match="large.png has 81 MB, above the limit of 80 MB"):
        read_image(tmp_path / "large.png")


@pytest.mark.parametrize("kind", ["EPS", "WEBP", "GIF"])
def test_no_other_format_is_opened(tmp_path, kind):
    Image.new("RGB", (8, 8)).save(tmp_path / "a.png", kind)
    with pytest.raises(InputError, match="cannot be read as an image"):
        read_image(tmp_path / "a.png")


@pytest.mark.parametrize("kind", FORMATS)
def test_pixels_are_those_of_the_file(tmp_path, kind):
    colour = tuple(random.Random(1).randbytes(3))
    Image.new("RGB", (8, 4), colour).save(tmp_path / "a", kind)
    image = read_image(tmp_path / "a", plain=True)
    assert image.shape == (4, 8, 3) and abs(image.astype(int) - colour).max() <= 3  # JPEG loses a little
