"""Which optics effect a gel lacks: fits with and without each, judged on photographs that no fit has seen.

The same rules as for a finger: the training part proposes, the held-out part decides by a paired bootstrap,
here over whole photographs. As one pair of images cannot tell a drift or a shift, some of the photographs
beside the calibration pair train too.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lerobot_pneutac.diagnosis.bootstrap import Resampler
from lerobot_pneutac.diagnosis.parts import Parts
from lerobot_pneutac.diagnosis.steps import Steps
from lerobot_pneutac.diagnosis.verdict import FEW_UNITS, MOST, Evidence, decide
from lerobot_pneutac.study.base import Study
from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.noise import NoiseFloor
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import get_effect, of_sensor, sensor_effects
from pneutac_sim.errors import InputError
from pneutac_sim.features import IMAGE_SHAPE
from pneutac_sim.gel import optics
from pneutac_sim.gel.fit import GelFit, fit_photographs
from pneutac_sim.gel.metrics import CONTACT_DISC
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import check_pair
from pneutac_sim.gel.photograph import Predictor, session_light
from pneutac_sim.twin import Twin

MOST_TRAINED = 6  # photographs that train; more cost time and pin the light no better
WORTH = 0.02  # share of the avoidable error that an effect must remove
NOISE_LIMIT = 1.25  # final error over noise: on generated images of the model's own form it stays below


@dataclass
class Trial:
    """A fit with some effects, tried on every photograph.

    Attributes:
        effects: switched on.
        fit: to the training photographs.
        squares: (n,) mean square error of each photograph, levels^2.
        contact: (n,) the same in the contact region.
        residuals: n of predicted - photographed, int16 (H, W, 3).
    """

    effects: tuple[str, ...]
    fit: GelFit
    squares: np.ndarray
    contact: np.ndarray
    residuals: list[np.ndarray]
    not_identified: dict[str, str] = field(default_factory=dict)

    @property
    def squared(self) -> np.ndarray:
        """(n,) mean square error of each photograph."""
        return self.squares


@dataclass
class GelFindings:
    """What was found.

    Attributes:
        data: the recording.
        train: (n,) mask of photographs that trained.
        noise: of the photographs away from contacts, after their own drift of light, levels.
        judge: resamples the held-out photographs.
        base: with the effects that the twin has.
        alone: each candidate on top of that.
        present: the twin's effects, each taken away.
        ladder: from `base` to the end, one effect more each.
        selected: effects found, in the order found.
        rivals: (effect, rival) that the held-out photographs cannot tell apart.
        rest: (n,) mean square error of the rest image alone, levels^2.
        stored: (n,) the same of the twin as it is stored, nothing fitted; None where it has no gel yet.
        evidence: numbers behind the verdict; its noise counts the light's drift from image to image too.
    """

    data: GelRecording
    train: np.ndarray
    noise: float
    judge: Resampler
    base: Trial
    alone: dict[str, Trial]
    present: dict[str, Trial]
    ladder: list[Trial]
    selected: list[str]
    rivals: list[tuple[str, str]]
    rest: np.ndarray
    stored: np.ndarray | None
    evidence: Evidence

    @property
    def verdict(self) -> str:
        """One of five, see `verdict`; what the twin's own effects explain counts too."""
        found = decide(self.evidence)
        return "insufficient_form" if found == "unknown_effect" and self.explained >= MOST else found

    @property
    def explained(self) -> float:
        """Share of what a contact changes that the final model predicts on held-out photographs."""
        return self.judge.reduction(self.rest, self.ladder[-1].squares, self.noise)[0]

    def heldout(self, trial: Trial) -> float:
        """Root mean square error over held-out photographs, levels."""
        return float(np.sqrt(self.judge.value(trial.squares)))


class Bench:
    """Fits and tries effects on one recording."""

    def __init__(self, gel: GelModel, data: GelRecording, seed: int):
        self.data, self._gel = data, gel
        self.photographs = [s.photograph for s in data.samples]
        self.train = deal(data, seed)
        held = ~self.train
        roles = np.array([s.role for s in data.samples])
        strata = np.unique(roles, return_inverse=True)[1]
        self.judge = Resampler(held, np.arange(len(held)), strata, seed)
        self._pair = data.calibration.photograph
        self._regions = [p.near(data.px_per_mm, CONTACT_DISC) for p in self.photographs]

    def trial(self, effects: Sequence[str], near: GelModel | None = None) -> Trial:
        """Fits these effects to the training photographs and predicts all."""
        chosen = [p for p, t in zip(self.photographs, self.train, strict=True) if t]
        fit = fit_photographs(self._gel, chosen, effects, near=near)
        residuals = self.residuals(fit.gel)
        squares = _squares(residuals)
        contact = np.array(
            [np.mean(np.square(r[m].astype(float))) for r, m in zip(residuals, self._regions, strict=True)]
        )
        return Trial(tuple(e for e in sensor_effects() if e in effects), fit, squares, contact, residuals)

    def residuals(self, gel: GelModel) -> list[np.ndarray]:
        """Predicted - photographed of every photograph, int16 (H, W, 3)."""
        predictor = Predictor(gel, self._pair)
        return [
            predictor.image(p.press, p.rest, p.clock).astype(np.int16) - p.image for p in self.photographs
        ]

    def far(self, trial: Trial) -> float:
        """Error of a trial away from contacts on held-out photographs, where no gel moves, levels."""
        out = []
        for p, r, trained in zip(self.photographs, trial.residuals, self.train, strict=True):
            far = ~p.near(self.data.px_per_mm)
            if far.mean() > 0.1 and not trained:
                out.append(np.mean(np.square(r[far].astype(float))))
        return float(np.sqrt(np.mean(out))) if out else 0.0

    def noise(self) -> float:
        """What is left away from contacts once each photograph's own drift of light is taken off, levels."""
        out = []
        for p in self.photographs:
            far = ~p.near(self.data.px_per_mm)
            if far.mean() > 0.1:
                drift = optics.upsample(session_light(p, self.data.px_per_mm), *p.rest.shape[:2])
                out.append(np.mean(np.square((p.image.astype(float) - p.rest - drift)[far])))
        return float(np.sqrt(np.mean(out))) if out else 0.0


def _squares(residuals: Sequence[np.ndarray]) -> np.ndarray:
    return np.array([np.mean(np.square(r.astype(np.float64))) for r in residuals])


def deal(data: GelRecording, seed: int) -> np.ndarray:
    """Mask (n,) of photographs that train: the calibration pairs, and others while enough stay held out.

    Raises:
        InputError: there is no photograph to judge by.
    """
    train = np.array([s.role == "calibration" for s in data.samples])
    others = np.flatnonzero(~train)
    if not len(others):
        raise InputError("The recording has no image beside the calibration pair, so nothing can be judged.")
    spare = min(MOST_TRAINED - int(train.sum()), len(others) - FEW_UNITS, len(others) // 2)
    if spare > 0:
        train[np.random.default_rng([seed, 5]).permutation(others)[:spare]] = True
    return train


def study(
    gel: GelModel,
    data: GelRecording,
    effects: Sequence[str],
    seed: int = 0,
    tell: Callable[[str, int], None] = lambda text, fits: None,
    done: Callable[[], None] = lambda: None,
) -> GelFindings:
    """Looks for what the effects of a twin leave unexplained.

    Args:
        gel: the twin's, as the recording's images show it.
        data: the recording.
        effects: that the twin has.
        seed: decides which photographs train, and the bootstrap.
        tell: hears what is tried and how many fits it takes.
        done: called after each fit.
    """
    bench = Bench(replace(gel, effects={}), data, seed)
    judge, noise = bench.judge, bench.noise()
    known = sensor_effects()
    own = [e for e in known if e in effects]

    def attempt(names: Sequence[str], near: GelModel | None = None) -> Trial:
        out = bench.trial(names, near)
        done()
        return out

    tell("the twin as it is", 1)
    base = attempt(own)

    def helps(before: Trial, after: Trial) -> bool:
        share = judge.reduction(before.squares, after.squares, noise)[0]
        return judge.drop(before.squares, after.squares)[1] > 0 and share > WORTH

    ladder, selected, alone, rivals = [base], [], {}, []
    while len(selected) < len(known) - len(own):
        now = ladder[-1]
        candidates = [e for e in known if e not in now.effects]
        tell(f"effect {len(selected) + 1}", len(candidates))
        tried = {e: attempt([*now.effects, e], now.fit.gel) for e in candidates}
        if not selected:
            alone = tried
        order = sorted(candidates, key=lambda e: float(tried[e].squares[bench.train].mean()))
        good = [e for e in order if helps(now, tried[e])]
        if not good:
            break
        best = good[0]
        for other in good[1:]:
            low, high = np.quantile(
                judge.mse(tried[other].squares) - judge.mse(tried[best].squares), [0.025, 0.975]
            )
            if low <= 0 <= high:
                rivals.append((best, other))
        selected.append(best)
        ladder.append(tried[best])

    tell("what each effect of the twin is good for", len(own))
    present = {e: attempt([x for x in own if x != e], base.fit.gel) for e in own}
    final = ladder[-1]
    floor = max(noise, bench.far(final))
    near_miss = [
        e for e, t in alone.items() if judge.reduction(base.squares, t.squares, noise)[0] > 2 * WORTH
    ]
    evidence = Evidence(
        samples=100 * int(bench.train.sum()),
        units=judge.units,
        moves=True,
        before=float(np.sqrt(judge.value(base.squares))) / floor,
        after=float(np.sqrt(judge.value(final.squares))) / floor,
        limit=NOISE_LIMIT,
        selected=selected,
        removed=judge.reduction(base.squares, final.squares, floor)[0] if selected else 0.0,
        at_bound=at_bound(final.fit.gel, selected),
        near_miss=[] if selected else near_miss,
    )
    return GelFindings(
        data=data,
        train=bench.train,
        noise=noise,
        judge=judge,
        base=base,
        alone=alone,
        present=present,
        ladder=ladder,
        selected=selected,
        rivals=rivals,
        rest=np.array([np.mean(np.square(p.image.astype(float) - p.rest)) for p in bench.photographs]),
        stored=_squares(bench.residuals(gel)) if gel.light.any() else None,
        evidence=evidence,
    )


def for_twin(gel: GelModel, twin: Twin) -> GelModel:
    """The gel at the size in which the twin keeps it: 240 x 320, other proportions for a lone gel only."""
    h, w = gel.rest_image.shape[:2]
    if twin.device == "gel" and abs(w / h / (IMAGE_SHAPE[1] / IMAGE_SHAPE[0]) - 1) > 0.02:
        return gel
    return gel.resized(*IMAGE_SHAPE[:2])


def predict(gel: GelModel, data: GelRecording) -> list[np.ndarray]:
    """Predicted image of every sample; the calibration pair tells how the light drifts."""
    pair = next((s.photograph for s in data.samples if s.role == "calibration"), None)
    predictor = Predictor(gel, pair)
    return [predictor.image(s.press, s.rest, s.clock) for s in data.samples]


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


def maps(study: GelFindings, trial: Trial) -> tuple[np.ndarray, np.ndarray]:
    """Where a trial fails on held-out photographs, root mean square over them in levels.

    Returns:
        In the image plane (H, W, 3); and around the contact (121, 121, 3), from -3 to 3 contact radii, as a
        signed mean.
    """
    from scipy.ndimage import map_coordinates

    held = [i for i in range(len(study.train)) if not study.train[i]]
    plane = np.sqrt(np.mean([np.square(trial.residuals[i].astype(np.float64)) for i in held], axis=0))
    t = np.linspace(-3, 3, 121)
    x, y = np.meshgrid(t, t)
    total, count = np.zeros((121, 121, 3)), np.zeros((121, 121, 1))
    for i in held:
        s, r = study.data.samples[i], trial.residuals[i].astype(float)
        at = [s.y_px - 0.5 + y * s.radius_px, s.x_px - 0.5 + x * s.radius_px]
        inside = (at[0] >= 0) & (at[0] <= r.shape[0] - 1) & (at[1] >= 0) & (at[1] <= r.shape[1] - 1)
        total += np.stack([map_coordinates(r[..., k], at, order=1) for k in range(3)], -1) * inside[..., None]
        count += inside[..., None]
    return plane, total / np.maximum(count, 1)


class GelStudy(Study):
    """Photographs of a gel; a sample is a photograph."""

    unit = "levels"

    def __init__(self, twin: Twin, recording: Recording, seed: int):
        data = GelRecording.load(recording)
        pair = data.calibration
        check_pair(pair.rest, pair.image, pair.press, data.px_per_mm)
        self.twin, self.recording, self.seed, self.data = twin, recording, seed, data
        gel = seen_by(GelModel.from_twin(twin), data)
        self.bench = Bench(replace(gel, effects={}), data, seed)
        held = ~self.bench.train
        strata = np.unique([s.role for s in data.samples], return_inverse=True)[1]
        self.parts = Parts(self.bench.train, held, held, np.arange(len(held)), strata)
        self.noise = NoiseFloor(self.bench.noise(), None, self.unit, "", {})
        self.own = tuple(of_sensor(twin.effects))
        self.candidates, self.untested = [e for e in sensor_effects() if e not in self.own], []
        self.findings = data.warnings

    def refit(self, effects: Sequence[str], start: Trial | None, steps: Steps) -> Trial:
        """Light and these effects, fitted to the training photographs."""
        out = self.bench.trial(effects, start and start.fit.gel)
        steps.done()
        return out

    def refusal(self, effect: str) -> str:
        """Why an effect cannot be switched on."""
        if effect not in sensor_effects():
            return f"'{effect}' does not act on a gel's images; give one of {', '.join(sensor_effects())}."
        return self.already_on(effect)

    def errors(self, model: Trial) -> dict:
        """Also in the contact."""
        contact = float(np.sqrt(model.contact[self.parts.test].mean()))
        return super().errors(model) | {"heldout_contact": contact}

    def twin_of(self, model: Trial) -> Twin:
        """The twin with the fitted gel."""
        twin = self.twin.copy()
        for_twin(model.fit.gel, twin).into_twin(twin)
        return twin

    def parameters(self, model: Trial, effect: str) -> dict[str, dict]:
        """Value and unit; a fit of light gives no intervals."""
        units = {p.name: p.unit for p in get_effect(effect).parameters}
        values = model.fit.gel.effects[effect]
        return {k: {"value": v, "ci95": None, "unit": units[k]} for k, v in values.items()}

    def at_bound(self, model: Trial, effects: Sequence[str]) -> list[str]:
        """Parameters at a bound."""
        return at_bound(model.fit.gel, effects)
