"""A lab's own tables: the same numbers come back in kPa, mm, s and rad, or one sentence says what is open."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from pneutac_datasets.demonstrations.reading import is_demonstrations
from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.sources import plain
from pneutac_datasets.recording.sources.columns import parse_columns
from pneutac_datasets.recording.sources.plain import Given
from pneutac_datasets.recording.text_table import read_text
from pneutac_sim.errors import InputError

LENGTH = 73.0


def truth(runs=3, seconds=12.0, hz=10.0):
    """A finger that follows its pressure, by a recording's names."""
    rows = []
    for run in range(runs):
        t = np.arange(0, seconds, 1 / hz)
        p = np.round(24 + 24 * np.sin(0.9 * t + run - np.pi / 2), 2)
        p[:5] = 0.0
        bend = 0.02 + 0.02 * p
        table = {"trial": run, "time_s": np.round(t, 3), "pressure_cmd_kpa": p}
        table |= {"pressure_kpa": np.round(p + 0.3, 2), "tip_x_mm": np.round(LENGTH * np.sin(bend) / bend, 3)}
        table |= {"tip_y_mm": np.round(0.1 * np.cos(t), 3), "bend_angle_rad": np.round(bend, 5)}
        table |= {"tip_z_mm": np.round(LENGTH * (1 - np.cos(bend)) / bend, 3), "temperature_c": 21.5 + run}
        rows.append(pd.DataFrame(table | {"payload_g": 2.7 * (run == 1)}))
    return pd.concat(rows, ignore_index=True)


TRUTH = truth()
ONE = TRUTH[TRUTH.trial == 0]
SCALE = {"bar": 100, "mbar": 0.1, "hPa": 0.1, "psi": 6.894757, "Pa": 1e-3, "MPa": 1000, "kPa": 1}
SCALE |= {"m": 1000, "cm": 10, "mm": 1, "in": 25.4, "deg": np.pi / 180, "°": np.pi / 180, "rad": 1}
SCALE |= {"s": 1, "ms": 1e-3, "min": 60, "g": 1, "kg": 1000}


def lab(names, units, pattern="{} [{}]"):
    """The truth by a lab's names and units; a unit of None is not written."""
    table = {}
    for column, name in names.items():
        unit = units.get(column)
        values = TRUTH[column]
        if unit == "K":
            values = values + 273.15
        elif unit == "°F":
            values = values * 9 / 5 + 32
        elif unit is not None and unit != "°C":
            values = values / SCALE[unit]
        table[pattern.format(name, unit) if unit is not None and pattern else name] = values
    return pd.DataFrame(table)


def understood(file, **given):
    return plain.Understood([file], Given(**given))


@pytest.fixture
def reads(tmp_path):
    """Writes a table and says how it is understood."""

    def reads(table, sep=",", **given):
        table.to_csv(tmp_path / "lab.csv", index=False, sep=sep)
        return understood(tmp_path / "lab.csv", **given)

    return reads


def same(recording, columns, atol=2e-6):
    for c in columns:
        np.testing.assert_allclose(recording.column(c), TRUTH[c], atol=atol, rtol=1e-6, err_msg=c)


COLUMNS = "trial time_s pressure_cmd_kpa pressure_kpa tip_x_mm tip_y_mm tip_z_mm bend_angle_rad temperature_c"
COLUMNS = [*COLUMNS.split(), "payload_g"]
GERMAN, ENGLISH, SHORT, COMPOUND = (
    dict(zip(COLUMNS, names.split(", "), strict=True))
    for names in (
        "Lauf, Zeit, p_soll, p_ist, Spitze x, Spitze y, Spitze z, Winkel, Temperatur, Gewicht",
        "Run, Time, Pressure setpoint, Measured pressure, Tip X, Tip Y, Tip Z, Bending angle, Temp, Payload",
        "run_id, t, p_cmd, p, x, y, z, theta, T, load",
        "Versuch Nr., Zeitstempel, Solldruck, Istdruck, xTip, yTip, zTip, Biegewinkel, Temperatur Ofen,"
        " Zusatzmasse",
    )
)
UNITS = [
    ("bar", "m", "deg", "s", "g", "°C"),
    ("mbar", "cm", "°", "ms", "kg", "K"),
    ("psi", "in", "rad", "min", "g", "°F"),
    ("Pa", "mm", "deg", "s", "g", "°C"),
    ("MPa", "m", "rad", "ms", "kg", "°C"),
    ("hPa", "mm", "deg", "s", "g", "K"),
]
WITH_UNIT = ("pressure_cmd_kpa", "tip_x_mm", "bend_angle_rad", "time_s", "payload_g", "temperature_c")


def units_of(choice):
    units = dict(zip(WITH_UNIT, choice, strict=True))
    units |= {"pressure_kpa": units["pressure_cmd_kpa"]}
    return units | dict.fromkeys(("tip_y_mm", "tip_z_mm"), units["tip_x_mm"])


LANGUAGES = zip(UNITS, [GERMAN, ENGLISH, SHORT, COMPOUND, GERMAN, ENGLISH], strict=True)
PATTERNS = "{} ({})", "{}_{}", "{} in {}", "{}, {}"


@pytest.mark.parametrize(
    ("choice", "names", "pattern"),
    [*((*x, "{} [{}]") for x in LANGUAGES), *((UNITS[1], GERMAN, p) for p in PATTERNS)],
)
def test_units_behind_the_name_come_back_as_the_recordings(reads, choice, names, pattern):
    found = reads(lab(names, units_of(choice), pattern), ";")
    assert found.faults == [] and found.length_mm == LENGTH
    same(found.recording, TRUTH)


ENCODINGS = ("utf-8", "utf-8-sig", "cp1252", "utf-16")
HEADS = ("", "sep=", "# a comment\n\n", "Messung vom 3. Mai\nBediener: Müller\n\n")
# Every delimiter, decimal mark, encoding and preamble, but not all of them at once.
TEXTS = [
    (sep, ".,"[(i + j) % 2], ENCODINGS[j], HEADS[(i + j) % 4])
    for i, sep in enumerate((",", ";", "\t", "|"))
    for j in (i % 2, i % 2 + 2)
]


@pytest.mark.parametrize(("sep", "decimal", "encoding", "head"), TEXTS)
def test_delimiters_decimal_marks_encodings_and_preambles(tmp_path, sep, decimal, encoding, head):
    table = lab(GERMAN, units_of(UNITS[0]))
    quoting = 1 if sep == decimal else 0
    if quoting:
        table = table.map(lambda v: str(v).replace(".", ","))
    text = table.to_csv(index=False, sep=sep, decimal=decimal if not quoting else ".", quoting=quoting)
    head = f"sep={sep}\n" if head == "sep=" else head
    (tmp_path / "lab.csv").write_bytes((head + text).encode(encoding))
    found = understood(tmp_path / "lab.csv")
    assert found.faults == []
    same(found.recording, TRUTH)


@pytest.mark.parametrize("brackets", ["{}", "[{}]", "({})"])
def test_a_line_of_units_below_the_header(tmp_path, brackets):
    units = units_of(UNITS[0])
    table = lab(GERMAN, units, None)
    line = ";".join(brackets.format(units[c]) if c in units else "" for c in GERMAN)
    rows = table.to_csv(index=False, sep=";", decimal=",").split("\n", 1)
    (tmp_path / "lab.csv").write_text(f"{rows[0]}\n{line}\n{rows[1]}", encoding="utf-8")
    same(understood(tmp_path / "lab.csv").recording, TRUTH)


def test_blanks_between_columns_units_in_cells_and_thousands(tmp_path, reads):
    table = lab(SHORT, units_of(UNITS[3]))  # pascal
    (tmp_path / "lab.txt").write_text(table.to_string(index=False))
    same(understood(tmp_path / "lab.txt").recording, TRUTH)
    cells = table.rename(columns={"p_cmd [Pa]": "p_cmd"})
    cells["p_cmd"] = [f"{v:,.1f} Pa" for v in table["p_cmd [Pa]"]]
    same(reads(cells).recording, TRUTH)
    cells["p_cmd"] = [f"{v:,.2f}".translate(str.maketrans(".,", ",.")) for v in table["p_cmd [Pa]"]]
    cells.rename(columns={"p_cmd": "p_cmd [Pa]"}).to_csv(
        tmp_path / "g.csv", sep=";", decimal=",", index=False
    )
    same(understood(tmp_path / "g.csv").recording, TRUTH)


CLOCKS = {
    "epoch": lambda t: 1.7e9 + t,
    "epoch in ms": lambda t: np.round(1.7e12 + 1000 * t).astype("int64"),
    "epoch in ns": lambda t: np.round(1e9 * t).astype("int64") + 1_700_000_000_000_000_000,
    "iso": lambda t: (pd.Timestamp("2026-03-01T12:00:00") + pd.to_timedelta(t, "s")).map(
        lambda v: v.isoformat()
    ),
    "german": lambda t: (pd.Timestamp("2026-03-01 12:00:00") + pd.to_timedelta(t, "s")).map(
        lambda v: f"{v:%d.%m.%Y %H:%M:%S},{v.microsecond // 1000:03d}"
    ),
    "of the day": lambda t: (pd.Timestamp("2026-03-01 23:59:55") + pd.to_timedelta(t, "s")).map(
        lambda v: f"{v:%H:%M:%S}.{v.microsecond // 1000:03d}"
    ),
}


@pytest.mark.parametrize("clock", CLOCKS)
def test_clocks_begin_with_zero(reads, clock):
    table = ONE.drop(columns="time_s").assign(timestamp=pd.Series(CLOCKS[clock](ONE.time_s.to_numpy())))
    found = reads(table, ";")
    np.testing.assert_allclose(found.recording.column("time_s"), ONE.time_s, atol=1e-6)
    assert found.recording.meta.get("date", "") in ("2026-03-01", "2023-11-14", "")


@pytest.mark.parametrize("pattern", ["%I:%M:%S", "%Y-%m-%d %I:%M:%S", "%d.%m.%Y %I:%M:%S"])
def test_a_clock_of_twelve_hours_goes_on_at_one_and_that_is_said(reads, pattern):
    stamps = pd.Timestamp("2026-03-01 12:59:55") + pd.to_timedelta(ONE.time_s, "s")
    texts = [f"{v:{pattern}}.{v.microsecond // 1000:03d}" for v in stamps]
    found = reads(ONE.drop(columns="time_s").assign(clock=texts))
    np.testing.assert_allclose(found.recording.column("time_s"), ONE.time_s, atol=1e-6)
    assert [n for n in found.notes if "from 12 to 1 o'clock in line 52, without AM or PM" in n]


@pytest.mark.parametrize("pattern", ["%d/%m/%Y", "%m/%d/%Y", "%d-%m-%Y"])
@pytest.mark.parametrize("day", ["2026-03-08", "2026-03-12"])
def test_the_order_of_day_and_month_is_that_in_which_midnight_is_no_pause(reads, day, pattern):
    stamps = pd.Timestamp(f"{day} 23:59:55") + pd.to_timedelta(ONE.time_s, "s")
    texts = [f"{v:{pattern} %H:%M:%S}.{v.microsecond // 1000:03d}" for v in stamps]
    found = reads(ONE.drop(columns=["trial", "time_s"]).assign(clock=texts))
    np.testing.assert_allclose(found.recording.column("time_s"), ONE.time_s, atol=1e-6)
    assert found.notes == [] and len(found.recording.trials()) == 1


def test_topics_of_a_bag_as_columns_are_recognised(reads):
    names = {"time_s": "__time", P: "/pressure_cmd/data [kPa]", "tip_x_mm": "/tip/pose/position/x"}
    names |= {"tip_y_mm": "/tip/pose/position/y", "tip_z_mm": "/tip/pose/position/z"}
    table = ONE[[*names]].rename(columns=names)
    recording = reads(table.assign(**{f"/tip/pose/orientation/{a}": 0.0 for a in "xyzw"})).recording
    for column in names:
        np.testing.assert_allclose(recording.column(column), ONE[column])


@pytest.mark.parametrize("names", [("secs", "nsecs"), ("/tip/header.stamp.sec", "/tip/header.stamp.nanosec")])
@pytest.mark.parametrize("begin", [0, 1_700_000_000])
def test_seconds_and_nanoseconds_of_ros_are_one_clock(reads, names, begin):
    nanoseconds = np.round(1e9 * ONE.time_s).astype("int64")
    stamps = {names[0]: begin + nanoseconds // 10**9, names[1]: nanoseconds % 10**9}
    table = ONE.drop(columns=["trial", "time_s"]).assign(**stamps)
    found = reads(table)
    np.testing.assert_allclose(found.recording.column("time_s"), ONE.time_s, atol=1e-6)
    assert "are one time, 'stamp [ns]'" in found.notes[0]
    again = reads(table, columns={c.name: str(c) for c in found.columns})
    np.testing.assert_array_equal(again.recording.column("time_s"), found.recording.column("time_s"))
    assert set(reads(ONE.assign(**stamps)).recording.samples) >= set(names)  # with a clock of its own


def test_days_are_asked_for_and_read_and_a_clock_in_them_is_refused(reads):
    days = ONE.drop(columns="time_s").assign(clock=46084.5 + ONE.time_s / 86400)
    with pytest.raises(InputError, match=r"in steps of 1.16e-06\) has no unit.*'clock: time_s \[s\|days\]'"):
        reads(days)
    found = reads(days, columns={"clock": "time_s [days]"})
    np.testing.assert_allclose(found.recording.column("time_s"), ONE.time_s, atol=1e-5)
    (fault,) = reads(days, columns={"clock": "time_s [s]"}).faults
    assert "can only be another unit than seconds; multiply it by 86400 if the clock counts days" in fault


def test_whole_seconds_of_even_rows_are_answered_by_their_rate(reads):
    whole = ONE.assign(time_s=np.floor(ONE.time_s))
    (fault,) = reads(whole).faults
    assert "(108 such rows)" in fault and "--columns='time_s: -' --rate_hz=10`." in fault
    found = reads(whole, columns={"time_s": "-"}, rate_hz=10.0)
    np.testing.assert_allclose(found.recording.column("time_s"), ONE.time_s, atol=1e-9)


@pytest.mark.parametrize("clock", ["seconds", *CLOCKS])
def test_a_run_begins_after_a_long_pause_of_any_clock(reads, clock):
    time_s = ONE.time_s.to_numpy() + 3600.0 * (np.arange(len(ONE)) >= len(ONE) // 2)
    stamps = pd.Series(CLOCKS.get(clock, pd.Series)(time_s))
    found = reads(ONE.drop(columns=["trial", "time_s"]).assign(timestamp=stamps))
    assert len(found.recording.trials()) == 2
    assert [n for n in found.notes if "pauses for more than 10 minutes (the longest 3600 s): 2 runs" in n]


@pytest.mark.parametrize("clock", ["seconds", *CLOCKS])
@pytest.mark.parametrize("files", [1, 2])
def test_pauses_are_read_off_a_clock_that_goes_on(tmp_path, reads, clock, files):
    runs = [
        TRUTH[TRUTH.trial == k].assign(pressure_cmd_kpa=lambda r: np.r_[0, r.pressure_cmd_kpa[1:-1], 0])
        for k in (0, 1)
    ]
    rows = pd.concat([runs[0], runs[1].assign(time_s=runs[1].time_s + 30.0)], ignore_index=True)
    stamps = pd.Series(CLOCKS.get(clock, pd.Series)(rows.time_s.to_numpy()))
    table = rows.drop(columns="time_s").assign(timestamp=stamps)
    parts = [r.drop(columns="trial") for _, r in table.groupby("trial")]
    for k, part in enumerate([table] if files == 1 else parts):
        part.to_csv(tmp_path / f"lab_{k}.csv", index=False)
    found = plain.Understood(sorted(tmp_path.glob("*.csv")), Given())
    known = files == 1 or clock not in ("seconds", "of the day")
    pause_s = 30.0 - runs[0].time_s.max()
    stated = {"1": {"start": "continues", "pause_s": pytest.approx(pause_s, abs=2e-3)}}
    assert found.recording.meta.get("trials", {}) == (stated if known else {})
    under = reads(table.assign(pressure_cmd_kpa=table.pressure_cmd_kpa + 5.0))  # not at zero in between
    assert "trials" not in under.recording.meta


def test_frames_and_rows_need_a_rate(reads):
    one = ONE.drop(columns="time_s")
    framed = one.assign(Frame=np.arange(len(one)) + 100)
    with pytest.raises(InputError, match=r"'Frame' counts frames; .* `pneutac convert .*csv --rate_hz=20`"):
        reads(framed)
    found = reads(framed, rate_hz=10.0)
    np.testing.assert_allclose(found.recording.column("time_s"), ONE.time_s, atol=1e-9)
    with pytest.raises(InputError, match="no column is a time; .* --rate_hz"):
        reads(one)
    assert reads(one, rate_hz=10.0).recording.column("time_s")[-1] == pytest.approx(11.9)


@pytest.mark.parametrize("offset", [0.0, 2e5, 1.7e9])
def test_times_are_written_to_a_microsecond_and_blocks_do_not_depend_on_their_zero(tmp_path, offset):
    table = TRUTH.assign(time_s=TRUTH.time_s + np.where(TRUTH.index % 3, 0.0123456, 0.0) + offset)
    Recording(tmp_path, {"length_mm": LENGTH}, table, "finger").write(tmp_path / "r")
    read = Recording.load(tmp_path / "r")
    np.testing.assert_allclose(read.column("time_s"), table.time_s, atol=1e-6, rtol=0)
    plainly = Recording(tmp_path, {}, TRUTH, "finger").blocks()
    late = Recording(tmp_path, {}, TRUTH.assign(time_s=TRUTH.time_s + offset), "finger").blocks()
    np.testing.assert_array_equal(plainly, late)


def renamed(name, column, factor=1.0, plus=0.0):
    """The truth with a column by another name and in another unit."""
    return lambda t: t.drop(columns=column).assign(**{name: t[column] * factor + plus})


P = "pressure_cmd_kpa"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (renamed("p", P), r"'p' \(0 to 48\) has no unit.*'p: pressure_cmd_kpa"),
        (
            renamed("p soll [kPa]", P, 1, 101.3),
            r"is 101.3 kPa at rest, as the air is: an absolute pressure\?.*\[kpa abs\|kpa gauge\]",
        ),
        (
            renamed("p soll [V]", P, 0.05),
            r"'p soll \[V\]' is no pressure but a signal.*pressure_cmd_kpa \* KPA_PER_UNIT",
        ),
        (renamed("Temp", "temperature_c", 1, 50), r"'Temp' \(72.5 in the middle\) .*\[C\|F\]"),
        (renamed("t", "time_s", 1000), r"'t' \(in steps of 100\) has no unit.*time_s \[s\|ms\]"),
        (
            lambda t: renamed("x", "tip_x_mm", 0.1)(
                renamed("z", "tip_z_mm", 0.1)(t.drop(columns="tip_y_mm"))
            ),
            r"'x' \(7.* from the origin\) has no unit.*\[mm\|cm\|m\|in\]",
        ),
        (renamed("p soll [foo]", P), "the unit 'foo' of 'p soll .*unknown"),
        (lambda t: t.drop(columns=["tip_x_mm", "tip_z_mm"]), "no column has the motion of the finger"),
        (
            lambda t: t[["time_s", P, "tip_x_mm"]].set_axis(["t", "Var1", "Var2"], axis=1),
            r"NAME: pressure_cmd_kpa \[kPa\], NAME: tip_x_mm \[mm\], NAME: tip_z",
        ),
        (
            lambda t: t.drop(columns="temperature_c").assign(**{"Temp A": 20.0, "Temp B": 21.0}),
            "'Temp A' and 'Temp B' could each be temperature_c",
        ),
        # a misspelt column is named where it is missing
        (renamed("presure_kpa", P), r"'presure_kpa' may be it.*'presure_kpa: pressure_cmd_kpa \[kpa\]'"),
        (renamed("pressure_comand_psi", P), r"'pressure_comand_psi: pressure_cmd_kpa \[psi\]'"),
        (renamed("pression (kPa)", P), r"'pression \(kPa\): pressure_cmd_kpa \[kPa\]'"),
        (renamed("pressure_cmd_volt", P), r"'pressure_cmd_volt: pressure_cmd_kpa \* KPA_PER_UNIT \+ KPA_AT"),
        (
            lambda t: t.rename(columns={P: "p_ist [kPa]"}),
            r"the measured one stands.*'p_ist \[kPa\]: pressure_cmd",
        ),
        (renamed("tiem_s", "time_s"), r"'tiem_s: time_s \[s\]'"),
        (renamed("temps (s)", "time_s"), r"'temps \(s\): time_s \[s\]'"),
        (
            lambda t: t.drop(columns="tip_y_mm").rename(
                columns={"tip_x_mm": "positon_x", "tip_z_mm": "positon_z"}
            ),
            r"'positon_x: tip_x_mm \[mm\|cm\|m\|in\], positon_z: tip_z_mm \[mm\|cm\|m\|in\]'",
        ),
        (
            lambda t: t.drop(columns="tip_y_mm").assign(tip_x_mm=np.nan, tip_z_mm=np.nan),
            "Nothing is in 'tip_x_mm', 'tip_z_mm'",
        ),
    ],
)
def test_what_is_open_is_asked_in_one_sentence(reads, change, says):
    with pytest.raises(InputError, match=says) as e:
        reads(change(TRUTH.drop(columns=["bend_angle_rad", "pressure_kpa"])))
    assert "\n" not in str(e.value) and "lab.csv" in str(e.value)


@pytest.mark.parametrize("answer", ["presure_cmd_kpa", "pressure_cmd", "presure_cmd_kpa [bar]"])
def test_an_answer_that_is_no_column_of_a_recording_is_refused(reads, answer):
    with pytest.raises(InputError, match="of 'u' is no column of a recording; did you mean 'pressure_cmd_k"):
        reads(TRUTH.rename(columns={P: "u"}), columns={"u": answer})


def test_named_arrays_of_numpy_are_a_table_and_objects_are_not(tmp_path):
    nanoseconds = 1_700_000_000_000_000_000 + np.round(1e9 * ONE.time_s).astype("int64")
    arrays = {"stamp_ns": nanoseconds, P: ONE[P], "label": np.repeat("stairs", len(ONE)), "rate": 10.0}
    arrays |= {"tip": ONE[["tip_x_mm", "tip_z_mm"]], "film": np.zeros((len(ONE), 4, 4))}
    np.savez(tmp_path / "lab.npz", **arrays)
    (file,) = plain.table_files(tmp_path / "lab.npz")
    found = understood(file, columns={"tip_1": "tip_x_mm", "tip_2": "tip_z_mm"})
    for column in ("time_s", P, "tip_x_mm", "tip_z_mm"):
        np.testing.assert_allclose(found.recording.column(column), ONE[column], atol=1e-9)
    assert set(found.recording.samples["program"]) == {"stairs"}
    np.savez(tmp_path / "objects.npz", time=np.array([{}, 1], object))
    (tmp_path / "cut.npz").write_bytes((tmp_path / "lab.npz").read_bytes()[:900])
    for name in ("objects", "cut"):
        with pytest.raises(InputError, match=r"is no .npz of arrays \(.*\); save it by `numpy.savez`"):
            understood(tmp_path / f"{name}.npz")


def test_a_misspelt_column_that_may_be_left_out_is_noted_and_its_remedy_works(reads):
    table = TRUTH.rename(columns={"pressure_kpa": "pressure_measurd_kpa", "payload_g": "payloda_g"})
    table = table.assign(step=1.0, setup=2.0, flow=3.0)
    notes = [n for n in reads(table).notes if "is stored as it is; if it is" in n]
    assert len(notes) == 2 and "--columns='pressure_measurd_kpa: pressure_kpa'`" in notes[0]
    answers = {"pressure_measurd_kpa": "pressure_kpa", "payloda_g": "payload_g"}
    found = reads(table, columns=answers)
    same(found.recording, ["pressure_kpa", "payload_g"])
    assert not [n for n in found.notes if "is stored as it is" in n]


@pytest.mark.parametrize(("factor", "plus", "proposed"), [(1 / 25.4, 0.0, 3), (1.0, 330.0, 403)])
def test_a_length_that_no_finger_has_is_noted(reads, factor, plus, proposed):
    table = TRUTH.drop(columns=["tip_y_mm", "bend_angle_rad"])
    table = table.assign(tip_x_mm=table.tip_x_mm * factor + plus, tip_z_mm=table.tip_z_mm * factor)
    (note,) = reads(table).notes
    assert f"at rest the tip is {proposed} mm from the origin" in note and "--base=X,Y,Z`" in note
    assert reads(table, length_mm=float(proposed)).notes == []


def test_answers_are_taken_and_repeated_by_the_mapping(tmp_path):
    table = TRUTH.drop(columns=[P, "pressure_kpa", "temperature_c", "bend_angle_rad"])
    table = table.assign(u=TRUTH[P] / 20 + 0.5, p_ist=TRUTH.pressure_kpa + 98.0, flow=1.5)
    table["T"] = TRUTH.temperature_c * 9 / 5 + 32
    table.to_csv(tmp_path / "lab.csv", index=False)
    text = "{u: pressure_cmd_kpa * 20 - 10, p_ist: pressure_kpa [kPa abs], 'T': temperature_c [F]}"
    found = understood(tmp_path / "lab.csv", columns=parse_columns(text))
    kept = ["pressure_cmd_kpa", "tip_x_mm", "temperature_c", "payload_g"]
    same(found.recording, kept)
    assert np.abs(found.recording.column("pressure_kpa")[:5]).max() < 1e-9  # less what it reads at rest
    assert found.recording.column("flow")[0] == 1.5
    written = found.write(tmp_path / "lab.recording")
    assert plain.is_current(tmp_path / "lab.recording", [tmp_path / "lab.csv"])
    again = plain.Understood([tmp_path / "lab.csv"], Given.load(tmp_path / "lab.recording" / "mapping.yaml"))
    pd.testing.assert_frame_equal(again.recording.samples, found.recording.samples)
    same(written, kept, atol=1e-4)
    table.iloc[:-1].to_csv(tmp_path / "lab.csv", index=False)
    assert not plain.is_current(tmp_path / "lab.recording", [tmp_path / "lab.csv"])


def test_a_unit_in_a_name_counts_where_an_answer_gives_none(reads):
    """`Ventil [bar]: pressure_cmd_kpa` is no kPa, and volts are asked for kPa each."""
    table = TRUTH.drop(columns=[P, "pressure_kpa", "tip_x_mm", "bend_angle_rad"])
    table = table.assign(**{"Ventil [bar]": TRUTH[P] / 100, "Weg lang_cm": TRUTH.tip_x_mm / 10})
    answers = {"Ventil [bar]": "pressure_cmd_kpa", "Weg lang_cm": "tip_x_mm"}
    same(reads(table, columns=answers).recording, [P, "tip_x_mm"])
    in_full = {"Ventil [bar]": "pressure_cmd_kpa * 100", "Weg lang_cm": "tip_x_mm [cm]"}
    same(reads(table, columns=in_full).recording, [P, "tip_x_mm"])
    table = table.rename(columns={"Ventil [bar]": "Ventil [V]"})
    answers = {"Ventil [V]": "pressure_cmd_kpa", "Weg lang_cm": "tip_x_mm"}
    with pytest.raises(InputError, match=r"'Ventil \[V\]' is no pressure but a signal"):
        reads(table, columns=answers)
    found = reads(table, columns=answers | {"Ventil [V]": "pressure_cmd_kpa * 100"})
    same(found.recording, [P])


@pytest.mark.parametrize(
    "names", [("Länge x [mm]", "Höhe z [mm]"), ("X coordinate (mm)", "Z coordinate (mm)")]
)
def test_a_length_along_an_axis_is_the_tip(reads, names):
    columns = ["trial", "time_s", P, "tip_x_mm", "tip_z_mm"]
    table = TRUTH[columns].rename(columns=dict(zip(columns[3:], names, strict=True)))
    same(reads(table).recording, columns[2:])


def test_several_files_are_trials_in_the_order_of_their_numbers(tmp_path):
    for run, rows in TRUTH.groupby("trial"):
        rows.drop(columns="trial").to_csv(tmp_path / f"run_{9 + run}.csv", index=False)
    files = plain.table_files(tmp_path / "run_*.csv")
    assert [f.name for f in files] == ["run_9.csv", "run_10.csv", "run_11.csv"]
    found = plain.Understood(files, Given())
    same(found.recording, TRUTH)
    assert list(found.recording.samples["run"].unique()) == ["run_9", "run_10", "run_11"]
    assert plain.folder_of(files).name == "run_9_to_run_11.recording"
    assert plain.table_files(f"{files[1]},{files[0]}") == files[:2]
    loaded = pd.read_csv(files[0])
    loaded.drop(columns="payload_g").to_csv(files[0], index=False)
    found = plain.Understood(files, Given())
    same(found.recording, ["payload_g"])
    assert any("has no 'payload_g': 0 there" in n for n in found.notes)
    loaded.drop(columns="tip_y_mm").to_csv(files[0], index=False)
    with pytest.raises(InputError, match="run_9.csv has no column 'tip_y_mm', which .*run_10.csv has"):
        plain.Understood(files, Given())


def test_the_trackers_frame_is_turned_into_the_bases(reads):
    tip = TRUTH[["tip_x_mm", "tip_y_mm", "tip_z_mm"]].to_numpy()
    # In the lab the finger hangs along -z and bends towards x.
    lab_mm = np.stack([tip[:, 2], tip[:, 1], -tip[:, 0]], 1) + [310.0, -40.0, 880.0]
    table = TRUTH.assign(
        **dict(zip(("x [mm]", "y [mm]", "z [mm]"), lab_mm.T, strict=True)), gx=0.0, gy=0.0, gz=-1.0
    )
    table = table.drop(columns=["tip_x_mm", "tip_y_mm", "tip_z_mm"])
    with pytest.raises(InputError, match=r"at rest the tip is at \(3.*\) mm, not along x .*--base=X,Y,Z"):
        reads(table)
    found = reads(table, base_mm=(310.0, -40.0, 880.0), base_x="-z", base_z="x")
    same(found.recording, TRUTH)
    assert (found.recording.column("gravity_x") == 1.0).all()  # it hangs
    assert found.length_mm == LENGTH
    flipped = TRUTH.assign(tip_z_mm=-TRUTH.tip_z_mm)
    assert "lab.csv --base_z=-z` turns it" in reads(flipped).faults[0]


def test_a_place_that_is_counted_from_the_tip_and_a_bend_along_y_are_noticed(reads):
    tared = TRUTH.assign(tip_x_mm=TRUTH.tip_x_mm - LENGTH)
    with pytest.raises(InputError, match="its place is counted from the tip; .*--base=-LENGTH,0,0"):
        reads(tared)
    same(reads(tared, base_mm=(-LENGTH, 0.0, 0.0)).recording, TRUTH)
    flat = TRUTH.drop(columns="tip_y_mm").rename(columns={"tip_z_mm": "tip_y_mm"})
    assert "lab.csv --base_z=y` turns it" in reads(flat).faults[0]
    same(reads(flat, base_z="y").recording, ["tip_x_mm", "tip_z_mm"])


def dataset(folder, features, robot_type="bench"):
    """A LeRobotDataset of the truth with these features: name to the names of its entries."""
    (folder / "meta").mkdir(parents=True)
    (folder / "data").mkdir()
    table = TRUTH.rename(columns={"trial": "episode_index", "time_s": "timestamp"})
    columns = {c: table[c] for c in ("episode_index", "timestamp")}
    columns |= {f: list(TRUTH[names].to_numpy("float32")) for f, names in features.items()}
    pd.DataFrame(columns).to_parquet(folder / "data" / "file.parquet")
    described = {f: {"dtype": "float32", "shape": [len(n)], "names": n} for f, n in features.items()}
    described |= {
        c: {"dtype": "float32", "shape": [1], "names": None} for c in ("episode_index", "timestamp")
    }
    info = {"robot_type": robot_type, "fps": 10, "features": described}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    return folder


def test_a_lerobot_dataset_of_a_bench_keeps_the_names_of_its_entries(tmp_path):
    tips = ["tip_x_mm", "tip_z_mm"]
    bench = dataset(tmp_path / "a", {"action": [P], "observation.state": tips})
    assert not is_demonstrations(bench)
    same(Recording.load(bench), [P, *tips], atol=1e-4)
    assert is_demonstrations(dataset(tmp_path / "b", {"action": [P], "observation.state": tips}, "pneutac"))
    doubled = dataset(tmp_path / "c", {"command": [P], "measured": [P, *tips]})
    with pytest.raises(InputError, match=f"'{P}' is the name of an entry of 'command' and of 'measured'"):
        Recording.load(doubled)


def test_what_is_not_recognised_is_retained_and_what_is_empty_said(tmp_path, reads):
    table = TRUTH.assign(flow_lpm=np.arange(len(TRUTH)) % 7, Bemerkung="ok", leer=np.nan, Ofen=20.5)
    table.loc[5:8, "tip_z_mm"] = np.nan
    table.loc[20:30, "temperature_c"] = np.nan
    found = reads(table.rename(columns={"Ofen": "Ofen [°C]", "temperature_c": "Tx"}))
    assert set(found.recording.samples) >= {"flow_lpm", "Bemerkung", "Tx", "temperature_c"}
    assert len(found.recording) == len(TRUTH) - 4
    said = "4 rows without", "'leer' is empty or not a number", "'Tx' is empty or not a number in 11 rows"
    assert all(words in " ".join(found.notes) for words in said)
    stored = found.write(tmp_path / "lab.recording")
    assert set(found.notes) <= set(stored.warnings)
    assert "missing from" not in " ".join(check(stored)[1])


def test_rows_left_out_at_an_end_hide_none_that_was_not_logged(tmp_path, reads):
    table = TRUTH.copy()
    table.loc[0:3, "tip_z_mm"] = np.nan  # before the first pose: no gap
    table.loc[60, "tip_z_mm"] = np.nan
    stored = reads(table.drop(index=[40, 50])).write(tmp_path / "lab.recording")
    assert "3 rows are missing" in (found := " ".join(check(stored)[1]))
    assert "the conversion left out 1 without a tip, 2 were not logged" in found


def test_faults_name_the_table_its_line_and_its_column(tmp_path):
    table = lab(GERMAN, units_of(UNITS[0])).astype(object)
    table.loc[7, "p_soll [bar]"] = "hoch"
    text = "Messung 1\n\n" + table.to_csv(index=False, sep=";")
    (tmp_path / "lab.csv").write_text(text, encoding="utf-8")
    (fault,) = understood(tmp_path / "lab.csv").faults
    assert "lab.csv: column 'p_soll [bar]', row 8 (line 11 of the file) is 'hoch'" in fault
    assert "samples.csv" not in fault


def test_a_number_that_its_unit_makes_impossible_is_shown_with_that_unit(reads):
    table = TRUTH.rename(columns={"tip_x_mm": "x [m]", "tip_y_mm": "y [m]", "tip_z_mm": "z [m]"})
    (fault,) = reads(table).faults
    assert "mm if it is in m, which cannot be" in fault
    assert "x [m]: tip_x_mm [UNIT], y [m]: tip_y_mm [UNIT], z [m]: tip_z_mm [UNIT]'`" in fault


def test_what_is_poor_is_said_before_a_table_is_converted_as_after(tmp_path, reads):
    few = TRUTH.assign(pressure_cmd_kpa=TRUTH[P] / 100, pressure_kpa=TRUTH["pressure_kpa"] / 100)
    found = reads(few[few["trial"] == 0])
    before, after = found.recording.warnings, found.write(tmp_path / "lab.recording").warnings
    assert "if that is bar, multiply the pressures by 100" in before[0] and "one trial only" in before[1]
    assert len(before) == len(after)


def test_the_rows_numbers_that_pandas_writes_are_left_out(tmp_path):
    TRUTH.to_csv(tmp_path / "lab.csv")
    found = understood(tmp_path / "lab.csv")
    same(found.recording, [P, "tip_x_mm"])
    assert found.notes == [
        f"{tmp_path / 'lab.csv'}: column 1, which has no name and counts the rows, is left out."
    ]


def test_zeros_that_a_tracker_writes_where_it_sees_nothing_are_left_out(reads):
    tips = ["tip_x_mm", "tip_y_mm", "tip_z_mm"]
    table = TRUTH.copy()
    table.loc[::25, tips] = 0.0
    found = reads(table)
    assert len(found.recording) == len(TRUTH) - len(TRUTH[::25])
    assert f"{len(TRUTH[::25])} rows in which tip_x_mm and" in found.notes[0]
    tared = TRUTH.assign(tip_x_mm=TRUTH["tip_x_mm"] - LENGTH, tip_y_mm=0.0)  # from the resting tip: 0 is seen
    tared.loc[::25, tips] = 0.0
    assert not reads(tared, base_mm=(-LENGTH, 0, 0)).notes


def test_how_a_curvature_becomes_a_bend_is_said(reads):
    table = TRUTH[["time_s", P]].assign(**{"curvature [1/m]": 10 * TRUTH["bend_angle_rad"]})
    with pytest.raises(InputError, match=r"times the length \(m\).*bend_angle_rad \* 0.1") as e:
        reads(table)
    answer = parse_columns(str(e.value).split("--columns='")[1].split("'`")[0])
    same(reads(table, columns=answer).recording, ["bend_angle_rad"])


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("0,0,1\n0.1,0,2\n0.2,0,3\n", "line 1 holds numbers where the names of the columns should be"),
        (
            "t,p\n0,5,1,5\n0,6,1,5\n0,7,1,5\n",
            "2 names in its header and 4 fields in its rows: decimal commas",
        ),
        (
            "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n",
            "Git LFS pointer.*git lfs pull",
        ),
        ("t;p\n0;1\n1;2\n2;3\nt;p\n0;1\n1;2\n", "line 5 repeats the header"),
        ("t;p\n0;1,5\n1;2.5\n", "has decimal points and decimal commas"),
        ("run,t,p\n0,0,5,1,5\n0,0,6,1,5\n0,0,7,1,5\n", "decimal commas between commas"),
        ("<!DOCTYPE html>\n<table>", "is a web page or XML and no text"),
        ("", "holds no table"),
        ("t,,p\n0,1,2\n1,2,3\n", "column 2 has no name in the header but is filled in line 2"),
    ],
)
def test_what_is_no_table_is_reported_in_one_sentence(tmp_path, content, says):
    (tmp_path / "lab.csv").write_text(content)
    with pytest.raises(InputError, match=says):
        read_text(tmp_path / "lab.csv")


def test_lines_below_the_table_are_left_out(tmp_path):
    (tmp_path / "lab.csv").write_text("t;p\n0;1\n1;2\n\n;;\nEnd of log;\n;;\n")
    table = read_text(tmp_path / "lab.csv")
    assert len(table.frame) == 2 and table.frame.dtypes.iloc[0].kind in "fi"
    assert "line 6 (End of log)" in table.notes[0]


@pytest.mark.parametrize("seed", range(6))
def test_spoilt_bytes_end_in_a_recording_or_one_sentence(tmp_path, seed):
    rng = np.random.default_rng(seed)
    small = TRUTH[:60]
    if seed % 3:
        names = lab(GERMAN, units_of(UNITS[seed % 6]))[:60]
        data = bytearray(names.to_csv(index=False, sep=";,\t"[seed % 3], decimal=",."[seed % 2]).encode())
        file = tmp_path / "lab.csv"
    else:
        savemat(tmp_path / "lab.mat", {c: small[c].to_numpy() for c in small}, do_compression=bool(seed % 2))
        data, file = bytearray((tmp_path / "lab.mat").read_bytes()), tmp_path / "lab.mat"
    for _ in range(25):
        spoilt = bytearray(data)
        for at in rng.integers(0, len(spoilt), rng.integers(1, 6)):
            spoilt[at] = rng.integers(0, 256)
        if rng.random() < 0.5:
            spoilt = spoilt[: rng.integers(0, len(spoilt))]
        if rng.random() < 0.2:
            a, b = np.sort(rng.integers(0, len(spoilt) + 1, 2))
            spoilt = spoilt[:a] + spoilt[b:]
        file.write_bytes(bytes(spoilt))
        try:
            found = understood(file)
            if not found.faults:
                assert len(found.write(tmp_path / "out.recording"))
        except InputError as e:
            assert "\n" not in str(e)


@pytest.mark.parametrize(("mm", "unit"), [(10.0, "cm"), (1000.0, "m"), (25.4, "in"), (1.0, "mm")])
def test_all_columns_of_a_tip_are_guessed_to_be_in_one_unit_and_that_is_said(mm, unit, reads):
    """A finger of 100 mm that bends by up to 1 rad: its z alone would fit 100 mm in another unit."""
    bend = 1.0 * np.abs(np.sin(np.arange(400) / 40)) + 1e-6
    x, z = 100 * np.sin(bend) / bend / mm, 100 * (1 - np.cos(bend)) / bend / mm
    table = {"run": 0, "t_s": np.arange(400) / 10, "p_set_kpa": 40 * bend, "x": x, "z": z}
    found = reads(table := pd.DataFrame(table), length_mm=100.0)
    assert [str(c.unit) for c in found.columns if c.column.startswith("tip_")] == [unit, unit]
    assert f"No unit is written for 'x' and 'z'; by the size of the numbers {unit} was taken" in found.guessed
    found = reads(table, columns={"x": f"tip_x_mm [{unit}]"})
    assert [str(c.unit) for c in found.columns if c.column.startswith("tip_")] == [unit, unit]
    assert not found.guessed
