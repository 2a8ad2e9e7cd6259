import importlib.metadata
import json
import logging
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from lerobot.datasets import io_utils

from lerobot_robot_pneutac.robots.episode_hooks import EpisodeHooks
from pneutac_sim.errors import InputError
from pneutac_sim.pace import DONE, PACE_FILE, Pace, pace_notes, read_outcomes, read_pace
from pneutac_sim.world.station import Station

DEMOS = Path(__file__).parents[2] / "golden/recordings/demos"
SECONDS = "lerobot_robot_pneutac.robots.episode_hooks.time.perf_counter"


class Lone:
    """A robot of no arm."""

    name = "pneutac"
    outcome = None

    def __init__(self):
        self.heard = []
        self.config = SimpleNamespace(station=None)

    def announced(self, begins):
        self.heard.append(begins)


@pytest.fixture
def keeper(monkeypatch, caplog):
    monkeypatch.setattr(io_utils, "write_json", io_utils.write_json)
    caplog.set_level(logging.INFO)
    keeper = EpisodeHooks(15, Lone())
    keeper.connect()
    yield keeper
    keeper.disconnect()


def observe(keeper, monkeypatch, times_s):
    for at in times_s:
        monkeypatch.setattr(SECONDS, lambda at=at: at)
        keeper.observed()


def save(meta, episodes, frames, fps=15):
    meta.mkdir(exist_ok=True)
    info = {"fps": fps, "total_episodes": episodes, "total_frames": frames}
    io_utils.write_json(info, meta / "info.json")
    assert json.loads((meta / "info.json").read_text()) == info


def test_an_episode_is_what_was_observed_after_it_was_announced(keeper, monkeypatch, tmp_path, caplog):
    save(tmp_path, 0, 0)
    logging.info("Recording episode 0")
    observe(keeper, monkeypatch, [0.0, 5.0])  # is recorded anew
    logging.info("Recording episode 0")
    observe(keeper, monkeypatch, [10.0, 10.1, 10.2, 10.4])
    observe(keeper, monkeypatch, [10.41, 10.42])  # while the scene is put back
    save(tmp_path, 1, 4)
    assert read_pace(tmp_path) == {0: Pace(7.5, 1, 0.2)}
    assert "Episode 0 ran at 7.50 Hz and not at 15 (1 late, the longest pause 0.20 s)" in caplog.text
    logging.info("Recording episode 1")
    observe(keeper, monkeypatch, [20 + k / 15 for k in range(31)])
    save(tmp_path, 2, 4 + 31)
    assert read_pace(tmp_path)[1].achieved_hz == pytest.approx(15)
    (note,) = pace_notes(tmp_path, 15)
    assert "fell short of 15 Hz in episode 0 (7.5 Hz, 1 frames late)" in note


def test_a_dataset_keeps_the_station_and_what_waits_has_no_pace(keeper, monkeypatch, tmp_path, caplog):
    robot = Lone()
    robot.config = SimpleNamespace(station=tmp_path / "mine.yaml", joints=5)
    robot.config.station.write_text("format: pneutac-station/1\narm: so101\nlatency_s: 0.1\n")
    waiting = EpisodeHooks(15, robot, waits=True)
    waiting.connect()
    save(tmp_path, 0, 0)
    for text in ("Recording episode 0", "Reset the environment"):
        logging.info(text)
    observe(waiting, monkeypatch, [10.0, 10.2, 10.4])
    save(tmp_path, 1, 3)
    waiting.disconnect()
    assert robot.heard == [True, False] and read_pace(tmp_path) == {}
    assert Station.load(tmp_path / "station.yaml") == Station(arm="so101", latency_s=0.1)
    assert "ran at 5.00 Hz and not at 15" in caplog.text
    assert "so its 3 frames are 0.2 s of the simulated world" in caplog.text


def test_how_each_episode_ended_is_stored(keeper, monkeypatch, tmp_path, caplog):
    robot = Lone()
    hooks = EpisodeHooks(15, robot, waits=True)
    hooks.connect()
    for number, robot.outcome in enumerate([DONE, "the task was not done"]):
        save(tmp_path, number, 3 * number)
        logging.info("Recording episode")
        observe(hooks, monkeypatch, [0.0, 0.1, 0.2])
        save(tmp_path, number + 1, 3 * number + 3)
    hooks.disconnect()
    assert read_outcomes(tmp_path) == {0: DONE, 1: "the task was not done"}
    assert "Episode 1 failed: the task was not done. `pneutac augment` sets it aside." in caplog.text


@pytest.mark.parametrize("waits", [False, True])
def test_a_loop_that_is_too_fast_is_stored_and_noted(keeper, monkeypatch, tmp_path, caplog, waits):
    """As `lerobot-rollout --interpolation_multiplier=2` records twice as many frames a second."""
    keeper._waits = waits
    save(tmp_path, 0, 0)
    logging.info("Recording episode 0")
    observe(keeper, monkeypatch, [k / 30 for k in range(61)])
    save(tmp_path, 1, 61)
    assert (
        read_pace(tmp_path)[0].achieved_hz == pytest.approx(30) and read_pace(tmp_path)[0].simulated == waits
    )
    (note,) = pace_notes(tmp_path, 15)
    assert "ran faster than 15 Hz in episode 0 (30.0 Hz" in note and "--interpolation_multiplier" in note
    assert ("of a simulated robot" in note) == waits == ("of the simulated world" in caplog.text)
    assert ("stored as slower than they were" in note) != waits


def test_what_was_not_announced_has_no_rate(keeper, monkeypatch, tmp_path):
    """Strategies that record all the time save in the midst of it, and our own recorder has no clock."""
    save(tmp_path, 0, 0)
    observe(keeper, monkeypatch, [0.0, 0.1, 0.2])
    save(tmp_path, 1, 3)
    logging.info("Recording episode 1")
    observe(keeper, monkeypatch, [0.0, 0.1])  # fewer than it counts
    save(tmp_path, 2, 6)
    io_utils.write_json({"total_frames": 9}, tmp_path / "stats.json")
    assert read_pace(tmp_path) == {} and pace_notes(tmp_path, 15) == []


@pytest.mark.parametrize(
    "waits,program,said",
    [
        (
            False,
            "mine.py",
            "31 actions came at 7.50 Hz and not at 15 (30 late, the longest pause 0.13 s); free",
        ),
        (True, "lerobot-replay", "31 actions came at 7.50 Hz and not at 15"),
        (True, "lerobot/async_inference/robot_client.py", "and not at 15"),
        (True, "mine.py", ""),  # a simulated robot without LeRobot's clock
    ],
)
def test_a_run_without_episodes_ends_with_its_rate(keeper, monkeypatch, caplog, waits, program, said):
    monkeypatch.setattr(sys, "argv", [program])
    keeper._waits = waits
    for hz in (7.5, 15.1, 30):
        keeper.connect()
        for k in range(31 if hz < 20 else 61):
            monkeypatch.setattr(SECONDS, lambda at=k / hz: at)
            keeper.acted()
        keeper.disconnect()
    slow, held, fast = [r.getMessage() for r in caplog.records if "actions came" in r.message] or [""] * 3
    assert said in slow and bool(slow) == bool(said)
    assert "and not" not in held and ("give --fps=15" in fast) == bool(said)
    keeper.connect()
    logging.info("Recording episode 0")  # of which another sentence is printed
    observe(keeper, monkeypatch, [k / 15 for k in range(31)])
    keeper.acted()


def test_a_damaged_file_is_reported_and_loses_no_episode(keeper, monkeypatch, tmp_path, caplog):
    (tmp_path / PACE_FILE).write_text("[1")
    with pytest.raises(InputError, match="is damaged"):
        read_pace(tmp_path)
    save(tmp_path, 0, 0)
    logging.info("Recording episode 0")
    observe(keeper, monkeypatch, [0.0, 0.1])
    save(tmp_path, 1, 2)
    assert "is damaged" in caplog.text


def test_an_unknown_lerobot_is_named_and_left_as_it_is(monkeypatch, caplog):
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "0.9.1")
    before = io_utils.write_json
    EpisodeHooks(15, Lone()).connect()
    assert before is io_utils.write_json
    assert "LeRobot 0.9.1 is unknown to this version of PneuTac" in caplog.text
    assert "install LeRobot 0.6, or a newer PneuTac." in caplog.text
