"""A measured pressure is compared with its command and with the motion before it drives a fit."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from lerobot_pneutac.verbs.result import measured_range
from pneutac_datasets.recording.checks import check, findings
from pneutac_datasets.recording.pressures import supply_limits
from pneutac_datasets.recording.recording import Recording


def program(kind: str, n: int, hz: float, top: float) -> np.ndarray:
    t = np.arange(n) / hz
    if kind == "steps":
        hold = round(2 * hz)
        return np.repeat(np.random.default_rng(0).uniform(0, top, n // hold + 1), hold)[:n].round(3)
    if kind == "stairs":
        levels = np.linspace(0, top, 7)
        return levels[np.abs((t / 2).astype(int) % 12 - 6)]
    return top * (1 - np.abs(1 - 2 * (t / 12 % 1)))  # ramps


def bench(kind="steps", n=1200, hz=20.0, top=20.0, lag_s=0.0, noise=0.02, moved_by=None):
    """A finger that bends in proportion to what reaches it, `moved_by` of the command where given."""
    rng = np.random.default_rng(1)
    u = np.concatenate([program(kind, n // 2, hz, top)] * 2)
    p = u.copy()
    for k in range(1, n):
        keep = np.exp(-1 / hz / lag_s) if lag_s else 0.0
        p[k] = keep * p[k - 1] + (1 - keep) * u[k]
    p = p if moved_by is None else moved_by(p)
    time = np.tile(np.arange(n // 2) / hz, 2)
    s = {"trial": np.repeat([0, 1], n // 2), "time_s": time, "pressure_cmd_kpa": u}
    s |= {"pressure_kpa": p + noise * rng.normal(size=n)}
    s["bend_angle_rad"] = 0.4 * p / top + 0.06 + 0.002 * rng.normal(size=n)
    return Recording(Path("r"), {"length_mm": 100.0}, pd.DataFrame(s), "finger")


def gauge(recording, change):
    p = change(recording.column("pressure_kpa").copy())
    recording.samples["pressure_kpa"] = p
    return recording


def of_pressure(recording):
    kinds = ("gauge", "pressure_offset", "supply", "saturated", "other_unit")
    return [f for f in findings(recording) if f.kind.startswith(kinds)]


PROGRAMS = [("steps", 20.0, 20.0), ("steps", 10.0, 300.0), ("stairs", 20.0, 60.0), ("ramps", 50.0, 3.0)]
TWO = PROGRAMS[1::2]


@pytest.mark.parametrize(("kind", "hz", "top"), PROGRAMS)
@pytest.mark.parametrize("lag_s", [0.0, 1.0])
def test_a_gauge_that_follows_has_no_finding_however_slow_the_valve(kind, hz, top, lag_s):
    assert of_pressure(bench(kind, hz=hz, top=top, lag_s=lag_s, noise=1e-3 * top)) == []


def test_a_log_of_a_row_in_ten_seconds_shows_no_lag():
    slow = bench()
    slow.samples["time_s"] *= 200
    assert of_pressure(slow) == of_pressure(bench())


@pytest.mark.parametrize(("kind", "hz", "top"), TWO)
@pytest.mark.parametrize("share", [-0.3, 101.325])
def test_an_offset_is_named_with_its_size_and_taken_off(kind, hz, top, share):
    offset = share if share > 100 else share * top
    r = gauge(bench(kind, hz=hz, top=top, noise=1e-3 * top), lambda p: p + offset)
    (f,) = of_pressure(r)
    assert f.kind == "pressure_offset" and f.numbers["offset_kpa"] == pytest.approx(offset, rel=0.03)
    assert ("absolute?" in f.sentence) == (
        share > 100
    ) and f"{abs(f.numbers['offset_kpa']):.3g} kPa" in f.sentence
    used = check(r)[0]
    left = used.column("pressure_kpa") - used.column("pressure_cmd_kpa")
    assert abs(np.median(left)) < 0.01 * top


def test_an_absolute_command_is_named_with_and_without_a_gauge():
    r = bench()
    r.samples["pressure_cmd_kpa"] += 101.3
    (f,) = of_pressure(r)
    assert "'pressure_cmd_kpa' reads 101 kPa more than 'pressure_kpa' at rest: absolute?" in f.sentence
    assert measured_range(r) == pytest.approx((0.0, 20.0), abs=1.0)
    r = bench("stairs")
    r.samples["pressure_cmd_kpa"] += 101.3
    r.samples = r.samples.drop(columns="pressure_kpa")
    (f,) = of_pressure(r)
    assert "never falls below 101.3 kPa: is it absolute?" in f.sentence


@pytest.mark.parametrize(("value", "noise"), [(0.0, 0.0), (12.3, 0.05)])
@pytest.mark.parametrize("where", ["throughout", "from a row on", "in one trial", "for some seconds"])
def test_a_gauge_that_stands_is_left_out(value, noise, where):
    rows = {
        "throughout": slice(None), "from a row on": slice(300, None), "in one trial": slice(600, None),
        "for some seconds": slice(200, 500),
    }[where]  # fmt: skip
    rng = np.random.default_rng(2)

    def stand(p):
        p[rows] = value + noise * rng.normal(size=len(p[rows]))
        return p

    r = gauge(bench(), stand)
    (f,) = [f for f in of_pressure(r) if f.kind != "saturated" or "sensor saturates" not in f.sentence]
    assert f.kind in ("gauge_stuck", "gauge_alone") and f.columns == ("pressure_kpa",)
    assert not check(r)[0].has("pressure_kpa")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: 5 + p / 20, "volts?"),
        (lambda p: 0.5 + p / 5, "volts?"),
        (lambda p: 40 * p, "counts?"),
        (lambda p: -p, "its sign is wrong"),
        (lambda p: p / 6.894757, "seems to be in psi"),
        (lambda p: 10 * p, "seems to be in mbar"),
        (lambda p: 7.50062 * p, "seems to be in mmHg"),
    ],
)
@pytest.mark.parametrize(("kind", "hz", "top"), TWO)
def test_a_gauge_of_another_scale_is_left_out(change, words, kind, hz, top):
    r = gauge(bench(kind, hz=hz, top=top, noise=1e-3 * top), change)
    (f,) = of_pressure(r)
    assert words in f.sentence and not check(r)[0].has("pressure_kpa")


@pytest.mark.parametrize(("most", "word"), [(255, "PWM"), (100, "percent")])
def test_a_command_in_counts_beside_a_gauge_in_kpa_is_named(most, word):
    r = bench("steps", top=33.0)
    r.samples["pressure_cmd_kpa"] = np.round(r.column("pressure_cmd_kpa") * most / 33.0)
    (f,) = of_pressure(r)
    assert f"{word} and not kPa?" in f.sentence


def test_a_gauge_of_noise_does_not_follow():
    rng = np.random.default_rng(3)
    r = gauge(bench(), lambda p: 10 + 5 * rng.normal(size=len(p)))
    (f,) = of_pressure(r)
    assert f.kind in ("gauge_alone", "gauge_stuck") and not check(r)[0].has("pressure_kpa")


@pytest.mark.parametrize("late", [6, 20])
@pytest.mark.parametrize("kind", ["steps", "ramps"])
def test_a_gauge_that_is_read_after_the_motion_is_left_out(kind, late):
    r = gauge(bench(kind), lambda p: np.r_[np.full(late, p[0]), p[:-late]])
    (f,) = of_pressure(r)
    assert f.kind == "gauge_late" and f.numbers["late_s"] == pytest.approx(late / 20, rel=0.3)


@pytest.mark.parametrize(
    ("kind", "hz", "top"), [("stairs", 20.0, 60.0), ("steps", 10.0, 60.0), ("ramps", 50.0, 6.0)]
)
@pytest.mark.parametrize(("share", "noise"), [(0.33, 0.0), (0.6, 1e-3)])
def test_where_the_supply_ends_the_command_ends_too(kind, hz, top, share, noise):
    ends = share * top
    r = bench(kind, hz=hz, top=top, noise=noise * top, moved_by=lambda p: np.minimum(p, ends))
    (f,) = of_pressure(r)
    assert f.kind == "supply_limit" and f.numbers["at"] == pytest.approx(ends, rel=0.03)
    if noise:  # without it the ramp itself has steps
        assert not [f for f in findings(r) if f.kind == "quantised"]
    used = check(r)[0]
    assert used.column("pressure_cmd_kpa").max() == pytest.approx(ends, rel=0.03)
    assert supply_limits(used) == {"pressure_cmd_kpa": pytest.approx(ends, rel=0.03)}
    assert measured_range(r)[1] == pytest.approx(ends, rel=0.06)


@pytest.mark.parametrize("share", [0.33, 0.7])
@pytest.mark.parametrize("kind", ["stairs", "steps", "ramps"])
def test_a_gauge_that_saturates_while_the_finger_goes_on_is_left_out(kind, share):
    r = gauge(bench(kind, top=60.0), lambda p: np.minimum(p, 60 * share))
    (f,) = of_pressure(r)
    assert f.kind == "saturated" and "the finger follows the command" in f.sentence
    assert not check(r)[0].has("pressure_kpa") and measured_range(r)[1] > 50.0


@pytest.mark.parametrize("kind", ["stairs", "steps", "ramps"])
def test_a_gauge_that_knows_no_vacuum_is_left_out(kind):
    r = bench(kind, top=60.0)
    r.samples["pressure_cmd_kpa"] -= 40.0
    gauge(r, lambda p: np.maximum(p - 40.0, 0.0))
    (f,) = of_pressure(r)
    assert f.kind == "saturated" and f.numbers["at"] == pytest.approx(0.0, abs=0.1)
    assert not check(r)[0].has("pressure_kpa")
