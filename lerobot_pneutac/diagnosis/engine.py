"""Fits sets of effects to a recording, in other processes where there are cores to spare.

Each worker loads the recording once and keeps it prepared; a job is only names and starting values, an answer
only arrays, so nothing that was compiled has to travel.
"""

import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from lerobot_pneutac.diagnosis.fits import FittedModel
from lerobot_pneutac.diagnosis.score import promising
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.finger.data import BodyData, simulate
from pneutac_sim.finger.fit import fit
from pneutac_sim.twin import Twin

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


PATIENCE_S = 10.0  # a round of fits that would take longer than this is shared among processes


@dataclass(frozen=True)
class Job:
    """One fit.

    Attributes:
        twin: where it starts; its parameters of these effects are used where it has them.
        effects: switched on.
        target: `pose` or `pressure`.
        source: `command` or `measured`.
        starts: starting points of the first round.
    """

    twin: Twin
    effects: tuple[str, ...]
    target: str
    source: str
    starts: int

    def run(self, prepared: "Prepared") -> FittedModel:
        """Fits one set of effects."""
        bench = prepared.bench(self.twin, self.target, self.source)
        if self.target == "pressure" and not self.effects:  # nothing to fit: the command is the pressure
            residual = simulate(self.twin, bench, []).residual[:, : bench.counted]
            return FittedModel((), residual, 0, replace(self.twin, arrays={}, gel={}, history=[], effects={}))
        found = fit(self.twin, bench, list(self.effects), prepared.train, starts=self.starts)
        return lean(found, bench, self.effects)


class Prepared:
    """A recording with its training samples, prepared once for each pair of target and source."""

    def __init__(self, recording: Recording, train: np.ndarray):
        self.recording, self.train = recording, train
        self._benches: dict[tuple[str, str], BodyData] = {}

    def bench(self, twin: Twin, target: str, source: str) -> BodyData:
        """The recording as the simulator wants it."""
        if (target, source) not in self._benches:
            self._benches[target, source] = BodyData.of(self.recording, twin, source=source, target=target)
        return self._benches[target, source]


def lean(found, bench: BodyData, effects: tuple[str, ...]) -> FittedModel:
    """What the diagnosis keeps of a simulator's fit."""
    return FittedModel(
        effects=tuple(effects),
        residual=found.residual[:, : bench.counted],
        count=_active(found, bench.inputs.pressure_range_kpa),
        twin=replace(found.twin, arrays={}, gel={}, history=[]),
        names=list(found.free_names),
        at_bound=dict(found.at_bound),
        not_identified=dict(found.not_identified),
        correlation=found.confidence.correlation,
        evaluations=found.evaluations,
    )


def _active(found, pressure_range_kpa: float) -> int:
    """Free parameters that do something: a weight that was fitted to zero costs nothing."""
    count = 0
    for i in found.free:
        spec = found.pipeline.specs[i]
        _, low, high = spec.limits(pressure_range_kpa)
        idle = spec.neutral in (low, high) and abs(found.theta[i] - spec.neutral) < 1e-3 * (high - low)
        count += not idle
    return count


_prepared: Prepared | None = None


def _begin(recording: Recording, train: np.ndarray) -> None:
    global _prepared
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent alone answers to Ctrl-C
    _prepared = Prepared(recording, train)


def _work(job):
    return job.run(_prepared)


@contextmanager
def _apart_from_script() -> Iterator[None]:
    """Processes started meanwhile do not run the user's script anew.

    A spawned process does, to find functions there; jobs are the library's own. Without this, a flat script
    that calls `diagnose` would need `if __name__ == "__main__"`.
    """
    main = sys.modules["__main__"]
    kept = {name: getattr(main, name) for name in ("__file__", "__spec__") if hasattr(main, name)}
    try:
        main.__spec__ = None
        vars(main).pop("__file__", None)
        yield
    finally:
        vars(main).update(kept)


class Engine:
    """Runs jobs, inline while that is quick, else in worker processes; use it as a context manager.

    Args:
        recording: to be fitted.
        train: (n,) training samples.
        jobs: processes; 1 always runs inline.
        done: is called after each fit.
    """

    def __init__(
        self,
        recording: Recording,
        train: np.ndarray,
        jobs: int = 1,
        done: Callable[[], None] = lambda: None,
    ):
        self._prepared = Prepared(recording, train)
        self._jobs, self._done = jobs, done
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> "Engine":
        return self

    def _start(self) -> None:
        """Starts the workers; each imports the simulator anew, which takes some seconds."""
        before = {k: os.environ.get(k) for k in THREADS}
        os.environ.update(dict.fromkeys(THREADS, "1"))  # read by the workers alone, at their start
        try:
            context = multiprocessing.get_context("spawn")
            prepared = (self._prepared.recording, self._prepared.train)
            self._pool = ProcessPoolExecutor(self._jobs, context, _begin, prepared)
            with _apart_from_script():
                for _ in range(self._jobs):
                    self._pool.submit(os.getpid)  # starts the processes while the environment is set
        finally:
            for k, v in before.items():
                os.environ.pop(k) if v is None else os.environ.__setitem__(k, v)

    def __exit__(self, kind, value, trace) -> None:
        if self._pool is not None:
            processes = list(self._pool._processes.values())
            self._pool.shutdown(wait=kind is None, cancel_futures=True)
            if kind is not None:
                for p in processes:
                    p.terminate()

    def promising(
        self, fit: FittedModel, candidates: list[str], least: float, target: str, source: str
    ) -> list[str]:
        """See `score.promising`."""
        return promising(
            fit, candidates, least, self._prepared.bench(fit.twin, target, source), self._prepared.train
        )

    def run(self, jobs: Iterable) -> list:
        """Answers in the order of the jobs, each a `Job` or anything else that pickles and has its `run`."""
        jobs, out = list(jobs), []
        began = time.perf_counter()
        for job in jobs if self._pool is None else ():
            out.append(job.run(self._prepared))
            self._done()
            each = (time.perf_counter() - began) / len(out)
            if self._jobs > 1 and len(out) >= 2 and each * (len(jobs) - len(out)) > PATIENCE_S:
                self._start()
                break
        rest = jobs[len(out) :]
        if self._pool is None or not rest:
            return out
        futures = {self._pool.submit(_work, job): i for i, job in enumerate(rest)}
        found = [None] * len(rest)
        for future in as_completed(futures):
            found[futures[future]] = future.result()
            self._done()
        return out + found


class StageFitter:
    """Fits sets of effects for one stage of a diagnosis and remembers them.

    Args:
        engine: runs the fits.
        twin: where the first fit starts.
        target: `pose` or `pressure`.
        source: `command` or `measured`.
        starts: starting points of a fit that has no warm start.
    """

    def __init__(self, engine: Engine, twin: Twin, target: str, source: str, starts: int = 4):
        self.engine, self.twin, self.target, self.source, self.starts = engine, twin, target, source, starts
        self._known: dict[tuple[str, ...], FittedModel] = {}

    def fit_all(
        self, effects: Iterable[tuple[str, ...]], start: FittedModel | None = None
    ) -> list[FittedModel]:
        """One fit for each set of effects, in order."""
        effects = [tuple(sorted(e)) for e in effects]
        missing = [e for e in dict.fromkeys(effects) if e not in self._known]
        twin = start.twin if start is not None else self.twin
        found = self.engine.run(
            Job(twin, e, self.target, self.source, 2 if start is not None else self.starts) for e in missing
        )
        self._known.update(zip(missing, found, strict=True))
        return [self._known[e] for e in effects]

    def promising(self, fit: FittedModel, candidates: list[str], least: float) -> list[str]:
        """Those that might lower the training mean square error by the share `least`, by a score test."""
        return self.engine.promising(fit, candidates, least, self.target, self.source)


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
