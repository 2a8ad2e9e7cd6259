"""`pneutac history`: versions are listed, and an earlier one comes back without any being lost."""

import pytest
from verbs import verb

from lerobot_pneutac.verbs.history import restore
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin, Value


@pytest.fixture
def folder(tmp_path):
    twin = Twin.builtin()
    for version, change in enumerate(("calibrated", "added creep", "added leak (unconfirmed)")):
        twin.parameters["rest_pressure_kpa"] = Value(float(version))
        twin.save_version(
            tmp_path / "twin", change, "bench", {"train": 1.0, "heldout": 2.0, "unit": "mm", "seed": 3}
        )
    return tmp_path / "twin"


def test_going_back_writes_a_further_version_equal_to_the_earlier_one(folder):
    twin = restore(folder, 1)
    assert twin.parameter("rest_pressure_kpa") == 1.0
    again = Twin.load(folder)
    assert again.parameter("rest_pressure_kpa") == 1.0 and len(again.history) == 4
    assert again.history[-1] | {"change": ""} == again.history[1] | {"version": 3, "change": ""}
    assert [Twin.load(folder, v).parameter("rest_pressure_kpa") for v in range(3)] == [0.0, 1.0, 2.0]


@pytest.mark.parametrize(("version", "match"), [(2, "newest"), (7, "it has 0, 1, 2"), (-1, "it has 0, 1, 2")])
def test_a_version_that_cannot_be_restored_is_refused_and_nothing_changes(folder, version, match):
    before = (folder / "twin.yaml").read_text()
    with pytest.raises(InputError, match=match):
        restore(folder, version)
    assert (folder / "twin.yaml").read_text() == before


def test_the_command_lists_unconfirmed_versions_as_such(folder, capsys):
    verb("history", twin=folder)
    assert "unconfirmed" in " ".join(capsys.readouterr().out.split())
    verb("history", twin=folder, restore=0)
    assert "equal to version 0" in " ".join(capsys.readouterr().out.split())
