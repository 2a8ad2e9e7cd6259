"""The study of a recording, by its device."""

from collections.abc import Sequence

from lerobot_pneutac.study.base import EffectStudy
from pneutac_datasets.demonstrations.reading import Demonstrations
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.twin import Twin


def study_of(
    twin: Twin, recording: Recording | Demonstrations, seed: int = 0, adding: Sequence[str] = ()
) -> EffectStudy:
    """The study of a recording by its device.

    Args:
        twin: of the recording's device, or a finger with the gel of the recording.
        recording: of a finger, an arm or a gel, or demonstrations.
        seed: decides the parts and every bootstrap.
        adding: the effects that are to be tried; empty where all are.

    Raises:
        InputError: there is too little to fit or to test.
    """
    if isinstance(recording, Demonstrations):
        from lerobot_pneutac.study.demonstrations import DemonstrationStudy

        return DemonstrationStudy(twin, recording, seed, adding)
    if recording.device == "gel":
        from lerobot_pneutac.study.gel import GelStudy

        return GelStudy(twin, recording, seed)
    from lerobot_pneutac.study.body import BodyStudy

    return BodyStudy(twin, recording, seed, adding)
