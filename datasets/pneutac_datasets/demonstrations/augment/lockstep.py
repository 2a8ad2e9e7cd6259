"""Demonstrations by library or planner, many at a time: controllers on the CPU, worlds together on a GPU.

Attempts are those of `Generator.episode`, with the same draws, controller and rules. A world whose attempt
has ended begins another one: attempts are begun in the order of their numbers, some of them before it is
known whether they are needed, and the first one that does the task is accepted.

Of the planner a second batch of worlds tries the sequences of many plans together. An attempt that needs a
plan waits, its world where it was, until enough others do.
"""

import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace

import numpy as np
import torch

from pneutac_datasets.demonstrations.augment.episode import (
    CONTACT,
    IN_THE_WAY,
    SHORTEST,
    AugmentSetup,
    Generator,
    Sensed,
    Variant,
    area_rmse,
    pieces,
    rejection,
)
from pneutac_datasets.demonstrations.augment.library import Followers
from pneutac_datasets.demonstrations.augment.planner import LATE_RELEASE, LATE_TOUCH, CemPlanner
from pneutac_datasets.demonstrations.augment.reference import EXTRA_STEPS
from pneutac_datasets.demonstrations.augment.scene import Scene
from pneutac_sim.executor import Progress
from pneutac_sim.world.base import Variation
from pneutac_sim.world.batch import BatchedWorld, Rollouts


@dataclass
class Run:
    """One attempt: number `number` at demonstration `index`; `reason` is why it was rejected."""

    index: int
    number: int
    variant: Variant
    where: dict
    rng: np.random.Generator
    start: tuple[int, Variation]  # seed and variation
    displacement_mm: dict[int, np.ndarray] = field(default_factory=dict)  # see `Sensed`
    reason: str | None = None
    sensed: Sensed | None = None  # once it has done the task
    scores: dict = field(default_factory=dict)  # then too, for its provenance


class Following:
    """Controllers of the library for the attempts of N worlds."""

    def __init__(self, generator: Generator, worlds: int):
        self._followers = Followers(generator.library, generator.world.action_limits, worlds)

    def begin(self, k: int, run: Run, flange_m: np.ndarray) -> None:
        """Begins an attempt in world `k`, whose flange is at (3,)."""
        self._followers.begin(k, run.rng, flange_m)

    def actions(
        self, worlds: np.ndarray, area: np.ndarray, centre_mm: np.ndarray, flange_m: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The next actions (K, 3 + C) in worlds (K,); arrays are as of `Followers.actions`.

        Returns:
            also whether the attempts go on (K,) bool, and whether they wait, so that the worlds must too.
        """
        made, goes_on = self._followers.actions(worlds, area, centre_mm, flange_m)
        return made, goes_on, np.zeros_like(goes_on)

    def scores(self, k: int, run: Run, area: np.ndarray) -> dict:
        """Provenance of the attempt in world `k`, to which contact areas (T,) were shown."""
        return pieces(self._followers.paths[k])


class Planning:
    """As `Following`, by the planner; `scenes` are one for each reference.

    Raises InputError: as `BatchedWorld`.
    """

    def __init__(self, generator: Generator, batch: BatchedWorld, ahead: BatchedWorld, scenes: list[Scene]):
        self._generator, self._scenes, self._config = generator, scenes, generator.setup.config.planner
        self._rollouts, self._most = Rollouts(batch, ahead), ahead.worlds // self._config.samples
        self._guides: dict[int, Iterator] = {}
        self._costs: dict[int, list[float]] = {}
        self._felt: dict[int, tuple] = {}
        self._waits: dict[int, CemPlanner] = {}

    def begin(self, k: int, run: Run, flange_m: np.ndarray) -> None:
        g = self._generator
        self._waits.pop(k, None)
        self._costs[k] = []
        planned = g.setup.references[run.variant.source], run.variant, run.rng
        self._guides[k] = g.guided(*planned, lambda: self._felt[k], self._costs[k])

    def actions(self, worlds, area, centre_mm, flange_m):
        keys = worlds.tolist()
        self._felt |= zip(keys, zip(area, centre_mm, flange_m, strict=True), strict=True)
        asked = {k: self._waits.pop(k, None) or next(self._guides[k], None) for k in keys}
        waits = [k for k in keys if isinstance(asked[k], CemPlanner)]
        while waits and len(waits) >= min(self._most, len(keys) / 2):
            some, waits = waits[: self._most], waits[self._most :]
            self._solve(some, [asked[k] for k in some])
            asked |= {k: next(self._guides[k]) for k in some}
        self._waits |= {k: asked[k] for k in waits}
        made = np.zeros((len(keys), len(self._generator.world.action_limits[0])))
        for row, k in enumerate(keys):
            if k not in self._waits and asked[k] is not None:
                made[row] = asked[k]
        return made, np.array([asked[k] is not None for k in keys], bool), np.isin(worlds, waits)

    def _solve(self, worlds: list[int], planners: list[CemPlanner]) -> None:
        """`CemPlanner.solve` of many plans, from where their worlds are."""
        area = np.array([self._felt[k][0] for k in worlds])
        self._rollouts.mirror(worlds, self._config.samples, area)
        for _ in range(self._config.iterations):
            found = self._rollouts.rollouts(np.stack([p.draw() for p in planners]))
            for planner, *one in zip(planners, *found, strict=True):
                planner.learn(*one)

    def scores(self, k, run, area):
        scene, r = self._scenes[run.variant.source], self._generator.setup.references[run.variant.source]
        cost = float(np.mean(self._costs[k])) if self._costs[k] else 0.0
        return {"cost": cost, "area_rmse": area_rmse(area, r.area), "scene": asdict(scene)}


class Lockstep:
    """Makes demonstrations of a setup whose method is `library` or `planner`.

    Args:
        setup: of the run, which names device and number of worlds; conditions are numbers. Of the planner
            these worlds try sequences, and twice as many attempts as plans find room there go on together.
        scenes: of the planner, one for each reference.

    Attributes:
        seconds: spent by this process in `world` and `controllers`.
        steps: control steps of all worlds.

    Raises InputError: as `BatchedWorld`.
    """

    def __init__(self, setup: AugmentSetup, scenes: Sequence[Scene] = ()):
        self._setup, self._generator = setup, Generator(setup, "area")
        c, single = setup.config, self._generator.world
        self._scenes = list(scenes)
        worlds = 2 * (c.worlds // c.planner.samples) if scenes else c.worlds
        options = single.twin, c.device, c.fidelity, c.conditions, None, setup.station, bool(scenes)
        self._world = BatchedWorld(setup.task, worlds, *options)
        self._world.single.widen_starts(c.start_width)
        self._world.reset(variations=[Variation(late_commands=self._generator.late_commands)] * worlds)
        self._until, self._after, self._longest = setup.limits
        self._shortest = setup.references[0].frames(SHORTEST)
        self._runs: list[Run | None] = [None] * worlds
        if scenes:
            ahead = BatchedWorld(setup.task, c.worlds, *options)
            self._controllers = Planning(self._generator, self._world, ahead, self._scenes)
            # Each touch, and each end of one, may be late.
            waits = [len(r.contacts) * r.frames(LATE_TOUCH + LATE_RELEASE + 2) for r in setup.references]
            lengths = [len(r) + r.frames(EXTRA_STEPS) for r in setup.references]
            self._until = self._after = self._longest = int(np.max(np.add(lengths, waits)))
        else:
            self._controllers = Following(self._generator, worlds)
        # Of each world: whether an attempt goes on in it, its control steps so far and at most, ...
        self._fresh = np.zeros(worlds, bool)
        self._busy, self._t, self._end_t = np.zeros(worlds, bool), *np.zeros((2, worlds), int)
        self._late_touch, self._missed = np.zeros(worlds, int), np.zeros(worlds, bool)
        self._states = np.zeros((worlds, self._longest + 1, self._world.state.shape[1]))
        self._actions = np.zeros((worlds, self._longest + 1, len(single.action_limits[0])), np.float32)
        self._ready: deque[tuple[int, Run]] = deque()
        self.seconds, self.steps = {"world": 0.0, "controllers": 0.0}, 0

    def make(
        self,
        missing: list[int],
        pool: ProcessPoolExecutor,
        save: Callable[[int, Sensed, dict], object],
        progress: Progress,
        done: int = 0,
    ) -> None:
        """Makes and saves demonstrations.

        Args:
            missing: their numbers.
            pool: its processes save accepted ones.
            save: of a number, an accepted attempt and its provenance; draws its images and saves it.
            progress: is called with how many are made.
            done: of them before these.

        Raises InputError: none of the attempts at one of them did the task.
        """
        self._open, self._ended = set(missing), defaultdict(dict)
        self._jobs = ((k, n) for n in range(self._setup.config.attempts) for k in missing if k in self._open)
        saved, shown = [], -1
        while self._open:
            with self._timed("world"):
                self._fill()
                sensed = self._look()
            with self._timed("controllers"):
                actions, waits, ended = self._act(*sensed)
                for run in ended:
                    if accepted := self._decide(run):
                        saved.append(pool.submit(save, *accepted))
            with self._timed("world"):
                stays = len(waits) and self._world.fork(waits)
                self._world.step(actions)
                if stays:
                    self._world.resume(waits, stays)
            self.steps += len(self._runs)
            if shown < (made := done + len(missing) - len(self._open)):
                shown = made
                progress("making demonstrations", made, done + len(missing))
            while saved and saved[0].done():  # a full disk is known at once
                saved.pop(0).result()
        for each in saved:
            each.result()

    @contextmanager
    def _timed(self, part: str) -> Iterator[None]:
        began = time.perf_counter()
        yield
        self.seconds[part] += time.perf_counter() - began

    def _fill(self) -> None:
        """Begins attempts in the worlds that have none."""
        free = deque(np.flatnonzero(~self._busy).tolist())
        while free:
            worlds, starts = [], []
            while free and self._ready:
                start, run = self._ready.popleft()
                if run.index in self._open:
                    worlds.append(k := free.popleft())
                    self._runs[k], self._late_touch[k] = run, run.start[1].late_touch
                    self._busy[k], self._t[k], self._missed[k] = True, 0, True
                    self._fresh[k] = True
                    self._end_t[k] = self._until
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
            if self._scenes:
                start = self._generator.start_in(self._scenes[variant.source], variant, rng)
            else:
                start = self._generator.start(variant, rng)
            runs.append(Run(index, number, variant, where, rng, start))
            if len(runs) == N:
                break
        if not runs:
            return False
        starts = [runs[k % len(runs)].start for k in range(N)]
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

    def _act(
        self, rows: np.ndarray, displacement_mm: dict[int, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, list[Run]]:
        """Actions (N, 3 + C) of all worlds, those that wait, and the attempts that have ended.

        As `Generator._carried_out`.
        """
        busy = np.flatnonzero(self._busy)
        t, sensed = self._t[busy], rows[busy]
        flange_m, centre_mm, flags = sensed[:, :3], sensed[:, -5:-3], sensed[:, -3:] > 0
        touches, done = flags[:, 0], flags[:, 1:].any(1)
        self._states[busy, t] = sensed[:, :-5]
        for k in displacement_mm.keys() & set(busy.tolist()):
            self._runs[k].displacement_mm[int(self._t[k])] = displacement_mm[k].copy()
        area = self._states[busy, np.maximum(t - self._late_touch[busy], 0), CONTACT.start]
        centre_mm[~(area > 0)] = np.nan
        first = self._missed[busy] & (t > 0) & (area > 0)
        self._missed[busy[first]] = False
        self._end_t[busy[first]] = np.minimum(t[first] + self._after, self._longest)
        fresh = self._fresh[busy]
        self._fresh[busy] = False
        for k, at in zip(busy[fresh].tolist(), flange_m[fresh], strict=True):
            self._controllers.begin(k, self._runs[k], at)
        on = ~done & ~(touches & (t == 0))
        made, goes_on, waits = self._controllers.actions(busy[on], area[on], centre_mm[on], flange_m[on])
        waiting, goes_on = busy[on][waits], goes_on & (t[on] < self._end_t[busy[on]])
        acts = goes_on & ~waits
        acting, made = busy[on][acts], made[acts]
        on[on] = goes_on
        self._actions[acting, self._t[acting]] = made
        actions = np.zeros((len(self._runs), made.shape[1]), np.float32)
        actions[acting] = made
        self._t[acting] += 1
        ended = [self._end(k, *f) for k, f in zip(busy[~on].tolist(), flags[~on], strict=True)]
        return actions, waiting, ended

    def _end(self, k: int, touches: bool, success: bool, failure: bool) -> Run:
        """The attempt of world `k`, which is free from now on."""
        run, t = self._runs[k], self._t[k]
        self._busy[k] = False
        if t == 0 and (touches or success or failure):
            run.reason = IN_THE_WAY
            return run
        why = self._world.why_failed(k) if failure else None
        run.reason = rejection(why, success, t < self._shortest, self._missed[k])
        if run.reason is None:
            late = np.maximum(np.arange(t) - self._late_touch[k], 0)
            run.scores = self._controllers.scores(k, run, self._states[k, late, CONTACT.start])
            states, actions = self._states[k, :t].copy(), self._actions[k, :t].copy()
            run.sensed = Sensed(run.start, states, actions, run.displacement_mm)
        return run

    def _decide(self, ended: Run) -> tuple[int, Sensed, dict] | None:
        """The accepted attempt at a demonstration, with its provenance, once it is known."""
        index, rejected = ended.index, []
        if index not in self._open:
            return None
        runs = self._ended[index]
        runs[ended.number] = ended
        for number in range(self._setup.config.attempts):
            run = runs.get(number)
            if run is None:
                return None
            if run.reason is None:
                self._open.remove(index)
                del self._ended[index]
                for k in np.flatnonzero(self._busy):  # others at it need not be known any more
                    self._busy[k] = self._runs[k].index != index
                made, frames = run.where | run.scores, len(run.sensed.actions)
                return index, run.sensed, self._generator.provenance(index, number, made, frames, rejected)
            rejected.append({"attempt": number, "reason": run.reason, **run.where})
        raise self._generator.none_worked(index, rejected)
