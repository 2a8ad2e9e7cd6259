"""The table of attacks: what did harm is counted and named."""

from pathlib import Path

from pneutac_benchmarks.robustness import main
from pneutac_benchmarks.robustness.outcome import judge
from pneutac_sim.errors import InputError


def test_tracebacks_and_long_sentences_are_harm_and_short_sentences_are_not():
    raised = [None, InputError("A sentence."), InputError("x" * 400), InputError("two\nlines"), KeyError("a")]

    def attempt(i: int) -> None:
        if raised[i]:
            raise raised[i]

    outcome = judge("attempts", 5, attempt)
    assert outcome.tried == 5 and outcome.refused == 3
    assert [b.partition(":")[0] for b in outcome.broken] == ["2", "3", "4"]
    assert "KeyError at" in outcome.broken[2] and "test_robustness.py" in outcome.broken[2]


def test_every_test_that_the_table_names_exists():
    for *names, _ in main.TESTS.values():
        for name in names:
            file, _, function = name.partition("::")
            assert f"def {function.partition('[')[0]}(" in (Path(main.ROOT) / file).read_text()
