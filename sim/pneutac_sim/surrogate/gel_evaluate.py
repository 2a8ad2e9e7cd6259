"""Errors of the perception network against full material points, and those of its baselines.

The same table has its baselines: the probe grid itself, and the analytic `gel.surface`.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.gel.indenter import INDENTERS
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.surrogate.gel_collect import Pairs
from pneutac_sim.surrogate.perception import GelSurrogate
from pneutac_sim.twin import Twin

METHODS = ("network", "probe", "surface")
MEASURES = ("mae_mm", "around_mm", "image_rmse_levels", "area_error_px")


def evaluate_gel(surrogate: GelSurrogate, contacts: Sequence[Pairs], twin: Twin) -> dict:
    """Compares displacement, tactile image and contact area of contacts at their full depth.

    Args:
        surrogate: the network.
        contacts: that it has not been trained on.
        twin: whose gel it is.

    Returns:
        `rows`: one for each indenter, then one, `unseen`, over indenters that were never trained on; each
        with `indenter`, `contacts`, `depth_mm` (mean of the deepest points) and for each of `METHODS` the
        means over contacts of

        - `mae_mm`: mean absolute error of the displacement where the probe grid touches;
        - `around_mm`: the same over the rest of the window;
        - `image_rmse_levels`: of the tactile images, over all pixels and channels;
        - `area_error_px`: absolute error of the number of pixels in contact.

    Raises:
        InputError: in no contact anything touches.
    """
    gel = replace(GelModel.from_twin(twin), depth_scale=1.0)  # the network's input is the object's own depth
    seen_by = {
        "network": TactileSensor(gel, surrogate.displacement),
        "probe": TactileSensor(gel, lambda depth: depth),
        "surface": TactileSensor(gel),
    }
    found: dict[str, list] = {}
    for pairs in contacts:
        depth, moved = pairs.depth_mm[-1], pairs.displacement_mm[-1]
        if depth.any():
            truth = TactileSensor(gel, lambda _, moved=moved: moved)
            errors = [_errors(sensor, truth, depth) for sensor in seen_by.values()]
            found.setdefault(pairs.indenter, []).append((float(depth.max()), np.array(errors)))
    if not found:
        raise InputError("In none of the contacts anything touches the gel's window; collect others.")
    rows = [_row(name, found[name]) for name in INDENTERS if name in found]
    unseen = [contact for name in surrogate.heldout for contact in found.get(name, [])]
    return {"rows": rows + ([_row("unseen", unseen)] if unseen else [])}


def _errors(sensor: TactileSensor, truth: TactileSensor, depth: np.ndarray) -> list[float]:
    error = np.abs(sensor.displacement(depth) - truth.displacement(depth))
    images = sensor.image(depth), truth.image(depth)
    rmse = np.sqrt(np.mean((images[0].astype(float) - images[1]) ** 2))
    pixels = [truth.contact(image).pixels for image in images]
    inside = depth > 0
    return [error[inside].mean(), error[~inside].mean(), rmse, abs(pixels[0] - pixels[1])]


def _row(name: str, contacts: list) -> dict:
    means = np.mean([errors for _, errors in contacts], 0)
    return {
        "indenter": name,
        "contacts": len(contacts),
        "depth_mm": float(np.mean([depth for depth, _ in contacts])),
        **{
            method: dict(zip(MEASURES, (float(v) for v in values), strict=True))
            for method, values in zip(METHODS, means, strict=True)
        },
    }
