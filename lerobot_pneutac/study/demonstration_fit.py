"""Fits of the finger to demonstrations: flange, pressure and touch predicted together.

All errors are in mm at the finger's tip: the flange's own; a pressure's by the bend that it makes in the
twin; a touch's by the bend that would make it. What belongs to an episode and not to the finger is fitted
beside it, from that episode alone: by how much its object stands elsewhere, as a bend, and how strong its
imprints show where it pressed. Touch is shown `touch_late` frames late, and grows as a power of the force,
alike in all.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from lerobot_pneutac.diagnosis.search import Trial
from lerobot_pneutac.study.demonstration_bench import LIGHTLY, FreeBend
from lerobot_pneutac.study.demonstration_data import EpisodeData, inputs_of
from lerobot_pneutac.study.demonstration_model import DemonstrationModel, Form
from lerobot_pneutac.study.demonstration_strength import Strength
from lerobot_pneutac.study.demonstration_touch import TYPICAL, imprint_per_rad, stiffness_n_per_rad, touch
from pneutac_sim.effects.effect import Parameter
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.features import CONTROL_HZ
from pneutac_sim.finger import Pipeline
from pneutac_sim.twin import Twin, Value

LATE = "late_commands"  # arm and air alike
LATENCY = Parameter("latency_s", "s", default=0.1, lower=0.0, upper=0.8)
GROWTH = Parameter("growth", "", default=TYPICAL, lower=0.5, upper=5.0)
MOST_LATE = 24.0  # frames by which clocks may have run apart
TOUCH_LATE = Parameter("touch_late", "frames", default=1.0, lower=0.0, upper=6.0)
# Of a residual's columns: the flange's x, y, z, and pressure; touch.
ARM, AIR, TOUCH = slice(0, 3), slice(0, 4), slice(4, 5)
START = {"growth": GROWTH.default, "touch_late": TOUCH_LATE.default}
STEP = 1e-3
BEGIN = 4  # frames


class Fitter:
    """Fits models of one twin to episodes.

    Args:
        twin: as it is; what a form does not free stays as it has it.
        episodes: all of them.
        rows: (N,) mask of the frames that are fitted, over all episodes in a row.
    """

    def __init__(self, twin: Twin, episodes: list[EpisodeData], rows: np.ndarray):
        self.twin, self.episodes, self.rows = twin, episodes, rows
        self.known_s = latency_s(twin)
        self.free_bend = FreeBend(twin, self._range)
        self.ends = np.cumsum([0, *map(len, episodes)])
        self.slope = imprint_per_rad(episodes, stiffness_n_per_rad(twin))
        bare = self._run((), {}).markers
        self._bent, tip = bare[:, 3], bare[:, [0, 2]]
        reach = np.ptp(self._bent) or 1.0
        self.mm_per_rad = float(np.linalg.norm(np.ptp(tip, axis=0)) / reach)
        pressure = np.concatenate([e.pressure_kpa for e in episodes])
        self.mm_per_kpa = self.mm_per_rad * reach / max(float(np.ptp(pressure)), 1.0)

    # ---------------------------------------------------------------- parameters

    def free(self, form: Form, columns: slice = TOUCH) -> list[tuple[str, Parameter]]:
        """Names and specifications of what a form fits to these columns."""
        out = [("growth", GROWTH), ("touch_late", TOUCH_LATE)] if columns == TOUCH else []
        pipeline = self._pipeline(form.effects)
        for effect in form.effects:
            if effect == LATE:
                out.append((f"{LATE}.latency_s", LATENCY))
            for name, spec in zip(pipeline.names, pipeline.specs, strict=True):
                if name.rpartition(".")[0] == effect and not spec.fixed:
                    out.append((name, spec))
        return out

    def start(self, effect: str) -> dict[str, float]:
        """Where an effect's parameters begin: as the twin has them, or at their defaults."""
        own = self.twin.effects.get(effect, {})
        range_kpa = self._range
        return {
            name: own[name.rpartition(".")[2]].value
            if name.rpartition(".")[2] in own
            else (self.known_s or LATENCY.default)
            if effect == LATE
            else spec.limits(range_kpa)[0]
            for name, spec in self.free(Form((effect,)), AIR)
            if name.startswith(f"{effect}.")
        }

    @property
    def _range(self) -> float:
        return float(max(np.abs(e.command_kpa).max() for e in self.episodes))

    def _pipeline(self, effects: Sequence[str]) -> Pipeline:
        more = [e for e in effects if e != LATE and e not in self.twin.effects]
        columns = set(inputs_of(self.episodes[:1], 0.0, self.twin).columns)
        names = [*self.twin.effects, *more]
        whole = Pipeline.of(self.twin, None, names)
        return Pipeline(whole.geometry, names, False, columns)

    def _theta(self, effects: Sequence[str], values: Mapping[str, float]) -> tuple[Pipeline, np.ndarray]:
        """A model and its parameters (P,)."""
        pipeline = self._pipeline(effects)
        theta = pipeline.theta(self.twin, self._range)
        for i, name in enumerate(pipeline.names):
            theta[i] = values.get(name, theta[i])
        return pipeline, theta

    def _run(self, effects: Sequence[str], values: Mapping[str, float]):
        pipeline, theta = self._theta(effects, values)
        latency = values.get(f"{LATE}.latency_s", self.known_s)
        return pipeline.run(inputs_of(self.episodes, latency, self.twin), theta)

    def _off_bench(self, effects: Sequence[str], values: Mapping[str, float]) -> np.ndarray:
        """(n,) by how much the free bend differs from the twin's, mm, as much as it counts; none of air's."""
        if all(e == LATE or get_effect(e).of_air for e in effects):
            return np.zeros(0)
        apart = self.free_bend.apart(*self._theta(effects, values))
        return self.mm_per_rad * apart * np.sqrt(LIGHTLY * self.rows.sum() / len(apart))

    # ---------------------------------------------------------------- prediction

    def predict(
        self, form: Form, values: Mapping[str, float], columns: slice = slice(None)
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Residual (N, 5) of all frames, measured - predicted in mm, and the curves behind it, (N,) each.

        Columns that are not asked for may be left 0.
        """
        run = self._run(form.effects, values)
        latency = values.get(f"{LATE}.latency_s", self.known_s) * CONTROL_HZ
        more, residual = run.markers[:, 3] - self._bent, np.zeros((self.ends[-1], 5))
        imprint = np.zeros(self.ends[-1])
        for e, a, b in zip(self.episodes, self.ends, self.ends[1:], strict=False):
            frames = np.arange(len(e))
            path = np.stack([np.interp(frames - latency, frames, c) for c in e.commanded_m.T], 1)
            residual[a:b, :3] = 1e3 * (moved(e.flange_m) - moved(path))
            residual[a:b, 3] = self.mm_per_kpa * (e.pressure_kpa - run.pressure_kpa[a:b, 0])
            if columns in (AIR, ARM):
                continue
            imprint[a:b], _ = touch(e, more[a:b], values["growth"], values["touch_late"])
            residual[a:b, 4] = (
                np.where(e.contact, (e.imprint - imprint[a:b]) / self.slope, 0.0) * self.mm_per_rad
            )
        return residual, {"pressure_kpa": run.pressure_kpa[:, 0], "imprint": imprint}

    def strength(self, model: DemonstrationModel, growth: float) -> Strength:
        """How strong the imprints of all episodes are, where they grow by that power of the force."""
        more = self._run(model.form.effects, model.values).markers[:, 3] - self._bent
        rows = zip(self.episodes, self.ends, self.ends[1:], strict=False)
        gains = [touch(e, more[a:b], growth, model.values["touch_late"])[1] for e, a, b in rows]
        return Strength.of(np.array(gains), growth, self.twin)

    def fit(self, trial: Trial, columns: slice, steps: int = 12) -> DemonstrationModel:
        """A model, by bounded least squares with differences, on the columns `AIR` or `TOUCH`."""
        names, specs = zip(*self.free(trial.form, columns), strict=True)
        known = ("", *trial.form.effects)
        given = {n: v for n, v in trial.values.items() if n.rpartition(".")[0] in known}
        low, high = np.array([_bounds(s, self._range) for s in specs]).T

        def free(v: np.ndarray) -> dict[str, float]:
            found = zip(names, specs, low + v * (high - low), strict=True)
            return given | {n: _value(s, x) for n, s, x in found}

        start = [_inside(s, given[n], self._range) for n, s in zip(names, specs, strict=True)]

        def residual(v: np.ndarray) -> np.ndarray:
            return self.predict(trial.form, free(v), columns)[0][self.rows, columns].ravel()

        def held(v: np.ndarray) -> np.ndarray:
            return np.concatenate([residual(v), self._off_bench(trial.form.effects, free(v))])

        def slopes(v: np.ndarray) -> np.ndarray:  # by steps of the range, not of what may be nearly 0
            steps = np.where(v < 0.5, STEP, -STEP)
            here = held(v)
            return np.stack([held(v + d) - here for d in np.diag(steps)], 1) / steps

        found = least_squares(
            held,
            np.clip(start, 1e-4, 1 - 1e-4),
            slopes,
            bounds=(0, 1),
            x_scale=0.1,
            max_nfev=steps,
            loss="linear",
        )
        size = int(self.rows.sum()) * len(range(5)[columns])
        r = found.fun[:size].reshape(int(self.rows.sum()), -1)
        edge = [n for n, v in zip(names, found.x, strict=True) if v < STEP or v > 1 - STEP]
        J = found.jac[:size].reshape(*r.shape, -1)
        moving = (found.x > STEP) & (found.x < 1 - STEP)
        kept = free(found.x)
        log = frozenset(n for n, s in zip(names, specs, strict=True) if s.log)
        unit = {n: (a, b) for n, a, b, m in zip(names, low, high, moving, strict=True) if m}

        def residual_at(step: np.ndarray) -> np.ndarray:
            there = found.x.copy()
            there[moving] = np.clip(there[moving] + step, 0, 1)
            return residual(there).reshape(r.shape)

        K = found.jac[size:][:, moving]
        bench = (found.fun[size:] @ K, K.T @ K)
        return DemonstrationModel(trial.form, kept, r, J[:, :, moving], edge, unit, log, residual_at, bench)

    def base(self, columns: slice) -> DemonstrationModel:
        """The twin as it is."""
        if columns == AIR:
            r = self.predict(Form(), START, AIR)[0][self.rows, AIR]
            return DemonstrationModel(Form(), dict(START), r, np.zeros((*r.shape, 0)), [], {})
        return self.fit(Trial(Form(), dict(START)), TOUCH, 20)

    def lateness(self, kept: list[np.ndarray]) -> float:
        """By how many frames touch is shown late in some frames of the episodes, (T,) masks each.

        How imprints grow is not fitted: where clocks part, that bends to make up for it.
        """
        episodes = [replace(e, contact=m) for e, m in zip(self.episodes, kept, strict=True)]
        part = Fitter(self.twin, episodes, np.concatenate(kept))
        tried = np.arange(0.0, MOST_LATE, 0.25)
        errors = []
        for late in tried:
            r = part.predict(Form(), START | {"touch_late": float(late)}, TOUCH)[0][part.rows, TOUCH]
            errors.append(float(np.abs(r).sum()))  # by squares the few frames of chatter would decide
        best = tried[int(np.argmin(errors))]
        near = np.abs(tried - best) <= 1.0  # between frames errors are a little jagged: a parabola is not
        curve, slope, _ = np.polyfit(tried[near] - best, np.array(errors)[near], 2)
        return float(np.clip(best - slope / (2 * curve), 0.0, MOST_LATE)) if curve > 0 else float(best)

    def twin_with(self, model: DemonstrationModel, ci95: Mapping[str, tuple[float, float]]) -> Twin:
        """The twin with a model's effects and their intervals."""
        twin, fitted = self.twin.copy(), {}
        pipeline = self._pipeline(model.form.effects)
        theta = pipeline.theta(twin, self._range)
        for name, value in zip(pipeline.names, theta, strict=True):
            effect, _, parameter = name.rpartition(".")
            if effect in model.form.effects:
                found = model.values[name] if name in model.values else float(value)
                fitted.setdefault(effect, {})[parameter] = Value(found, ci95.get(name))
        twin.effects = twin.effects | fitted
        if LATE in model.form.effects:
            known = model.values[f"{LATE}.latency_s"]
            twin.parameters = twin.parameters | {
                "command_latency_s": Value(known, ci95.get(f"{LATE}.latency_s"))
            }
        return replace(twin)


def latency_s(twin: Twin) -> float:
    """By which the twin's commands act late."""
    known = twin.parameters.get("command_latency_s")
    return known.value if known else 0.0


def moved(path: np.ndarray) -> np.ndarray:
    """A path (T, 3) from where it begins, the mean of its first frames."""
    return path - path[:BEGIN].mean(0)


def _bounds(spec: Parameter, range_kpa: float) -> tuple[float, float]:
    _, low, high = spec.limits(range_kpa)
    return (np.log(low), np.log(high)) if spec.log else (low, high)


def _value(spec: Parameter, x: float) -> float:
    return float(np.exp(x)) if spec.log else float(x)


def _inside(spec: Parameter, value: float, range_kpa: float) -> float:
    low, high = _bounds(spec, range_kpa)
    return ((np.log(max(value, 1e-12)) if spec.log else value) - low) / (high - low)
