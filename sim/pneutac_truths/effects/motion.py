"""Effects of a body in motion; only `pneutac_truths.cosserat` moves."""

import numpy as np

from pneutac_truths.effects.table import effect
from pneutac_truths.world import World


@effect(
    "motion",
    "A heavy tip and little damping: the body rings after each change.",
    "Rayleigh, Theory of Sound (1877) art. 173; Tonkens, Lorenzetti and Pavone, ICRA (2021)",
    devices=("cosserat",),
    damping=(0.12, 0.3),
    tip_share=(0.15, 0.4),
    size=(0.18, 0.8),
)
def ringing(w: World, damping: float, tip_share: float, size: float) -> None:
    """`size`: period of the lowest mode, s."""
    w.dynamics |= {"period_s": size, "damping": damping, "tip_share": tip_share}


@effect(
    "motion",
    "Foam in the body damps it so that it follows slowly.",
    "Christensen, Theory of Viscoelasticity (1982); Mac Murray et al., Adv. Mater. 27 (2015) 6334 (foams)",
    devices=("cosserat",),
    size=(1.0, 12.0),
)
def overdamped(w: World, size: float) -> None:
    """`size`: damping ratio of the lowest mode."""
    w.dynamics |= {"damping": size}


@effect(
    "motion",
    "The tip runs into a wall in motion, is thrown back and leans on it.",
    "Johnson, Contact Mechanics (1985) ch. 11; Gazzola et al., R. Soc. Open Sci. 5 (2018) 171628",
    devices=("cosserat",),
    stiffness=(2.0, 10.0),
    size=(0.03, 0.7),
)
def obstacle(w: World, stiffness: float, size: float) -> None:
    """`size`: share of the way to the top pose that the wall takes away; `stiffness` over the tip's own."""
    w.contact = {"taken": size, "stiffness": stiffness, "lets_go": np.inf}


@effect(
    "motion",
    "A machine nearby shakes the stand.",
    "Harris and Piersol, Shock and Vibration Handbook (2002): vibration of floors",
    physics=False,
    devices=("cosserat",),
    hz=(0.7, 2.5),
    size=(0.3, 20.0),
)
def stand_shakes(w: World, hz: float, size: float) -> None:
    """`size`: swing of the tip that the shaking would cause at rest, mm."""
    omega = 2 * np.pi / w.dynamics["period_s"]
    # a rod under its weight sags by q L^4 / (8 EI), and its lowest mode has omega^2 = 12.36 EI / (m L^3)
    w.dynamics |= {"shake": {"acceleration": 1e-3 * size * omega**2 * 8 / 12.36, "hz": hz, "swing_mm": size}}
