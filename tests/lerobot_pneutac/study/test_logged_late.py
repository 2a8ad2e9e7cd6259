"""A slow valve is found wherever a computer writes its rows: as it sends a command, or before."""

import numpy as np
import pandas as pd
import pytest
from scipy import signal

from lerobot_pneutac import Recording, calibrate, diagnose
from lerobot_pneutac.verbs.new import new_twin

DT_S, TAU_S, LENGTH_MM = 0.1, 0.25, 100.0


def logged(late_rows: int) -> Recording:
    """An arc of 0.02 rad a kPa behind a valve of 0.25 s, exactly; each row `late_rows` after its command."""
    rng, runs = np.random.default_rng(1), []
    vented = np.ravel([(kpa, 0.0) for kpa in rng.uniform(10, 60, 3)])
    up = np.linspace(0, 60, 7)
    wave = 30 - 30 * np.cos(2 * np.pi * DT_S * np.arange(1700) / 12)
    steps = np.repeat(rng.uniform(0, 60, 57), 30)
    for run, kpa in enumerate((np.repeat(vented, 300), np.repeat([*up, *up[-2::-1]], 130), steps, wave)):
        kpa = np.r_[np.zeros(100), kpa]
        valve = np.zeros(len(kpa) + 1)
        for i, command in enumerate(kpa):
            valve[i + 1] = command + (valve[i] - command) * np.exp(-DT_S / TAU_S)
        gauge = valve[late_rows:][: len(kpa)]
        bend = 0.02 * gauge
        tip = LENGTH_MM * np.array([np.sinc(bend / np.pi), np.sin(bend / 2) * np.sinc(bend / 2 / np.pi)])
        tip += rng.normal(0, 0.25, tip.shape)
        table = {"trial": run, "time_s": DT_S * np.arange(len(kpa)), "pressure_cmd_kpa": kpa}
        table |= {
            "pressure_kpa": gauge + rng.normal(0, 0.2, len(kpa)),
            "tip_x_mm": tip[0],
            "tip_z_mm": tip[1],
        }
        runs.append(pd.DataFrame(table))
    return Recording("bench", {"device": "finger", "length_mm": LENGTH_MM}, pd.concat(runs), "finger")


@pytest.mark.slow
@pytest.mark.parametrize("late_rows", [0, 1])
def test_a_slow_valve_is_no_creep_wherever_its_rows_are_written(late_rows):
    recording = logged(late_rows)
    twin = calibrate(new_twin(recording=recording), recording).twin
    found = diagnose(twin, recording)
    assert found.selected == ["valve_lag"], found.sentence
    assert found.outcome.after.twin.effects["valve_lag"]["fill_time_s"].value == pytest.approx(
        TAU_S, rel=0.05
    )


@pytest.mark.slow
def test_a_row_that_has_the_command_sent_after_its_pose_is_a_dead_time_and_no_swing():
    """A plain finger and a valve, no gauge; commands are sent at any moment until the next row."""
    rng, runs, fine_s = np.random.default_rng(1), [], 0.002
    rows = slice(None, None, round(DT_S / fine_s))
    for run in range(6):
        kpa = np.repeat(rng.uniform(0, 60, 40) * (rng.random(40) < 0.8), rng.integers(750, 2250, 40))[:50000]
        kpa[:1000] = 0.0
        gauge = signal.lfilter([0.0, fine_s / TAU_S], [1.0, fine_s / TAU_S - 1.0], kpa)[rows]
        bend = 0.02 * gauge
        tip = LENGTH_MM * np.array([np.sinc(bend / np.pi), np.sin(bend / 2) * np.sinc(bend / 2 / np.pi)])
        tip += rng.normal(0, 0.2, tip.shape)
        command = np.append(kpa, kpa[-1:].repeat(50))[49:][: len(kpa)][rows]
        table = {"trial": run, "time_s": DT_S * np.arange(len(gauge)), "pressure_cmd_kpa": command}
        runs.append(pd.DataFrame(table | {"tip_x_mm": tip[0], "tip_z_mm": tip[1]}))
    recording = Recording("bench", {"device": "finger", "length_mm": LENGTH_MM}, pd.concat(runs), "finger")
    found = diagnose(calibrate(new_twin(recording=recording), recording).twin, recording)
    assert sorted(found.selected) == ["dead_time", "valve_lag"], found.sentence
    assert found.outcome.after.twin.effects["valve_lag"]["fill_time_s"].value == pytest.approx(
        TAU_S, rel=0.05
    )


@pytest.mark.slow
def test_what_begins_vented_remembers_no_run_and_nothing_stands_in_for_what_only_one_term_explains():
    """Runs that begin at zero, a quick valve of second order, a room that warms and cools; no gauge."""
    rng, runs, dt_s, began_s = np.random.default_rng(3), [], 0.005, 0.0
    for run in range(3):
        kpa = np.repeat(np.r_[0.0, rng.uniform(0, 50, 39)], 800)
        valve, speed = np.zeros(len(kpa)), 0.0
        for i in range(1, len(kpa)):
            speed += (400.0 * (kpa[i - 1] - valve[i - 1]) - 32.0 * speed) * dt_s
            valve[i] = valve[i - 1] + speed * dt_s
        time_s = dt_s * np.arange(len(kpa))
        warmer_k = 4 * np.sin((began_s + time_s) / 80)
        bend = 0.025 * valve * (1 + 0.006 * warmer_k)
        tip = LENGTH_MM * np.array([np.sinc(bend / np.pi), np.sin(bend / 2) * np.sinc(bend / 2 / np.pi)])
        table = {"trial": run, "time_s": time_s, "pressure_cmd_kpa": kpa, "temperature_c": 22 + warmer_k}
        table |= {"tip_x_mm": tip[0], "tip_z_mm": tip[1]}
        runs.append(pd.DataFrame(table)[:: round(0.1 / dt_s)])
        began_s += time_s[-1] + 15
    samples = pd.concat(runs, ignore_index=True)
    samples[["tip_x_mm", "tip_z_mm"]] += rng.normal(0, 0.25, (len(samples), 2))
    recording = Recording("bench", {"device": "finger", "length_mm": LENGTH_MM}, samples, "finger")
    found = diagnose(calibrate(new_twin(recording=recording), recording).twin, recording)
    assert "p dT" in found.selected, found.sentence
    assert "pause_s" not in found.twin.parameters
    assert not any("rested" in w or "about as well as dependence" in w for w in found.warnings), (
        found.warnings
    )


@pytest.mark.slow
def test_play_of_a_valve_that_the_gauge_shows_is_no_hysteresis_of_the_body():
    """A regulator that rests within 1 kPa of its command; each program runs twice."""
    rng, runs = np.random.default_rng(5), []
    programs = [np.repeat(rng.uniform(0, 50, 45), 40) for _ in range(2)]
    programs.append(np.interp(np.arange(1800), np.arange(0, 1900, 100), np.r_[0.0, rng.uniform(0, 50, 18)]))
    for run, kpa in enumerate((*programs, *programs)):
        valve = np.zeros(len(kpa))
        for i in range(1, len(kpa)):
            away = kpa[i - 1] - valve[i - 1]
            valve[i] = valve[i - 1] + (1 - np.exp(-0.05 / 0.08)) * away * (abs(away) > 1.0)
        bend = 0.025 * valve
        tip = LENGTH_MM * np.array([np.sinc(bend / np.pi), np.sin(bend / 2) * np.sinc(bend / 2 / np.pi)])
        tip += rng.normal(0, 0.2, tip.shape)
        table = {"trial": run, "time_s": 0.05 * np.arange(len(kpa)), "pressure_cmd_kpa": kpa}
        table |= {
            "pressure_kpa": valve + rng.normal(0, 0.08, len(kpa)),
            "tip_x_mm": tip[0],
            "tip_z_mm": tip[1],
        }
        runs.append(pd.DataFrame(table))
    samples = pd.concat(runs, ignore_index=True)
    recording = Recording("bench", {"device": "finger", "length_mm": LENGTH_MM}, samples, "finger")
    found = diagnose(calibrate(new_twin(recording=recording), recording).twin, recording)
    of_body = [m for m in found.outcome.mechanisms if m.cause in ("hysteresis", "friction", "snap")]
    assert found.outcome.evidence.noise_known and not any(m.named for m in of_body), found.sentence
    if of_body:
        assert any("lies between the command and the measured pressure" in w for w in found.warnings)
