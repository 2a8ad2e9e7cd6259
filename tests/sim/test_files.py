"""Files are written whole or not at all."""

import errno
import os

import numpy as np
import pytest

from pneutac_sim.errors import InputError
from pneutac_sim.files import whole, write_image, write_json, write_text


def test_a_file_takes_its_place_when_it_is_finished(tmp_path):
    file = tmp_path / "a.json"
    with whole(file) as part:
        part.write_text("1")
        assert not file.exists()
    assert file.read_text() == "1" and list(tmp_path.iterdir()) == [file]


def test_what_was_there_stays_where_the_writing_stops(tmp_path):
    file = tmp_path / "a.json"
    file.write_text("old")
    with pytest.raises(KeyboardInterrupt), whole(file) as part:
        part.write_text("ne")
        raise KeyboardInterrupt
    assert file.read_text() == "old"


@pytest.mark.parametrize(
    "write",
    [
        lambda file: write_text(file.with_suffix(".html"), "new"),
        lambda file: write_json(file.with_suffix(".json"), {"new": 1}),
        lambda file: write_image(file.with_suffix(".png"), np.zeros((4, 5, 3), np.uint8)),
        lambda file: write_image(file.with_suffix(".jpg"), np.zeros((4, 5), np.uint8), quality=95),
    ],
)
def test_each_writer_leaves_the_old_file_where_the_disk_is_full(tmp_path, monkeypatch, write):
    def full(_):
        raise OSError(errno.ENOSPC, "full")

    write(tmp_path / "a")
    (file,) = tmp_path.iterdir()
    file.write_bytes(b"old")
    with monkeypatch.context() as m:
        m.setattr(os, "fsync", full)
        with pytest.raises(InputError, match=f"No space is left to write .*{file.name}"):
            write(tmp_path / "a")
    assert file.read_bytes() == b"old" and list(tmp_path.iterdir()) == [file]
    write(tmp_path / "a")
    assert file.read_bytes() != b"old"


def test_a_number_that_is_none_replaces_nothing(tmp_path):
    file = tmp_path / "a.json"
    write_json(file, {"a": 1.0})
    with pytest.raises(ValueError, match="JSON"):
        write_json(file, {"a": float("nan")})
    assert file.read_text() == '{\n "a": 1.0\n}\n'
