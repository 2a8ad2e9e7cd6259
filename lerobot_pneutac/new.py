"""`pneutac new`: a new twin, from the parametric device or with the geometry of a recording."""

from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console

from lerobot_pneutac.options import parse_options
from pneutac_datasets.recording import BenchRecording
from pneutac_datasets.rules import an
from pneutac_sim.errors import InputError
from pneutac_sim.finger import Pipeline
from pneutac_sim.gel.model import GelModel
from pneutac_sim.twin import DEVICES, Twin

USUAL_RANGE_KPA = 50.0  # scales a body's first guess where no recording tells its pressures


@dataclass
class NewConfig:
    """Options of `pneutac new`.

    Attributes:
        twin: folder to write; it must not hold a twin yet.
        device: finger, arm or gel; left out, the recording's own, else a finger.
        recording: geometry is taken from its recording.json.
        length_mm: of the straight device, where neither a recording nor the paper's finger tells it.
    """

    twin: Path
    device: str | None = None
    recording: Path | None = None
    length_mm: float | None = None


def main(argv: list[str]) -> None:
    """Runs the verb."""
    config = parse_options(NewConfig, argv)
    if (config.twin / "twin.yaml").exists():
        raise InputError(f"{config.twin} already holds a twin; choose another folder, or delete that one.")
    if config.device is not None and config.device not in DEVICES:
        raise InputError(f"--device is '{config.device}'; it must be one of {', '.join(DEVICES)}.")
    recording = BenchRecording.load(config.recording) if config.recording is not None else None
    if recording is not None and config.device not in (None, recording.device):
        raise InputError(
            f"--device is '{config.device}', but {config.recording} is of {an(recording.device)}; omit one."
        )
    twin = new_twin(
        config.device or (recording.device if recording else "finger"), recording, config.length_mm
    )
    twin.save(config.twin)
    joints = len(twin.spine_joint_positions_mm)
    shape = f", {twin.length_mm:g} mm long with {joints} spine joints" if joints else ""
    Console().print(
        f"{config.twin} holds a new {twin.device}{shape}; fit it to measurements with "
        f"`pneutac calibrate --twin={config.twin} --recording={config.recording or 'DIR'}`."
    )


def new_twin(device: str, recording: BenchRecording | None = None, length_mm: float | None = None) -> Twin:
    """A twin with starting values.

    Args:
        device: `finger` (the paper's), `arm`, or `gel` (a generated DIGIT).
        recording: of the same device; gives length, joints and pressure range, or the gel's rest image.
        length_mm: overrides the length.
    """
    if device == "gel":
        twin = Twin(device="gel", length_mm=16.0)
        gel = GelModel.builtin()
        if recording is not None:
            meta = recording.meta
            missing = [name for name in ("rest_image", "px_per_mm") if name not in meta]
            if missing:
                file = recording.folder / "recording.json"
                raise InputError(f"{file}: field '{missing[0]}' is missing; a gel's recording needs it.")
            gel = replace(gel, rest_image=recording.image(meta["rest_image"]), px_per_mm=meta["px_per_mm"])
        gel.into_twin(twin)
        return twin
    length = length_mm or (recording.length_mm if recording else None) or 110.0
    joints = (recording.spine_joint_positions_mm if recording and not length_mm else None) or []
    start = Twin.builtin() if device == "finger" and recording is None else Twin(device=device)
    twin = Twin(device, length, list(joints), parameters=start.parameters)
    if start.parameters:
        return twin
    top = USUAL_RANGE_KPA
    if recording is not None:
        top = float(recording.samples[recording.pressure_columns].abs().to_numpy().max()) or USUAL_RANGE_KPA
    pipeline = Pipeline.of(twin)
    return pipeline.update(twin, pipeline.theta(twin, top))
