"""The press that shows most which of a gel's models is right, and the two that show most of its creep."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.diagnosis.design import nats_between
from lerobot_pneutac.diagnosis.result import Candidate
from lerobot_pneutac.study.gel import seen_by
from pneutac_datasets.recording.gel import GelRecording
from pneutac_sim.effects.gel_creep import EFFECT, share_left
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.gel.identifiability import DEEPER, DEEPEST, PLACES
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import CONTACT_DISC, Earlier, PressPhotograph
from pneutac_sim.gel.photograph import Predictor
from pneutac_sim.gel.residual import ERROR_LEVELS, INDEPENDENT
from pneutac_sim.gel.sensor import branches_of


@dataclass(frozen=True)
class PressChoice:
    """One press, and its expected information."""

    press: Press  # which indenter, where and how deep
    rivals: float  # nats about which candidate is true
    images: tuple[np.ndarray, ...]  # what each candidate predicts, uint8 (H, W, 3)


def press_choices(data: GelRecording, models: Sequence[Candidate]) -> list[PressChoice]:
    """Presses of the recording's indenters all over the window, the most informative first.

    What a model leaves over is smooth over a contact, so that a photograph counts as `INDEPENDENT` pixels
    with errors of `ERROR_LEVELS`; two models' images differ as in the mean over the contact.
    """
    predictors = [Predictor(seen_by(GelModel.from_twin(m.twin), data), data.presses) for m in models]
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


HOLDS_S, WAITS_S = (10.0, 30.0, 60.0), (3.0, 10.0, 30.0)  # by hand, three seconds at least
SHORT_S = 2.0  # the second press


@dataclass(frozen=True)
class HeldChoice:
    """A long press, and a short one after it that is photographed."""

    first: Press  # held for `hold_s`, then lifted
    hold_s: float  # how long
    wait_s: float  # from its release to the second press
    press: Press  # the second, as far from the first as the window allows, photographed after `SHORT_S`
    share: float  # of the first that is left in the photograph
    levels: float  # root mean square that it changes where the first was
    rivals: float  # nats about whether the gel creeps
    assumed: bool  # whether the creep is the effect's default, as no candidate model has one

    @property
    def seen(self) -> bool:
        return self.rivals > T.LITTLE_GAIN

    @property
    def sentence(self) -> str:
        a, b = self.first, self.press
        whose = "a gel" if self.assumed else "the gel of the likeliest model with creep,"
        do = (
            f"To find whether it creeps, hold the {a.indenter} of {a.size_mm:g} mm {a.depth_mm:g} mm deep at "
            f"x {a.x_mm:g}, y {a.y_mm:g} mm for {self.hold_s:g} s and lift it; {self.wait_s:g} s later press "
            f"it {b.depth_mm:g} mm deep at x {b.x_mm:g}, y {b.y_mm:g} mm and photograph"
        )
        why = (
            f"on {whose} that still holds {100 * self.share:.1f} % of the first press then, that one's place "
            f"changes by {self.levels:.1f} levels, {self.rivals:.2f} nats of information on whether it creeps"
        )
        if not self.seen:
            return f"{do}; but {why}, too little to see."
        return f"{do}: {why}. A longer hold leaves more, a longer wait less. Fill in time_s and hold_s."

    def rows(self) -> list[tuple[Press, float, float]]:
        """Each press with `time_s` and `hold_s` of its photograph."""
        after = self.hold_s + self.wait_s + SHORT_S
        return [(self.first, self.hold_s, self.hold_s), (self.press, after, SHORT_S)]


def held_choice(data: GelRecording, models: Sequence[Candidate]) -> HeldChoice:
    """The two presses, of the recording's deepest and shallowest; models come with the likeliest first."""
    gels = [GelModel.from_twin(m.twin) for m in models]
    creeping = [bool(branches_of(gel)) for gel in gels]
    gel = seen_by(gels[creeping.index(True) if any(creeping) else 0], data)
    without = {n: v for n, v in gel.effects.items() if not getattr(get_effect(n), "late", None)}
    if not any(creeping):
        gel = replace(
            gel, effects=gel.effects | {EFFECT.name: {p.name: p.default for p in EFFECT.parameters}}
        )
    branches, pairs = branches_of(gel), data.presses
    left = {
        (hold, wait): share_left(branches, hold, wait + SHORT_S) for hold, wait in product(HOLDS_S, WAITS_S)
    }
    enough = T.HOLD_ENOUGH * max(left.values())
    hold, wait = min((k for k, share in left.items() if share >= enough), key=lambda k: (sum(k), k))
    predictors = [Predictor(g, pairs) for g in (gel, replace(gel, effects=without))]
    deepest = max((s.press for s in data.samples), key=lambda p: p.depth_mm)
    shallow = min((s.press for s in data.samples), key=lambda p: p.depth_mm)
    width, height = gel.window_mm
    tried = []
    for x, y in product(PLACES, PLACES):
        at = {"x_mm": round(x * width, 1), "y_mm": round(y * height, 1)}
        away = {"x_mm": round(-(x or PLACES[0]) * width, 1), "y_mm": round(-(y or PLACES[0]) * height, 1)}
        first, then = replace(deepest, **at), replace(shallow, **away)
        earlier = [Earlier(first, hold, wait + SHORT_S)]
        there = PressPhotograph(first, data.rest, data.rest).near(data.px_per_mm, CONTACT_DISC)
        seen = [p.image(then, data.rest, 1.0, earlier)[there].astype(float) for p in predictors]
        levels = float(np.sqrt(np.mean(np.square(seen[0] - seen[1]))))
        tried.append((levels, first, then, [s / np.sqrt(there.sum()) for s in seen]))
    levels, first, then, each = max(tried, key=lambda t: t[0])
    yes = sum(m.probability for m, c in zip(models, creeping, strict=True) if c) if any(creeping) else 0.5
    nats = nats_between(each, np.array([yes, 1 - yes]), INDEPENDENT / ERROR_LEVELS**2)
    return HeldChoice(first, hold, wait, then, left[hold, wait], levels, nats, not any(creeping))
