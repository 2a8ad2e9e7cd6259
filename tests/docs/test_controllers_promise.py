"""The page's state machine is the firmware's, and the tests that it names exist."""

import re

import controller_states as states
import pytest
from doc_blocks import ROOT
from pressure_rig import build


@pytest.fixture(scope="module")
def found():
    return states.transitions(build())


def test_table_and_picture_are_the_firmwares_own(found):
    assert states.BEGIN + "\n" + states.table(found) + "\n" + states.END in states.PAGE.read_text()
    assert states.PICTURE.read_text() == states.svg(found)


def test_only_following_has_air_and_only_a_set_point_leads_there(found):
    into = {(state, event) for (state, event), new in found.items() if new == "following" != state}
    assert into == {("ready", "set-point within the limits")}
    assert {new for (_, event), new in found.items() if event == "a fault"} == {"fault"}


def test_every_test_that_is_named_exists():
    names = set(re.findall(r"`(test_\w+\.py)`", states.PAGE.read_text()))
    assert len(names) > 4
    assert not [name for name in names if not (ROOT / "tests/robots/hardware" / name).exists()]
