"""`pneutac new`: makes a twin from the parametric device, a mesh, or the geometry of a recording."""

import shlex
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from lerobot_pneutac.cli.options import TableOptions, parse_options
from lerobot_pneutac.verbs.measured_range import measured_range, range_sentence
from lerobot_pneutac.verbs.new import mesh_sentence, new_twin, read_body, write_geometry
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import an
from pneutac_sim.errors import InputError, check_choice
from pneutac_sim.files import check_writable
from pneutac_sim.twin import DEVICES


@dataclass
class NewConfig(TableOptions):
    """Options of `pneutac new`.

    Attributes:
        twin: folder to write; it must not hold a twin yet.
        device: `finger`, `arm` or `gel`; where left out, the recording's own, else a finger.
        recording: bench recording whose recording.json gives the geometry, or tables as `pneutac convert`
            reads them.
        mesh: STL, OBJ or PLY of the soft body of a finger or an arm.
        mesh_unit: unit of the mesh's coordinates, `mm` or `m`.
        mesh_axis: axis along which the mesh lies, base first: `x`, `y` or `z`; where left out, its longest
            side. Axes are renamed in cyclic order: along z it bends towards the file's y, along y towards x,
            along x towards z.
        length_mm: length of the straight device, where no mesh, recording or the paper's finger tells it.
    """

    twin: Path
    device: str | None = None
    recording: Path | None = None
    mesh: Path | None = None
    mesh_unit: str = "mm"
    mesh_axis: str | None = None
    length_mm: float | None = None

    def __post_init__(self):
        check_choice("device", self.device or DEVICES[0], DEVICES)
        if self.mesh is None:
            return
        if self.device == "gel":
            raise InputError("--mesh is of a finger or an arm; a gel's shape is its window, omit one.")
        if self.length_mm is not None:
            raise InputError("--length_mm is the mesh's own where --mesh is given; omit one.")


def main(argv: list[str]) -> None:
    """Runs the verb."""
    config, console = parse_options(NewConfig, argv), Console()
    if (config.twin / "twin.yaml").exists():
        raise InputError(f"{config.twin} already holds a twin; choose another folder, or delete that one.")
    check_writable(config.twin, f"--twin={config.twin}")
    recording = Recording.load(config.recording) if config.recording is not None else None
    if recording is not None and config.device not in (None, recording.device):
        raise InputError(
            f"--device is '{config.device}', but {config.recording} is of {an(recording.device)}; omit one."
        )
    if (
        recording is not None
        and recording.meta.get("source")
        and not (recording.length_mm or config.length_mm)
    ):
        raise InputError(f"Give --length_mm: nothing in {config.recording} tells how long the device is.")
    device = config.device or (recording.device if recording else "finger")
    body = None
    if config.mesh is not None:
        body = read_body(config.mesh, device, recording, config.mesh_unit, config.mesh_axis)
    twin = new_twin(device, recording, config.length_mm, body)
    write_geometry(twin, twin.save(config.twin))
    if body is not None:
        console.print(f"{config.mesh}: {mesh_sentence(body)}", highlight=False, markup=False)
        for note in body.notes:
            console.print(f"[yellow]{escape(str(config.mesh))}:[/] {note}", highlight=False)
    if recording is not None and twin.device != "gel" and measured_range(recording):
        console.print(range_sentence(twin.pressure_range_kpa), highlight=False)
    joints = len(twin.spine_joint_positions_mm)
    shape = f", {twin.length_mm:g} mm long with {joints} spine joints" if joints else ""
    fit = ["pneutac", "calibrate", f"--twin={config.twin}", f"--recording={config.recording or 'DIR'}"]
    console.print(
        f"{config.twin} holds a new {twin.device}{shape}. Next: `{shlex.join(fit)}`",
        soft_wrap=True,
    )
