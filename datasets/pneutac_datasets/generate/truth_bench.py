"""A device of `pneutac_truths` on the bench: it follows programs and shares nothing with a twin."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from pneutac_datasets.recording.axes import command_columns
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_truths import generate, write
from pneutac_truths.programs import given
from pneutac_truths.world import CHAMBERS, Body

DRAWN = ("temperature_c",)  # logged by the draw of a recording, not by every one
RESTED_S = 120.0
ARM_SEED, ARM_EFFECTS = 5, ("creep_fractional",)  # of the arm that stands in for a real one


class TruthBench:
    """A truth, `rod` or `arm` of three chambers, that remembers the programs before, in order.

    A `rested` one has long been without pressure before each; another number `noise` is another day.
    """

    hz = 20.0

    def __init__(
        self, effects: Sequence[str], seed: int, device: str = "rod", rested: bool = False, noise: int = 0
    ):
        self._effects, self._seed, self._device, self._rested = tuple(effects), seed, device, rested
        self._noise, self._programs = noise, []
        self.pause_s: float | None = None
        self._top_kpa = Body.draw(device, seed).top_kpa
        chambers = CHAMBERS[device]
        self.range_kpa = np.zeros(chambers), np.full(chambers, self._top_kpa)

    def follow(self, program: Path, out: Path, number: int) -> Recording:
        """See `lerobot_pneutac.verbs.benches.Bench`."""
        table = pd.read_csv(program)
        commands = table[command_columns(CHAMBERS[self._device])].to_numpy(float)
        shares = np.round(commands / self._top_kpa, 5)
        one = str(table["program"].iloc[0]), table["time_s"].to_numpy(float), shares
        if self._rested:
            return self._recorded([one], out, 1 + 1000 * self._noise + number)
        self.pause_s = RESTED_S if number else None
        self._programs = [*self._programs[:number], one]
        r = self._recorded(self._programs, out, 1 + 1000 * self._noise, state_pauses=False)
        r = r.keep(r.column("trial") == number)
        r.write(out)
        return Recording.load(out)

    def measure(self, trials: Sequence[tuple[str, np.ndarray, np.ndarray]], out: Path) -> Recording:
        """A recording of several trials, each a name, (n,) s and (n, chambers) kPa, one after the other.

        Raises InputError where a trial leaves the device's pressures.
        """
        for name, _, p in trials:
            if p.min() < 0 or p.max() > self._top_kpa:
                raise InputError(f"'{name}' leaves 0 to {self._top_kpa:g} kPa, the range of the stand-in.")
        programs = [(name, t, np.round(p / self._top_kpa, 5)) for name, t, p in trials]
        return self._recorded(programs, out, 1 + 1000 * self._noise)

    def _recorded(self, programs: list, out: Path, day: int, state_pauses: bool = True) -> Recording:
        options = {"log_sent": True, "state_pauses": state_pauses, "plan": given(programs, RESTED_S)}
        truth = generate(self._device, self._effects, self._seed, day, **options)
        write(truth, out)
        r = Recording.load(out)
        r.samples = r.samples.drop(columns=[c for c in DRAWN if r.has(c)])
        r.write(out)
        return Recording.load(out)


def standin_arm(seed: int = 0) -> TruthBench:
    """The arm that stands in for a real one, rested before each program; `seed` is of the noise."""
    return TruthBench(ARM_EFFECTS, ARM_SEED, "arm", rested=True, noise=seed)
