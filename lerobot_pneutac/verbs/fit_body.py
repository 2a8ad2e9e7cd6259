"""Calibrates a finger or an arm to marker or angle data: all parameters by bounded least squares.

Known loads determine its stiffness first (`fit_compliance`), so that weights bend it by the right amount.
Where the pressure was measured, pneumatic effects are fitted to it and the body is driven by it, so that a
slow valve cannot pass for a creeping body; else everything is fitted to the pose at once.

What loads the tip must be known: `payload_g` with the direction of gravity, or a measured `force_x_n`,
`force_y_n`, `force_z_n`. The finger's own weight under another direction of gravity identifies weight over
stiffness alone; it is fitted along and not taken for either.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib.util import find_spec

import numpy as np

from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.diagnosis.bootstrap import BlockBootstrap, deal
from lerobot_pneutac.diagnosis.result import CURVE_LIKE, Contribution
from lerobot_pneutac.reports.page import HELDOUT, MEASURED, MODEL, Report
from lerobot_pneutac.study.base import experiment_of, not_identifiable, unidentified, with_unit
from lerobot_pneutac.study.body_base import doubt, known_causes
from lerobot_pneutac.study.pair import fit_parts, pressure_unit_doubts
from lerobot_pneutac.verbs.result import Calibration, measured_range, range_sentence
from pneutac_datasets.recording import axes
from pneutac_datasets.recording.mounts import align_mounts
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import joined, plural
from pneutac_sim.effects.gravity import STANDARD_GRAVITY
from pneutac_sim.errors import InputError
from pneutac_sim.executor import Progress, no_progress
from pneutac_sim.finger import BodyData, Pipeline, PipelineFit, fit, simulate
from pneutac_sim.finger.quantities import squared_distance
from pneutac_sim.finger.stages import BODY_SHARE, FORCES
from pneutac_sim.twin import PAPER_FINGER, Twin, Value

WHOLE, MODULUS = "joint_stiffness_nm_per_rad", "youngs_modulus_mpa"
GRAVITY = ("gravity_x", "gravity_y", "gravity_z")
LEAST_FORCE_N = 0.02  # by which loads must differ
TURNED = 0.1  # change of a component of gravity from which on the finger's own weight counts
WIDEST = 1.5  # upper over lower end of an interval, beyond which a number is not identified

PARTICLES = 4000  # of the soft body, about
CURVES = "gain_saturation", "stiffening"  # curves of the pressure: one limit, or a gain by powers of it


@dataclass(frozen=True)
class Compliance:
    """What loaded poses determine."""

    twin: Twin
    remark: str
    parameters: dict[str, dict] = field(default_factory=dict)  # stiffness and modulus, as in a `Calibration`
    evaluations: int = 0  # simulations made


def fit_compliance(twin: Twin, recording: Recording, train: np.ndarray, seed: int = 0) -> Compliance:
    """Fits the joints' whole stiffness and the soft body's modulus where known loads bend the finger.

    Only the samples `train` (n,) are fitted; of an arm, which bends in two planes, nothing is.
    """
    if twin.device != "finger":
        fixed = "An arm's modulus and stiffness are not fitted to loaded poses; they stay fixed."
        return Compliance(twin, fixed)
    force = known_forces(recording)
    if force is None or np.ptp(force[train], axis=0)[[0, 2]].max() < LEAST_FORCE_N:
        return Compliance(twin, f"{NO_LOAD}, so {_NEITHER}; {advice(twin, recording)}.")
    samples, start = recording.samples.assign(**dict(zip(FORCES, force.T, strict=True))), twin.copy()
    start.pressure_range_kpa = measured_range(recording) or twin.pressure_range_kpa
    start.effects.pop("payload", None)  # its weight is a force now
    effects = list(start.effects)
    turned = all(map(recording.has, GRAVITY)) and np.ptp(samples[list(GRAVITY)].to_numpy()[train], 0).max()
    if turned > TURNED and "gravity" not in effects:
        effects.append("gravity")
    if not (find_spec("taichi") or find_spec("quadrants")):
        without = f"The soft body's torque needs Taichi, which is not installed, so {_NEITHER}."
        return Compliance(twin, without)
    from pneutac_sim.mpm.devices import measure  # the other bench verbs run without Taichi
    from pneutac_sim.mpm.solve import MpmDiverged
    from pneutac_sim.surrogate.collect import bending_range

    try:
        body = measure(start, bending_range(start), PARTICLES)
    except (InputError, MpmDiverged) as e:
        return Compliance(twin, f"No soft body can be put round this spine ({e}), so {_NEITHER}.")
    data = BodyData.of(replace(recording, samples=samples), start)
    found = fit(start, data, effects, train, seed=seed, body=body)
    if WHOLE not in found.ci95 or WHOLE in found.at_bound:
        little = f"The loads bend the finger too little, so {_NEITHER}; {advice(twin, recording)}."
        return Compliance(twin, little)
    new, whole = twin.copy(), found.twin.parameters[WHOLE]
    if whole.ci95[1] > WIDEST * whole.ci95[0]:
        shown = "anywhere from {:.2g} to {:.2g} N m/rad a joint".format(*whole.ci95)
        leave = f"The loads leave the stiffness {shown}, so {_NEITHER}; {advice(twin, recording)}."
        return Compliance(twin, leave)
    new.parameters[WHOLE] = whole
    rows = {WHOLE: with_unit(whole, "N m/rad") | {"note": ""}}
    remark = "Joint stiffness: {:.2g} to {:.2g} N m/rad.".format(*whole.ci95)
    # a body of the modulus E alone would be as stiff as joints of E times this
    alone = body.alone(1e-3 * (twin.length_mm - np.asarray(twin.spine_joint_positions_mm)))
    share = found.twin.parameters[BODY_SHARE]
    low, high = (whole.value * s / alone for s in share.ci95 or (0.0, 1.0))
    if BODY_SHARE not in found.at_bound and high < WIDEST * low:
        new.parameters[MODULUS] = Value(whole.value * share.value / alone, (low, high))
        rows[MODULUS] = with_unit(new.parameters[MODULUS], "MPa") | {"note": ""}
        remark += f" Young's modulus: {low:.3g} to {high:.3g} MPa; the rest is the chamber's."
        return Compliance(new, remark, rows, found.evaluations)
    value = twin.parameters.get(MODULUS, Value(PAPER_FINGER[MODULUS])).value
    range_mpa = f"{max(low, 0.0):.2g} to {high:.2g} MPa"
    rows[MODULUS] = with_unit(Value(value), "MPa") | {"note": f"fixed: not identifiable ({range_mpa})"}
    angles = any(c.startswith("q_") for c in recording.observations)
    remedy = "a tensile test of its material shows it" + ", as joint angles (q_1_rad ...) would" * (
        not angles
    )
    remark += f" Young's modulus cannot be identified from these data ({range_mpa}); {remedy}."
    if value * alone >= whole.value:
        new.parameters[MODULUS] = Value(0.5 * (low + min(high, 0.9 * whole.value / alone)))
        remark += f" It is set to {new.parameters[MODULUS].value:.2g} MPa."
        rows[MODULUS]["value"] = new.parameters[MODULUS].value
    return Compliance(new, remark, rows, found.evaluations)


def known_forces(recording: Recording) -> np.ndarray | None:
    """(n, 3) N at the tip in the base frame, measured or of what hangs there; None where neither is known."""
    force = np.zeros((len(recording.samples), 3))
    measured = all(map(recording.has, FORCES))
    if measured:
        force += recording.samples[list(FORCES)].to_numpy(float)
    hung = recording.has("payload_g") and all(map(recording.has, GRAVITY))
    if hung:
        down = recording.samples[list(GRAVITY)].to_numpy(float)
        force += 1e-3 * STANDARD_GRAVITY * recording.column("payload_g")[:, None] * down
    return force if measured or hung else None


def advice(twin: Twin, recording: Recording) -> str:
    """What to hang on the finger: what moves its tip by a tenth of its length, as far as is known.

    It is twice as much as hung there, at least.
    """
    levers = 1e-3 * (twin.length_mm - np.asarray(twin.spine_joint_positions_mm))
    K = twin.parameters.get(WHOLE, Value(PAPER_FINGER[WHOLE])).value
    hung = float(recording.column("payload_g").max()) if recording.has("payload_g") else 0.0
    moves = 1e3 * 0.1e-3 * twin.length_mm * K / (levers @ levers) / STANDARD_GRAVITY
    grams = float(f"{max(moves, 2 * hung):.1g}")
    hang = f"hang about {grams:g} g on the tip in some trials, with the base level and with it upright"
    push = "or push with a force gauge and write force_x_n, force_y_n, force_z_n"
    return f"{hang}, and write payload_g and gravity_x, gravity_y, gravity_z, {push}"


NO_LOAD = "No known load bends the finger"
_NEITHER = "neither the joints' stiffness nor the modulus is identified and both stay fixed"


# What a body's parameter means.
MEANING = {
    "gain_rad_per_kpa": "how far it bends per kPa",
    "gain_alpha": "whether it bends more near the tip or near the base",
    "gain_beta": "whether its ends bend more than its middle",
    "rest_pressure_kpa": "the pressure that would make the bend it has at rest",
}
WEIGHT = "record a known weight at the tip (payload_g), with the base level and upright"


def shown_by(name: str, twin: Twin, recording: Recording) -> str:
    """What would show a parameter that a recording does not identify, beyond what it has, a clause."""
    if name in (WHOLE, MODULUS):
        return WEIGHT
    angle, tip = recording.has("bend_angle_rad"), any(c.startswith("tip_") for c in recording.observations)
    joints = any(c.startswith("q_") for c in recording.observations)
    if name == "rest_pressure_kpa" or name == "gain_rad_per_kpa" and (angle or joints):
        held, span = held_kpa(recording), np.ptp(recording.commands, axis=0).max()
        if len(held) < T.ENOUGH_HOLDS or np.ptp(held, axis=0).max() < T.OF_RANGE * span:
            ends = f", from {held.min():.3g} to {held.max():.3g} kPa" if len(held) else ""
            has = f"this recording has {plural(len(held), 'such pressure')}{ends}"
            return f"record holds at {T.ENOUGH_HOLDS} pressures or more over the whole range ({has})"
        has = f"holds at {len(held)} pressures are there already"
        if "base_tilt" in twin.effects:
            return f"{has}, but a tilted base makes up for it: mark two points on the base and measure them"
        return f"{has}, and the twin predicts them as well without it"
    if joints:
        return "record larger bends: their shape shows little at the pressures of this recording"
    if not tip:
        return "a marker at the tip shows it (tip_x_mm, tip_z_mm); the bend is predicted as well without it"
    by = "larger bends show it" if angle else "the tip's angle (bend_angle_rad) or larger bends show it"
    return f"{by}; the tip is predicted as well without it"


def held_kpa(recording: Recording) -> np.ndarray:
    """Commanded pressures (k, chambers), kPa, that were held for `thresholds.HOLD_S`, each once."""
    commands = recording.commands
    step = max(float(np.ptp(commands, axis=0).max()), T.STANDS_KPA) / T.LEVELS
    return step * np.unique(np.round(commands[axes.motion(recording)[1] >= T.HOLD_S] / step), axis=0)


def unknown_parameters(rows: Mapping[str, dict]) -> str:
    """Parameters whose `note` begins with `unidentified`, and what shows them, once for all of one remedy."""
    by: dict[str, list[str]] = {}
    for name, row in rows.items():
        note = str(row["note"])
        if note.startswith("not identifiable"):
            values = "{:.3g} to {:.3g} {}".format(*row["ci95"], row["unit"]).strip() if row["ci95"] else ""
            fit = f"{values} fit about as well" if values else ""
            of = "; ".join(filter(None, (MEANING.get(name, ""), fit)))
            by.setdefault(note.partition(": ")[2], []).append(f"{name} ({of})" if of else name)
    return " ".join(
        f"Not identifiable: {joined(names)}. {remedy[:1].upper()}{remedy[1:]}."
        for remedy, names in by.items()
    )


LIMIT = "at the limit of its allowed range: the model is probably missing something"
MOST_POINTS = 4000  # of a line in the report


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class BodyCalibration(Calibration):
    """A body calibrated to markers or angles."""

    heading = "Calibrated {0.twin.device}"

    fits: list[PipelineFit]  # one fit a stage: of the measured pressure, if any, then of the pose
    # the recording as the body fit sees it, driven by the measured pressure where there is one.
    bench: BodyData
    train: np.ndarray  # (n,) mask
    before: float | None  # held-out error of the twin as it was, from the command; None if there is none
    without_causes: float | None  # held-out error without the known causes; None where nothing was held out
    # known causes that the recording shows (weight, payload, base pose, stretch), and what each is worth on
    # the held-out part.
    causes: list[Contribution]
    compliance: str  # what loaded poses show of modulus and stiffness, one sentence

    @property
    def sentence(self) -> str:
        heldout, train = self.error["heldout"], f"training error {self.error['train']:.3g} {self.unit}"
        if heldout is None:
            return f"Calibrated: {train}; nothing was held out{self._now()}."
        before = f"{heldout:.3g} {self.unit} (before {self.before:.3g})"
        return f"Calibrated: test error {before}, {train}{self._now()}."

    @property
    def reference(self) -> tuple[str, float | None]:
        return "the twin as it was", self.before

    def remarks(self) -> list[str]:
        """Known causes, then the one thing that a reader should know most; the report has all."""
        noted = {k: str(p["note"]) for k, p in self.parameters.items()}
        limit = [k for k, note in noted.items() if note == LIMIT]
        notes = []
        if limit:
            notes.append(f"At the limit of its allowed range: {joined(limit)}. Something may be missing.")
        if unknown := unknown_parameters(self.parameters):
            notes.append(unknown)
        if NO_LOAD in self.compliance:
            notes.append(self.compliance)
        return [*self._causes(), *notes[:1]]

    def rows(self) -> list[dict]:
        return []  # the sentence has the errors, the report the parameters

    def _causes(self) -> list[str]:
        if not self.causes:
            return []
        falls = f"from {self.without_causes:.3g} to {self.error['heldout']:.3g} {self.unit}"
        each = ", ".join(f"{c.name.replace('_', ' ')} {c.error_without:.3g}" for c in self.causes)
        without = f"Without each, all else re-fitted: {each} {self.unit}."
        return [f"Known causes lower the test error {falls}. {without}"]

    def content(self) -> dict:
        errors = {k: {"heldout": getattr(self, k)} for k in ("before", "without_causes")}
        return super().content() | errors | {"known_causes": self.causes, "compliance": self.compliance}

    def page(self) -> Report:
        from lerobot_pneutac.reports.figures import curves  # plotly

        page = Report(self.title)
        page.lead(" ".join([self.sentence, *self._causes()]))
        page.text(f"{self.compliance} {range_sentence(self.twin.pressure_range_kpa)}")
        worth = "Intervals count neighbouring samples as the few independent ones that they are worth."
        page.table(Calibration.rows(self), worth)
        t = self.bench.inputs.columns["session_time_s"][self.bench.inputs.rows]
        thin = slice(None, None, max(1, len(t) // MOST_POINTS))
        for i, column in enumerate(self.bench.columns[: self.bench.counted]):
            measured, residual = self.bench.measured[:, i], self.fits[-1].residual[:, i]
            lines = (("measured", measured, MEASURED), ("twin", measured - residual, MODEL))
            left = ("test residual", np.where(self.train, np.nan, residual), HELDOUT)
            shown = ((name, t[thin], y[thin], colour) for name, y, colour in (*lines, left))
            page.figure(curves(shown, "time (s)", column))
        return page


def calibrate_body(
    twin: Twin, recording: Recording, seed: int = 0, progress: Progress = no_progress
) -> BodyCalibration:
    began = time.perf_counter()
    folder = str(recording.folder)
    recording, findings, train, heldout = fit_parts(twin, recording, seed)
    recording, moved = align_mounts(recording, twin.length_mm, train)
    bench, command = (BodyData.of(recording, twin, source=s) for s in ("auto", "command"))
    loads = fit_compliance(twin, recording, train, seed)
    # first of the measured pressure, where effects act between it and the command
    fits, start, left_out = [], loads.twin, simulate(loads.twin, bench).left_out
    air = [e for e in start.effects if bench.inputs.measured and "measured pressure" in left_out.get(e, "")]
    stages = 1 + bool(air)
    if air:
        progress("fitting the measured pressure", 0, stages)
        pressure = BodyData.of(recording, start, target="pressure")
        fits.append(fit(start, pressure, None, train, air, seed=seed))
        start = fits[0].twin
    progress("fitting the pose", stages - 1, stages)
    fits.append(fit(start, bench, train=train, seed=seed))
    progress("fitted", stages, stages)
    test = _HeldOutTest(command, recording, heldout, seed) if heldout.any() else None
    fits, plain, causes, doubts = _with_known_causes(fits, recording, bench, train, test, seed, progress)
    after = replace(fits[-1].twin, fitted_to={"change": "calibrated", "recording": folder, "seed": seed})

    def error(model: Twin, mask: np.ndarray) -> float | None:
        return command.error(simulate(model, command).residual, mask) if mask.any() else None

    return BodyCalibration(
        twin=after,
        parameters=parameters(after, fits, bench, recording) | loads.parameters,
        error={"train": error(after, train), "heldout": error(after, heldout)},
        unit=bench.unit,
        evaluations=loads.evaluations + sum(f.evaluations for f in fits),
        seconds=time.perf_counter() - began,
        recording=folder,
        change="calibrated",
        seed=seed,
        findings=tuple(findings + moved + pressure_unit_doubts(after) + doubts),
        fits=fits,
        bench=bench,
        train=train,
        before=error(twin, heldout),
        without_causes=error(plain, heldout),
        causes=causes,
        compliance=loads.remark,
    )


class _HeldOutTest:
    """Held-out errors from the command, and whether their fall is significant."""

    def __init__(self, command: BodyData, recording: Recording, heldout: np.ndarray, seed: int):
        self._command, parts = command, deal(recording, seed)
        self.held = BlockBootstrap(heldout, parts.unit, parts.stratum, seed)

    def squared(self, twin: Twin) -> np.ndarray:
        residual = simulate(twin, self._command).residual * self._command.scale
        return squared_distance(residual[:, : self._command.counted])

    def needs(self, without: np.ndarray, squared: np.ndarray) -> bool:
        """Whether held-out squared errors (n,) rise significantly, by `WORTH_OF_CAUSE` at least."""
        before, after = self.held.value(without), self.held.value(squared)
        enough = before - after > T.WORTH_OF_CAUSE * after
        return enough and self.held.significant_drop(without, squared)

    def idle(self, twin: Twin, cause: str) -> bool:
        """Whether a cause ended where it moves nothing: a better fit with it is no merit of it."""
        seen, plain = (simulate(t, self._command).residual for t in (twin, twin.without(cause)))
        return self._command.error(seen - plain) < T.IDLE_OF_RESIDUAL * self._command.error(seen)


def _with_known_causes(
    fits: list[PipelineFit], recording, bench, train, test: _HeldOutTest | None, seed: int, progress
) -> tuple[list[PipelineFit], Twin, list[Contribution], list[str]]:
    """The fits with those known causes that the recording shows, the twin without them, and their worth.

    All are fitted together; then the one whose removal costs least goes, while that is not significant or
    there is a `doubt`. Last in the result are sentences on those that went for a doubt.
    """
    plain = fits[-1].twin
    names = [c for c in known_causes(recording) if c not in plain.effects]

    def fitted(twin: Twin, effects: list[str]) -> PipelineFit:
        return fit(twin, bench, [*plain.effects, *effects], train, starts=1, seed=seed)

    if not names or test is None:
        return fits, plain, [], []
    progress("fitting known causes", 0, 1 + len(names))
    doubts = _curve_instead(plain, names, fitted, test)
    names = [c for c in names if c not in doubts]
    if not names:
        return fits, plain, [], list(doubts.values())
    now = fit(plain, bench, [*plain.effects, *names], train, seed=seed)
    squared, lost = test.squared(now.twin), {}
    while names:
        without = {c: fitted(now.twin.without(c), [n for n in names if n != c]) for c in names}
        lost = {c: test.squared(f.twin) for c, f in without.items()}
        goes = [c for c in names if test.idle(now.twin, c) or not test.needs(lost[c], squared)]
        if not goes:
            doubts |= {c: d for c in names if (d := _doubt(c, recording, bench, now, lost[c], squared))}
            goes = [c for c in names if c in doubts]
        if not goes:
            break
        weakest = min(goes, key=lambda c: lost[c].sum())
        names.remove(weakest)
        now, squared = without[weakest], lost[weakest]
        progress("fitting known causes", 1, 1 + len(names))
    sentences = [d for c, d in doubts.items() if c not in names]
    if not names or not test.needs(test.squared(plain), squared):
        return fits, plain, [], sentences
    error = {c: float(np.sqrt(test.held.value(lost[c]))) for c in names}
    now_error, drop = float(np.sqrt(test.held.value(squared))), test.held.drop
    causes = [Contribution(c, True, error[c], now_error, drop(lost[c], squared)) for c in names]
    return [*fits[:-1], now], plain, sorted(causes, key=lambda c: -c.drop[0]), sentences


def _curve_instead(plain: Twin, names: list[str], fitted: Callable, test: _HeldOutTest) -> dict[str, str]:
    """Mount and stretch that a curve of the pressure makes needless, and why they are left out, a sentence.

    They bend the path of the tip nearly as such a curve does. It is not stored: `diagnose` finds which it is.
    """
    doubted = [c for c in names if c in CURVE_LIKE]
    if not doubted or set(CURVES) & set(plain.effects):
        return {}
    others = [c for c in names if c not in doubted]
    curves = {c: fitted(plain, [*others, c]) for c in CURVES}
    curve = min(curves, key=lambda c: test.squared(curves[c].twin).sum())
    bare = test.squared(curves[curve].twin)
    if not test.needs(test.squared(fitted(plain, others).twin if others else plain), bare):
        return {}
    both = fitted(curves[curve].twin, [*others, curve, *doubted])
    if test.needs(bare, test.squared(both.twin)):
        return {}
    alone = test.squared(fitted(plain, names).twin)
    if alone.sum() <= bare.sum():
        return {}
    why = (
        "with a curve of the pressure it no longer lowers the test error, so it would stand in for the curve"
    )
    return {
        c: f"{c.replace('_', ' ')} is left out: {why}, which `pneutac diagnose` looks for." for c in doubted
    }


def _doubt(
    cause: str, recording: Recording, bench: BodyData, now: PipelineFit, lost: np.ndarray, squared: np.ndarray
) -> str:
    """Why a known cause of a fit may stand in for something else; empty where it does not."""
    stuck = [n for n in now.at_bound if n.partition(".")[0] == cause]
    if stuck:
        name = cause.replace("_", " ")
        return f"{name} is left out: {joined(stuck)} stopped at a bound, so it stands in for something else."
    scale = bench.scale[: bench.counted]

    def predict(changed: Recording) -> np.ndarray:
        data = BodyData.of(changed, now.twin, source="measured" if bench.inputs.measured else "command")
        seen = now.pipeline.outputs(now.pipeline.run(data.inputs, now.theta), data.columns)
        return seen[:, : bench.counted] * scale

    residual = now.residual[:, : bench.counted] * scale
    return doubt(cause, recording, predict, residual, np.arange(len(residual)), lost, squared)


def parameters(twin: Twin, fits: list[PipelineFit], bench: BodyData, recording: Recording) -> dict[str, dict]:
    """Value, 95 % interval where it was fitted, unit, and what to know about each parameter."""
    model = Pipeline.of(twin)
    theta = model.theta(twin, bench.inputs.pressure_range_kpa)
    out = {}
    for name, spec, value in zip(model.names, model.specs, theta, strict=True):
        row = {"value": float(value), "ci95": None, "unit": spec.unit, "note": "held"}
        for f in fits:
            if name in f.ci95:
                row |= {"ci95": list(f.ci95[name]), "note": ""}
            if name in f.at_bound:
                row["note"] = LIMIT
            known = row["value"], row["ci95"], spec, bench.inputs.pressure_range_kpa
            if name in f.not_identified or not_identifiable(*known):
                effect, dot, _ = name.partition(".")
                by = experiment_of(effect, recording) if dot else shown_by(name, twin, recording)
                row["note"] = unidentified(by)
        out[name] = row
    return out
