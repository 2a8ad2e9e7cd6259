"""Measuring at the bench: drives a pressure program and writes what finger and gel did."""

import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from lerobot.cameras import Camera, make_cameras_from_configs

from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.diagnosis.hands import instructions
from lerobot_pneutac.measuring.camera import Intrinsics, MarkerTracker, calibrate_camera
from lerobot_pneutac.measuring.programs import STANDIN, MeasureConfig, PressureTrial, read_program
from lerobot_robot_pneutac.hardware.chambers import Chambers
from lerobot_robot_pneutac.hardware.parts import COMMAND_S, HardwareFault
from pneutac_datasets.recording.axes import command_columns, device_with, measured_columns
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import plural
from pneutac_sim.errors import InputError
from pneutac_sim.files import write_image

BASE_IMAGES = 15
FRAME_MS = 1000 * COMMAND_S  # a camera that is slower than this is lost; the chamber vents by itself then
OVERPRESSURE = 1.15  # of the set maximum, measured: everything stops
RESTED_S = 60.0  # without pressure before the first trial: what came before the run is then forgotten


@dataclass(frozen=True)
class TrialNote:
    """How one trial went."""

    number: int  # of the trial, from 0
    program: str
    planned: int  # samples of the program
    taken: int  # samples for which the cameras were quick enough
    seen: int  # those of them in which the tip was seen, which are stored


def measure(
    config: MeasureConfig,
    on_start: Callable[[int, float], None] = lambda trials, seconds: None,
    on_trial: Callable[[TrialNote], None] = lambda note: None,
) -> Recording:
    """Drives the program; the recording holds every trial that was finished, however it ends.

    `on_start` is called with the number of trials and their seconds before anything moves.

    Raises:
        InputError: program or calibration cannot be read.
        HardwareFault: a part failed; the chamber is vented, as after KeyboardInterrupt.
    """
    trials = program_of(config) * config.repeat
    if config.bench == STANDIN:
        on_start(len(trials), sum(t.time_s[-1] for t in trials))
        return _on_the_standin(config, trials)
    camera = Intrinsics.load(config.intrinsics)
    tracker = MarkerTracker(camera, config.marker_mm, config.base_id, config.tip_id, config.base_offset_mm)
    given = {"camera": config.camera} | ({"tactile": config.digit} if config.digit is not None else {})
    cameras = make_cameras_from_configs(given)
    pressure = config.pressure.make()
    driver = BenchDriver(config, pressure, cameras, tracker)
    on_start(len(trials), sum(t.time_s[-1] + config.rest_s for t in trials))
    try:
        pressure.connect()
        for name, c in cameras.items():
            _asked(name, "cannot be opened", c.connect)
        tracker.see_base([_image(cameras["camera"], "camera") for _ in range(BASE_IMAGES)])
        for number, trial in enumerate(trials):
            taken, seen = driver.drive(number, trial)
            on_trial(TrialNote(number, trial.program, len(trial.time_s), taken, seen))
    finally:
        pressure.disconnect()  # vents first, whatever comes after
        for c in cameras.values():
            if c.is_connected:
                c.disconnect()
        kept = kept_trials(config.out)
        for number in set(range(len(trials))) - kept:
            shutil.rmtree(driver.images(number), ignore_errors=True)
        shutil.rmtree(config.out / "new", ignore_errors=True)
        if not kept:
            shutil.rmtree(config.out, ignore_errors=True)
    return Recording.load(config.out)


def program_of(config: MeasureConfig) -> list[PressureTrial]:
    """The trials that are driven, once; raises InputError where they cannot be read."""
    low, high = config.range_kpa
    return read_program(config.program, high, config.hz, config.recording, low, config.chambers)


def _on_the_standin(config: MeasureConfig, trials: list[PressureTrial]) -> Recording:
    from pneutac_datasets.generate.standin import write_trials
    from pneutac_datasets.generate.truth_bench import standin_arm

    given = [(t.program, t.sent_s, t.pressure_kpa) for t in trials]
    if config.chambers > 1:
        return standin_arm(config.seed).measure(given, config.out)
    conditions = config.conditions | dict(trials[0].conditions)
    return write_trials(config.out, [(n, p[:, 0]) for n, _, p in given], config.hz, config.seed, conditions)


def kept_trials(folder: Path) -> set[int]:
    """Numbers of the trials in a folder's table: what is there counts, wherever an interrupt came."""
    table = folder / "samples.csv"
    return set(pd.read_csv(table, usecols=["trial"])["trial"]) if table.exists() else set()


class BenchDriver:
    """Drives trials one by one and writes the recording after each."""

    def __init__(
        self, config: MeasureConfig, pressure: Chambers, cameras: dict[str, Camera], tracker: MarkerTracker
    ):
        self._config, self._pressure, self._cameras, self._tracker = config, pressure, cameras, tracker
        self._rows: list[dict] = []
        self._starts: dict[str, dict] = {}
        self._vented_s: float | None = None  # clock at the end of the trial before, if it was stored

    def images(self, number: int) -> Path:
        return self._config.out / "images" / f"trial_{number:03d}"

    def drive(self, number: int, trial: PressureTrial) -> tuple[int, int]:
        """Drives one trial at its own pace; returns samples taken, and those in which the tip was seen."""
        folder = self.images(number)
        folder.mkdir(parents=True)
        self._pressure.vent()
        time.sleep(self._config.rest_s)
        rows, taken, k, start_s = [], 0, 0, time.monotonic()
        started, command, sent_s = self._started(start_s), None, None
        while k < len(trial.time_s):
            _wait_until(start_s + trial.sent_s[k])
            sample, before, command, taken = k, command, trial.pressure_kpa[k], taken + 1
            if sent_s is None or (command != before).any():  # one sent again counts from the first time
                sent_s = time.monotonic() - start_s
            self._pressure.set_pressure(command)
            _wait_until(start_s + trial.time_s[k])
            images = {name: _image(c, name) for name, c in self._cameras.items()}
            now_s, kpa = time.monotonic() - start_s, self._pressure.pressure()
            self._check_pressure(kpa)
            tip = self._tracker.tip_mm(images["camera"])
            due = int(np.searchsorted(trial.time_s, time.monotonic() - start_s, side="right"))
            k = max(k + 1, min(due - 1, len(trial.time_s) - 1))
            if tip is None:
                continue
            row = {"trial": number, "time_s": now_s, "time_sent_s": sent_s, "program": trial.program}
            row |= dict(zip(command_columns(len(kpa)), command.tolist(), strict=True))
            row |= dict(zip(measured_columns(len(kpa)), kpa.tolist(), strict=True)) | self._config.conditions
            row |= trial.conditions
            row |= dict(zip(("tip_x_mm", "tip_y_mm", "tip_z_mm"), tip.tolist(), strict=True))
            for name, image in images.items():
                file = folder / f"{name}_{sample:05d}.jpg"
                write_image(file, image, quality=95)
                row[f"image_{name}"] = str(file.relative_to(self._config.out))
            rows.append(row)
            sent_s = None
        self._pressure.vent()
        self._vented_s = time.monotonic() if rows else None
        if rows:
            self._rows += rows
            self._starts[str(number)] = started
            self._write()
        return taken, len(rows)

    def _check_pressure(self, kpa: np.ndarray) -> None:
        """Raises HardwareFault where a chamber is farther from zero than the program's limits explain."""
        low, high = self._config.range_kpa
        most = OVERPRESSURE * np.maximum(high, -low)
        wrong = ~(kpa <= most) | ((low < 0) & (kpa < -most))
        for i in np.flatnonzero(wrong):
            where = f" in chamber {i + 1}" if len(kpa) > 1 else ""
            raise HardwareFault(f"The pressure{where} reads {kpa[i]:.1f} kPa; check valve and sensor.")

    def _started(self, start_s: float) -> dict:
        """How a trial that begins at this time on the clock starts: each trial leaves the chamber vented."""
        if self._vented_s is not None:
            return {"start": "continues", "pause_s": round(start_s - self._vented_s, 3)}
        return {"start": "rested" if self._config.rest_s >= RESTED_S else "unknown"}

    def _write(self) -> None:
        """The recording so far; the old one stays until the new one is whole."""
        camera = self._tracker.camera
        meta = {"length_mm": self._config.length_mm, "notes": self._config.notes, "trials": self._starts}
        numbers = {"intrinsics": camera.matrix, "extrinsics": self._tracker.extrinsics()}
        numbers |= {"distortion": camera.distortion}
        meta["cameras"] = {"camera": {name: array.tolist() for name, array in numbers.items()}}
        samples = pd.DataFrame(self._rows)
        device = device_with(self._config.chambers)
        new = Recording(self._config.out, meta, samples, device).write(self._config.out / "new")
        # a trial in the table is final, and recording.json names none that is not in it
        names = ["recording.json", "samples.csv"]
        for name in names[::-1] if (self._config.out / "samples.csv").exists() else names:
            (new / name).replace(self._config.out / name)
        new.rmdir()


def _wait_until(clock_s: float) -> None:
    time.sleep(max(0.0, clock_s - time.monotonic()))


def _asked(name: str, fault: str, call: Callable):
    """What a call to a camera returns; raises HardwareFault where it fails, in whichever way it does."""
    try:
        return call()
    except Exception as e:
        raise HardwareFault(f"The camera '{name}' {fault}: {str(e).rstrip('.')}.") from e


def _image(camera: Camera, name: str) -> np.ndarray:
    """The camera's next image; raises HardwareFault where none comes in time."""
    return _asked(name, "gives no picture", lambda: camera.async_read(timeout_ms=FRAME_MS))


MOST_UNSEEN = 0.2  # share of a trial's images without the tip marker above which it is reported
MOST_MISSED = 0.1  # share of a trial's samples for which the cameras were too slow, likewise


def command(config: MeasureConfig, terminal: Terminal) -> None:
    """Drives a pressure program at the bench and writes what finger and gel did."""
    if config.chessboard is not None:
        camera, views = calibrate_camera(config.chessboard, config.corners, config.square_mm)
        camera.save(config.intrinsics)
        terminal.say(f"{config.intrinsics}: {views} photographs, error {camera.rms_px:.2f} px")
        return
    trials = 0

    def start(number: int, seconds: float) -> None:
        nonlocal trials
        trials = number
        what = plural(trials, "trial")
        terminal.say(f"{what}, {seconds / 60:.1f} min; finished ones stay stored after Ctrl-C.")

    def show(note: TrialNote) -> None:
        what = "stored" if note.seen else "left out"
        terminal.say(f"trial {note.number + 1} of {trials}, {note.program}: {what}")
        unseen, missed = 1 - note.seen / note.taken, 1 - note.taken / note.planned
        if unseen > MOST_UNSEEN:
            terminal.note(f"the tip marker was unseen in {100 * unseen:.0f} % of it")
        if missed > MOST_MISSED:
            terminal.note(f"{100 * missed:.0f} % of its samples are missing, the camera is slower than --hz")

    for sentence in dict.fromkeys(s for t in program_of(config) for s in instructions({}, t.conditions)):
        terminal.console.print(f"[yellow]first:[/] {sentence}", highlight=False)
        if terminal.console.is_terminal:
            terminal.console.input("Then press Enter: ")
    try:
        measure(config, start, show)
    except HardwareFault as e:
        raise InputError(str(e)) from e
    finally:
        kept = len(kept_trials(config.out))
        if kept:
            terminal.say(f"{config.out}: {kept} of {trials} trials")
        elif trials:
            terminal.say("No trial was finished; nothing was written.")
