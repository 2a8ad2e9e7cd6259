"""Files are written whole or not at all."""

import pytest

from pneutac_sim.files import whole


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
