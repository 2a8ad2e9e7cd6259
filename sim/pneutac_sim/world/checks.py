"""Whether a world can be made of a twin, asked before any work begins."""

from pneutac_sim.twin import Twin
from pneutac_sim.world.conditions import Conditions, conditions_for


def check_networks(twin: Twin, fidelity: str) -> None:
    """Whether the networks that the fidelity asks for belong to the twin, and its finger is stable with them.

    Raises:
        InputError: it has none, they are older than its shape or material, or its soft body alone is stiffer
            than the whole finger, which no controller makes stable.
    """
    if fidelity == "surrogate":  # its modules take a second to start
        from pneutac_sim.surrogate.networks import Networks

        Networks.of(twin).finger(twin)


def check_world(twin: Twin, fidelity: str, conditions: Conditions) -> None:
    """All that can be known of a world before it is made.

    Raises:
        InputError: a condition of an effect is missing or no number, or as `check_networks`.
    """
    conditions_for(twin, conditions)
    check_networks(twin, fidelity)
