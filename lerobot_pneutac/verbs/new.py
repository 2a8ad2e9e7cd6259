"""`pneutac new`: a new twin, from the parametric device, a mesh or with the geometry of a recording."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape

from lerobot_pneutac.cli.options import parse_options
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.rules import an
from pneutac_sim.errors import InputError
from pneutac_sim.finger import Pipeline
from pneutac_sim.gel.model import GelModel
from pneutac_sim.mpm.shapes import WIDTH_MM, body_mesh, digit_mount_mesh
from pneutac_sim.mpm.user_mesh import UserMesh, read_mesh, store_mesh, stored_mesh
from pneutac_sim.twin import DEVICES, PAPER_FINGER, Twin, Value

SAME_LENGTH = 0.02  # within which a mesh and a recording are of one device
USUAL_RANGE_KPA = 50.0  # scales a body's first guess where no recording tells its pressures


@dataclass
class NewConfig:
    """Options of `pneutac new`.

    Attributes:
        twin: folder to write; it must not hold a twin yet.
        device: finger, arm or gel; left out, the recording's own, else a finger.
        recording: geometry is taken from its recording.json.
        mesh: STL, OBJ or PLY of the soft body of a finger or an arm.
        mesh_unit: of its coordinates, mm or m.
        mesh_axis: x, y or z, along which it lies, base first; left out, its longest side. Axes are renamed in
            cyclic order: along z it bends towards the file's y, along y towards x, along x towards z.
        length_mm: of the straight device, where no mesh, recording or the paper's finger tells it.
    """

    twin: Path
    device: str | None = None
    recording: Path | None = None
    mesh: Path | None = None
    mesh_unit: str = "mm"
    mesh_axis: str | None = None
    length_mm: float | None = None

    def __post_init__(self):
        if self.mesh is None:
            return
        if self.device == "gel":
            raise InputError("--mesh is of a finger or an arm; a gel's shape is its window, omit one.")
        if self.length_mm is not None:
            raise InputError("--length_mm is the mesh's own where --mesh is given; omit one.")


def main(argv: list[str]) -> None:
    """Runs the verb."""
    config = parse_options(NewConfig, argv)
    if (config.twin / "twin.yaml").exists():
        raise InputError(f"{config.twin} already holds a twin; choose another folder, or delete that one.")
    if config.device is not None and config.device not in DEVICES:
        raise InputError(f"--device is '{config.device}'; it must be one of {', '.join(DEVICES)}.")
    recording = Recording.load(config.recording) if config.recording is not None else None
    if recording is not None and config.device not in (None, recording.device):
        raise InputError(
            f"--device is '{config.device}', but {config.recording} is of {an(recording.device)}; omit one."
        )
    device = config.device or (recording.device if recording else "finger")
    body = _read_body(config, device, recording)
    twin = new_twin(device, recording, config.length_mm, body)
    write_geometry(twin, twin.save(config.twin))
    if body is not None:
        _tell(config.mesh, body)
    joints = len(twin.spine_joint_positions_mm)
    shape = f", {twin.length_mm:g} mm long with {joints} spine joints" if joints else ""
    Console().print(
        f"{config.twin} holds a new {twin.device}{shape} (geometry.stl, in mm); fit it to measurements with "
        f"`pneutac calibrate --twin={config.twin} --recording={config.recording or 'DIR'}`."
    )


def _read_body(config: NewConfig, device: str, recording: Recording | None) -> UserMesh | None:
    if config.mesh is None:
        return None
    if device == "gel":
        raise InputError(f"--mesh is of a finger or an arm, but {config.recording} is of a gel; omit one.")
    body = read_mesh(config.mesh, config.mesh_unit, config.mesh_axis)
    told = recording.length_mm if recording else None
    if told is not None and abs(body.length_mm - told) > SAME_LENGTH * told:
        raise InputError(
            f"{config.mesh} is {body.length_mm:g} mm long, but length_mm is {told:g} in "
            f"{config.recording}/recording.json; give the mesh of the device that was recorded."
        )
    return body


def _tell(file: Path, body: UserMesh) -> None:
    """Prints what a mesh became, so that a wrong unit or axis is seen at once."""
    size = " x ".join(f"{side:.4g}" for side in body.mesh.extents)
    moved = "as it lay in the file"
    if np.abs(body.shift_mm).max() >= 0.01:
        moved = (
            "moved by ({})".format(", ".join(f"{s:.2f}" for s in np.round(body.shift_mm, 2) + 0.0)) + " mm"
        )
    Console().print(
        f"{file}: {size} mm along x, y and z, {1e-3 * body.mesh.volume:.4g} cm³, {moved}: base at x = 0, "
        "neutral axis at y = z = 0.",
        highlight=False,
        markup=False,
    )
    for note in body.notes:
        Console().print(f"[yellow]{escape(str(file))}:[/] {note}", highlight=False)


def write_geometry(twin: Twin, folder: Path) -> None:
    """Writes `geometry.stl` (mm), the soft body that is filled, and the `mount.stl` of a parametric finger.

    They are to look at, print or edit; an edited one comes back with `pneutac new --mesh`.
    """
    body_mesh(twin).apply_scale(1000.0).export(folder / "geometry.stl")
    if twin.device == "finger" and stored_mesh(twin) is None:
        mount = digit_mount_mesh(1e-3 * twin.length_mm, 1e-3 * WIDTH_MM["finger"])
        mount.apply_scale(1000.0).export(folder / "mount.stl")


def new_twin(
    device: str,
    recording: Recording | None = None,
    length_mm: float | None = None,
    body: UserMesh | None = None,
) -> Twin:
    """A twin with starting values.

    Args:
        device: `finger` (the paper's), `arm`, or `gel` (a generated DIGIT).
        recording: of the same device; gives length, joints and pressure range, or the gel's rest image.
        length_mm: overrides the length.
        body: of a finger or an arm; gives the length.
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
    length = (body.length_mm if body else length_mm) or (recording.length_mm if recording else None) or 110.0
    joints = (recording.spine_joint_positions_mm if recording and not length_mm else None) or []
    start = Twin.builtin() if device == "finger" and recording is None else Twin(device=device)
    twin = Twin(device, length, list(joints), parameters=start.parameters)
    if body is not None:
        store_mesh(twin, body.mesh)
    if start.parameters:
        return twin
    top = USUAL_RANGE_KPA
    if recording is not None:
        top = float(recording.samples[recording.pressure_columns].abs().to_numpy().max()) or USUAL_RANGE_KPA
    pipeline = Pipeline.of(twin)
    twin = pipeline.update(twin, pipeline.theta(twin, top))
    if device == "finger":  # no recording tells it, and the world needs it
        twin.parameters["joint_damping_nms_per_rad"] = Value(PAPER_FINGER["joint_damping_nms_per_rad"])
    return twin
