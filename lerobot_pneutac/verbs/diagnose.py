"""Which physical effect a twin lacks, with rivals, intervals and the next experiment."""

import os
from collections.abc import Callable

from lerobot_pneutac.diagnosis.steps import Steps
from lerobot_pneutac.study import study_of
from lerobot_pneutac.study.pair import same_body
from lerobot_pneutac.verbs.diagnosis import Diagnosis
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
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
