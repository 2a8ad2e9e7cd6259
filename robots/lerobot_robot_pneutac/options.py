"""Checks of options, in the one form of error whose text LeRobot's commands show.

What simulates is imported where it is used: LeRobot's commands import the options of every device.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from draccus.utils import DecodingError

from lerobot_camera_digit.parts import refuse_if
from pneutac_sim.errors import InputError
from pneutac_sim.features import CHAMBERS, FIDELITIES, RENDERS
from pneutac_sim.twin import Twin, checked_range

if TYPE_CHECKING:
    from pneutac_sim.gel.model import GelModel
    from pneutac_sim.world.station import Station


@dataclass(kw_only=True)
class WorldOptions:
    """Options of every simulated world of a twin."""

    # how finger and gel deform: `surrogate`, by networks; `mpm`, by full material points (seconds a control
    # step in contact, for checks); `probe`, by formulas, the one that an arm has
    fidelity: str = "surrogate"
    # what the twin's effects ask for, such as {temperature_c: 28, payload_g: [0, 20]}; from a range [low,
    # high] every episode draws
    conditions: dict[str, float | list[float]] = field(default_factory=dict)
    # what draws touch and finger: `mesh`, light on every pixel and MuJoCo's shapes; `splats`, the Gaussians
    # of the gel and, in pictures of the scene, of the twin's body over MuJoCo's scene (needs OpenGL)
    render: str = "mesh"
    # pressures of the action, such as [0, 20]; default those that the twin was measured over, beyond which it
    # is extrapolated
    pressure_range_kpa: tuple[float, float] | None = None
    # file `station.yaml` of arm, workspace, mount and control rate; default the paper's
    station: Path | None = None


@dataclass(kw_only=True)
class SceneOptions:
    """Options of every simulated scene before a task."""

    # how much wider than the task's own random starts of hand and objects are: 0 the task's own, 1 wide, 2 at
    # most
    start_width: float = 0.0
    randomise_look: bool = False  # light, colours and texture of the scene are newly drawn in every episode
    # touch is data too, `tactile.points`: displacement and force on a grid; lerobot-record 0.6 has no place
    # for it and leaves it out, `record_episodes` writes it
    tactile_points: bool = False


@contextmanager
def named(option: str) -> Iterator[None]:
    """Refuses what is an InputError inside, and names the option."""
    try:
        yield
    except InputError as e:
        raise DecodingError((), f"--{option}: {e}") from e


def check_range(option: str, value: float | None, low: float, high: float = math.inf, ends: str = "[]"):
    """Refuses a number outside of a range, of which an end with a round bracket is no part; None is none."""
    if value is None:
        return
    above = low <= value if ends[0] == "[" else low < value
    below = value <= high if ends[1] == "]" else value < high
    words = f"{low:g} or more" if ends[0] == "[" else f"above {low:g}"
    if high == math.inf:
        below = value < high
    else:
        words += f" and at most {high:g}" if ends[1] == "]" else f" and below {high:g}"
    refuse_if(not (above and below), f"{option} is {value}; it must be {words}.")


def check_choice(option: str, value: str, choices: tuple[str, ...]) -> None:
    """Refuses a value that is not among the choices."""
    refuse_if(value not in choices, f"--{option} is '{value}'; it must be one of {', '.join(choices)}.")


def check_twin_folder(option: str, folder: Path | None) -> None:
    """Refuses a folder without a twin; None is none."""
    missing = folder is not None and not (Path(folder) / "twin.yaml").is_file()
    refuse_if(missing, f"--{option} is '{folder}', which holds no twin.yaml; give a twin's folder.")


def chambers_of(option: str, twin: Path | None) -> int:
    """Chambers of what a twin is of; 0 of a gel, 1 of the built-in finger where there is none."""
    with named(option):
        return CHAMBERS.get(Twin.load(twin).device, 0) if twin else 1


def check_bend(option: str, twin: Path | None) -> None:
    """Refuses a twin of several chambers where one bend is to be commanded."""
    chambers = chambers_of(f"{option}.twin", twin)
    refuse_if(
        chambers > 1,
        f"--{option}.bend=true commands the bend of one chamber and --{option}.twin has {chambers}; leave"
        f" --{option}.bend out and command the pressures.",
    )


def twin_of(folder: Path | None) -> Twin:
    """The twin in a folder; the built-in one where there is none. Raises InputError where it is damaged."""
    return Twin.load(folder) if folder else Twin.builtin()


def gel_of(twin: Path | None) -> "GelModel":
    """The gel of a twin, or the built-in one; raises InputError where the twin's folder is damaged."""
    from pneutac_sim.gel.model import GelModel

    return GelModel.from_twin(Twin.load(twin) if twin else None)


def tactile_shape(option: str, twin: Path | None) -> tuple[int, int, int]:
    """Height, width and channels of the images of a twin's sensor; a DIGIT's where there is none."""
    with named(option):
        h, w, c = gel_of(twin).rest_image.shape
        return h, w, c


def standin_sensor(twin: Path | None) -> dict:
    """What the stand-in takes of the twin that was calibrated on it: threshold, size of images and window."""
    if twin is None:
        return {}
    gel = gel_of(twin)
    shape = tuple(gel.rest_image.shape)
    return {"contact_threshold": gel.threshold_levels, "image_shape": shape, "window_mm": gel.window_mm}


def station_of(file: Path | None) -> "Station":
    """The station of a file, or the paper's; raises InputError where it is no station.yaml."""
    from pneutac_sim.world.station import Station

    return Station.load(file) if file is not None else Station()


def check_station(option: str, file: Path | None) -> None:
    """Refuses what is no station.yaml, or has an arm that carries no finger; None is none."""
    if file is not None:
        with named(option):
            station_of(file).make_arm()


def check_scene(group: str, start_width: float, cameras: dict[str, tuple[int, int]]) -> None:
    """Refuses what a scene does not have, of options of a group `env` or `robot`.

    That is starts that are wider than the arm is safe with, and pictures, (height, width) by camera, without
    OpenGL.
    """
    from pneutac_sim.world.base import MOST_WIDE
    from pneutac_sim.world.scene import check_camera

    check_range(f"--{group}.start_width", start_width, 0, MOST_WIDE)
    with named(f"{group}.cameras"):
        for name, size in cameras.items():
            check_camera(name, size)
    if cameras:
        check_gl(f"{group}.cameras")


def check_gl(option: str) -> None:
    """Refuses pictures of a scene where OpenGL does not start."""
    from pneutac_sim.world.view import require_gl

    with named(option):
        require_gl()


def check_finger(group: str, twin: Path | None, conditions: dict) -> None:
    """Refuses a twin of nothing that bends, and one that has an effect without its conditions."""
    from pneutac_sim.world.checks import conditions_for

    refuse_if(
        chambers_of(f"{group}.twin", twin) == 0,
        f"--{group}.twin is '{twin}', the twin of a gel; give that of a finger or an arm.",
    )
    with named(f"{group}.conditions"):
        conditions_for(twin_of(twin), conditions)


def check_world(group: str, config) -> None:
    """Refuses options of which no twin's world can be made: twin, fidelity, conditions, light, pressures."""
    from pneutac_sim.world.checks import check_networks

    check_choice(f"{group}.fidelity", config.fidelity, FIDELITIES)
    check_choice(f"{group}.render", config.render, RENDERS)
    check_twin_folder(f"{group}.twin", config.twin)
    check_finger(group, config.twin, config.conditions)
    with named(f"{group}.twin"):
        check_networks(twin_of(config.twin), config.fidelity)
    try:
        if config.pressure_range_kpa is not None:
            checked_range(config.pressure_range_kpa, f"--{group}.pressure_range_kpa")
    except InputError as e:
        raise DecodingError((), str(e)) from e
