"""`pneutac render`: draws a finger, arm or gel of material points under load, as pictures and a film."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from pneutac_datasets.recording.wording import an
from pneutac_sim.errors import InputError, check_between, check_least
from pneutac_sim.finger.online import refuse_unused
from pneutac_sim.gel.indenter import AnyFigure, Figure, Outline, Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.twin import Twin

FPS = 15

# What a device takes, and what it is where it is not given.
SEEN = {"recording": None, "camera": None, "view": None}
MOST_S = 3600.0  # of a film at one pressure
BODY = {"pressure_kpa": None, "seconds": 1.0, "particles": 4000} | SEEN
GEL = {"indenter": "sphere", "size_mm": 4.0, "depth_mm": 1.4, "x_mm": 0.0, "y_mm": 0.0, "yaw_rad": 0.0}
GEL |= {"indenter_file": None, "outline_mm": None}


@dataclass
class RenderView:
    """From where a body is seen, hanging from its base."""

    azimuth_deg: float = 30.0  # round its length, from where a bend goes to the right, towards the bend
    elevation_deg: float = 10.0  # angle from below (-90) through level to above (90)
    distance_lengths: float = 4.0  # distance from the middle of its motion, in lengths of the body

    def __post_init__(self):
        if not np.isfinite([self.azimuth_deg, self.elevation_deg]).all() or abs(self.elevation_deg) > 90:
            angles = f"azimuth_deg is {self.azimuth_deg} and elevation_deg {self.elevation_deg}"
            raise InputError(f"{angles}; give numbers, the elevation between -90 and 90.")
        if not 1.5 <= self.distance_lengths <= 100:
            far = f"distance_lengths is {self.distance_lengths}; from there the camera does not see the body"
            raise InputError(f"{far}: give 1.5 to 100.")


@dataclass
class RenderConfig:
    """Options of `pneutac render`; those of another device are refused, so they are None where not given."""

    twin: Path  # folder of the twin
    # pressures of a finger, one after the other; of an arm three numbers for each pose. If omitted, those of
    # the recording; without one four from rest to the end of the range that the twin was measured over, for
    # an arm at rest, then two thirds of it in one chamber after the other
    pressure_kpa: list[float] | None = None
    # time of each pressure in the film, half to get there, half to stay; if omitted, 1
    seconds: float | None = None
    conditions: dict[str, float] = field(default_factory=dict)  # what effects ask for, {temperature_c: 30}
    recording: Path | None = None  # photographs to show next to a finger or an arm calibrated by images
    camera: str | None = None  # name of one of the recording's cameras; if omitted, the first
    # direction of view without a recording; the body is in the twin's looks where it has them, else coloured
    # by stretch
    view: RenderView | None = None
    # indenter of a gel: `sphere`, `cylinder`, `cube`, `edge`, `cone`, `outline` or `mesh`; if omitted, a
    # sphere
    indenter: str | None = None
    size_mm: float | None = None  # radius of the indenter, or side of cube and edge; if omitted, 4
    depth_mm: float | None = None  # depth of the press into the gel; if omitted, 1.4
    x_mm: float | None = None  # place along image columns, from the middle; if omitted, 0
    y_mm: float | None = None  # place along image rows, from the middle; if omitted, 0
    yaw_rad: float | None = None  # turn of the indenter, from columns towards rows; if omitted, 0
    indenter_file: Path | None = None  # STL of a `mesh` in mm, tip down, the contact's centre at x = y = 0
    outline_mm: str | None = None  # corners of an `outline`, mm from the contact's centre: "0 2; 2 -1; -2 -1"
    particles: int | None = None  # number of material points of a finger or an arm, about; if omitted, 4000
    device: str = "auto"  # `auto`, `cpu` or `cuda`
    out: Path = Path("outputs/render")  # folder for pictures, film.mp4, `report.html` and `result.json`

    def __post_init__(self):
        if self.pressure_kpa is not None and not (self.pressure_kpa and np.isfinite(self.pressure_kpa).all()):
            raise InputError(f"pressure_kpa is {self.pressure_kpa}; give finite numbers, as in [0,5,10].")
        if self.seconds is not None and not 2 / FPS <= self.seconds <= MOST_S:
            raise InputError(f"seconds is {self.seconds}; a pressure needs {2 / FPS:.2f} to {MOST_S:g} s.")
        if self.particles is not None:
            check_least(100, particles=self.particles)
            check_between(100, 1_000_000, particles=self.particles)


def filled(config: RenderConfig, twin: Twin) -> RenderConfig:
    """Options with the defaults of the twin's device; raises InputError where it has no use for one."""
    own = GEL if twin.device == "gel" else BODY
    for name in BODY if own is GEL else GEL:
        if getattr(config, name) is not None:
            of = "a finger or an arm" if own is GEL else "a gel"
            raise InputError(f"{name} is of {of}, but {config.twin} is of {an(twin.device)}; omit it.")
    if config.camera is not None and config.recording is None:
        raise InputError("camera is one of a recording; give its folder too, or choose a view instead.")
    if config.view is not None and config.recording is not None:
        raise InputError("view and recording exclude each other; omit one.")
    refuse_unused(twin, config.conditions)
    if own is not GEL:
        own = own | {"pressure_kpa": _pressures(twin)}
    if config.recording is not None:
        own = {name: value for name, value in own.items() if name != "pressure_kpa"}
    return replace(config, **{name: value for name, value in own.items() if getattr(config, name) is None})


def _pressures(twin: Twin) -> list[float]:
    """Poses that show how a finger or an arm moves, within the range that the twin was measured over, kPa."""
    far = max(twin.pressure_range_kpa, key=abs)
    if twin.device == "finger":
        return [far * share / 3 for share in range(4)]
    return [0.0, 0.0, 0.0, *(2 / 3 * far * np.eye(3)).ravel().tolist()]


def deepest_press(config: RenderConfig, gel: GelModel) -> Press:
    """The indenter where it is deepest; raises InputError where it goes too deep, or touches no gel."""
    place = config.x_mm, config.y_mm, config.depth_mm, config.yaw_rad or 0.0
    press = Press(config.indenter, config.size_mm, *place, _figure(config))
    deepest = 0.8 * gel.thickness_mm
    if config.depth_mm >= deepest:
        thick = f"depth_mm is {config.depth_mm}; the gel is {gel.thickness_mm:g} mm thick"
        raise InputError(f"{thick}: press less than {deepest:.2g} mm.")
    for name, side, reach in zip(("x_mm", "y_mm"), gel.window_mm, _footprint_mm(press), strict=True):
        place, most = getattr(config, name), side / 2 + reach
        if not abs(place) < most:
            misses = f"{name} is {place:g}, where the {config.indenter} misses the gel's window"
            raise InputError(f"{misses}; give a place between {-most:.3g} and {most:.3g}.")
    return press


def _figure(config: RenderConfig) -> AnyFigure | None:
    for kind, name in (("outline", "outline_mm"), ("mesh", "indenter_file")):
        if (config.indenter == kind) != (getattr(config, name) is not None):
            raise InputError(f"indenter={kind} and {name} come together; give both or neither.")
    if config.indenter_file is not None:
        return Figure.read(config.indenter_file)
    return Outline.of_text(config.outline_mm) if config.outline_mm else None


def _footprint_mm(press: Press) -> tuple[float, float]:
    """Half the extent, along x and y, of what lies below the resting surface."""
    s, d = press.size_mm, press.depth_mm
    if press.figure is not None:
        return s, s
    if press.indenter == "edge":
        return s / 2, min(d, s / np.sqrt(2))
    ball = np.sqrt(d * (2 * s - d)) if d < s else s
    reach = {"sphere": ball, "cylinder": s, "cone": min(d, s), "cube": s / 2}[press.indenter]
    return reach, reach
