"""The library of priors: what sensors of a make share, as files; those of the product and one's own.

Own ones lie in $PNEUTAC_PRIORS, else in ~/.local/share/pneutac/priors, and are written by `save`.
"""

import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pneutac_sim.effects.sensor_effect import CHANNELS
from pneutac_sim.errors import InputError
from pneutac_sim.gel.channel import Channel
from pneutac_sim.gel.layout import DIGIT, MAKE_SD, MAKE_SD_MM, MAKE_SD_RAD, Layout, Unit, kept
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.residual import Leftover

NAME = r"[A-Za-z0-9][A-Za-z0-9 _.-]{0,39}"
LENDERS = ("near_light", "rest_colour")


def own_folder() -> Path:
    """Folder of the user's own sensor priors."""
    given = os.environ.get("PNEUTAC_PRIORS")
    return Path(given) if given else Path.home() / ".local" / "share" / "pneutac" / "priors"


def library() -> tuple[Layout, ...]:
    """All makes whose lights are known.

    Raises:
        InputError: a file of one's own is no prior.
    """
    return DIGIT, *(Layout.read(file) for file in sorted(own_folder().glob("*.yaml")))


def check_name(name: str) -> None:
    """Raises InputError where a prior cannot be called so."""
    if not re.fullmatch(NAME, name) or name.lower() == DIGIT.name.lower():
        raise InputError(
            f"save_prior is '{name[:60]}'; give up to 40 letters, digits, spaces, dots, - and _, other than "
            f"{DIGIT.name}."
        )


def save(
    name: str, gel: GelModel, channels: Sequence[Channel], source: str, leftovers: Sequence[Leftover] = ()
) -> Path:
    """Keeps a calibrated sensor's lights as a prior for others of its make; an earlier one is replaced.

    Each number is stored with the deviation that its calibration left, and never less than that between
    sensors of one make.

    Args:
        name: of the make.
        gel: as calibrated.
        channels: of that fit, red, green and blue.
        source: where it is from.
        leftovers: what its light left over of each press, from which its prior field is learnt.

    Returns:
        Its file.

    Raises:
        InputError: the name will not do, or the fit knows no near lights or no rest colour.
    """
    check_name(name)
    if not set(LENDERS) <= set(gel.effects):
        raise InputError(f"A prior takes a calibration with the effects {' and '.join(LENDERS)}.")
    left = [c.deviations() for c in channels]

    def spread(unknown: tuple[str, str], least: float) -> tuple[float, ...]:
        return tuple(max(least, float(d[unknown])) for d in left)

    exponents = gel.effects["rest_colour"]
    width, height = gel.window_mm
    rest = np.asarray(kept(gel.rest_image))
    units = (Unit.of(rest, leftovers, float(np.linalg.norm(gel.light))),) if leftovers else ()
    make = Layout(
        name,
        tuple((float(c[3]), float(c[4])) for c in gel.coefficients),
        tuple(exponents[f"exponent_{c}"] for c in CHANNELS),
        width / height,
        rest,
        spread(("near_light", "distance_mm"), MAKE_SD_MM),
        spread(("", "direction"), MAKE_SD_RAD),
        spread(("rest_colour", "exponent"), MAKE_SD),
        units,
    )
    file = own_folder() / f"{name}.yaml"
    file.parent.mkdir(parents=True, exist_ok=True)
    make.write(file, source)
    return file
