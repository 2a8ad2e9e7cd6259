"""How far a twin is from a recording, and where it fails."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from lerobot_pneutac.cli.options import PairOptions, keywords
from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.study.pair import load_bench_pair, load_pair, same_device, with_unit_note
from lerobot_pneutac.verbs.result import Comparison
from pneutac_datasets.demonstrations.replay.reading import Demonstrations
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError, check_choice
from pneutac_sim.progress import Progress, no_progress
from pneutac_sim.twin import Twin

FIDELITIES = ("pipeline", "mpm")


def compare(
    twin: Twin,
    recording: Recording | Demonstrations,
    *,
    fidelity: str = "pipeline",
    samples: int | None = None,
    seed: int = 0,
    progress: Progress = no_progress,
) -> Comparison:
    """Runs the twin on what a recording commanded and sorts the errors; neither is changed.

    Args:
        twin: of the recording's device, or a finger with the gel of the recording.
        recording: of a finger, an arm or a gel; or demonstrations of a robot with the finger, which are
            replayed in the twin's world.
        fidelity: `pipeline` (the twin's kinematics, every sample) or `mpm` (of a finger or an arm: the full
            body of material points, at samples spread over the recording).
        samples: largest number of samples by mpm; if omitted, 200.
        seed: seed of the choice of the samples by mpm, and of the demonstrations that are held out.
        progress: called with a text, the steps done and all of them.

    Raises:
        InputError: the devices differ, or an effect cannot act in the full simulation.
    """
    check_fidelity(fidelity, samples)
    if isinstance(recording, Demonstrations):
        if fidelity != "pipeline":
            raise InputError(f"fidelity={fidelity} does not replay demonstrations; omit it.")
        same_device(twin, recording, "the twin", "compare")
        from lerobot_pneutac.verbs.compare_demonstrations import compare_demonstrations

        return compare_demonstrations(twin, recording, seed, progress)
    if not (recording.device == "gel" and twin.gel):
        same_device(twin, recording, "the twin", "compare")
    if recording.device == "gel":
        if fidelity != "pipeline":
            raise InputError(
                f"fidelity={fidelity} is of a finger or an arm, but the recording is of a gel; omit it."
            )
        from lerobot_pneutac.verbs.compare_gel import compare_gel

        return compare_gel(twin, recording)
    from lerobot_pneutac.verbs.compare_body import compare_body

    whole = compare_body(twin, with_unit_note(twin, recording))
    if fidelity == "pipeline":
        return whole
    from lerobot_pneutac.verbs.compare_mpm import SAMPLES, by_mpm

    return by_mpm(whole, twin, samples or SAMPLES, seed, progress)


def check_fidelity(fidelity: str, samples: int | None) -> None:
    check_choice("fidelity", fidelity, FIDELITIES)
    if samples is not None and (samples < 2 or fidelity != "mpm"):
        raise InputError(f"samples={samples} must be 2 or more, together with fidelity=mpm.")


@dataclass
class CompareConfig(PairOptions):
    """Options of `pneutac compare`.

    Attributes:
        recording: folder of a bench recording, or tables as `pneutac convert` reads them of the same device;
            or of a LeRobotDataset of demonstrations, or its name on the Hub, which are replayed in the twin's
            world.
        later: recordings of the same finger or arm on other dates: how it ages, when to calibrate it again.
    """

    described_by: ClassVar = compare

    fidelity: str = "pipeline"
    samples: int | None = None
    later: list[Path] = field(default_factory=list)
    seed: int = 0

    def __post_init__(self):
        check_fidelity(self.fidelity, self.samples)
        if self.later and self.fidelity != "pipeline":
            raise InputError(f"later is compared by the pipeline, not by fidelity={self.fidelity}; omit it.")


def command(cfg: CompareConfig, terminal: Terminal) -> None:
    """Compares a twin with a recording, and shows where it fails."""
    if cfg.later:
        from lerobot_pneutac.verbs.ageing import ageing  # plotly, which the library loads for a page alone

        pairs = [load_bench_pair(cfg.twin, p, "compute ageing from") for p in (cfg.recording, *cfg.later)]
        terminal.finish(ageing(pairs[0][0], [recording for _, recording in pairs], cfg.seed), cfg.out)
        return
    twin, recording = load_pair(cfg.twin, cfg.recording, "compare", cfg.task, cfg.station)
    with terminal.progress() as progress:
        result = compare(twin, recording, **keywords(cfg, compare), progress=progress)
    terminal.finish(result, cfg.out)
