"""What a gel shows of a press, and what the light did between a rest image and a photograph.

Light and exposure drift between a rest image and the photographs of a session. One pair of images shows how
far, away from its contact, but not whether that is the session's or its own: half of it is expected of the
session's other photographs, which is right where both are equal, and n / (n + 1) of the mean of n pairs.
So is a part of each pixel's own difference away from a contact, which is the rest image's noise.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pneutac_sim.effects.gel_creep import share_left
from pneutac_sim.gel import optics
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import FAR_ENOUGH, Earlier, PressPhotograph, smooth_change, to_grid
from pneutac_sim.gel.probe import COLS, ROWS
from pneutac_sim.gel.sensor import LEAST_MM, TactileSensor, branches_of, pressed_on
from pneutac_sim.gel.surface import surface

# The gel's surface (80, 59) in mm under a press at a share of its depth (`GelModel.depth_scale`).
Pressed = Callable[[Press, float], np.ndarray]

SUBCELLS = 3  # along each side of a cell, over which a bench indenter's depth is averaged


def press_depth(press: Press, gel: GelModel) -> np.ndarray:
    """Probe grid (80, 59) in mm of a bench indenter on this gel: the mean over each cell, as of a photograph.

    A depth at each cell's centre alone would move a punch's edge by up to half a cell and make it jagged.
    """
    return to_grid(press.depths(gel.window_mm, gel.thickness_mm, (SUBCELLS * ROWS, SUBCELLS * COLS)))


def registered(press: Press, gel: GelModel) -> Press:
    """The press where the gel's effects say that it truly is."""
    for effect, values in gel.acting:
        if effect.press is not None:
            press = effect.press(press, values)
    return press


def contact_light(gel: GelModel, press: Press, left_mm: np.ndarray | None) -> np.ndarray:
    """What a press changes on a face that earlier ones left uneven, (80, 59, 3) levels before the weight."""
    depth_mm = press_depth(registered(press, gel), gel)
    u = pressed_on(gel.imprint(depth_mm), left_mm, gel.cell_mm, gel.decay_mm)
    u = gel.surface(u, gel.cell_mm)
    return optics.light(u, gel.cell_mm, *gel.lighting).transpose(1, 2, 0)


class Residues:
    """What is left under photographs, by one gel's effects, of the presses before each."""

    def __init__(self, gel: GelModel, earlier: Sequence[Sequence[Earlier]]):
        branches, presses = branches_of(gel), {}
        self._left: list[list[tuple[int, float]]] = []
        for before in earlier:
            row = []
            for e in before if branches else ():
                share = share_left(branches, e.held_s, e.since_s)
                if share * e.press.depth_mm > LEAST_MM:
                    presses[id(e.press)] = e.press
                    row.append((id(e.press), share))
            self._left.append(row)
        self._depths = {k: press_depth(registered(p, gel), gel) for k, p in presses.items()}
        self._cell = gel.cell_mm

    def surfaces(self, gel: GelModel) -> list[np.ndarray | None]:
        """Displacement (80, 59) in mm that is left under each photograph, None where it is none."""
        if not self._depths:
            return [None] * len(self._left)
        held = {k: surface(gel.imprint(d), self._cell, gel.decay_mm) for k, d in self._depths.items()}
        return [np.float32(sum(share * held[k] for k, share in row)) if row else None for row in self._left]


def session_light(pair: PressPhotograph, px_per_mm: float) -> np.ndarray:
    """`smooth_part` of all that a photograph changes."""
    return smooth_part(to_grid(pair.image.astype(np.float32) - pair.rest), pair, px_per_mm)


def smooth_part(change: np.ndarray, pair: PressPhotograph, px_per_mm: float) -> np.ndarray:
    """`smooth_change` of a change (80, 59, 3) in levels away from a photograph's contact.

    Zero where hardly anything lies away from it.
    """
    far = pair.far(px_per_mm)
    if far.mean() <= FAR_ENOUGH:
        return np.zeros((ROWS, COLS, 3))
    return smooth_change(change, to_grid(pair.rest), far)


def expected_drift(pairs: Sequence[PressPhotograph], rest: np.ndarray, px_per_mm: float) -> np.ndarray:
    """Change (H, W, 3) in levels from its rest image that a session's other photographs are expected to have.

    Smooth where a press is near; each pixel of its own elsewhere. `pairs` are the session's known photographs
    with this rest image, uint8 (H, W, 3).
    """
    own = [(p, session_light(p, px_per_mm), ~p.near(px_per_mm)) for p in pairs if p.rest is rest]
    smooth = sum(light for _, light, _ in own) / (len(own) + 1)
    share = _noise_of_rest([p.image for p, _, _ in own], rest, [far for _, _, far in own])
    rough, frames = np.zeros(rest.shape), np.full(rest.shape, (1 - share) / share)
    for p, light, far in own:
        drawn = optics.upsample(light, *rest.shape[:2])
        rough[far] += (p.image.astype(np.float32) - rest - drawn)[far]
        frames[far] += 1
    return optics.upsample(smooth, *rest.shape[:2]) + rough / frames


def _noise_of_rest(images, rest: np.ndarray, far) -> float:
    """Share of the noise of images - rest away from contacts that is the rest image's, above 0 to 1.

    Of neighbours' differences, -cov(image - rest, rest) / var(image - rest): a half where the rest image is a
    frame as noisy as others, little where it is the mean of many.
    """
    top, bottom, r = 0.0, 1e-9, np.diff(rest.astype(np.float32), axis=1)
    for image, away in zip(images, far, strict=True):
        both = away[:, 1:] & away[:, :-1]
        d = (np.diff(image.astype(np.float32), axis=1) - r)[both]
        top, bottom = top - float((d * r[both]).sum()), bottom + float(np.square(d).sum())
    return float(np.clip(top / bottom, 1e-3, 1))


def gains(gel: GelModel, clock: float) -> np.ndarray:
    """Brightness over the rest image (3,) at a time of the session, by the gel's effects."""
    out = np.ones(3)
    for effect, values in gel.acting:
        if effect.gain is not None:
            out = out * effect.gain(clock, values)
    return out


def drift_known(gel: GelModel) -> bool:
    """Whether an effect of the gel describes how the light changes over a session."""
    return any(effect.gain is not None for effect, _ in gel.acting)


class Predictor:
    """Predicts the photographs of one session, by photographs whose drift of light is known.

    `pressed` gives the surfaces, such as `mpm.devices.PressedGel.surface`; None for the closed form.
    """

    def __init__(self, gel: GelModel, pairs: Sequence[PressPhotograph] = (), pressed: Pressed | None = None):
        self._gel, self._pairs, self._pressed = gel, pairs, pressed
        self._sensors: dict[int, tuple] = {}
        self._drifts: dict[int, np.ndarray] = {}
        if not drift_known(gel):
            rests = {id(p.rest): p.rest for p in pairs}
            self._drifts = {i: expected_drift(pairs, rest, gel.px_per_mm) for i, rest in rests.items()}

    def image(
        self, press: Press, rest: np.ndarray, clock: float = 0.0, earlier: Sequence[Earlier] = ()
    ) -> np.ndarray:
        """Predicted photograph, uint8 (H, W, 3), of a press as stated, at a clock of its session, 0 to 1.

        `earlier` are the presses since the rest image.
        """
        if id(rest) not in self._sensors:
            self._sensors[id(rest)] = rest, TactileSensor(replace(self._gel, rest_image=rest))
        sensor, press = self._sensors[id(rest)][1], registered(press, self._gel)
        left = Residues(self._gel, [earlier]).surfaces(self._gel)[0]
        if self._pressed is None:
            image = sensor.image(press_depth(press, self._gel), left)
        else:
            u = self._pressed(press, self._gel.depth_scale)
            u = u if left is None else np.maximum(u, left)
            image = sensor.draw(self._gel.surface(u, self._gel.cell_mm))
        if drift_known(self._gel):
            image = image * gains(self._gel, clock)
        elif id(rest) in self._drifts:
            image = image + self._drifts[id(rest)]
        return np.clip(np.round(image), 0, 255).astype(np.uint8)
