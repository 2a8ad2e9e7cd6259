"""What a newcomer reads first of a diagnosis: causes, confidence, warnings, the next step.

Reports open offline and carry no NaN; the command line says what is not there yet.
"""

import re
from itertools import product
from types import SimpleNamespace

import numpy as np
import plotly.graph_objects as go
import pytest

from lerobot_pneutac.diagnosis.result import Contribution
from lerobot_pneutac.diagnosis.verdict import NONE, Evidence, Explained, Mechanism, decide, explained
from lerobot_pneutac.reports.page import Report, write_result
from lerobot_pneutac.reports.sentences import (
    Confidence,
    Kind,
    State,
    alternatives,
    do_next,
    evidence,
    explanation,
    headline,
    hedged,
    meaning,
    mechanism,
    next_experiment,
    state_of,
    warnings,
)  # fmt: skip
from pneutac_sim.effects.laws import law
from pneutac_sim.twin import Twin

LAW = "lag(p)"
ADD = "pneutac add --twin=finger --recording=monday --from=found"


def given(selected=(LAW,), after=0.45, contributions=(), known=(), run_terms=None, **evidence):
    """A study and an outcome, as far as sentences ask, from 0.8 mm to `after` where the noise is 0.43 mm."""
    error = {"before": 0.8 / 0.43, "after": after / 0.43}
    e = Evidence(**error | {"selected": list(selected), "removed": 0.9 if selected else 0.0} | evidence)
    constants = {"weight": 0.1, "scale_kpa": 25.0, "time_s": 8.0, "width_kpa": 5.0}
    study = SimpleNamespace(
        recording=SimpleNamespace(device="finger"), unit="mm", findings=["The clock jumps."],
        noise=SimpleNamespace(value=0.43, how="from two repeated runs"), parts=SimpleNamespace(has_test=True),
        errors=lambda model: {"heldout": model}, reduction=lambda a, b: (0.92, (0.88, 0.95)),
        cause=lambda model, name: law(name).as_cause(constants, "finger"), caveats=lambda outcome: [],
        to_log=lambda outcome: "",
        confusable_with=lambda effects: "It may be a load." if "lag(p^2)" in effects else "",
        experiment=lambda model, name: "Step and hold.", too_little=lambda: "Too short.",
        recorded="", more_data="Record longer.", repeat="Do it twice.", nothing_left="Nothing.",
        untested=[SimpleNamespace(name="gravity", reason="record column gravity_x")],
    )  # fmt: skip
    outcome = SimpleNamespace(
        evidence=e, verdict=decide(e), selected=list(selected), before=0.8, after=after, rivals=[], tested=[],
        chosen_in=dict.fromkeys(selected, 6 / 7), known=list(known), run_terms=run_terms,
        contributions=list(contributions), explained=explained(e), mechanisms=[creep(0.874)], not_yet="",
        twin=Twin("finger", 110.0), named=list(selected),
    )  # fmt: skip
    return study, outcome


def creep(right: float) -> Mechanism:
    return Mechanism("creep", (("creep", right), (NONE, 1 - right)), ())


def text_of(s: State) -> list[str]:
    """All sentences of one state."""
    return [headline(s), meaning(s), *warnings(s), do_next(s, ADD), alternatives(s), evidence(s)]


def test_the_headline_lists_the_causes_by_size_without_equations():
    one = headline(state_of(*given()))
    assert one.startswith(
        "One thing is missing from the model: creep, time constant 8 s. With it the test error"
    )
    assert (
        "from 0.8 to 0.45 mm (noise 0.43 mm). Explained: fully. The error is 1.05 times the noise; up to"
        in one
    )
    assert one.endswith("Mechanism: creep is certain (87 %).")
    study, outcome = given()
    outcome.mechanisms = [creep(0.6)]
    unsure = headline(state_of(study, outcome))
    assert unsure.startswith("One thing is missing from the model and behaves like creep, time constant 8 s.")
    worth = [
        Contribution("lag(p)", False, 0.5, 0.45, (0.1, 0.05, 0.2)),
        Contribution("play(p)", True, 0.7, 0.45, (0.3, 0.2, 0.4)),
    ]
    study, outcome = given(selected=(LAW, "play(p)"), contributions=worth, known=("play(p)",))
    two = headline(state_of(study, outcome))
    assert "Two things are missing from the model: (1) hysteresis, width 5 kPa; (2) creep" in two
    assert "With both the test error" in two and "[" not in two and "lag(p)" not in two


def test_what_single_runs_have_of_their_own_is_apart():
    s = state_of(*given(after=0.6, run_terms={"error": 0.44}))
    assert "from 0.8 to 0.6 mm, and to 0.44 mm without each run's own offset (noise 0.43 mm)" in headline(s)


@pytest.mark.parametrize(
    ("case", "verdict", "confidence"),
    [
        ({}, "missing_effect", Confidence.CONFIRMED),
        ({"after": 0.6}, "missing_effect", Confidence.LIKELY),
        ({"after": 0.9, "noise_known": False}, "missing_effect", Confidence.LIKELY),
        ({"selected": ("lag(p^2)",)}, "missing_effect", Confidence.LIKELY),
        ({"after": 0.9}, "insufficient_form", Confidence.UNNAMED),
        ({"forward": False}, "insufficient_form", Confidence.UNNAMED),
        ({"removed": 0.2, "after": 0.7}, "unknown_effect", Confidence.INCONCLUSIVE),
        ({"selected": (), "after": 0.43}, "adequate", Confidence.CONFIRMED),
        ({"poor": True}, "ambiguous", Confidence.INCONCLUSIVE),
    ],
)
def test_confidence_follows_the_verdict_and_what_is_open(case, verdict, confidence):
    study, outcome = given(**case)
    assert outcome.verdict == verdict and state_of(study, outcome).confidence is confidence


def test_warnings_have_findings_of_the_data_and_what_was_not_tested():
    told = warnings(state_of(*given(after=0.9)))
    assert told[0].startswith("A check failed: the error stays at 2.1 times the noise")
    assert (
        "The clock jumps." in told
        and told[-1] == "Not tested: the weight of the body (record column gravity_x)."
    )


def test_what_to_record_next_is_the_effects_own():
    assert next_experiment(*given())[0] == "To confirm creep (lag(p)): Step and hold."
    assert next_experiment(*given(selected=(), after=0.43))[0] == "Nothing."
    study, outcome = given(selected=(), near_miss=["creep"])
    outcome.not_yet = "Record about 12 more minutes of the same programs."
    assert next_experiment(study, outcome)[0] == outcome.not_yet


CAUSES = ((), ("creep",), ("the finger's own weight", "creep"))


def states():
    """Every combination of what the sentences depend on that a diagnosis can end in."""
    flags = product(
        ("adequate", "missing_effect", "insufficient_form", "unknown_effect", "ambiguous"), CAUSES,
        ("noise", "above", "unknown"), (True, False), ("", "Too short."), (True, False), (True, False),
        (True, False), (0.9, 0.35, None), (True, False),
    )  # fmt: skip
    for verdict, causes, level, measured, poor, rivals, lower, objection, right, runs in flags:
        if (verdict == "missing_effect" and not causes) or (poor and verdict != "ambiguous"):
            continue
        if verdict == "adequate" and (causes or level == "above"):
            continue
        if verdict == "ambiguous" and causes and not poor:
            continue
        if verdict == "missing_effect" and objection:
            continue
        if level == "unknown" and measured:
            continue
        after, failed = 0.45 if level == "noise" else 0.9, "a bound was reached"
        if level == "above":
            failed = "a black box still removes 40 % of what is left"
        yield State(
            device="finger", unit="mm", verdict=verdict, before=2.0, after=after + 0.1 * runs, rest=after,
            noise=None if level == "unknown" else 0.43, noise_how="cannot be determined from this recording",
            noise_measured=measured, at_noise=level == "noise", poor=poor, causes=causes,
            known=len(causes) // 2, removed=(0.9, (0.8, 0.95)) if causes else (0.0, (0.0, 0.0)),
            rivals=(("creep", "hysteresis"),) if rivals and causes else (),
            lower=("hysteresis",) if lower and causes else (),
            near_miss=("friction",) if verdict == "ambiguous" else (),
            objections=(failed,) if objection and causes else (),
            black_box=0.4 if level == "above" and objection else 0.0,
            explained=Explained.FULLY if level == "noise" and not poor else Explained.UNDETERMINED,
            mechanisms=() if right is None or not causes else (creep(right),),
            unnamed=("creep",) if right == 0.35 and causes else (),
            agreed=0.9 if causes else None, untested=("thermal: record column temperature_c",),
            experiment="Step and hold.",
        )  # fmt: skip


def right_of(s: State) -> float | None:
    return s.mechanisms[0].probability if s.mechanisms else None


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {},
            "Explained: fully. The error is 1.05 times the noise, 95 % interval 1.00 to 1.10; up to 1.2",
        ),
        (
            {"rest": 0.56, "later": 1.0, "program": 1.1},
            "with later rows and other programs 1.12 times, and up to",
        ),
        ({"recorded": "up to 60 kPa"}, "fully, as far as was recorded (up to 60 kPa). The error is 1.05"),
        ({"recorded": "up to 60 kPa", "where": "where it is dry"}, "(up to 60 kPa), where it is dry. The"),
        ({"later": 1.4, "explained": Explained.MOSTLY}, "but 1.40 times the noise in the last part"),
        (
            {"later": 1.1, "program": 1.8, "explained": Explained.MOSTLY},
            "but 1.80 times the noise in programs that are predicted from all others",
        ),
        (
            {"explained": Explained.UNDETERMINED},
            "known too roughly: 1.05 times the noise, 95 % interval 1.00 to 1.10, and above 1.5 times",
        ),
        (
            {"explained": Explained.UNDETERMINED, "noise_too_large": True, "noise_measured": False},
            "since the noise is estimated too large: the error is 1.05 times the estimated noise",
        ),
        ({"at_noise": False, "rest": 0.9, "explained": Explained.NO}, "Explained: no. The error is 2.00"),
        ({"noise": None}, "Explained: undetermined, since the noise is not known."),
        ({"noise_measured": False}, "1.05 times the estimated noise"),
        ({"poor": "Too short."}, ""),
    ],
)
def test_how_much_is_explained_is_one_sentence(change, said):
    base = {
        "device": "finger", "unit": "mm", "verdict": "missing_effect", "before": 2.0, "after": 0.4725,
        "rest": 0.4725, "noise": 0.45, "at_noise": True, "causes": ("creep",), "explained": Explained.FULLY,
        "interval": (1.0, 1.1),
    }  # fmt: skip
    s = State(**(base | change))
    text = explanation(s)
    assert (said in text) if said else text == ""


def test_a_mechanism_that_is_not_certain_shows_the_ranks_that_count():
    ranked = (("creep", 0.55), (NONE, 0.39), ("leak", 0.04), ("valve_lag", 0.02))
    s = State(
        device="finger", unit="mm", verdict="missing_effect", before=2.0, after=0.45, rest=0.45, noise=0.45,
        causes=("creep", "friction"), mechanisms=(Mechanism("creep", ranked, ()), creep(0.9)),
    )  # fmt: skip
    first = "what looks like creep is creep 55 %, none of these 39 %"
    assert mechanism(s) == f"Mechanism: {first}; creep is certain (90 %)."


def test_how_the_device_is_mounted_is_no_effect_that_is_missing():
    both = given(("creep", "base_tilt"))
    both[0].cause = lambda model, name: {"creep": "creep", "base_tilt": "a tilted base"}[name]
    assert headline(state_of(*both)).startswith(
        "One thing is missing from the model: creep. With it and a tilted base the test error falls"
    )
    mount = given(("base_tilt",))
    mount[0].cause = both[0].cause
    assert headline(state_of(*mount)).startswith("The model lacks no effect that this recording shows.")


def test_a_name_below_the_limit_is_no_fact_in_the_description_either():
    text = "Your finger creeps."
    assert hedged(text, "creep", [creep(0.9)]) == text == hedged(text, "leak", [creep(0.5)])
    assert hedged(text, "creep", [creep(0.5)]) == "creep is not certain (50 %). As an equation: " + text


def test_no_two_sentences_of_any_state_contradict_each_other():
    count = 0
    for s in states():
        count += 1
        said, first = " ".join(text_of(s)), headline(s)
        at_noise = "at the noise" in said or "at the estimated noise" in said
        unexplained = "no known effect describes" in said or "is unexplained" in said
        assert not (at_noise and unexplained), said
        assert not (s.at_noise and unexplained), said
        assert ("Explained: fully" in said) == (s.explained is Explained.FULLY), said
        assert ("creep is certain" in said) == (right_of(s) == 0.9 and not s.poor), said
        assert not ("Nothing is missing" in said and ("missing from the model" in said or unexplained)), said
        assert not (
            "No other effect" in said and ("reaches a slightly lower" in said or "about as well" in said)
        )
        assert said.lower().count("a black box ") - said.count("nor a black box") <= 1, said
        assert not ("every check passed" in said and "A check failed" in said), said
        assert not ("does not decide" in said and s.confidence is not Confidence.INCONCLUSIVE), said
        if s.confidence is Confidence.INCONCLUSIVE:
            assert " add " not in do_next(s, ADD), said
            assert " is missing from the model" not in first and " are missing from the model" not in first, (
                said
            )
        if s.confidence is Confidence.CONFIRMED:
            assert s.noise is not None and s.at_noise and "estimate" not in said, said
            assert right_of(s) in (0.9, None), said
        if s.confidence is Confidence.LIKELY:
            open_ = [w for w in warnings(s) if not w.startswith("Not tested")]
            assert open_ or right_of(s) == 0.35, said
        if s.noise is None and not s.poor:
            assert "noise 0.43" not in said and "above the noise" not in said, said
            assert "noise unknown" in said or "cannot be determined" in said, said
        if "No effect" in said or s.kind is Kind.UNKNOWN:
            assert not s.causes
        assert first.count("Explained: ") == (not s.poor) and do_next(s, ADD) and "OUT/" not in said
        if s.kind is Kind.CAUSES and s.unnamed:
            assert "(2)" not in first and "none is likelier: creep." in first
        elif s.kind is Kind.CAUSES and len(s.causes) == 2:
            assert "(1) the finger's own weight; (2) creep" in first
    assert count > 1000


def test_page_has_no_outside_reference_and_escapes_text(tmp_path):
    report = Report("A <title>")
    report.lead("1 < 2 and `code`")
    report.table([{"a": 1.23456, "b": None, "c": True}])
    report.image(np.zeros((4, 5, 3), np.uint8), "black")
    report.figure(go.Figure(go.Scatter(x=[0, 1], y=[0, 1])))
    page = report.write(tmp_path).read_text()
    assert (tmp_path / "report.html").is_file()
    assert "A &lt;title&gt;" in page and "1 &lt; 2 and <code>code</code>" in page and "1.235" in page
    markup = re.sub(r"<script>.*?</script>", "", page, flags=re.S)
    assert not re.search(r'(src|href)="(https?:|//)', markup) and "<script src" not in page
    assert re.search(r'Plotly.newPlot\(\s*"figure1"', page)


def test_result_refuses_nan(tmp_path):
    assert write_result(tmp_path, {"x": np.float32(1.5), "y": np.arange(2)}).read_text().count("1.5") == 1
    with pytest.raises(ValueError, match="JSON"):
        write_result(tmp_path, {"x": float("nan")})
