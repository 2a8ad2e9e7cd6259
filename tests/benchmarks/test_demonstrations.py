"""The benchmark of demonstrations: what is hidden, and when an answer is right."""

import pytest

from lerobot_robot_pneutac.standin.world import Physics
from pneutac_benchmarks.demonstrations import CASES, VALVE, BenchmarkDemonstrationsConfig, names_right
from pneutac_sim.errors import InputError


def test_something_is_hidden_where_something_is_to_be_found():
    for physics, right in CASES.values():
        assert (physics == Physics()) == (right == ())


def test_an_answer_is_right_where_it_names_all_that_was_hidden():
    assert names_right((), []) and not names_right((), ["creep"])
    assert names_right(("creep",), ["creep", "hysteresis"]) and not names_right(("creep",), ["hysteresis"])
    assert not names_right(("late_commands", "creep"), ["late_commands"])
    assert names_right(VALVE, ["valve_lag"]) and not names_right(VALVE, ["creep"])


def test_too_few_demonstrations_are_refused():
    with pytest.raises(InputError, match="demonstrations is 2; it must be 5 or more"):
        BenchmarkDemonstrationsConfig(demonstrations=2)
