"""Which physical effect a twin lacks, with rivals, intervals and the next experiment."""

import os
from collections.abc import Callable
from dataclasses import dataclass

from lerobot_pneutac.cli.options import PairOptions
from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.diagnosis.steps import Steps
from lerobot_pneutac.study import study_of
from lerobot_pneutac.study.pair import load_pair, same_body
from lerobot_pneutac.verbs.diagnosis import Diagnosis, save_contenders
from pneutac_datasets.demonstrations.replay.reading import Demonstrations
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin


def diagnose(
    twin: Twin,
    recording: Recording | Demonstrations,
    *,
    jobs: int = 0,
    seed: int = 0,
    progress: Callable[[str, int, int], None] | None = None,
) -> Diagnosis:
    """Finds what a twin lacks to explain a recording; neither is changed.

    Args:
        twin: of the recording's device, or a finger with the gel of the recording.
        recording: of a finger, an arm or a gel, or demonstrations of a robot with the finger.
        jobs: threads; 0 for all cores.
        seed: decides which part is held out, and every bootstrap.
        progress: called with a text, the fits done and all of them.

    Raises:
        InputError: the recording has too few rows to fit the twin at all, or is of another device.
    """
    if jobs < 0:
        raise InputError(f"jobs={jobs} must be 0 (all cores) or a positive number.")
    study = study_of(twin, same_body(twin, recording, "diagnose"), seed)
    return Diagnosis(study=study, outcome=study.search(jobs or cores(), Steps(progress)))


def cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass
class DiagnoseConfig(PairOptions):
    """Options of `pneutac diagnose`.

    Attributes:
        twin: folder of the twin, which is not changed.
        jobs: number of processes; 0 for all cores.
        seed: seed of the data split and of every bootstrap.
    """

    jobs: int = 0
    seed: int = 0


def command(cfg: DiagnoseConfig, terminal: Terminal) -> None:
    """Finds the physical effect that a twin lacks, its rivals and the next experiment."""
    twin, recording = load_pair(cfg.twin, cfg.recording, "diagnose", cfg.task, cfg.station)
    with terminal.progress() as progress:
        result = diagnose(twin, recording, jobs=cfg.jobs, seed=cfg.seed, progress=progress)
    if cfg.out is not None and recording.device != "gel":
        result = result.save(cfg.out)
    elif cfg.out is not None:
        save_contenders(cfg.out, result.outcome.contenders)
    terminal.finish(result, cfg.out)
