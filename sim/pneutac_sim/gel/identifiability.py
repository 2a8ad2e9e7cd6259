"""What a gel's presses identify of its light: parameters that none shows, and the press to add.

A fit minimises |r(x)|^2 with the priors of x among the residuals r, so that about its solution x has the
covariance S = (J^T J)^-1, J = dr/dx, and a predicted light with derivatives g the variance g^T S g. Another
press adds its own information to S^-1 before anyone takes it: the one to add leaves the least variance in the
mean over places and depths. All that knows of noise and priors alone; a wrong model is off by more.

The library of priors: what sensors of a make share, as files; those of the product and one's own.

Own ones lie in $PNEUTAC_PRIORS, else in ~/.local/share/pneutac/priors, and are written by `save`.
"""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pneutac_sim.effects.sensor_effect import CHANNELS
from pneutac_sim.errors import InputError
from pneutac_sim.files import check_new_file
from pneutac_sim.gel.fit import Channel
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.layout import DIGIT, MAKE_SD, MAKE_SD_MM, MAKE_SD_RAD, Layout, SensorPrior, stored_rest
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import PressPhotograph, to_grid
from pneutac_sim.gel.photograph import press_depth
from pneutac_sim.gel.residual import ERROR_LEVELS, INDEPENDENT, Leftover
from pneutac_sim.gel.surface import surface

# Of a prior's variance: a parameter of which presses removed no more stays where its prior is.
UNIDENTIFIED = 0.2
DEEPER, DEEPEST = 1.5, 0.4  # a deeper press, over the deepest so far; of the thickness at most
PLACES = (-0.28, 0.0, 0.28)  # of the window's width and height, from its centre
ACROSS, DOWN = ("left", "middle", "right"), ("upper", "middle", "lower")


@dataclass(frozen=True)
class Identified:
    """What presses identify."""

    unidentified: tuple[str, ...]  # parameters, `effect.name (colour)`, that stay where their priors are
    add: Press  # the press to add, of the same indenter
    where: str  # of that press, such as `lower left`
    deeper: bool  # whether it is deeper than all so far
    open_levels: float  # standard deviation that the fit leaves to predicted contacts, a mean over the gel
    then_levels: float  # the same with the press added


def identify(
    gel: GelModel, channels: Sequence[Channel], photographs: Sequence[PressPhotograph]
) -> Identified:
    """What the presses of a fit, with its channels as solved, identify of a gel's light."""
    deepest = max((p.press for p in photographs), key=lambda p: p.depth_mm)
    depth = max(min(DEEPER * deepest.depth_mm, DEEPEST * gel.thickness_mm), deepest.depth_mm)
    width, height = gel.window_mm
    presses = [
        (f"{row} {column}".replace("middle middle", "middle"), replace(deepest, x_mm=x, y_mm=y, depth_mm=d))
        for row, y in zip(DOWN, height * np.array(PLACES), strict=True)
        for column, x in zip(ACROSS, width * np.array(PLACES), strict=True)
        for d in dict.fromkeys((deepest.depth_mm, depth))
    ]
    now, then = open_levels(gel, channels, [press for _, press in presses])
    where, add = presses[int(np.argmin(then))]
    deeper = add.depth_mm > deepest.depth_mm
    return Identified(_unidentified(channels), add, where, deeper, now, float(then.min()))


def open_levels(
    gel: GelModel, channels: Sequence[Channel], presses: Sequence[Press]
) -> tuple[float, np.ndarray]:
    """Standard deviation in levels that a fit leaves to the light of n presses, their root mean square.

    Returns it as it is, and (n,) with each press added.
    """
    grams = np.array([_grams(gel, channels, press) for press in presses])  # (presses, channels, F, F)
    now = [c.covariance for c in channels]
    more = INDEPENDENT / ERROR_LEVELS**2 * grams
    then = [[np.linalg.pinv(np.linalg.pinv(S) + g) for S, g in zip(now, each, strict=True)] for each in more]
    return _levels(grams, now), np.array([_levels(grams, covariances) for covariances in then])


def _grams(gel: GelModel, channels: Sequence[Channel], press: Press) -> list[np.ndarray]:
    rest = to_grid(gel.rest_image)
    u = gel.surface(surface(gel.imprint(press_depth(press, gel)), gel.cell_mm, gel.decay_mm), gel.cell_mm)
    near = to_grid(PressPhotograph(press, gel.rest_image, gel.rest_image).near(gel.px_per_mm)) > 0.5
    return [c.gram(u, rest[..., k], near) for k, c in enumerate(channels)]


def _levels(grams: np.ndarray, covariances: Sequence[np.ndarray]) -> float:
    return float(np.sqrt(np.einsum("pkfg,kgf->pk", grams, np.array(covariances)).mean()))


def _unidentified(channels: Sequence[Channel]) -> tuple[str, ...]:
    learnt: dict[str, float] = {}
    for channel, colour in zip(channels, ("red", "green", "blue"), strict=True):
        for (effect, name), share in channel.learnt().items():
            if effect:
                key = f"{effect}.{name} ({colour})"
                learnt[key] = max(learnt.get(key, 0.0), share)
    return tuple(name for name, share in learnt.items() if share < UNIDENTIFIED)


NAME = r"[A-Za-z0-9][A-Za-z0-9 _.-]{0,39}"
PRIOR_EFFECTS = ("near_light", "rest_colour")


def own_folder() -> Path:
    """Folder of the user's own sensor priors."""
    given = os.environ.get("PNEUTAC_PRIORS")
    return Path(given) if given else Path.home() / ".local" / "share" / "pneutac" / "priors"


def library() -> tuple[Layout, ...]:
    """All makes whose lights are known; raises InputError where a file of one's own is no prior."""
    return DIGIT, *(Layout.read(file) for file in sorted(own_folder().glob("*.yaml")))


def check_name(name: str) -> None:
    """Raises InputError where a prior cannot be called so, or is already."""
    if not re.fullmatch(NAME, name) or name.lower() == DIGIT.name.lower():
        raise InputError(
            f"save_prior is '{name[:60]}'; give up to 40 letters, digits, spaces, dots, - and _, other than "
            f"{DIGIT.name}."
        )
    file = own_folder() / f"{name}.yaml"
    check_new_file(file, f"save_prior={name}: {file}")


def save(
    name: str, gel: GelModel, channels: Sequence[Channel], source: str, leftovers: Sequence[Leftover] = ()
) -> Path:
    """Keeps a calibrated sensor's lights as a prior for others of its make; returns its file.

    Each number is stored with the deviation that its calibration left, and never less than that between
    sensors of one make. The prior field is learnt from the leftovers of each press.

    Raises InputError where the name will not do or is taken, or the fit knows no near lights or no rest
    colour.
    """
    check_name(name)
    if not set(PRIOR_EFFECTS) <= set(gel.effects):
        raise InputError(f"A prior takes a calibration with the effects {' and '.join(PRIOR_EFFECTS)}.")
    left = [c.deviations() for c in channels]

    def spread(unknown: tuple[str, str], least: float) -> tuple[float, ...]:
        return tuple(max(least, float(d[unknown])) for d in left)

    exponents = gel.effects["rest_colour"]
    width, height = gel.window_mm
    rest = np.asarray(stored_rest(gel.rest_image))
    units = (SensorPrior.of(rest, leftovers, float(np.linalg.norm(gel.light))),) if leftovers else ()
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
