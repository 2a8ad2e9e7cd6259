"""Demonstrations of the independent stand-in: compared, diagnosed, added, and their light taken."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import played
import pytest
from verbs import verb

from lerobot_pneutac import Demonstrations, InputError, Recording, Twin, add, calibrate, compare, diagnose
from lerobot_robot_pneutac.standin.world import Physics, new_gel
from pneutac_datasets.generate.standin import write_finger, write_gel
from pneutac_sim.features import AREA, CONTROL_HZ

GOLDEN = Path(__file__).parents[2] / "golden" / "recordings"


def shown(*which):
    return Demonstrations(Path("shown"), "button", played.shown(*which))


@pytest.fixture(scope="module")
def two():
    return shown(2, 20)


def with_gel(twin):
    """The twin, lit at rest as the stand-in is."""
    from pneutac_sim.gel.model import GelModel

    twin = twin.copy()
    replace(GelModel.from_twin(twin), rest_image=new_gel().rest_image).into_twin(twin)
    return twin


@pytest.mark.slow
def test_a_comparison_tells_phases_latency_and_light(two, tmp_path):
    result = compare(Twin.builtin(), two)
    told = result.to_dict()
    assert [r["bin"] for r in told["by"]["phase"]] == ["free", "onset", "pressed", "release"]
    assert told["latency_s"] == pytest.approx(1 / CONTROL_HZ, abs=0.01)  # the stand-in's own
    free = told["by"]["phase"][0]
    assert free["touch"] < 0.1 * free["arm"] and told["by"]["phase"][2]["touch"] > 0.2
    assert told["light"]["drifted"]  # the built-in gel is lit otherwise
    for row, e in zip(told["by"]["episode"], two.episodes, strict=True):
        assert abs(row["onset_s"] - e.contact()[0] / CONTROL_HZ) < 1e-9
        assert abs(row["onset_replayed_s"] - row["onset_s"]) < 0.5
    page = result.report(tmp_path).read_text()
    assert "image/webp" in page and (tmp_path / "touch.png").is_file()
    assert "Commands acted 0.0" in " ".join(result.remarks())
    assert result.drift_s == pytest.approx(0.0, abs=0.5 / CONTROL_HZ)
    assert "clocks of camera and robot drift" not in " ".join(result.remarks())


@pytest.mark.slow
def test_a_clock_of_the_camera_that_jumps_in_the_midst_is_told(two):
    frames = 6

    def apart(e):
        first, last = e.contact()
        lag = frames / 2 * (np.arange(len(e)) > (first + last) / 2)  # from the middle of the touch on
        source = np.clip(np.round(np.arange(len(e)) - lag), 0, len(e) - 1).astype(int)
        state = e.state.copy()
        state[:, AREA] = e.state[source, AREA]
        return replace(e, state=state, images=e.images[source])

    told = compare(Twin.builtin(), replace(two, episodes=[apart(two.episodes[0])]))
    jump_s = 0.5 * frames / CONTROL_HZ
    assert told.drift_s == pytest.approx(jump_s, abs=0.5 / CONTROL_HZ)
    assert "clocks of camera and robot drift" in " ".join(told.remarks())


@pytest.mark.slow
def test_light_at_rest_is_taken_and_a_drift_is_told(two):
    twin = with_gel(Twin.builtin())
    same = calibrate(twin, two)
    assert not same.light.drifted
    red = [
        replace(e, images=np.clip(e.images * np.array([1.2, 1, 1]), 0, 255).astype(np.uint8))
        for e in two.episodes
    ]
    drifted = calibrate(twin, replace(two, episodes=red))
    assert drifted.light.drifted and "has changed" in drifted.sentence
    assert drifted.error["heldout"] < 0.5 * drifted.before
    assert not calibrate(drifted.twin, replace(two, episodes=red)).light.drifted


@pytest.mark.slow
def test_what_does_not_go_with_demonstrations_is_refused(two):
    with pytest.raises(InputError, match="fidelity=mpm does not replay demonstrations"):
        compare(Twin.builtin(), two, fidelity="mpm")
    with pytest.raises(InputError, match="is of a finger and the twin of an arm"):
        compare(Twin(device="arm", length_mm=200.0), two)
    wrong = add(Twin.builtin(), two, "base_tilt")
    assert not wrong.accepted and "Demonstrations cannot show 'base_tilt'" in wrong.reason
    alone = add(Twin.builtin(), two, "compliance")
    assert not alone.accepted and "is found by a diagnosis only; give its folder with --from" in alone.reason
    assert "2 demonstrations are too few" in add(Twin.builtin(), two, "late_commands").reason


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A twin that was measured on the stand-in's bench and then fitted to its demonstrations."""
    folder = tmp_path_factory.mktemp("measured")
    finger = write_finger(folder / "finger")
    twin = calibrate(Twin.builtin(), finger).twin
    twin = add(twin, finger, diagnose(twin, finger, jobs=1)).twin
    twin = calibrate(twin, Recording.load(write_gel(folder / "gel").folder)).twin
    twin.save(folder / "twin")
    plain = shown(10, 300)
    result = add(Twin.load(folder / "twin"), plain, diagnose(Twin.load(folder / "twin"), plain, jobs=1))
    return result.save(folder / "twin").twin


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("hidden", "found", "shows", "left"),
    [
        (Physics(late_commands=3), "late_commands", "heldout", 0.5),
        (Physics(creep=0.5), "creep", "touch", 0.8),
        (Physics(), None, "heldout", 1.0),
    ],
)
def test_ten_demonstrations_reveal_what_is_hidden_in_the_stand_in(measured, hidden, found, shows, left):
    """Commands three steps late instead of one, creep three times as large, and nothing.

    Arm and gauge, most of the whole error, know nothing of creep: touch alone shows it.
    """
    from lerobot_pneutac.diagnosis.thresholds import NOISE
    from pneutac_sim.effects.laws import family

    diagnosis = diagnose(measured, shown(10, 100, hidden), jobs=1)
    assert ([family(e) for e in diagnosis.selected][:1] or [None]) == [found]
    assert diagnosis.after[shows] <= left * diagnosis.before[shows]
    assert diagnosis.after["heldout"] <= min(diagnosis.before["heldout"], NOISE * diagnosis.study.noise.floor)


@pytest.mark.nightly
def test_what_demonstrations_tell_does_not_spoil_the_bench(tmp_path):
    """A twin of the bench alone: not held to its free bend, it would err there by a third more."""
    finger = write_finger(tmp_path / "finger", 15)
    twin = calibrate(Twin.builtin(), finger).twin
    twin = calibrate(twin, Recording.load(write_gel(tmp_path / "gel", 15).folder)).twin
    plain = shown(10, 10300)
    added = add(twin, plain, diagnose(twin, plain, jobs=1))
    assert added.before and added.after and added.after["heldout"] < 0.5 * added.before["heldout"]
    before, after = (compare(t, finger).error["heldout"] for t in (twin, added.twin))
    assert after < 1.1 * before


@pytest.mark.parametrize(("name", "option"), [("compare", "--later"), ("report", "--rrd")])
def test_what_takes_bench_recordings_alone_says_so(name, option, tmp_path):
    twin, value = Twin.builtin().save(tmp_path / "twin"), tmp_path / "out.rrd"
    with pytest.raises(InputError, match="demos holds demonstrations; .* a bench recording of the device."):
        verb(name, f"{option}={value}", twin=twin, recording=GOLDEN / "demos")
