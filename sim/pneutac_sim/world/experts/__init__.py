"""The scripts of the experts, one file a task."""

from collections.abc import Callable

from pneutac_sim.world.experts.card import pull_card
from pneutac_sim.world.experts.egg import open_carton
from pneutac_sim.world.experts.motion import Script
from pneutac_sim.world.experts.switch import flip_switch

SCRIPTS: dict[str, Callable[..., Script]] = {
    "switch": flip_switch,
    "egg": open_carton,
    "card": pull_card,
}
