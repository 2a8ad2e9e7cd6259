"""How finger and gel of a world deform, by its fidelity."""

from pneutac_sim.twin import Twin


def deforming(twin: Twin, fidelity: str, touch: str):
    """What bends the finger, and what indents the gel; None for the formulas."""
    deforms = touch in ("image", "area")
    if fidelity == "surrogate":  # its modules take a second to start
        from pneutac_sim.surrogate.networks import Networks

        networks = Networks.of(twin)
        return networks.finger(twin), networks.gel if deforms else None
    if fidelity == "mpm":
        from pneutac_sim.world.mpm_finger import MpmFinger
        from pneutac_sim.world.mpm_gel import MpmGel

        return MpmFinger(twin), MpmGel(twin) if deforms else None
    return None, None
