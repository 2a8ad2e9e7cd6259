"""The press that tells most about which of a gel's models is right."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from lerobot_pneutac.diagnosis.bootstrap import Resampler
from lerobot_pneutac.diagnosis.design import nats_between
from lerobot_pneutac.diagnosis.result import Contender
from lerobot_pneutac.diagnosis.search import Found
from lerobot_pneutac.study.gel_model import calibration_pairs, seen_by
from lerobot_pneutac.study.gel_space import FittedGel
from pneutac_datasets.recording.gel import GelRecording
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.photograph import Predictor, PressPhotograph
from pneutac_sim.gel.residual import ERROR_LEVELS, INDEPENDENT
from pneutac_sim.gel.told import DEEPER, DEEPEST, PLACES
from pneutac_sim.twin import Twin

MOST_OTHERS = 4  # contenders beside the final model and the twin as it is


@dataclass(frozen=True)
class PressChoice:
    """One press, and what it is expected to tell.

    Attributes:
        press: which indenter, where and how deep.
        rivals: nats about which contender is true.
        images: what each contender predicts, uint8 (H, W, 3).
    """

    press: Press
    rivals: float
    images: tuple[np.ndarray, ...]


def contenders(found: Found, judge: Resampler, twin_of: Callable[[FittedGel], Twin]) -> list[Contender]:
    """The final model, others that were fitted well, and last the twin as it is, re-fitted."""
    weighed = [s for round_ in reversed(found.rivals) for s in sorted(round_, key=lambda s: s.value)]
    others = {s.model.effects: s for s in [found.final, *found.without.values(), *found.path, *weighed]}
    others.pop(found.base.model.effects, None)
    scored = [*list(others.values())[: 1 + MOST_OTHERS], found.base]
    share = judge.shares([s.crossed for s in scored])
    had = set(found.base.model.effects)
    terms = [tuple(e for e in s.model.effects if e not in had) for s in scored]
    return [Contender(twin_of(s.model), e, float(p)) for s, e, p in zip(scored, terms, share, strict=True)]


def press_choices(data: GelRecording, models: Sequence[Contender]) -> list[PressChoice]:
    """Presses of the recording's indenters all over the window, the one that tells most first.

    What a model leaves over is smooth over a contact, so that a photograph counts as `INDEPENDENT` pixels
    with errors of `ERROR_LEVELS`; two models' images are as far apart as in the mean over the contact.

    Args:
        data: the photographs so far.
        models: in the running.
    """
    predictors = [
        Predictor(seen_by(GelModel.from_twin(m.twin), data), calibration_pairs(data)) for m in models
    ]
    probability = np.array([m.probability for m in models])
    found = []
    for press in _presses(data):
        images = [p.image(press, data.rest, clock=1.0) for p in predictors]  # it comes last
        near = PressPhotograph(press, data.rest, data.rest).near(data.px_per_mm)
        seen = [i[near].astype(float) / np.sqrt(near.sum()) for i in images]
        nats = nats_between(seen, probability, INDEPENDENT / ERROR_LEVELS**2)
        found.append(PressChoice(press, nats, tuple(images)))
    return sorted(found, key=lambda c: -c.rivals)


def _presses(data: GelRecording) -> list[Press]:
    """Each indenter at nine places, as deep as the shallowest, the middle and the deepest one, and deeper."""
    width, height = (n / data.px_per_mm for n in data.rest.shape[1::-1])
    depths = np.sort([s.press.depth_mm for s in data.samples])
    deeper = max(min(DEEPER * depths[-1], DEEPEST * data.thickness_mm), depths[-1])
    each = dict.fromkeys(np.round([depths[0], depths[len(depths) // 2], depths[-1], deeper], 2).tolist())
    tools = {(s.press.indenter, s.press.size_mm): s.press for s in data.samples}
    return [
        replace(tool, x_mm=round(x * width, 1), y_mm=round(y * height, 1), depth_mm=depth)
        for tool, x, y, depth in product(tools.values(), PLACES, PLACES, each)
    ]
