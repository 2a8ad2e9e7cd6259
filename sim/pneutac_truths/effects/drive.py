"""From pressure in the chamber to the bend that it drives, without memory of the material."""

from functools import partial

import numpy as np

from pneutac_truths.effects.table import by_column, effect
from pneutac_truths.world import World, stream

acts = partial(effect, "drive")


def _bent(w: World, share: np.ndarray) -> None:
    """Bends by `share` (n, c) of the top bend where the plain device would bend by the share of pressure."""
    w.drive = w.drive + w.body.bend_rad * (share - w.air)


@acts(size=(0.02, 0.9))
def unfolding(w: World, size: float) -> None:
    """Bend grows with a power of pressure above one (walls unfold).

    `size`: power minus one. Source: Mosadegh et al., Adv. Funct. Mater. 24 (2014) 2163; Toshimitsu et al.,
    IROS (2021).
    """
    _bent(w, np.sign(w.air) * np.abs(w.air) ** (1 + size))


@acts(size=(0.02, 0.85))
def chain_locking(w: World, size: float) -> None:
    """Chains of the rubber reach their full length: bend saturates.

    `size`: top bend over locking bend, squared. Source: Gent, Rubber Chem. Technol. 69 (1996) 59.
    """
    x = np.where(np.abs(w.air) < 1e-9, 1e-9, w.air)
    _bent(w, (np.sqrt((1 - size) ** 2 + 4 * size * x**2) - (1 - size)) / (2 * size * x))


@acts(knee=(0.4, 0.7), size=(0.03, 0.6))
def balloon_softening(w: World, knee: float, size: float) -> None:
    """The inflating rubber softens before it stiffens.

    `size`: bend added beyond the knee over the top bend. Source: Müller and Strehlow, Rubber and Rubber
    Balloons (2004) ch. 2; Mooney, J. Appl. Phys. 11 (1940) 582.
    """
    rise = lambda x: 1 / (1 + np.exp(-(x - knee) / 0.08))  # noqa: E731
    _bent(w, w.air + size * (rise(w.air) - rise(0.0)) * w.air)


@acts(round=(0.01, 0.04), size=(0.003, 0.35))
def slack_chamber(w: World, round: float, size: float) -> None:
    """The chamber's slack must be taken up before it bends.

    `size`: share of the top pressure below which little happens; `round` is its soft edge. Source: Connolly,
    Walsh and Bertoldi, PNAS 114 (2017) 51 (fibre sleeves).
    """
    soft = lambda x: round * np.logaddexp(0, (x - size) / round)  # noqa: E731
    _bent(w, (soft(w.air) - soft(0.0)) / (soft(1.0) - soft(0.0)))


@acts(first=(0.3, 0.6), spread=(0.05, 0.3), size=(0.05, 0.95))
def bellows_touch(w: World, first: float, spread: float, size: float) -> None:
    """Neighbouring bellows touch one after the other and stiffen the body.

    `size`: share of the compliance that is lost when all touch. Source: Marchese, Katzschmann and Rus, Soft
    Robotics 2 (2015) 7; Johnson, Contact Mechanics (1985).
    """
    at = first + spread * np.linspace(0, 1, 7)
    lost = np.mean([np.clip(w.air - a, 0, None) for a in at], axis=0)
    _bent(w, w.air - size * lost)


@acts(up=(0.45, 0.7), gap=(0.08, 0.25), size=(0.01, 0.25))
def seam_snap(w: World, up: float, gap: float, size: float) -> None:
    """A seam buckles: the bend snaps further at one pressure and back at a lower one.

    `size`: jump over the top bend. Source: Overvelde et al., PNAS 112 (2015) 10863; Gorissen et al., Science
    Robotics 5 (2020) eabb1967.
    """
    _bent(w, w.air + size * _two_states(w.air, up, up - gap))


@by_column
def _two_states(x, out, up, down):
    state = 0.0
    for i in range(len(x)):
        if x[i] > up:
            state = 1.0
        elif x[i] < down:
            state = 0.0
        out[i] = state


@acts(bond=(0.5, 0.8), minutes=(0.3, 1.5), size=(0.02, 0.4))
def delamination(w: World, bond: float, minutes: float, size: float) -> None:
    """High pressure peels the chamber off its strain-limiting layer step by step; it stays peeled.

    `size`: bend gained when all has peeled; it goes on above the share `bond` of the top pressure. Each
    session starts with the layer pressed on again. Source: Kendall, J. Phys. D 8 (1975) 1449 (peeling);
    Marechal et al., Soft Robotics 8 (2021) 284.
    """
    over = np.clip(w.air - bond, 0, None) / (1 - bond)
    peeled = 1 - np.exp(-np.cumsum(over, axis=0) * 0.005 / (60 * minutes * 0.25))
    w.drive = w.drive * (1 + size * peeled)


@acts(devices=("arm",), size=(0.02, 0.5))
def uneven_directions(w: World, size: float) -> None:
    """The chambers of the arm lie at uneven angles.

    `size`: standard deviation of the angles, rad. Source: Webster and Jones, IJRR 29 (2010) 1661; Toshimitsu
    et al., IROS (2021).
    """
    away = _device_draws(w, "uneven_directions")
    turned = w.body.direction_rad + size * away
    # a chamber's bend, written in the even directions: exact in both components of the plane
    way = w.body.direction_rad
    even = np.stack([np.cos(way), np.sin(way)])
    w.drive = w.drive @ (np.linalg.pinv(even) @ np.stack([np.cos(turned), np.sin(turned)])).T


@acts(devices=("arm",), size=(0.02, 0.5))
def unequal_chambers(w: World, size: float) -> None:
    """The chambers of the arm have unequal gains and curves.

    `size`: standard deviation of gains and of powers. Source: Marchese and Rus, IJRR 35 (2016) 840;
    Caasenbrood, Pogromsky and Nijmeijer, Soft Robotics 10 (2023).
    """
    away = _device_draws(w, "unequal_chambers")
    _bent(w, (1 + size * away) * np.sign(w.air) * np.abs(w.air) ** (1 + size * np.abs(away[::-1])))


@acts(devices=("arm",), size=(0.03, 0.8))
def chamber_cross(w: World, size: float) -> None:
    """A chamber under pressure stiffens the arm against its neighbours (cross terms).

    `size`: share of its bend that a chamber loses when both others are at the top pressure. Source:
    Toshimitsu et al., IROS (2021); Della Santina, Duriez and Rus, IEEE Control Syst. 43 (2023) 30.
    """
    others = (w.air.sum(1, keepdims=True) - w.air) / 2
    _bent(w, w.air * (1 - size * others))


def _device_draws(w: World, name: str) -> np.ndarray:
    """(chambers,) normal numbers of the device, with mean 0 and standard deviation 1."""
    x = stream(w.seed, name, "device").normal(size=len(w.body.bend_rad))
    return (x - x.mean()) / x.std()
