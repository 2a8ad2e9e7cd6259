"""A device that was mounted anew is moved back and reported; one that remembers is left as measured."""

import numpy as np
import pytest
from generated import once
from scipy import signal
from scipy.spatial.transform import Rotation

from lerobot_pneutac.diagnosis.bootstrap import deal
from pneutac_datasets.generate.finger import generate
from pneutac_datasets.recording.mounts import align_mounts, moved, remounted
from pneutac_datasets.recording.recording import Recording
from pneutac_truths import generate as truth
from pneutac_truths import write

TIP = ["tip_x_mm", "tip_y_mm", "tip_z_mm"]
AGAIN = (3, 4, 5)  # trials of six after the device was taken off and put back


def cut(recording, into=6):
    """The main trial as several that begin in the middle of its memory."""
    s = recording.samples.iloc[recording.trials()[0]].reset_index(drop=True)
    s["trial"] = np.arange(len(s)) * into // len(s)
    s["time_s"] -= s.groupby("trial")["time_s"].transform("min")
    return with_samples(recording, s)


def with_samples(recording, samples):
    return Recording(recording.folder, recording.meta, samples, recording.device)


def ringing(recording):
    """Each trial starts at its first pose and swings at 1 Hz, damped by a tenth."""
    w, samples = 2 * np.pi, recording.samples.copy()
    b, a, _ = signal.cont2discrete(([w * w], [1, 0.2 * w, w * w]), 0.05)
    for rows in recording.trials().values():
        y = samples[TIP].to_numpy()[rows]
        swung = signal.lfilter(b.ravel(), a, y - y[0] * 0.5, axis=0)
        samples.loc[samples.index[rows], TIP] = swung + y[0] * 0.5
    return with_samples(recording, samples)


def angle_of(recording):
    """Only the bend was measured: of an arc, twice the tip's elevation."""
    s = recording.samples
    s = s.assign(bend_angle_rad=2 * np.arctan2(s["tip_z_mm"], s["tip_x_mm"]))
    return with_samples(recording, s.drop(columns=TIP))


def height_of(recording):
    return with_samples(recording, recording.samples.drop(columns=["tip_x_mm", "tip_y_mm"]))


def put_back(recording, move, trials=AGAIN):
    """The headline of these trials as it is seen after the device was put back."""
    s = recording.samples.copy()
    columns = [c for c in (*TIP, "bend_angle_rad") if c in s]
    rows = s.index[s["trial"].isin(trials)]
    s.loc[rows, columns] = move(s.loc[rows, columns].to_numpy())
    return with_samples(recording, s)


def finger(tmp_path_factory, effect, strength=1.0):
    folder = tmp_path_factory.mktemp("mounts") / effect
    once(generate, effect, folder, seed=4, strength=strength, minutes=5)
    return Recording.load(folder)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return finger(tmp_path_factory, "none")


@pytest.fixture(scope="module")
def creeping(tmp_path_factory):
    return finger(tmp_path_factory, "creep", 3.0)


@pytest.mark.parametrize("seen", [lambda r: r, angle_of, height_of], ids=["tip", "angle", "height"])
def test_a_creeping_finger_is_left_as_measured(creeping, seen):
    for recording in (creeping, cut(creeping)):
        r = seen(recording)
        same, sentences = align_mounts(r, r.length_mm, r.split(0)[0])
        assert sentences == [] and same is r


@pytest.mark.parametrize("effect", ["cyclic_softening", "sensor_offset"])
def test_other_memories_and_drift_are_left_as_measured(tmp_path_factory, effect):
    r = finger(tmp_path_factory, effect, 2.0)
    assert align_mounts(r, r.length_mm)[1] == [] and align_mounts(cut(r), r.length_mm)[1] == []


def test_a_ringing_finger_is_left_as_measured(plain):
    for r in (ringing(plain), ringing(cut(plain)), angle_of(ringing(cut(plain)))):
        same, sentences = align_mounts(r, r.length_mm)
        assert sentences == [] and same is r


MOVES = {
    "turned about its axis and shifted": lambda y: (
        Rotation.from_euler("x", 180, degrees=True).apply(y) + [9, 2, 0]
    ),
    "tilted": lambda y: Rotation.from_rotvec([0.1, -0.25, 0.15]).apply(y) + [0, 5, -8],
    "shifted": lambda y: y + [4.0, -3.0, 9.0],
}


@pytest.mark.parametrize("how", MOVES)
def test_a_finger_that_was_put_back_otherwise_is_moved_and_that_is_reported(plain, how):
    r = cut(plain)
    train = r.split(0)[0]
    back, sentences = align_mounts(put_back(r, MOVES[how]), r.length_mm, train)
    assert len(sentences) == 1 and "mounted differently in trials 3 to 5:" in sentences[0]
    assert np.abs(back.samples[TIP] - r.samples[TIP]).max().max() < 0.5  # its noise is 0.3 mm
    early = r.column("trial") < 3
    np.testing.assert_array_equal(back.samples[TIP][early], r.samples[TIP][early])


@pytest.mark.parametrize("seen", [angle_of, height_of], ids=["angle", "height"])
def test_one_coordinate_is_shifted(plain, seen):
    r = seen(cut(plain))
    (column,) = r.observations
    offset = 0.4 if column.endswith("rad") else 25.0
    back, sentences = align_mounts(put_back(r, lambda y: y + offset), r.length_mm, r.split(0)[0])
    assert len(sentences) == 1 and "are shifted onto the first mount" in sentences[0]
    assert np.abs(back.column(column) - r.column(column)).max() < 0.05 * offset


def test_a_creeping_finger_that_was_put_back_keeps_its_creep(creeping):
    r = cut(creeping)
    turned = put_back(r, MOVES["turned about its axis and shifted"])
    back, sentences = align_mounts(turned, r.length_mm, r.split(0)[0])
    assert len(sentences) == 1 and "trials 3 to 5:" in sentences[0]
    again = np.isin(r.column("trial"), AGAIN)
    off = np.linalg.norm(back.samples[TIP].to_numpy() - r.samples[TIP].to_numpy(), axis=1)[again]
    assert np.sqrt(np.mean(off**2)) < 2.0


def test_a_model_places_trials_that_a_map_of_the_pressure_left_and_only_those_that_lie_far_away(plain):
    r = cut(plain)
    rows, truth = r.split(0)[0], r.samples[TIP].to_numpy()
    off = put_back(put_back(r, MOVES["tilted"], [3]), lambda y: y + [0.0, 1.0, 0.0], [4, 5])
    for known, trials in ((set(), [3]), ({4}, [3, 4])):
        found = remounted(off, truth, truth, rows, r.length_mm, known)
        assert sorted(found) == trials
        back = moved(off, TIP, {t: f.motion for t, f in found.items()})
        mine = np.isin(r.column("trial"), trials)
        assert np.abs(back.samples[TIP][mine] - truth[mine]).max().max() < 0.5


def test_held_out_rows_do_not_tell_the_motion(plain):
    r = put_back(cut(plain), MOVES["tilted"])
    train = r.split(0)[0]
    other = r.samples.copy()
    other.loc[~train, TIP] += np.random.default_rng(0).normal(0, 30, (int((~train).sum()), 3))
    a, b = (align_mounts(q, r.length_mm, train) for q in (r, with_samples(r, other)))
    assert a[1] == b[1] and len(a[1]) == 1
    np.testing.assert_array_equal(a[0].samples[TIP][train], b[0].samples[TIP][train])


def test_a_regulator_whose_zero_moved_is_left_as_measured(plain):
    r = cut(plain)
    p = r.column("pressure_kpa")
    curve = [np.polynomial.Polynomial.fit(p, r.column(c), 4) for c in TIP]
    s = r.samples.copy()
    again = np.isin(r.column("trial"), AGAIN)
    for c, f in zip(TIP, curve, strict=True):
        s[c] += again * (f(p + 0.12 * np.ptp(p)) - f(p))
    assert np.linalg.norm(s[TIP] - r.samples[TIP], axis=1)[again].mean() > 0.05 * r.length_mm
    assert align_mounts(with_samples(r, s), r.length_mm)[1] == []


def test_a_neighbour_that_was_never_driven_before_may_be_the_cause(plain):
    r = cut(plain)
    s = put_back(r, MOVES["shifted"]).samples
    s["segment2_cmd_1_kpa"] = np.where(s["trial"] >= 3, 20.0, 0.0)
    assert align_mounts(with_samples(r, s), r.length_mm)[1] == []


def test_few_holds_of_three_chambers_say_nothing_of_other_pressures(tmp_path):
    plain = Recording.load(write(truth("arm", [], 12409, minutes=6.0), tmp_path / "arm"))
    train = deal(plain, 12409).train  # leaves eighteen of the holds of the first trial
    assert align_mounts(plain, plain.length_mm, train)[1] == []
