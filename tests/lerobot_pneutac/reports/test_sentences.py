"""What a newcomer reads first of a diagnosis: what the device does, how sure, and what is not explained."""

from types import SimpleNamespace

import pytest

from lerobot_pneutac.diagnosis.verdict import Evidence, decide
from lerobot_pneutac.reports.sentences import how_sure, lead, next_experiment, not_explained
from pneutac_sim.effects.laws import law

LAW = "lag(p)"


def told(selected=(LAW,), after=0.45, **evidence):
    """A study and an outcome, as far as sentences ask, from 0.8 mm to `after` where the noise is 0.43 mm."""
    given = {"before": 0.8 / 0.43, "after": after / 0.43}
    e = Evidence(**given | {"selected": list(selected), "removed": 0.9 if selected else 0.0} | evidence)
    constants = {"weight": 0.1, "scale_kpa": 25.0, "time_s": 8.0}
    study = SimpleNamespace(
        recording=SimpleNamespace(device="finger"), unit="mm", noise=SimpleNamespace(value=0.43),
        errors=lambda model: {"heldout": model}, reduction=lambda a, b: (0.92, (0.88, 0.95)),
        describe=lambda model, name: law(name).describe(constants, "finger"),
        size=lambda model, name: "That moves its tip by up to 1.8 mm.",
        alike=lambda effects: "It may be a load." if effects else "",
        experiment=lambda model, name: "Step and hold.", too_little=lambda: "Too short.",
        more_data="Record longer.", repeat="Do it twice.", nothing_left="Nothing.",
        unknown_where="moves your {device}", untested=[SimpleNamespace(name="gravity")],
    )  # fmt: skip
    outcome = SimpleNamespace(
        evidence=e, verdict=decide(e), selected=list(selected), before=0.8, after=after, rivals=[], tested=[],
        chosen_in=dict.fromkeys(selected, 6 / 7), likely_right=0.874,
    )  # fmt: skip
    return study, outcome


def test_what_is_found_is_told_without_its_equation():
    text = lead(*told())
    assert text.startswith("Your finger creeps (it goes on bending while the pressure is held).")
    assert "by up to 1.8 mm" in text and "from 0.8 mm to 0.45 mm" in text and "0.43 mm" in text
    assert "[" not in text and "weight" not in text and "lag(p)" not in text
    assert text.endswith("It may be a load.") and "a load" not in lead(*told(selected=(), after=0.43))
    assert "It also shows hysteresis." in lead(*told(selected=(LAW, "play(p)", "lag(p^2)")))


@pytest.mark.parametrize(
    ("case", "verdict", "says"),
    [
        ({}, "missing_effect", "Very: it explains all"),
        ({"after": 0.6}, "missing_effect", "Fairly: what is left is 1.4 times the noise"),
        ({"after": 0.9, "noise_known": False}, "missing_effect", "but the noise is not known"),
        ({"after": 0.9}, "insufficient_form", "of its form, no"),
        ({"removed": 0.2, "after": 0.7}, "unknown_effect", "Not at all: it only stands in"),
        ({"selected": (), "after": 0.43}, "adequate", "Nothing that was tried"),
        ({"poor": True}, "ambiguous", "too poor for any claim"),
    ],
)
def test_how_sure_follows_the_verdict(case, verdict, says):
    study, outcome = told(**case)
    assert outcome.verdict == verdict and says in how_sure(study, outcome)
    if outcome.selected and not outcome.evidence.poor:
        for figure in ("92 % [88 to 95]", "86 % of repeated", "87 % had the physics that was named first"):
            assert figure in how_sure(study, outcome)


def test_what_is_not_explained_is_a_number_and_what_was_not_recorded():
    text = not_explained(*told(after=0.86))
    assert text.startswith("0.74 mm beside the noise (the error is 2 times the noise).")  # 0.86^2 - 0.43^2
    assert "not recorded: gravity." in text
    assert "0.43 mm is the noise" in not_explained(*told(selected=(), after=0.43))


def test_what_to_record_next_is_the_laws_own():
    assert next_experiment(*told())[0] == "To confirm creep as lag(p): Step and hold."
    assert next_experiment(*told(after=0.9))[0] == "To see creep as lag(p): Step and hold."
    assert next_experiment(*told(selected=(), after=0.43))[0] == "Nothing."
