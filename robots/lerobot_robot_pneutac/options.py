"""Checks of options, in the one form of error whose text LeRobot's commands show."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from draccus.utils import DecodingError

from lerobot_camera_digit.parts import refuse_if
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin, checked_range

if TYPE_CHECKING:
    from pneutac_sim.gel.model import GelModel
    from pneutac_sim.world.station import Station


@contextmanager
def named(option: str) -> Iterator[None]:
    """Refuses what is an InputError inside, and names the option."""
    try:
        yield
    except InputError as e:
        raise DecodingError((), f"--{option}: {e}") from e


def check_choice(option: str, value: str, choices: tuple[str, ...]) -> None:
    """Refuses a value that is not among the choices."""
    refuse_if(value not in choices, f"--{option} is '{value}'; it must be one of {', '.join(choices)}.")


def check_twin_folder(option: str, folder: Path | None) -> None:
    """Refuses a folder without a twin; None is none."""
    missing = folder is not None and not (Path(folder) / "twin.yaml").is_file()
    refuse_if(missing, f"--{option} is '{folder}', which holds no twin.yaml; give a twin's folder.")


def check_finger(option: str, twin: Path | None) -> None:
    """Refuses a twin that is damaged or of nothing that bends; None is the built-in finger."""
    refuse_if(
        chambers_of(option, twin) == 0,
        f"--{option} is '{twin}', the twin of a gel; give that of a finger or an arm.",
    )


def chambers_of(option: str, twin: Path | None) -> int:
    """Chambers of what a twin is of; 0 of a gel, 1 of the built-in finger where there is none."""
    from pneutac_sim.features import CHAMBERS

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


def pressure_range(option: str, twin: Path | None) -> tuple[float, float]:
    """Pressures that a twin was measured over, kPa; those of the built-in one where there is none."""
    with named(option):
        return twin_of(twin).pressure_range_kpa


def twin_of(folder: Path | None) -> Twin:
    """The twin in a folder; the built-in one where there is none. Raises InputError where it is damaged."""
    return Twin.load(folder) if folder else Twin.builtin()


def gel_of(twin: Path | None) -> "GelModel":
    """The gel of a twin, which has contact threshold, size of the images and window of its sensor.

    Raises:
        InputError: the twin's folder is damaged.
    """
    from pneutac_sim.gel.model import GelModel

    return GelModel.from_twin(Twin.load(twin) if twin else None)


def contact_threshold(twin: Path | None) -> float:
    """Contact threshold of a twin's gel, 8-bit levels; that of the built-in twin where there is none."""
    return gel_of(twin).threshold_levels


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


def check_start_width(option: str, width: float) -> None:
    """Refuses a width of random starts beyond what the arm is safe with."""
    from pneutac_sim.world.base import MOST_WIDE

    refuse_if(not 0 <= width <= MOST_WIDE, f"--{option} is {width:g}; it must be from 0 to {MOST_WIDE:g}.")


def check_range(option: str, pressure_range_kpa: tuple[float, float] | None) -> None:
    """Refuses what is no range of pressures; None is none."""
    try:
        if pressure_range_kpa is not None:
            checked_range(pressure_range_kpa, f"--{option}")
    except InputError as e:
        refuse_if(True, str(e))


def check_station(option: str, file: Path | None) -> None:
    """Refuses what is no station.yaml, or has an arm that carries no finger; None is none."""
    from pneutac_sim.world.station import Station

    if file is not None:
        with named(option):
            Station.load(file).make_arm()


def station_of(file: Path | None) -> "Station":
    """The station of a file; the paper's where there is none.

    Raises:
        InputError: it is no station.yaml.
    """
    from pneutac_sim.world.station import Station

    return Station.load(file) if file is not None else Station()


def check_gl(option: str) -> None:
    """Refuses pictures of a scene where OpenGL does not start."""
    from pneutac_sim.world.view import require_gl

    with named(option):
        require_gl()


def check_cameras(option: str, sizes: dict[str, tuple[int, int]]) -> None:
    """Refuses cameras that the scene does not have, and where OpenGL does not start; none are none."""
    from pneutac_sim.world.scene import check_camera

    with named(option):
        for name, size in sizes.items():
            check_camera(name, size)
    if sizes:
        check_gl(option)


def check_conditions(option: str, twin: Path | None, conditions: dict) -> None:
    """Refuses conditions that are no numbers, or a twin that has an effect without its conditions."""
    from pneutac_sim.world.conditions import conditions_for

    with named(option):
        conditions_for(twin_of(twin), conditions)


def check_networks(option: str, twin: Path | None, fidelity: str) -> None:
    """Refuses a twin whose networks are missing or older than it, or whose stiffness no controller holds."""
    from pneutac_sim.world import checks

    with named(option):
        checks.check_networks(twin_of(twin), fidelity)
