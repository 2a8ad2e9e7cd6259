"""A gel between a twin and a recording's images."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pneutac_datasets.recording.gel import GelRecording
from pneutac_sim.effects.registry import get_effect, sensor_effects
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.photograph import Predictor, Pressed, PressPhotograph
from pneutac_sim.twin import Twin


def for_twin(gel: GelModel, twin: Twin) -> GelModel:
    """The gel at the size in which the twin has its images; as it is where that is of other proportions."""
    (h, w), (rows, columns) = gel.rest_image.shape[:2], GelModel.from_twin(twin).rest_image.shape[:2]
    return gel.resized(rows, columns) if twin.gel and abs(w * rows / (h * columns) - 1) <= 0.02 else gel


def calibration_pairs(data: GelRecording) -> list[PressPhotograph]:
    """Photographs of role `calibration`, whose drift of light every prediction may know; none is allowed."""
    return [s.photograph for s in data.samples if s.role == "calibration"]


def predict(gel: GelModel, data: GelRecording, pressed: Pressed | None = None) -> list[np.ndarray]:
    """Predicted image of every sample; the calibration pairs tell how the light drifts.

    Args:
        gel: of this recording.
        data: its images.
        pressed: gives the surfaces, see `Predictor`.
    """
    predictor = Predictor(gel, calibration_pairs(data), pressed)
    return [predictor.image(s.press, s.rest, s.clock, s.earlier) for s in data.samples]


def kept(effects: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
    """Effects whose values stay where photographs cannot tell them: of what earlier presses leave."""
    return {name: values for name, values in effects.items() if sensor_effects()[name].late}


def seen_by(gel: GelModel, data: GelRecording) -> GelModel:
    """The same gel in a recording's images: their rest image, scale and thickness."""
    own = {"rest_image": data.rest, "px_per_mm": data.px_per_mm, "thickness_mm": data.thickness_mm}
    return replace(gel, **own)


def at_bound(gel: GelModel, effects: Sequence[str]) -> list[str]:
    """Parameters of these effects that lie at a bound."""
    return [
        f"{e}.{p.name}"
        for e in effects
        for p in get_effect(e).parameters
        if min(gel.effects[e][p.name] - p.lower, p.upper - gel.effects[e][p.name])
        < 1e-3 * (p.upper - p.lower)
    ]
