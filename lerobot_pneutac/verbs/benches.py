"""What `learn` measures on: the stand-in for a real finger, or the bench itself."""

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.diagnosis.design import Choice
from lerobot_pneutac.diagnosis.programs import sent_s
from pneutac_datasets.recording.axes import command_columns
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.features import MAX_PRESSURE_KPA

if TYPE_CHECKING:
    from lerobot_pneutac.verbs.measure import MeasureConfig


class Bench(Protocol):
    """A device that follows programs."""

    range_kpa: tuple[np.ndarray, np.ndarray]  # lowest and highest set-point, each (chambers,)
    hz: float  # samples a second
    # seconds without pressure before the program that it followed last, since the one before; None where it
    # was rested, or nothing is known
    pause_s: float | None

    def follow(self, program: Path, out: Path, number: int) -> Recording:
        """Drives a program, a CSV of `program_columns`, from rest; records into the new folder `out`.

        `number` programs were driven before. Raises HardwareFault where a part failed; the chamber is vented.
        """
        ...


class StandinBench:
    """The stand-in's finger, which shares no physics with a twin."""

    range_kpa, hz, pause_s = (np.zeros(1), np.full(1, MAX_PRESSURE_KPA)), 20.0, None

    def __init__(self, seed: int = 0):
        self._seed = seed

    @property
    def length_mm(self) -> float:
        from lerobot_robot_pneutac.standin.world import LENGTH_MM, TIP_MM

        return LENGTH_MM + TIP_MM

    def follow(self, program: Path, out: Path, number: int) -> Recording:
        from pneutac_datasets.generate.standin import write_program

        return write_program(out, program, 1000 * self._seed + number)


class MeasuredBench:
    """A finger in front of a camera, on a pressure controller: `pneutac measure`."""

    def __init__(self, config: "MeasureConfig"):
        self._config = config
        self.range_kpa, self.hz, self.length_mm = config.range_kpa, config.hz, config.length_mm
        self.pause_s: float | None = None
        self._vented_s: float | None = None  # on the clock

    def follow(self, program: Path, out: Path, number: int) -> Recording:
        from lerobot_pneutac.verbs.measure import measure

        began_s, before_s = time.monotonic() + self._config.rest_s, self._vented_s
        self.pause_s = None if before_s is None else began_s - before_s
        recording = measure(replace(self._config, program=str(program), out=out, repeat=1))
        self._vented_s = time.monotonic()
        return recording


def program_columns(c: Choice) -> dict:
    """A program as `pneutac measure --program=` reads it, its steps between samples (`sent_s`).

    Columns are `time_s`, when a command is sent, the commands in kPa, `program`, its kind, and the conditions
    that it asks for, such as `payload_g`.
    """
    commands = np.reshape(c.pressure_kpa, (len(c.time_s), -1)).T
    columns = dict(zip(command_columns(len(commands)), commands, strict=True))
    return {"time_s": sent_s(c.time_s, c.pressure_kpa), **columns, "program": c.kind, **c.conditions}


BENCHES = ("standin", "measure")


def check_bench(bench: str, measure: Path | None) -> None:
    """Raises InputError where there is no such bench, or the file of its options is missing or too much."""
    if bench not in BENCHES:
        raise InputError(f"bench={bench} must be one of {', '.join(BENCHES)}.")
    if (bench == "measure") != (measure is not None):
        raise InputError("bench=measure and --measure=FILE.yaml, the options of your bench, go together.")


def make_bench(
    measure: Path | None, out: Path, seed: int, device: str = "finger"
) -> tuple[Bench, dict[str, float]]:
    """The bench, and the conditions on it while no hand changes them.

    `measure` is a YAML file with the options of `pneutac measure`; None for the stand-in, of a `device`.
    """
    if measure is None and device == "arm":
        from pneutac_datasets.generate.finger import standin_arm

        return standin_arm(seed), {}
    if measure is None:
        from pneutac_datasets.generate.standin import HANGING

        return StandinBench(seed), dict(HANGING)
    if not measure.is_file():
        raise InputError(f"measure={measure} is no file; give a YAML file with the options of your bench.")
    from lerobot_pneutac.verbs.measure import MeasureConfig

    config = parse_options(MeasureConfig, [f"--config_path={measure}", f"--out={out / 'round'}"])
    return MeasuredBench(config), config.conditions
