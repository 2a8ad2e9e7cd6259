"""The experts, one file a task."""

from collections.abc import Callable

from pneutac_sim.world.experts.card import pull_card
from pneutac_sim.world.experts.egg import open_carton
from pneutac_sim.world.experts.motion import Wish
from pneutac_sim.world.experts.switch import flip_switch

EXPERTS: dict[str, Callable[..., Wish]] = {
    "switch": flip_switch,
    "egg": open_carton,
    "card": pull_card,
}
