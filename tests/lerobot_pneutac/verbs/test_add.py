"""`pneutac add`: the error falls and a version is written, or nothing is written and the numbers are told."""

import json
import re
from pathlib import Path
from types import SimpleNamespace

import pytest
from generated import once, twin_of
from verbs import refused, verb

from lerobot_pneutac import add, compare
from lerobot_pneutac.verbs.add import Addition
from lerobot_pneutac.verbs.diagnose import BEFORE, FOUND, read_found
from lerobot_pneutac.verbs.new import new_twin
from pneutac_datasets.generate.finger import generate
from pneutac_datasets.generate.gel import write_gel_recording
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """A short recording with hidden creep, and a plain twin of the same finger."""
    folder = tmp_path_factory.mktemp("add")
    once(generate, ["creep"], folder / "recording", 5003, minutes=3.0, hz=10)
    twin = new_twin("finger", Recording.load(folder / "recording"))
    return twin.save(folder / "twin"), folder / "recording"


def test_adding_the_hidden_effect_writes_the_next_version(pair, tmp_path):
    twin, recording = pair
    verb("add", twin=twin, recording=recording, effect="creep", out=tmp_path)
    result = json.loads((tmp_path / "result.json").read_text())
    assert result["after"]["heldout"] < 0.5 * result["before"]["heldout"]
    assert result["after"]["heldout_ci95"][1] < result["before"]["heldout_ci95"][0]
    assert any(p["value"] > 0.01 for p in result["parameters"].values())
    page = (tmp_path / "report.html").read_text().split("<main>")[1]
    assert "Your finger creeps" in page and "(a ratio)" in (tmp_path / "report.html").read_text()
    new = Twin.load(twin)
    assert "creep" in new.effects and new.history[-1]["change"] == "added creep"
    assert new.history[-1]["heldout"] == pytest.approx(result["after"]["heldout"])
    assert (twin / "history" / "000" / "twin.yaml").is_file()
    refused("has the effect 'creep' already", "add", twin=twin, recording=recording, effect="creep")


@pytest.mark.slow
def test_what_speaks_against_a_diagnosis_is_told_where_its_finding_is_added(pair, tmp_path):
    _, folder = pair
    recording = Recording.load(folder)
    twin = twin_of(recording)
    named = add(twin, recording, "creep")
    twin.save(tmp_path / BEFORE)
    named.twin.save(tmp_path / FOUND)
    objection = "fitted to the earlier part, less than half of its improvement stays in the later one"
    told = {"verdict": "insufficient_form", "rows": len(recording), "seed": 0, "selected": ["creep"]}
    (tmp_path / "result.json").write_text(json.dumps(told | {"objections": [objection]}))
    added = add(twin, recording, tmp_path)
    assert added.accepted and added.to_dict()["objections"] == [objection]
    assert f"[yellow]warnings of the diagnosis:[/] {objection}" in added.remarks()
    assert objection in added.page().fragment()
    assert not named.objections and not [r for r in named.remarks() if "warnings of" in r]


def test_what_touch_told_asks_for_the_bench_again(tmp_path):
    bench = {"version": 0, "change": "calibrated", "recording": "bench/finger"}
    twin = Twin("finger", 110.0, (13.75, 41.25, 68.75, 96.25), history=[bench])
    after = {"train": 0.5, "heldout": 0.6, "heldout_ci95": (0.5, 0.7)}
    given = {"effect": "creep", "accepted": True, "reason": "", "twin": twin, "recording": "demos", "seed": 0}
    named = Addition(**given, after=after).save(tmp_path / "a").remarks()
    told = Addition(**given, after=after | {"touch": 0.3}).save(tmp_path / "b").remarks()
    assert not [r for r in named if "free bend" in r]
    assert f"`pneutac calibrate --twin={tmp_path / 'b'} --recording=bench/finger`" in told[-1]


def test_an_effect_that_does_not_help_is_refused_with_numbers(pair, tmp_path):
    _, recording = pair
    r = Recording.load(recording)
    twin = new_twin("finger", r).save(tmp_path / "twin")
    before = (twin / "twin.yaml").read_text()
    with pytest.raises(
        InputError,
        match="Not added: loss of pressure during holds changes nothing; its constants end where it does",
    ):
        verb("add", twin=twin, recording=recording, effect="leak")
    assert (twin / "twin.yaml").read_text() == before and not (twin / "history").exists()


@pytest.mark.slow
def test_a_fall_that_is_not_significant_says_how_much_more_to_record(tmp_path):
    once(generate, ["creep"], tmp_path / "short", 5003, minutes=2.0, hz=10)
    r = Recording.load(tmp_path / "short")
    added = add(twin_of(r), r, "friction")
    number = r"([\d.]+)"
    found = re.search(
        rf"not significant yet: .* by {number} \[-.* show a fall of {number} mm\^2 with a power of 80 %, so "
        rf"record about {number} more minutes of the same programs; --anyway stores it now",
        added.reason,
    )
    assert found and not added.accepted
    fall, least, more = map(float, found.groups())
    assert more == pytest.approx(len(r) / 600 * ((least / fall) ** 2 - 1), abs=1.1), "600 rows a minute"


@pytest.mark.slow
def test_an_effect_in_whose_place_another_explains_more_is_refused_and_stored_only_as_unconfirmed(
    pair, tmp_path
):
    recording = Recording.load(pair[1])
    twin = twin_of(recording)
    refused = add(twin, recording, "hysteresis")
    assert not refused.accepted and refused.twin is twin and not refused.unconfirmed
    assert (
        refused.instead
        and refused.instead in refused.reason
        and refused.instead_error < refused.after["heldout"]
    )
    anyway = add(twin, recording, "hysteresis", anyway=True)
    assert (anyway.accepted, anyway.unconfirmed, anyway.reason) == (False, True, refused.reason)
    anyway.save(tmp_path / "twin")
    stored = Twin.load(tmp_path / "twin")
    assert "hysteresis" in stored.effects and stored.history[-1]["change"] == "added hysteresis (unconfirmed)"


@pytest.mark.nightly  # every day: one effect that changes nothing is refused
@pytest.mark.slow
def test_of_two_effects_the_one_that_adds_nothing_is_named(pair):
    recording = Recording.load(pair[1])
    twin = twin_of(recording)
    result = add(twin, recording, ["creep", "leak"])
    assert not result.accepted and "loss of pressure during holds changes nothing" in result.reason
    worth = {c.name: c.error_without - c.error_with for c in result.contributions}
    assert worth["creep"] > 10 * abs(worth["leak"])


def test_a_gels_diagnosis_in_a_folder_is_refused(tmp_path):
    write_gel_recording(tmp_path / "recording", seed=0, heldout=3)
    verb("calibrate", twin=tmp_path / "twin", recording=tmp_path / "recording", effects="none")
    recording, twin = Recording.load(tmp_path / "recording"), Twin.load(tmp_path / "twin")
    for name in (BEFORE, FOUND):
        twin.save(tmp_path / "d" / name)
    told = {"verdict": "missing_effect", "rows": len(recording), "seed": 0, "selected": []}
    (tmp_path / "d" / "result.json").write_text(json.dumps(told))
    with pytest.raises(InputError, match="added by name; give --effect=A,B"):
        add(twin, recording, tmp_path / "d")


def test_an_effect_without_its_column_is_refused(pair, tmp_path):
    _, recording = pair
    r = Recording.load(recording)
    r.samples = r.samples.drop(columns=["temperature_c"])
    r.write(tmp_path / "cold")
    twin = new_twin("finger", r).save(tmp_path / "twin")
    refused("record column temperature_c", "add", twin=twin, recording=tmp_path / "cold", effect="thermal")


@pytest.mark.nightly  # every day: the same of creep, in test_api
@pytest.mark.slow
def test_every_verb_sees_the_fall_of_a_pneumatic_effect(tmp_path, no_soft_body):
    """Errors are counted from the command, so a slow valve is in them although the pressure was measured."""
    once(generate, ["valve_lag"], tmp_path / "recording", 5001, minutes=3.0, hz=10)
    recording = Recording.load(tmp_path / "recording")
    folder = new_twin("finger", recording).save(tmp_path / "twin")
    verb("calibrate", twin=folder, recording=recording.folder)

    def heldout():
        twin = Twin.load(folder)
        return compare(twin, recording).heldout

    plain = heldout()
    assert Twin.load(folder).history[-1]["heldout"] == pytest.approx(plain, rel=0.02)
    verb("add", twin=folder, recording=recording.folder, effect="valve_lag")
    assert heldout() < 0.5 * plain


@pytest.mark.parametrize(
    ("baseline", "says"),
    [
        (1.418, "the weight at the tip leaves the test error at 1.42 mm"),
        (1.1, "the weight at the tip lowers the test error from 1.42 to 1.1"),
    ],
)
def test_known_causes_are_said_to_lower_only_what_they_lower(baseline, says):
    errors = [{"train": e, "heldout": e, "heldout_ci95": (e, e)} for e in (1.42, baseline, 0.46)]
    given = {"twin": Twin("finger", 90.0), "recording": "r", "seed": 0, "unit": "mm", "known": ("payload",)}
    given |= dict(zip(("before", "baseline", "after"), errors, strict=True), findings=("a note.",))
    named = Addition(effect="creep, payload", accepted=True, reason="", **given)
    assert says in named.sentence
    assert len(named.rows()) == 3 and named.findings_shown
    found = Addition(effect="creep, payload", accepted=True, reason="", diagnosed=True, **given)
    assert not found.rows() and not found.findings_shown  # the diagnosis has shown both
    assert "with known causes (the weight at the tip)" in found.page().fragment()


def test_an_effect_that_is_named_twice_is_refused_before_it_is_fitted(pair):
    twin, recording = pair
    refused(
        "effect names 'creep' twice; give it once",
        "add",
        twin=twin,
        recording=recording,
        effect="creep,creep",
    )


def test_where_there_is_no_diagnosis_the_command_that_makes_one_is_whole(tmp_path):
    twin, recording = SimpleNamespace(folder=Path("my twin")), SimpleNamespace(folder=Path("bench"))
    with pytest.raises(
        InputError, match=r"`pneutac diagnose --twin='my twin' --recording=bench --out=.*/d`\."
    ):
        read_found(tmp_path / "d", twin, recording)
