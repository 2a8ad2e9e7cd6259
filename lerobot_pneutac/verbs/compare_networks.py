"""Whether a recording stays within what the twin's action network was trained with."""

from pathlib import Path

import numpy as np

from pneutac_sim.errors import option
from pneutac_sim.finger import BodyData, Pipeline
from pneutac_sim.surrogate.finger import network_of
from pneutac_sim.surrogate.network import ActionNetwork
from pneutac_sim.twin import Twin


def out_of_range(twin: Twin, bench: BodyData) -> tuple[float | None, str | None]:
    """Share of samples whose bending pressure or joint angles lie outside the training, and a sentence.

    Each sample's joint angles count, as in the world in free air.

    Args:
        twin: of a finger or an arm; both results are None where it has no action network of its own.
        bench: the recording, as prepared for it.

    Raises:
        InputError: the network's file is damaged.
    """
    file = twin.networks.get("action")
    if file is None:
        return None, None
    network = network_of(twin, ActionNetwork.load(file))
    if network is None:
        return None, (
            "The twin's action network was trained before its body's shape or material changed, so its range "
            f"says nothing; run `pneutac surrogate {option('twin', Path(file).parent)}`."
        )
    pipeline = Pipeline.of(twin, bench.inputs)
    joints = pipeline.run(bench.inputs, pipeline.theta(twin, bench.inputs.pressure_range_kpa)).joints
    outside = np.array([not network.resistance(q, q)[2] for q in joints])
    share = float(outside.mean())
    if not outside.any():
        return share, "All samples lie within what the twin's action network was trained with."
    low, high = network.low[-1], network.high[-1]
    asked = network.pressure_kpa(joints)
    return share, (
        f"{100 * share:.2g}% of samples lie outside what the twin's action network was trained with (bending "
        f"pressures from {low:.3g} to {high:.3g} kPa; the recording's go from {asked.min():.3g} to "
        f"{asked.max():.3g} kPa); there its torque goes on straight."
    )
