"""The benchmark of demonstrations: what is hidden, and when an answer is right."""

from pneutac_benchmarks.demonstrations import VALVE, names_right


def test_an_answer_is_right_where_it_names_all_that_was_hidden():
    assert names_right((), []) and not names_right((), ["creep"])
    assert names_right(("creep",), ["creep", "hysteresis"]) and not names_right(("creep",), ["hysteresis"])
    assert not names_right(("late_commands", "creep"), ["late_commands"])
    assert names_right(VALVE, ["valve_lag"]) and not names_right(VALVE, ["creep"])
