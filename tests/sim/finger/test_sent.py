"""Commands whose times nobody logged: those of a faster computer are read off, all others are left alone."""

import numpy as np
import pytest

from pneutac_sim.finger.inputs import Inputs
from pneutac_sim.finger.sent import sent_times

TRIALS, SECONDS, ROW_S = 8, 30.0, 0.05


def ramps(t, rng):
    corners = np.r_[0, np.cumsum(rng.uniform(1, 4, 40))]
    return np.interp(t, corners, rng.uniform(0, 12, len(corners)))


def sine(t, rng):
    return 6 + 5 * np.sin(2 * np.pi * rng.uniform(0.1, 0.6) * t)


def chirp(t, rng):
    return 6 + 5 * np.sin(2 * np.pi * (0.05 + 0.02 * t) * t)


def then_rests(t, rng):
    return np.where(t < SECONDS / 3, sine(t, rng), 6.0)


def levels(t, rng):
    """One level a trial, with the rounding of whatever computed it."""
    return rng.uniform(1, 12) * (1 + 1e-15 * rng.integers(-3, 4, len(t)))


def joystick(t, rng):
    """What a hand does, at 20 Hz: smooth over some tenths of a second alone."""
    hand = np.convolve(rng.normal(size=len(t) + 40), np.hanning(9), "same")[20:-20]
    return 6 + hand


def table(sent_by, rng, jitter_s=0.0):
    """Time, command and begins of trials; `sent_by` gives the command of rows at these times."""
    time, pressure = [], []
    for trial in range(TRIALS):
        t = ROW_S * np.arange(int(SECONDS / ROW_S))
        pressure.append(sent_by(t, trial))
        time.append(t + jitter_s * rng.uniform(-1, 1, len(t)))
    return np.concatenate(time), np.concatenate(pressure)[:, None], np.arange(TRIALS * len(t)) % len(t) == 0


@pytest.mark.parametrize("tick_s", (0.0173, 0.0252, 0.0311, 0.0463, 0.0496))
@pytest.mark.parametrize("resolution_kpa", (0.0, 0.001))
def test_when_a_faster_computer_sent_is_read_off_its_commands(tick_s, resolution_kpa):
    rng, truth = np.random.default_rng(1), []

    def command(t, trial):
        phase = rng.uniform(0, tick_s)
        sent = phase + tick_s * np.floor((t - phase) / tick_s + 1e-9)
        truth.append(sent)
        p = (ramps, sine, chirp)[trial % 3](sent, rng)
        return np.round(p / resolution_kpa) * resolution_kpa if resolution_kpa else p

    time, pressure, first = table(command, rng)
    found = sent_times(time, pressure, first)
    known = np.isfinite(found)
    assert known.mean() > 0.8
    off = np.abs(found - np.concatenate(truth))[known]
    assert np.quantile(off, 0.9) < 0.05 * tick_s


@pytest.mark.parametrize(
    ("form", "jitter_s", "resolution_kpa"),
    [
        pytest.param(sine, 0.0, 0.0, id="a loop that logs what it sends"),
        pytest.param(sine, 0.004, 0.0, id="a loop with jitter"),
        pytest.param(ramps, 0.0, 0.1, id="a command in tenths"),
        pytest.param(joystick, 0.0, 0.0, id="a hand"),
        pytest.param(levels, 0.0, 0.0, id="levels"),
        pytest.param(then_rests, 0.0, 0.0, id="a loop that moves for a third of a trial"),
    ],
)
def test_nothing_is_read_off_commands_that_do_not_show_it(form, jitter_s, resolution_kpa):
    rng = np.random.default_rng(2)

    def command(t, trial):
        p = form(t, rng)
        return np.round(p / resolution_kpa) * resolution_kpa if resolution_kpa else p

    assert np.isnan(sent_times(*table(command, rng, jitter_s))).all()


def test_a_trial_of_three_rows_changes_nothing():
    rng = np.random.default_rng(2)
    time, pressure, first = table(lambda t, trial: sine(t, rng), rng)
    rows = slice(0, np.flatnonzero(first)[-1] + 3)
    assert np.isnan(sent_times(time[rows], pressure[rows], first[rows])).all()


def test_the_inputs_hold_each_command_until_the_next_as_if_its_time_were_logged():
    rng, sent = np.random.default_rng(3), []

    def command(t, trial):
        sent.append(0.0311 * np.floor(t / 0.0311 + 1e-9))
        return sine(sent[-1], rng)

    time, pressure, first = table(command, rng)
    samples = {"trial": np.cumsum(first), "time_s": time, "pressure_cmd_kpa": pressure[:, 0]}
    logged = Inputs.from_samples(samples | {"time_sent_s": np.concatenate(sent)}, start="held")
    read_off = Inputs.from_samples(samples, start="held", switch=0.5)
    straight = Inputs.from_samples(samples, start="held")

    def at(inputs):
        clock = np.cumsum(np.where(np.isinf(inputs.dt_s), 1.0, inputs.dt_s))
        begins = clock[np.isinf(inputs.dt_s)]
        fine = (begins[:, None] + np.arange(0.2, SECONDS - 0.2, 0.01)).ravel()
        return np.interp(fine, clock, inputs.pressure_kpa[:, 0])

    error = lambda inputs: np.sqrt(np.mean((at(inputs) - at(logged)) ** 2))  # noqa: E731
    assert error(read_off) < error(straight) / 3
