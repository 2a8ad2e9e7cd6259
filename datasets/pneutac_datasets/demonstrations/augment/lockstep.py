"""Demonstrations by the library, many at a time: controllers on the CPU, their worlds together on a GPU.

Attempts are those of `Generator.episode`, with the same draws, controller and rules. A world whose attempt
has ended begins another one: attempts are begun in the order of their numbers, some of them before it is
known whether they are needed, and the first one that does the task is accepted.
"""

import time
from collections import defaultdict, deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch

from pneutac_datasets.demonstrations.augment.episode import (
    IN_THE_WAY,
    LONGEST,
    SHORTEST,
    AugmentSetup,
    Generator,
    pieces,
    rejection,
)
from pneutac_datasets.demonstrations.augment.library import Follower
from pneutac_datasets.demonstrations.augment.work import Sensed, Work, save_sensed
from pneutac_sim.executor import process_pool
from pneutac_sim.features import PRESSURES
from pneutac_sim.progress import Progress
from pneutac_sim.world.base import Variation
from pneutac_sim.world.batch import BatchedWorld


@dataclass
class Run:
    """One attempt: number `number` at demonstration `index`; `reason` is why it was rejected."""

    index: int
    number: int
    where: dict
    rng: np.random.Generator
    late_touch: int
    sensed: Sensed
    follower: Follower | None = None
    missed: bool = True
    reason: str | None = None


class Lockstep:
    """Makes demonstrations of a setup whose method is `library`.

    Args:
        setup: of the run; conditions are numbers.
        work: takes the demonstrations.
        device: of PyTorch, see `BatchedWorld`.
        worlds: that are stepped together.

    Attributes:
        seconds: spent by this process in `world` and `controllers`.
        steps: control steps of all worlds.

    Raises:
        InputError: as `BatchedWorld`.
    """

    def __init__(self, setup: AugmentSetup, work: Work, device: str, worlds: int):
        self._setup, self._work, self._generator = setup, work, Generator(setup, "area")
        single = self._generator.world
        self._world = BatchedWorld(
            setup.task, worlds, single.twin, device, setup.fidelity, setup.conditions, station=setup.where
        )
        self._world.single.widen_starts(setup.start_width)
        self._world.reset(variations=[Variation(late_commands=self._generator.late_commands)] * worlds)
        frames = setup.references[0].frames
        self._longest, self._shortest, self._limits = frames(LONGEST), frames(SHORTEST), single.action_limits
        self._runs: list[Run | None] = [None] * worlds
        self._ready: deque[tuple[int, Run]] = deque()
        self.seconds, self.steps = {"world": 0.0, "controllers": 0.0}, 0

    def make(self, missing: list[int], workers: int, progress: Progress, done: int = 0) -> None:
        """Makes and saves demonstrations.

        Args:
            missing: their numbers.
            workers: processes that draw the images of accepted ones and save them.
            progress: is called with how many are made.
            done: of them before these.

        Raises:
            InputError: none of the attempts at one of them did the task.
        """
        self._open, self._ended = set(missing), defaultdict(dict)
        self._jobs = ((k, n) for n in range(self._setup.attempts) for k in missing if k in self._open)
        saved, shown, save = [], -1, partial(save_sensed, self._setup, self._work.folder)
        with process_pool(workers) as pool:
            while self._open:
                with self._timed("world"):
                    self._fill()
                    rows, displacement_mm = self._look()
                with self._timed("controllers"):
                    actions = np.zeros((len(self._runs), len(self._limits[0])), np.float32)
                    for k, run in enumerate(self._runs):
                        if run is None or run.index not in self._open:  # it need not be known any more
                            self._runs[k] = None
                        elif (action := self._act(run, rows[k], displacement_mm.get(k), k)) is not None:
                            actions[k] = action
                        else:
                            self._runs[k] = None
                            if accepted := self._decide(run):
                                saved.append(pool.submit(save, *accepted))
                with self._timed("world"):
                    self._world.step(actions)
                self.steps += len(self._runs)
                if shown < (made := done + len(missing) - len(self._open)):
                    shown = made
                    progress("making demonstrations", made, done + len(missing))
            for each in saved:
                each.result()

    @contextmanager
    def _timed(self, part: str) -> Iterator[None]:
        began = time.perf_counter()
        yield
        self.seconds[part] += time.perf_counter() - began

    def _fill(self) -> None:
        """Begins attempts in the worlds that have none."""
        free = deque(k for k, run in enumerate(self._runs) if run is None)
        while free:
            worlds, starts = [], []
            while free and self._ready:
                start, run = self._ready.popleft()
                if run.index in self._open:
                    self._runs[free[0]] = run
                    worlds.append(free.popleft())
                    starts.append(start)
            sent = (torch.tensor(x, device=self._world.torch_device) for x in (worlds, starts))
            if worlds:
                self._world.restart(*sent, self._staged)
            if free and not self._stage():
                return

    def _stage(self) -> bool:
        """Draws the starts of the next attempts; False where there are none."""
        runs, N = [], len(self._runs)
        for index, number in self._jobs:
            variant, where, rng = self._generator.variant(index, number)
            start = self._generator.start(variant, rng)
            runs.append(Run(index, number, where, rng, variant.late_touch, Sensed(start)))
            if len(runs) == N:
                break
        if not runs:
            return False
        starts = [runs[k % len(runs)].sensed.start for k in range(N)]
        variations = [replace(v, late_touch=0, conditions={}) for _, v in starts]
        self._staged = self._world.stage([seed for seed, _ in starts], variations)
        self._ready.extend(enumerate(runs))
        return True

    def _look(self) -> tuple[np.ndarray, dict[int, np.ndarray]]:
        """What the worlds sense: rows (N, 13 + C), and the gels' displacement (80, 59) mm where not zero.

        A row: state (8 + C), middle of the imprint (2), force on the finger, success, failure.
        """
        w = self._world
        flags = torch.stack([w.forces[:, -1], w.success.float(), w.failure.float()], 1)
        rows = torch.cat([w.state, w.centre_mm, flags], 1).cpu().numpy().astype(float)
        (touched,) = torch.nonzero(w.displacement_mm.amax((1, 2)) > 0, as_tuple=True)
        moved = w.displacement_mm[touched].cpu().numpy()
        return rows, dict(zip(touched.tolist(), moved, strict=True))

    def _act(self, run: Run, row: np.ndarray, displacement_mm: np.ndarray | None, world: int):
        """The next action (3 + C,) of an attempt; None where it has ended. As `Generator._carried_out`."""
        flange_m, contact, (*centre_mm, force, success, failure) = row[:3], row[6:8], row[-5:]
        s, t = run.sensed, len(run.sensed.actions)
        s.states.append(row[:-5])
        if displacement_mm is not None:
            s.displacement_mm[t] = displacement_mm.copy()
        s.contacts.append(contact)
        s.shown.append(max(t - run.late_touch, 0))
        area = s.contacts[s.shown[t]][0]
        if t == 0:
            if force > 0 or success or failure:
                run.reason = IN_THE_WAY
                return None
            library = self._generator.library
            run.follower, s.pressure_kpa = Follower(library, run.rng, flange_m), library.pressure_kpa[0]
        else:
            run.missed = run.missed and not area > 0
        action = None
        if not (success or failure):
            centre_mm = np.array(centre_mm) if area > 0 else np.full(2, np.nan)
            action = run.follower.action(area, centre_mm, flange_m, s.pressure_kpa)
        if action is None or t >= self._longest:
            why = self._world.why_failed(world) if failure else None
            run.reason = rejection(why, bool(success), t < self._shortest, run.missed)
            return None
        action = np.clip(action, *self._limits)
        s.pressure_kpa = action[PRESSURES]
        s.actions.append(action.astype(np.float32))
        return s.actions[-1]

    def _decide(self, ended: Run) -> tuple[int, Sensed, dict] | None:
        """The accepted attempt at a demonstration, with its provenance, once it is known."""
        runs, index, rejected = self._ended[ended.index], ended.index, []
        runs[ended.number] = ended
        for number in range(self._setup.attempts):
            run = runs.get(number)
            if run is None:
                return None
            if run.reason is None:
                self._open.remove(index)
                del self._ended[index]
                made = run.where | pieces(run.follower.path)
                frames = len(run.sensed.actions)
                return index, run.sensed, self._generator.provenance(index, number, made, frames, rejected)
            run.sensed = None  # its memory
            rejected.append({"attempt": number, "reason": run.reason, **run.where})
        raise self._generator.none_worked(index, rejected)
