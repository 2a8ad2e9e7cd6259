"""New twins: a parametric device, one with a mesh of its own, or with the geometry of a recording."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from rich.markup import escape

from lerobot_pneutac.cli.options import TableOptions
from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.study.pair import fit_parts
from lerobot_pneutac.verbs.result import measured_range, range_sentence
from pneutac_datasets.demonstrations.reading import is_demonstrations
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.sources.plain import refuse_other_axes
from pneutac_datasets.recording.wording import an
from pneutac_sim.errors import InputError, check_choice, check_length, refuse_given
from pneutac_sim.files import whole
from pneutac_sim.finger import Pipeline
from pneutac_sim.gel.model import GelModel
from pneutac_sim.twin import DEVICES, PAPER_FINGER, Twin, Value

if TYPE_CHECKING:  # meshes are slow to import, and most twins have none
    from pneutac_sim.mpm.user_mesh import UserMesh

SAME_LENGTH = 0.02  # share of the length within which a mesh and a recording are of one device
USUAL_LENGTH_MM = 110.0
USUAL_RANGE_KPA = 50.0  # scales a body's first guess where no recording has its pressures


def new_twin(
    device: str = "finger",
    recording: Recording | None = None,
    length_mm: float | None = None,
    body: UserMesh | None = None,
) -> Twin:
    """A twin with starting values.

    Length, joints and pressure range, or a gel's rest image, are the recording's; `length_mm` overrides its
    length, and a `body` from `read_body` has its own. Raises InputError where a gel's recording lacks what
    it needs.
    """
    if device == "gel":
        twin, gel = Twin(device="gel", length_mm=16.0), GelModel.builtin()
        if recording is not None:
            meta = recording.meta
            missing = [name for name in ("rest_image", "px_per_mm") if name not in meta]
            if missing:
                file = recording.folder / "recording.json"
                raise InputError(f"{file}: field '{missing[0]}' is missing; a gel's recording needs it.")
            gel = replace(gel, rest_image=recording.image(meta["rest_image"]), px_per_mm=meta["px_per_mm"])
        gel.into_twin(twin)
        return twin
    length = body.length_mm if body else length_mm
    joints = (recording.spine_joint_positions_mm if recording and length_mm is None else None) or []
    if length is None:
        length = (recording.length_mm if recording else None) or USUAL_LENGTH_MM
    start = Twin.builtin() if device == "finger" and recording is None else Twin(device=device)
    twin = Twin(device, length, list(joints), parameters=start.parameters)
    measured = None if recording is None else measured_range(recording)
    twin.pressure_range_kpa = measured or twin.pressure_range_kpa
    if body is not None:
        from pneutac_sim.mpm.user_mesh import store_mesh

        store_mesh(twin, body.mesh)
    if start.parameters:
        return twin
    pipeline, top_kpa = Pipeline.of(twin), max(map(abs, measured or (0.0,)))
    twin = pipeline.update(twin, pipeline.theta(twin, top_kpa or USUAL_RANGE_KPA))
    if device == "finger":  # no recording has it, and the world needs it
        damping, stiffness = "joint_damping_nms_per_rad", "joint_stiffness_nm_per_rad"
        twin.parameters[damping] = Value(PAPER_FINGER[damping])
        # K = E I / h of the paper's section, with segments of another length h.
        paper = Twin.builtin()
        shorter = len(twin.spine_joint_positions_mm) / twin.length_mm * paper.length_mm
        shorter /= len(paper.spine_joint_positions_mm)
        twin.parameters[stiffness] = Value(PAPER_FINGER[stiffness] * shorter)
    return twin


def read_body(
    mesh: Path, device: str, recording: Recording | None = None, unit: str = "mm", axis: str | None = None
) -> UserMesh:
    """The mesh of a finger or an arm, in `mm` or `m`, base first along `axis` (None for its longest side).

    Raises InputError where a recording of the device has another length, or the file is no usable mesh.
    """
    from pneutac_sim.mpm.user_mesh import read_mesh

    if device == "gel":
        raise InputError(f"mesh is of a finger or an arm, but {recording.folder} is of a gel; omit one.")
    body = read_mesh(mesh, unit, axis)
    expected = recording.length_mm if recording else None
    if expected is not None and abs(body.length_mm - expected) > SAME_LENGTH * expected:
        stated = f"length_mm is {expected:g} in {recording.folder}/recording.json"
        remedy = "give the mesh of the device that was recorded"
        raise InputError(f"{mesh} is {body.length_mm:g} mm long, but {stated}; {remedy}.")
    return body


def mesh_sentence(body: UserMesh) -> str:
    """What a mesh became, so that a wrong unit or axis is seen at once."""
    size = " x ".join(f"{side:.4g}" for side in body.mesh.extents)
    moved = "as it lay in the file"
    if np.abs(body.shift_mm).max() >= 0.01:
        moved = f"moved by ({', '.join(f'{s:.2f}' for s in np.round(body.shift_mm, 2) + 0.0)}) mm"
    volume = f"{1e-3 * body.mesh.volume:.4g} cm³"
    return f"{size} mm along x, y and z, {volume}, {moved}: base at x = 0, neutral axis at y = z = 0."


def write_geometry(twin: Twin, folder: Path) -> None:
    """Writes `geometry.stl` (mm), the soft body that is filled, and the `mount.stl` of a parametric finger.

    They are to look at, print or edit; an edited one comes back with `pneutac new --mesh`.
    """
    from pneutac_sim.mpm.solid import WIDTH_MM, body_mesh, digit_mount_mesh
    from pneutac_sim.mpm.user_mesh import stored_mesh

    meshes = {"geometry.stl": body_mesh(twin)}
    if twin.device == "finger" and stored_mesh(twin) is None:
        meshes["mount.stl"] = digit_mount_mesh(1e-3 * twin.length_mm, 1e-3 * WIDTH_MM["finger"])
    for name, mesh in meshes.items():
        with whole(folder / name) as part:
            mesh.apply_scale(1000.0).export(part, file_type="stl")


@dataclass
class NewConfig(TableOptions):
    """Options of `pneutac new`."""

    outputs: ClassVar = ("twin",)

    twin: Path  # folder to write; it must not hold a twin yet
    device: str | None = None  # `finger`, `arm` or `gel`; if omitted, the recording's own, else a finger
    # bench recording whose recording.json gives the geometry, or tables as `pneutac convert` reads them
    recording: Path | None = None
    mesh: Path | None = None  # STL, OBJ or PLY of the soft body of a finger or an arm
    mesh_unit: str = "mm"  # unit of the mesh's coordinates, `mm` or `m`
    # axis along which the mesh lies, base first: `x`, `y` or `z`; if omitted, its longest side. Axes are
    # renamed in cyclic order: along z it bends towards the file's y, along y towards x, along x towards z
    mesh_axis: str | None = None
    # length of the straight device, if no mesh, recording or the paper's finger gives it
    length_mm: float | None = None

    def __post_init__(self):
        if (self.twin / "twin.yaml").exists():  # before a table is converted
            raise InputError(f"{self.twin} already holds a twin; choose another folder, or delete that one.")
        check_choice("device", self.device or DEVICES[0], DEVICES)
        if self.length_mm is not None:
            check_length(self.length_mm)
        if self.mesh is None:
            if self.mesh_unit != "mm" or self.mesh_axis is not None:
                raise InputError("mesh_unit and mesh_axis are of a --mesh=FILE; omit them, or give it.")
            return
        if self.device == "gel":
            raise InputError("--mesh is of a finger or an arm; a gel's shape is its window, omit one.")
        if self.length_mm is not None:
            raise InputError("--length_mm is the mesh's own where --mesh is given; omit one.")


def command(config: NewConfig, terminal: Terminal) -> None:
    if config.recording is not None and is_demonstrations(config.recording):
        raise InputError(f"{config.recording} holds demonstrations; give a bench recording of the device.")
    recording = Recording.load(config.recording) if config.recording is not None else None
    if recording is not None and config.device not in (None, recording.device):
        of = f"{config.recording} is of {an(recording.device)}"
        raise InputError(f"--device is '{config.device}', but {of}; omit one.")
    if recording is not None:
        refuse_other_axes(recording)
    converted = recording is not None and recording.meta.get("source")
    if converted and not (recording.length_mm or config.length_mm):
        raise InputError(f"Give --length_mm: {config.recording} does not state the length of the device.")
    device = config.device or (recording.device if recording else "finger")
    if device == "gel":
        refuse_given(config, ("length_mm",), "is of a finger or an arm, and this is a gel")
    known_mm = recording.length_mm if recording is not None else None
    if known_mm and config.length_mm and not 0.5 <= config.length_mm / known_mm <= 2.0:
        raise InputError(
            f"--length_mm is {config.length_mm:g}, but {config.recording} is of {an(device)} of about "
            f"{known_mm:g} mm; correct one of them."
        )
    how = (device, recording, config.mesh_unit, config.mesh_axis)
    body = None if config.mesh is None else read_body(config.mesh, *how)
    twin = new_twin(device, recording, config.length_mm, body)
    if body is not None:
        terminal.say(f"{config.mesh}: {mesh_sentence(body)}")
        for note in body.notes:
            terminal.say(f"[yellow]{escape(str(config.mesh))}:[/] {note}", markup=True)
    if recording is not None and twin.device != "gel":
        if measured_range(recording):
            terminal.say(range_sentence(twin.pressure_range_kpa))
        try:
            fit_parts(twin, recording)
        except InputError as e:
            terminal.note(f"This recording gives the geometry, but nothing can be fitted to it: {e}")
    write_geometry(twin, config.twin)
    twin.save(config.twin)  # last: a folder that holds one is refused when the command is repeated
    joints = len(twin.spine_joint_positions_mm)
    shape = f", {twin.length_mm:g} mm long with {joints} spine joints" if joints else ""
    fit = ["pneutac", "calibrate", f"--twin={config.twin}", f"--recording={config.recording or 'DIR'}"]
    terminal.say(f"{config.twin} holds a new {twin.device}{shape}.")
    terminal.next_step(shlex.join(fit))
