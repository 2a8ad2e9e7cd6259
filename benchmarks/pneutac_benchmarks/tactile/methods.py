"""What `pneutac benchmark tactile` compares: each method fits one pair of images and predicts others."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lerobot_pneutac.study.gel import Pasted
from pneutac_benchmarks.baselines.dot_sim import DotSim
from pneutac_benchmarks.baselines.pair import Pair
from pneutac_benchmarks.baselines.tacchi import Tacchi
from pneutac_benchmarks.baselines.taxim import Taxim
from pneutac_datasets.recording.gel import GelRecording, GelSample
from pneutac_sim.gel.fit import fit_presses
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.layout import DIGIT, Layout
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.photograph import Predictor, Pressed, expected_drift, press_depth, registered
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.mpm.devices import PressedGel
from pneutac_sim.splat.gel import SplatSensor, refine_fit
from pneutac_sim.twin import Twin

Predict = Callable[[GelSample], np.ndarray]

# The library's DIGIT was found on photographs of both of these units, held-out ones among them. These are the
# same constants found on one unit alone. Residual fields need no such care: none is lent to its own unit.
FOUND_ALONE = {
    "digit_nagoya": Layout(
        "DIGIT",
        ((8.48, -7.73), (-11.55, -5.02), (9.85, 76.5)),
        (1.34, 3.4, 0.33),
        DIGIT.proportions,
        units=DIGIT.units,
    ),
    "digit_fots": Layout(
        "DIGIT",
        ((7.02, -6.78), (-13.8, -6.25), (35.6, 139.0)),
        (1.3, 2.34, 0.42),
        DIGIT.proportions,
        units=DIGIT.units,
    ),
}
OTHER_UNIT = {"digit_nagoya": "digit_fots", "digit_fots": "digit_nagoya"}


@dataclass(frozen=True)
class Method:
    """One row of the table.

    Attributes:
        name: as the table shows it.
        fit: takes a set's name and its recording, gives the prediction of a sample.
        ours: whether it is this library's model, as it is offered.
        seconds: about how long a set takes, which the progress bar needs.
        sets: the only sets on which it means anything; None for all.
    """

    name: str
    fit: Callable[[str, GelRecording], Predict]
    ours: bool = False
    seconds: float = 2.0
    sets: tuple[str, ...] | None = None


def own_gel(
    data: GelRecording,
    effects: tuple[str, ...] | None = None,
    makes: tuple[Layout, ...] = (DIGIT,),
    pressed: Pressed | None = None,
) -> GelModel:
    """This library's gel, fitted to a recording's calibration pair; refined by splats where `pressed`."""
    pair = data.presses[0]
    fit = fit_presses([pair], data.px_per_mm, effects, data.thickness_mm, makes, pressed)
    if pressed is not None:
        refine_fit(fit, [pair], pressed)
    return fit.gel


def _model(
    effects: tuple[str, ...] | None = None, makes: Callable[[str], tuple[Layout, ...]] = lambda name: (DIGIT,)
):
    def fit(name: str, data: GelRecording) -> Predict:
        predictor = Predictor(own_gel(data, effects, makes(name)), [data.presses[0]])
        return lambda s: predictor.image(s.press, s.rest, s.clock)

    return fit


def _through_mpm(effects: tuple[str, ...] | None = None, drawn: bool = True, splats: bool = False):
    """Light fitted to the surface of material points; where `drawn`, predictions are of theirs, too."""

    def fit(name: str, data: GelRecording) -> Predict:
        sizes = GelModel(data.rest, np.zeros((3, 2)), np.zeros(3), data.px_per_mm)
        points = PressedGel(sizes, Twin("gel"))
        gel = own_gel(data, effects, pressed=points.between)
        if splats:
            return _by_splats(gel, data, lambda press: points.surface(press, gel.depth_scale))
        predictor = Predictor(gel, [data.presses[0]], points.surface if drawn else None)
        return lambda s: predictor.image(s.press, s.rest, s.clock)

    return fit


def _without_drift(name: str, data: GelRecording) -> Predict:
    predictor = Predictor(own_gel(data))
    return lambda s: predictor.image(s.press, s.rest, s.clock)


def _baseline(kind: type):
    """A renderer that knows the calibration's rest image; what it adds is added to another session's."""

    def fit(name: str, data: GelRecording) -> Predict:
        c = data.presses[0]
        fitted = kind.fit(Pair(c.rest, c.image, c.press, data.px_per_mm, data.thickness_mm))

        def predict(s: GelSample) -> np.ndarray:
            image = fitted.image(s.press)
            if s.rest is c.rest:
                return image
            return np.clip(image.astype(np.int16) - c.rest + s.rest, 0, 255).astype(np.uint8)

        return predict

    return fit


def _splats(name: str, data: GelRecording) -> Predict:
    """The same fit, mechanics and drift of light, drawn by Gaussians that move with the gel."""
    gel = own_gel(data)
    surface = TactileSensor(gel)
    return _by_splats(gel, data, lambda press: surface.displacement(press_depth(press, gel)))


def _by_splats(gel: GelModel, data: GelRecording, surface: Callable[[Press], np.ndarray]) -> Predict:
    c = data.presses[0]
    pair = c
    drift = expected_drift([pair], pair.rest, gel.px_per_mm)
    sensors = {id(c.rest): SplatSensor(gel)}

    def predict(s: GelSample) -> np.ndarray:
        if id(s.rest) not in sensors:
            sensors[id(s.rest)] = SplatSensor(replace(gel, rest_image=s.rest))
        image = sensors[id(s.rest)].image(surface(registered(s.press, gel)))
        return np.clip(np.round(image + drift * (s.rest is c.rest)), 0, 255).astype(np.uint8)

    return predict


class RestAlone:
    """Predicts that no contact shows."""

    def __init__(self, rest: np.ndarray):
        self._rest = rest

    @classmethod
    def fit(cls, pair: Pair) -> "RestAlone":
        return cls(pair.rest)

    def image(self, press: Press) -> np.ndarray:
        return self._rest.copy()


class PastedPair(Pasted):
    @classmethod
    def fit(cls, pair: Pair) -> "PastedPair":
        return cls(pair, pair.px_per_mm)


METHODS = {
    "rest": Method("rest image", _baseline(RestAlone), seconds=0.5),
    "pasted": Method("difference pasted", _baseline(PastedPair), seconds=0.5),
    "taxim": Method("Taxim", _baseline(Taxim), seconds=6),
    "tacchi": Method("Tacchi", _baseline(Tacchi), seconds=8),
    "dot_sim": Method("DOT-Sim", _baseline(DotSim), seconds=35),
    "linear": Method("paper, linear model", _model(effects=()), seconds=2),
    "linear_mpm": Method("paper, material points", _through_mpm(effects=()), seconds=60),
    "chain": Method("paper, whole chain", _through_mpm(effects=(), splats=True), seconds=70),
    "model": Method("this model", _model(), ours=True, seconds=5),
    "splats": Method("this model, splats", _splats, ours=True, seconds=9),
    "model_mpm": Method("this model, material points", _through_mpm(), ours=True, seconds=60),
    "model_chain": Method("this model, whole chain", _through_mpm(splats=True), ours=True, seconds=70),
    "light_mpm": Method("this model, light through mpm", _through_mpm(drawn=False), seconds=15),
    "no_drift": Method("this model, no drift", _without_drift, seconds=5),
    "no_make": Method(
        "this model, no make", _model(makes=lambda name: ()), seconds=4, sets=tuple(FOUND_ALONE)
    ),
    "other_unit": Method(
        "this model, other's make",
        _model(makes=lambda name: (FOUND_ALONE[OTHER_UNIT[name]],)),
        seconds=5,
        sets=tuple(FOUND_ALONE),
    ),
}


def makes_for(source: str, target: str) -> tuple[Layout, ...]:
    """Makes that a gel fitted to one set may know without having seen another one; they lend it no field."""
    if source in FOUND_ALONE and target in FOUND_ALONE:
        return (replace(FOUND_ALONE[source], units=()),)
    return (DIGIT,)
