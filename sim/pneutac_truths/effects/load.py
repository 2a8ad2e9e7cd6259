"""Loads, further ways to move, and what the base does.

Effects of a body in motion; only `pneutac_truths.cosserat` moves.
"""

from dataclasses import replace
from functools import partial

import numpy as np
from numba import njit

from pneutac_truths.effects.table import by_column, effect
from pneutac_truths.world import World

loads = partial(effect, "load")
moves = partial(effect, "motion", devices=("cosserat",))

DOWN = np.array([[1, 0, 0], [0, 0, -1], [0, 0, 1], [0, 1, 0], [0, -1, 0]], float)


@loads(devices=("rod", "arm"), size=(0.02, 1.2))
def gravity(w: World, size: float) -> None:
    """The body's own weight bends it; the base is mounted in several directions.

    `size`: weight times length squared over bending stiffness. Source: Antman, Nonlinear Problems of
    Elasticity (2005) ch. 4; Till, Aloi and Rucker, IJRR 38 (2019) 723.
    """
    rng = w.draws("gravity")
    w.body = replace(w.body, weight=size)
    w.weighs = True
    if "gravity" in w.plan.conditions:
        w.gravity = w.plan.conditions["gravity"]
        return
    ways = DOWN[:3] if w.in_plane else DOWN[rng.permutation(len(DOWN))[: rng.integers(3, 5)]]
    # each direction for a run of trials, as the rig is turned seldom; the repeats at the end as they come
    w.gravity = ways[np.sort(np.arange(len(w.plan.starts)) % len(ways))]


@loads(devices=("rod", "arm"), size=(0.5, 80.0))
def payload(w: World, size: float) -> None:
    """Weights are hung on the tip in some trials.

    `size`: the largest weight, g. Without `gravity` the mount stays as it is. Source: Polygerinos et al.,
    IEEE T. Robotics 31 (2015) 778 (payload tests).
    """
    rng = w.draws("payload")
    n = len(w.plan.starts)
    shares = rng.permutation(np.resize([0.0, 1.0, 0.0, 0.5], n))
    if "payload_g" in w.plan.conditions:
        shares = w.plan.conditions["payload_g"] / w.plan.conditions["payload_g"].max()
    w.payload_g = np.round(shares * size, 2)
    if w.gravity is None:
        w.gravity = w.plan.conditions.get("gravity", np.tile(DOWN[1], (n, 1)))


@loads(power=(1.0, 1.6), size=(0.01, 0.3))
def stretch(w: World, power: float, size: float) -> None:
    """Pressure also stretches the body.

    `size`: strain of the chamber at the top pressure. Source: Connolly, Walsh and Bertoldi, PNAS 114 (2017)
    51.
    """
    w.stretch = w.stretch + size * np.clip(w.air.mean(1), 0, None) ** power


@loads(devices=("rod", "cosserat"), power=(1.0, 2.0), size=(0.01, 0.5))
def out_of_plane(w: World, power: float, size: float) -> None:
    """The bend leaves the plane as pressure rises (uneven walls).

    `size`: sideways bend over the bend in the plane at the top pressure. Source: Holland et al., Soft
    Robotics 1 (2014) 224; Bishop-Moser and Kota, IEEE T. Robotics 31 (2015) 536.
    """
    x = np.clip(w.drive[:, 0] / w.body.bend_rad[0], 0, None)
    w.aside = w.aside + size * w.body.bend_rad[0] * x**power


@loads(size=(0.03, 1.2))
def twist(w: World, size: float) -> None:
    """Fibres wound unevenly twist the body under pressure.

    `size`: twist over the length at the top pressure, rad. Source: Bishop-Moser and Kota, IEEE T. Robotics 31
    (2015) 536; Connolly et al., Soft Robotics 2 (2015) 26.
    """
    w.twist = w.twist + size * w.air.mean(1)


@loads(lever=(0.1, 0.4), size=(0.005, 0.3))
def mount_play(w: World, lever: float, size: float) -> None:
    """The base has play in its clamp and is pushed over by the body's motion.

    `size`: play, rad; it is crossed while the bend changes by `lever` of the top bend. Source: Nordin and
    Gutman, Automatica 38 (2002) 1633: backlash.
    """
    x = w.drive.sum(1) / w.body.bend_rad.max()
    w.base_turn = w.base_turn.copy()
    w.base_turn[:, 1] += size * (_play(x, lever) - 0.5)


@njit(cache=True)
def _play(x, width):
    """Where in its play (0 to 1) a part sits that is dragged by x and stays when x turns."""
    out = np.empty_like(x)
    y = 0.0
    for i in range(len(x)):
        y = min(max(y + ((x[i] - x[i - 1]) / width if i else 0.0), 0.0), 1.0)
        out[i] = y
    return out


@loads(power=(1.0, 1.8), size=(0.005, 0.25))
def soft_clamp(w: World, power: float, size: float) -> None:
    """The clamp is soft: the base turns with the moment that the chamber passes into it.

    `size`: turn of the base against the bend at the top pressure, rad. Source: Timoshenko, Strength of
    Materials (1955): elastic clamping.
    """
    x = np.clip(w.drive / w.body.bend_rad, 0, None) ** power
    way = w.body.direction_rad
    w.base_turn = w.base_turn.copy()
    w.base_turn[:, 1] += size * (x @ np.cos(way))
    w.base_turn[:, 2] -= size * (x @ np.sin(way))


@loads(presliding=(0.05, 0.3), size=(0.005, 0.3))
def tube_drag(w: World, presliding: float, size: float) -> None:
    """The air tube trails along the body and holds it back by presliding friction.

    `size`: bend that the friction holds back, share of the top bend. Source: Dahl, AIAA J. 14 (1976) 1675.
    """
    x = w.drive / w.body.bend_rad
    w.memory = w.memory - size * w.body.bend_rad * _dahl(x, presliding)


@by_column
def _dahl(x, out, length):
    z = 0.0
    for i in range(len(x)):
        d = x[i] - x[i - 1] if i else 0.0
        z = 1.0 - (1.0 - z) * np.exp(-d / length) if d > 0 else -1.0 + (1.0 + z) * np.exp(d / length)
        out[i] = z


@loads(devices=("rod",), stiffness=(1.0, 20.0), size=(0.03, 0.7))
def wall_lean(w: World, stiffness: float, size: float) -> None:
    """The tip leans on a wall that stands in its way.

    `size`: share of the way to the top pose that the wall takes away; `stiffness` over the tip's own. Source:
    Signorini (1959); Wriggers, Computational Contact Mechanics (2006): penalty of a compliant wall.
    """
    w.contact = {"taken": size, "stiffness": stiffness, "lets_go": np.inf}


@loads(devices=("rod",), lets_go=(0.2, 0.4), size=(0.1, 0.8))
def wall_snap(w: World, lets_go: float, size: float) -> None:
    """The tip catches on an edge, and snaps past it when pressed hard enough.

    `size`: share of the way at which the edge sits from the top; it holds against `lets_go` of the way.
    Source: Gorissen et al., Science Robotics 5 (2020) eabb1967; Johnson, Contact Mechanics (1985).
    """
    w.contact = {"taken": size, "stiffness": 20.0, "lets_go": lets_go}


@moves(damping=(0.12, 0.3), tip_share=(0.15, 0.4), size=(0.18, 0.8))
def ringing(w: World, damping: float, tip_share: float, size: float) -> None:
    """A heavy tip and little damping: the body rings after each change.

    `size`: period of the lowest mode, s. Source: Rayleigh, Theory of Sound (1877) art. 173; Tonkens,
    Lorenzetti and Pavone, ICRA (2021).
    """
    w.dynamics |= {"period_s": size, "damping": damping, "tip_share": tip_share}


@moves(size=(1.0, 12.0))
def overdamped(w: World, size: float) -> None:
    """Foam in the body damps it so that it follows slowly.

    `size`: damping ratio of the lowest mode. Source: Christensen, Theory of Viscoelasticity (1982); Mac
    Murray et al., Adv. Mater. 27 (2015) 6334 (foams).
    """
    w.dynamics |= {"damping": size}


@moves(stiffness=(2.0, 10.0), size=(0.03, 0.7))
def obstacle(w: World, stiffness: float, size: float) -> None:
    """The tip runs into a wall in motion, is thrown back and leans on it.

    `size`: share of the way to the top pose that the wall takes away; `stiffness` over the tip's own. Source:
    Johnson, Contact Mechanics (1985) ch. 11; Gazzola et al., R. Soc. Open Sci. 5 (2018) 171628.
    """
    w.contact = {"taken": size, "stiffness": stiffness, "lets_go": np.inf}


@moves(physics=False, hz=(0.7, 2.5), size=(0.3, 20.0))
def stand_shakes(w: World, hz: float, size: float) -> None:
    """A machine nearby shakes the stand.

    `size`: swing of the tip that the shaking would cause at rest, mm. Source: Harris and Piersol, Shock and
    Vibration Handbook (2002): vibration of floors.
    """
    omega = 2 * np.pi / w.dynamics["period_s"]
    # a rod under its weight sags by q L^4 / (8 EI), and its lowest mode has omega^2 = 12.36 EI / (m L^3)
    w.dynamics |= {"shake": {"acceleration": 1e-3 * size * omega**2 * 8 / 12.36, "hz": hz, "swing_mm": size}}
