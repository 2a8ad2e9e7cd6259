"""Bench recordings survive a round trip, bad ones say what to do, and parts are whole blocks of time."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from pneutac_benchmarks.robustness.recordings import damage_recordings
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import CONTROL, InputError

META = {"device": "finger", "length_mm": 110.0, "samples": "samples.csv"}


def table(n=400, trials=4):
    """A quasi-static finger on ramps up and down: `trials` trials of n / trials samples at 20 Hz."""
    m = n // trials
    p = np.tile(40 * (1 - np.abs(np.linspace(-1, 1, m))), trials)
    bend = 0.02 * p
    s = {"trial": np.repeat(np.arange(trials), m)}
    s |= {"program": np.repeat([f"program_{i % 2}" for i in range(trials)], m)}
    s |= {"time_s": np.tile(np.arange(m) / 20, trials), "pressure_cmd_kpa": p}
    s |= {"tip_x_mm": 110 * np.sinc(bend / np.pi), "tip_y_mm": 0.0, "tip_z_mm": 55 * bend}
    return pd.DataFrame(s | {"temperature_c": 21.0})


def write(folder, samples=None, **meta):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "recording.json").write_text(json.dumps(META | meta))
    (table() if samples is None else samples).to_csv(folder / "samples.csv", index=False)
    return folder


def test_csv_and_parquet_give_the_same_samples(tmp_path):
    a = Recording.load(write(tmp_path / "a"))
    a.meta["samples"] = "samples.parquet"
    b = Recording.load(a.write(tmp_path / "b"))
    pd.testing.assert_frame_equal(a.samples, b.samples)
    assert b.device == "finger" and b.length_mm == 110.0
    assert b.observations == ["tip_x_mm", "tip_y_mm", "tip_z_mm"]
    assert b.conditions == ["program", "temperature_c"]
    assert list(b.trials()) == [0, 1, 2, 3] and b.trials()[2] == slice(200, 300)


def test_a_lerobot_dataset_with_the_same_columns_is_a_recording(tmp_path):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    tip = ["tip_x_mm", "tip_y_mm", "tip_z_mm"]
    scalar = {"dtype": "float32", "shape": (1,), "names": None}
    features = {
        "pressure_cmd_kpa": scalar,
        "observation.tip": {"dtype": "float32", "shape": (3,), "names": tip},
    }
    root = tmp_path / "set"
    dataset = LeRobotDataset.create("me/bench", fps=20, features=features, root=root, use_videos=False)
    samples = table(100, 2)
    for _, g in samples.groupby("trial"):
        for kpa, place in zip(g[["pressure_cmd_kpa"]].to_numpy("f4"), g[tip].to_numpy("f4"), strict=True):
            dataset.add_frame({"pressure_cmd_kpa": kpa, "observation.tip": place, "task": "bench"})
        dataset.save_episode()
    dataset.finalize()
    r = Recording.load(root)
    assert r.device == "finger" and len(r.trials()) == 2
    np.testing.assert_allclose(
        r.samples[["time_s", "pressure_cmd_kpa", *tip]].to_numpy(float),
        samples[["time_s", "pressure_cmd_kpa", *tip]].to_numpy(float),
        atol=1e-4,
    )


def break_(column, row, value):
    def change(samples):
        samples[column] = samples[column].astype(object)
        samples.loc[row, column] = value
        return samples

    return change


P, TIPS = "pressure_cmd_kpa", ["tip_x_mm", "tip_y_mm", "tip_z_mm"]
BAD = [  # more are in `tests/snapshots/sentences.txt`
    (lambda s: s.rename(columns={P: "pressure_cmd_pa"}), "there is 'pressure_cmd_pa'"),
    (lambda s: s.assign(pressure_cmd_kpa=1000 * s[P]), "pascal.*divide"),
    (lambda s: s.assign(pressure_kpa=s[P] / 100), "'pressure_kpa', row 50"),
    (lambda s: s.assign(**{c: s[c] / 1000 for c in TIPS}), "metres.*multiply"),
    (lambda s: s.assign(bend_angle_rad=s[P]), "degrees"),
    (lambda s: s.assign(temperature_c=294.0), "kelvin"),
    (lambda s: s.assign(gravity_x=9.81, gravity_y=0, gravity_z=0), "have the length 9.81, where a direction"),
    (lambda s: s.assign(gravity_x=1.0), "'gravity_y' is missing"),
    (lambda s: s.assign(time_s=np.round(s.time_s * 1e4)), "time_s.*milliseconds; divide it by 1000"),
    (lambda s: s.assign(time_s=np.round(s.time_s * 1e6)), "time_s.*every .* divide it by 1e6"),
    *(  # one row alone is not another unit, nor a clock that was reset
        (break_(c, 12, 1e18), rf"'{c}', row 13 .line 14 of the file. is '1e.18' .1 such.*leave out that row")
        for c in (*TIPS, P, "trial", "time_s", "temperature_c")
    ),
    (break_("time_s", 12, 900.0), "'time_s', row 13 .* is 900 s, out of order; .*leave out that row"),
    (break_("tip_z_mm", 12, 9e3), "'tip_z_mm', row 13 .* is 9000, .* an error .*leave out that row"),
    (break_(P, 12, 3e3), rf"'{P}', row 13 .* is 3000, .* an error .*leave out that row"),
    (lambda s: s.assign(time_s=s.time_s - (s.time_s > 1)), "goes back from .* sort the trial by time"),
    (lambda s: s.assign(time_s=np.round(s.time_s, 1)), "repeats the stamp.*digits"),
    (
        break_("tip_x_mm", 12, np.nan),
        r"'tip_x_mm', row 13 \(line 14 of the file\) is empty or not a number \(1 such.*leave out that row",
    ),
    (break_("tip_z_mm", 3, np.inf), "'tip_z_mm', row 4"),
    (break_("temperature_c", 0, np.nan), "'temperature_c', row 1"),
    (lambda s: s.assign(trial=s.trial + 0.5), "'trial', row 1"),
    (break_("trial", 12, 1e300), r"'trial', row 13 .* is '1e\+300' \(1 such row\); correct it"),
    (lambda s: pd.concat([s, s[s.trial == 0]]), "'trial', row 401 .*goes back to trial 0"),
    (lambda s: with_sent(s, 12, np.nan), "'time_sent_s', row 13 .* is empty"),
    (
        lambda s: s.assign(time_sent_s=s.time_s + 1.7e9),  # on another clock
        r"row 1 \(line 2 of the file\) \(trial 0\) is 1.7e\+09 s, later than the time 0.05 s of the next "
        "row; give it on the clock of time_s",
    ),
    (lambda s: with_sent(s, 40, s.time_s[38] + 0.045), "row 41 .* earlier than the time 1.95 s of the row b"),
    (lambda s: with_sent(s, 40, s.time_s[39] - 0.04), "row 41 .* goes back from"),
    (lambda s: with_sent(s, 40, s.time_s[39] - 0.01), "row 41 .* as in the row before, though the command"),
]


def with_sent(samples, row, time_s):
    """Each command sent 10 ms before its row's time, but for one."""
    samples = samples.assign(time_sent_s=samples.time_s - 0.01)
    samples.loc[row, "time_sent_s"] = time_s
    return samples


@pytest.mark.parametrize(("change", "message"), BAD)
def test_bad_table_is_one_sentence_with_file_column_and_remedy(tmp_path, change, message):
    write(tmp_path / "r", change(table()))
    with pytest.raises(InputError, match=message) as e:
        Recording.load(tmp_path / "r")
    text = str(e.value)
    assert "samples.csv" in text and "\n" not in text and text.endswith(".")


NOISE = [  # field `noise`, and of which the sentence speaks
    ('"0.2"', "noise.*standard deviation"),
    ('{"tip_x_mm": "0.2"}', "'noise' of 'tip_x_mm' is '0.2'"),
    ('{"tip_x_mm": 0.2, "tip_z_mm": 0.2}', "does not name 'tip_y_mm'"),
]
STARTS = [  # field `trials`
    ("[3]", "'trials' is .3.; name trials by number"),
    ('{"1": "rested"}', "'trials' of trial '1' is 'rested'; give 'start'"),
    ('{"1": {"pause_s": 3}}', "give 'start' and perhaps 'pause_s'"),
    ('{"1": {"start": ["rested"]}}', "it must be one of rested"),
    ('{"1": {"start": "continues", "pause_s": "1"}}', "'pause_s' is '1'; give seconds"),
]
META_TEXTS = [
    ('{"device": "finger", "length_mm": NaN}', "length_mm"),
    *((f'{{"device": "finger", "length_mm": 110, "noise": {noise}}}', says) for noise, says in NOISE),
    *((f'{{"device": "finger", "length_mm": 110, "trials": {starts}}}', says) for starts, says in STARTS),
    ("[" * 100_000, "is not valid JSON"),
    ('{"length_mm": ' + "1" * 5000 + "}", "field 'length_mm' is inf"),
    ("\udcff", "is no text in UTF-8"),
]


@pytest.mark.parametrize(("text", "message"), META_TEXTS)
def test_bad_metadata_is_one_short_sentence_that_names_the_field(tmp_path, monkeypatch, text, message):
    monkeypatch.chdir(tmp_path)
    write(Path("r"))
    Path("r/recording.json").write_text(text, errors="surrogateescape")
    with pytest.raises(InputError, match=message) as e:
        Recording.load("r")
    assert len(str(e.value)) <= 400


def test_a_missing_column_and_a_long_image_name_are_short_sentences(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    r = Recording.load(write(Path("r"), table().assign(**{f"condition_{i}": 0.0 for i in range(50)})))
    for call in (lambda: r.column("force_x_n"), lambda: r.image(5000 * "x" + ".png")):
        with pytest.raises(InputError) as e:
            call()
        assert len(str(e.value)) <= 400


def test_what_is_no_table_or_too_large_is_refused_before_it_is_read(tmp_path, monkeypatch):
    folder = write(tmp_path / "r")
    (folder / "samples.csv").write_bytes(bytes(range(256)))
    with pytest.raises(InputError, match=r"samples\.csv"):
        Recording.load(folder)
    with (folder / "samples.csv").open("r+b") as f:
        f.truncate(2 * 2**30)  # sparse: takes no space on disk
    with pytest.raises(InputError, match=r"2\.0 GB.*\.parquet"):
        Recording.load(folder)
    (folder / "samples.parquet").write_bytes(b"PAR1 no")
    (folder / "recording.json").write_text(json.dumps(META | {"samples": "samples.parquet"}))
    with pytest.raises(InputError, match="Parquet"):
        Recording.load(folder)
    monkeypatch.setattr("pneutac_datasets.recording.recording.MAX_CELLS", 60)
    table()[:20].to_parquet(folder / "samples.parquet")
    with pytest.raises(InputError, match="has 8 columns of 20 rows"):
        Recording.load(folder)


def test_a_folder_of_tables_and_a_twin_are_named_where_a_recording_is_wanted(tmp_path):
    (tmp_path / "twin.yaml").write_text("")
    with pytest.raises(InputError, match="recording.json is missing; '.*' is a twin"):
        Recording.load(tmp_path)
    (tmp_path / "twin.yaml").rename(tmp_path / "monday.csv")
    with pytest.raises(InputError, match=r"holds tables: give one, such as '.*monday.csv', or all by .*csv"):
        Recording.load(tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s.assign(pressure_cmd_kpa=20.0), "constant at 20 kPa"),
        (lambda s: s[s.trial == 0], "one trial only"),
        (lambda s: s.iloc[:3], "only 3 rows"),
        (break_("time_s", 12, 11 / 20), "0.55 s of trial 0 (1 such row); it is left out"),
        (lambda s: s.rename(columns={"tip_y_mm": "tip_y_mmm"}), "not read; did you mean 'tip_y_mm'?"),
        (
            lambda s: s.drop(columns="temperature_c", errors="ignore").assign(temperature_f=72.0),
            "'temperature_f' is not read; multiply it by 0.555556, add -17.7778 and call it 'temperature_c'.",
        ),
        (lambda s: s.assign(payload_kg=0.02), "multiply it by 1000 and call it 'payload_g'."),
        (
            lambda s: s.assign(time_s=s.time_s / 1000),
            "has 20000 samples a second, 0.0198 s in all; if the clock",
        ),
        (lambda s: s.drop(columns="tip_z_mm"), "z, in which the device bends, was not measured"),
    ],
)
def test_poor_data_loads_with_a_warning(tmp_path, change, message):
    r = Recording.load(write(tmp_path / "r", change(table())))
    assert any(message in w for w in r.warnings)
    assert all((np.diff(r.column("time_s")[s]) > 0).all() for s in r.trials().values())


def test_starts_and_times_sent_survive_a_round_trip_and_the_loss_of_trials(tmp_path):
    started = {"0": {"start": "rested"}, "2": {"start": "continues", "pause_s": 12}}
    started |= {"3": {"start": "continues"}}
    held = table().assign(pressure_cmd_kpa=lambda s: np.repeat(s.pressure_cmd_kpa[::10], 10).to_numpy())
    first = np.repeat(held.time_s[::10] - 0.01, 10).to_numpy()  # a command stands for ten rows
    r = Recording.load(write(tmp_path / "r", held.assign(time_sent_s=first), trials=started))
    r = Recording.load(r.write(tmp_path / "again"))
    np.testing.assert_allclose(r.column("time_sent_s"), first)
    assert r.conditions == ["program", "temperature_c"]
    assert [(s.start, s.pause_s) for s in r.starts.values()] == [
        ("rested", None), ("unknown", None), ("continues", 12), ("continues", None)
    ]  # fmt: skip
    fewer = r.keep(r.column("trial") != 1)
    fewer = Recording.load(fewer.write(tmp_path / "fewer"))
    assert [s.start for s in fewer.starts.values()] == ["rested", "unknown", "continues"]
    thinned = r.keep(np.arange(len(r)) % 7 > 0)
    assert thinned.starts == r.starts
    assert len(Recording.load(thinned.write(tmp_path / "thin"))) == len(thinned)


@pytest.mark.parametrize(
    "command",
    [
        lambda n: np.where(np.arange(n) < n / 2, 0.0, 30.0),
        lambda n: np.random.default_rng(0).uniform(0, 40, n).round(3),
    ],
    ids=["creep under one load", "cycles faster than the logger"],
)
def test_a_recording_of_days_is_no_clock_in_milliseconds(tmp_path, command):
    s = table(8000, 1)
    s = s.assign(time_s=60.0 * np.arange(len(s)), pressure_cmd_kpa=command(len(s)))
    r = Recording.load(write(tmp_path / "r", s))
    assert any("if the clock counts milliseconds" in w for w in r.warnings)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("fractions", [(0.7, 0.3), (0.6, 0.2, 0.2)])
def test_parts_are_whole_blocks_and_hold_every_condition(seed, fractions):
    s = table(4000, 8)
    flipped = s.trial == 5
    s = s.assign(gravity_x=np.where(flipped, -1.0, 1.0), gravity_y=0.0, gravity_z=0.0)
    s["temperature_c"] = np.where(s.trial >= 4, 30.0, 21.0) + 0.2 * np.sin(s.time_s)
    r = Recording(Path("r"), META, s, "finger")
    parts = r.split(seed, fractions)
    assert (np.sum(parts, axis=0) == 1).all()
    block = r.blocks()
    for mask, share in zip(parts, fractions, strict=True):
        assert set(block[mask]).isdisjoint(block[~mask])
        assert mask.mean() == pytest.approx(share, abs=0.1)
        assert set(s.program[mask]) == set(s.program)
        assert (mask & flipped).any() and set(s.temperature_c[mask] > 25) == {False, True}
    for b in np.unique(block):  # a block is one stretch of one trial, long against the sampling time
        rows = np.flatnonzero(block == b)
        assert (np.diff(rows) == 1).all() and len(rows) >= 20 and s.trial[rows].nunique() == 1
    again = r.split(seed, fractions)
    assert all((a == b).all() for a, b in zip(parts, again, strict=True))
    assert any((a != b).any() for a, b in zip(parts, r.split(seed + 100, fractions), strict=True))


def test_gel_recording_splits_by_role_and_reads_images(tmp_path):
    folder = tmp_path / "gel"
    folder.mkdir()
    picture = np.random.default_rng(0).integers(0, 255, (32, 24, 3), np.uint8)
    Image.fromarray(picture).save(folder / "a.png")
    rows = {"trial": range(4), "time_s": 0, "image": "a.png", "indenter": "sphere"}
    rows |= {
        "role": ["calibration", "heldout", "heldout", "known_depth"],
        "depth_mm": [np.nan, 0.4, 0.5, 0.6],
    }
    write(folder, pd.DataFrame(rows), device="gel", rest_image="a.png", px_per_mm=20)
    r = Recording.load(folder)
    train, heldout = r.split()
    assert train.tolist() == [True, False, False, False] and (train != heldout).all()
    np.testing.assert_array_equal(r.image(r.samples.image[0]), picture)


@pytest.mark.parametrize("number", [120, pytest.param(10_000, marks=pytest.mark.nightly)])
def test_a_damaged_recording_is_read_or_refused_in_a_sentence(tmp_path, number):
    outcome = damage_recordings(tmp_path, number)
    assert outcome.broken == () and 0.3 * number < outcome.refused < number


@pytest.mark.parametrize("text", ["=HYPERLINK(1)", "-cmd", " =1", "\x1b[2Jx", "a\u202eb"])
def test_no_text_is_a_formula_or_moves_a_terminals_cursor(tmp_path, text):
    write(tmp_path / "whole", table())
    for case in ("cell", "column", "json"):
        folder = tmp_path / case
        rows = table()
        if case == "cell":
            rows.loc[7, "program"] = text
        if case == "column":
            rows = rows.assign(**{text: 0.0})
        write(folder, rows)
        if case == "json":
            meta = json.loads((folder / "recording.json").read_text()) | {"notes": {text: 1}}
            (folder / "recording.json").write_text(json.dumps(meta))
            if not CONTROL.search(text):
                continue  # nothing puts notes into a table
        with pytest.raises(InputError, match="formula|would run|control characters") as e:
            Recording.load(folder)
        assert not CONTROL.search(str(e.value))
