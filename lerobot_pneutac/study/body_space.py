"""What a search may try on a body: bases and actuation models, terms to add, and how trials begin."""

from dataclasses import replace
from itertools import combinations

import numpy as np

from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.diagnosis.result import CURVE_LIKE
from lerobot_pneutac.diagnosis.search import Space, Start
from lerobot_pneutac.study.body_model import BodyFitter, BodyModel, BodyStructure, InputModel
from pneutac_sim.effects.laws import is_law, starts
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.finger.instants import RESTED_S, StepProblem, by_row, goes_on, pauses, step_rows
from pneutac_sim.least_squares import minimise

ACTUATIONS = (
    (),
    ("dead_time",),
    ("valve_lag",),
    ("dead_time", "valve_lag"),
    ("dead_time", "air_resonance"),
    ("dead_time", "valve_lag", "air_resonance"),
    ("dead_time", "orifice_flow"),
    ("dead_time", "valve_slew"),
)
AIR_STEPS = 20  # most Jacobians of the air by the rows after steps; it takes two to eight
QUICKER = ("s", "rad/s", "1/s", "kPa/s")  # units of times and rates, each of which does nothing at one bound
PAUSES_S = (0.0, 2.0, 4.0, 6.0, 9.0, 15.0, 30.0, 100.0)


class BodySpace(Space):
    """Everything that a search asks of a body.

    Args:
        fitter: of the recording.
        base: effects that every model has.
        joints: numbers of joints to try.
        candidates: names of effects and laws that may be added.
        actuations: alternatives for the air; only () where the measured pressure drives the body.
        input_model: to begin with.
        gauged: parameters of the air found from the gauge, by name.
        gauged_switch: instants of the command's steps found from the gauge, see `InputModel.switch`.
    """

    def __init__(
        self,
        fitter: BodyFitter,
        base,
        joints,
        candidates,
        actuations,
        input_model: InputModel,
        gauged=None,
        gauged_switch=None,
    ):
        self.gauged, self._gauged_switch, self.required = gauged or {}, gauged_switch, tuple(base)
        self.trials: tuple[float, ...] = ()
        self.fitter, self.base, self.joints = fitter, tuple(base), tuple(joints)
        self.candidates, self.actuations, self.input_model = list(candidates), actuations, input_model
        data = fitter.data(input_model)
        self._steps = step_rows(fitter.recording) if input_model.source == "command" else []
        first = data.inputs.rows[np.isinf(data.inputs.sample_dt_s)]
        begins = np.abs(data.inputs.pressure_kpa[first])
        self._begins_under_pressure = bool(begins.max() > T.UNDER_PRESSURE * data.inputs.pressure_range_kpa)
        self.range_kpa = data.inputs.pressure_range_kpa

    # ---------------------------------------------------------------- to begin with

    def bases(self) -> list[Start]:
        out = []
        for n in self.joints:
            structure = BodyStructure(self.base, self.input_model, n, trials=self.trials)
            out.append((structure, {}))
            if self.input_model.target == "pose":
                out.append((structure, self.fitter.rough(structure)))
        return out

    def bare_starts(self, model: BodyModel) -> list[Start]:
        """Without mount and stretch, which bend a curve of the pressure nearly as its own term does."""
        structure = model.structure.without(*CURVE_LIKE)
        if structure == model.structure or self.trials:
            return []
        return [(structure, model.values)]

    def with_actuations(self, model: BodyModel, starts: bool) -> list[Start]:
        of_actuations, out = {e for actuation in self.actuations for e in actuation}, []
        rest = tuple(e for e in model.structure.effects if e not in of_actuations)
        begins = (model.structure.input_model.start,)
        if starts:
            begins += ("held", *(("vented",) if self._begins_under_pressure else ()))
        for begin in dict.fromkeys(begins):
            for actuation in self.actuations:
                input_model = replace(model.structure.input_model, start=begin)
                if actuation and len(self._steps):
                    input_model = replace(input_model, switch=0.5)
                structure = replace(model.structure, effects=(*actuation, *rest), input_model=input_model)
                out += [(structure, model.values | start) for start in _actuation_starts(actuation)]
                gauged = {k: v for k, v in self.gauged.items() if k.rpartition(".")[0] in actuation}
                if gauged:  # at the instants at which it was found: the same lag at others is another
                    input_model = replace(input_model, switch=self._gauged_switch)
                    out.append((replace(structure, input_model=input_model), model.values | gauged))
        return out

    # ---------------------------------------------------------------- growing

    def grow(self, model: BodyModel, most: int, pairs: int) -> list[Start]:
        atoms, columns, groups = self._columns(model)
        if not atoms:
            return []
        Q = np.linalg.qr(model.jacobian / (np.linalg.norm(model.jacobian, axis=0) + 1e-12))[0]
        r = -model.residual.ravel()
        r = r - Q @ (Q.T @ r)
        N = columns - Q @ (Q.T @ columns)
        size0, size = (columns**2).sum(0) + 1e-300, (N**2).sum(0)
        ok = size > 1e-5 * size0
        dot = N.T @ r
        gain = np.zeros(len(atoms))
        for a, cols in enumerate(groups):
            cols = [c for c in cols if ok[c]]
            if len(cols) == 1:
                gain[a] = dot[cols[0]] ** 2 / size[cols[0]]
            elif cols:
                G = N[:, cols].T @ N[:, cols]
                gain[a] = dot[cols] @ np.linalg.lstsq(G, dot[cols], rcond=1e-6)[0]
        order = [a for a in np.argsort(-gain) if gain[a] > 0]
        weight, out, seen = dot / np.maximum(size, 1e-300), [], {}
        for a in order:
            name = atoms[a][0]
            if seen.get(name, 0) >= (2 if is_law(name) else 1):
                continue
            seen[name] = seen.get(name, 0) + 1
            out.append(self._added(model, [atoms[a]], [weight[groups[a][0]]]))
            if len(out) >= most:
                break
        if pairs:
            top = [a for a in order[:60] if len(groups[a]) == 1 and ok[groups[a][0]]][:36]
            index = [groups[a][0] for a in top]
            G, p, found = N[:, index].T @ N[:, index], dot[index], []
            for x, y in combinations(range(len(top)), 2):
                det = G[x, x] * G[y, y] - G[x, y] ** 2
                if atoms[top[x]][0] == atoms[top[y]][0] or det < T.COLLINEAR * G[x, x] * G[y, y]:
                    continue
                both = (G[y, y] * p[x] ** 2 - 2 * G[x, y] * p[x] * p[y] + G[x, x] * p[y] ** 2) / det
                c = ((G[y, y] * p[x] - G[x, y] * p[y]) / det, (G[x, x] * p[y] - G[x, y] * p[x]) / det)
                found.append((both, [atoms[top[x]], atoms[top[y]]], c))
            for _, pair, c in sorted(found, key=lambda f: -f[0])[:pairs]:
                out.append(self._added(model, pair, c))
        return out

    def _added(self, model: BodyModel, atoms, weights) -> Start:
        structure, values = model.structure, model.values
        for (name, start), weight in zip(atoms, weights, strict=True):
            structure = structure.plus(name)
            new = structure.effects[-1]
            values = values | {f"{new}.{n}": v for n, v in start.items()}
            if is_law(name) and "weight" in {p.name for p in get_effect(name).parameters}:
                values[f"{new}.weight"] = float(np.clip(weight, -1.0, 1.0))
        return (structure, values)

    def _columns(self, model: BodyModel):
        """Atoms as (name, start values), their columns (N D, C), and which columns are each atom's."""
        f, structure = self.fitter, model.structure
        data = f.data(structure.input_model)
        thin = data.thin(f.rows)
        pipe, theta = model.pipeline, model.theta
        run = pipe.run(thin.inputs, theta)
        base = self._values(pipe, run, data)
        u = run.signals[pipe.drive]
        eps, bent = 1e-4 * self.range_kpa, []
        for c in range(u.shape[1]):
            moved = u.copy()
            moved[:, c] += eps
            bent.append((self._values(pipe, pipe.run(thin.inputs, theta, run, moved), data) - base) / eps)
        atoms, columns, groups = [], [], []
        for name in (*self.candidates, *(e for e in CURVE_LIKE if e in self.base)):
            effect = get_effect(name)
            if name in structure.effects and not is_law(name):
                continue
            if is_law(name) and effect.stage == "drive":
                if data.unit == "kPa":
                    continue
                for start in starts(name):
                    values = self._start_values(effect, start)
                    changed = self._act(effect, u, data, values | {"weight": 1.0}) - u
                    g = changed[thin.inputs.rows]
                    column = np.sum([b * g[:, c : c + 1] for c, b in enumerate(bent)], axis=0)
                    atoms.append((name, values))
                    groups.append([len(columns)])
                    columns.append(column.ravel())
                continue
            new = self._by_running(name, model, thin, base)
            if new:
                atoms.append((name, {}))
                groups.append(list(range(len(columns), len(columns) + len(new))))
                columns += new
        return atoms, np.stack(columns, 1) if columns else np.zeros((base.size, 0)), groups

    def _by_running(self, name: str, model: BodyModel, thin, base: np.ndarray) -> list[np.ndarray]:
        """Columns of an effect: what it does at its start, and what moving each of its parameters does."""
        f = self.fitter
        structure = model.structure.plus(name)
        pipe = f.pipeline(structure)
        if name in pipe.left_out:
            return []
        theta = f.start(structure, pipe, model.values)
        run = pipe.run(thin.inputs, theta)
        at = self._values(pipe, run, thin)
        if not np.isfinite(at).all():
            return []
        out = [at - base] if np.abs(at - base).max() > 1e-9 else []
        for i, (n, spec) in enumerate(zip(pipe.names, pipe.specs, strict=True)):
            if n.rpartition(".")[0] != structure.effects[-1] or spec.fixed:
                continue
            _, low, high = spec.limits(self.range_kpa)
            moved = theta.copy()
            step = 0.02 * moved[i] if spec.log else 0.002 * (high - low)
            moved[i] += step if moved[i] + step <= high else -step
            change = self._values(pipe, pipe.run(thin.inputs, moved, run), thin) - at
            if not np.isfinite(change).all() or np.abs(change).max() < 1e-9:
                continue
            change /= np.abs(change).max()
            if not any(_parallel(change, c) for c in out):  # of a weight alone: one column, fit for pairs
                out.append(change)
        return [c.ravel() for c in out]

    def _values(self, pipe, run, data) -> np.ndarray:
        return pipe.outputs(run, data.columns) * data.scale

    def _start_values(self, effect, start: tuple[float, ...]) -> dict[str, float]:
        constants = [p for p in effect.parameters if p.name not in ("weight", "scale_kpa")]
        return {p.name: s * self.range_kpa**p.range_power for p, s in zip(constants, start, strict=True)}

    def _act(self, effect, u, data, values) -> np.ndarray:
        out = np.array(u)
        theta = [values.get(p.name, p.limits(self.range_kpa)[0]) for p in effect.parameters]
        state = np.zeros(effect.state_size(out.shape[1]))
        conditions = data.inputs.conditions(effect.columns)
        effect.run(out, data.inputs.dt_s, np.array(theta), conditions, state)
        return out

    # ---------------------------------------------------------------- fitting

    def fit(self, start: Start, steps: int, every: int = 1) -> BodyModel | None:
        """A fitted model; None where it does not come to a finite error."""
        try:
            model = self.fitter.fit(*start, steps, every)
        except np.linalg.LinAlgError:
            return None
        if every > 1:
            model = self.fitter.fit(model.structure, model.values, 0)
        return model if np.isfinite(model.residual).all() and np.isfinite(model.jacobian).all() else None

    def trial(
        self, structure: BodyStructure, values: dict[str, float], name: str, start: tuple[float, ...]
    ) -> Start:
        """A structure whose last effect starts with these constants, see `laws.starts`."""
        effect = get_effect(name)
        begin = self._start_values(effect, start) if start else {}
        return (structure, values | {f"{structure.effects[-1]}.{k}": v for k, v in begin.items()})

    def refine_actuation(self, model: BodyModel) -> BodyModel:
        """Finds the instants of steps, then fits well."""
        if model.structure.input_model.target == "pressure":
            return self.refine_air(self.with_instants(model, 1))
        for _ in range(5):
            before = (model.residual**2).mean()
            moved = self.with_instants(model, 2)
            model = self.fitter.fit(moved.structure, moved.values, 0)  # judged on all rows of the search
            if (model.residual**2).mean() > T.INSTANTS_AGAIN * before:
                break
        return self.fitter.fit(model.structure, model.values, 8)

    def refine_air(self, model: BodyModel) -> BodyModel:
        """Fits the air by the samples just after the command's steps, each step at the instant that suits it.

        Instants, lags and dead times are nearly interchangeable: least squares in turns with the instants
        stops early.
        """
        air = [
            j for j, i in enumerate(model.free)
            if (e := model.pipeline.names[i].rpartition(".")[0]) and get_effect(e).stage == "pneumatics"
        ]  # fmt: skip
        if not air or not len(self._steps):
            return model
        index, first = model.free[air], model.v[air]
        steps = self.fitter.steps(model.structure.input_model)
        problem = StepProblem(steps, model.pipeline, model.theta, model.bounds, index)
        none = np.where([model.pipeline.specs[i].jump > 0 for i in index], 0.0, first)  # without a dead time
        found = [
            minimise(problem.residual, problem.jacobian, v, AIR_STEPS, 1e-4)
            for v in ([first, none] if (none != first).any() else [first])
        ]
        best = min(found, key=lambda s: s.cost)
        values = replace(model, theta=problem.theta(best.v)).values
        moved = self.with_instants(self.fitter.fit(model.structure, values, 0), 1)
        return self.fitter.fit(moved.structure, moved.values, 8)

    def refine(self, model: BodyModel) -> BodyModel:
        """Tries how trials may begin, each after a pause of its own too, then the instants of steps."""
        best, now = model, float((model.residual**2).mean())
        if any(e.remembers for e in model.pipeline.chain):
            input_model = model.structure.input_model
            own = self.fit(
                (model.structure, model.values), 3, 2
            )  # else what three more steps gain is a start's
            if own is not None and (own.residual**2).mean() < now:
                best, now = own, float((own.residual**2).mean())
            common = PAUSES_S if self.fitter.trial.max() else ()  # before a single run there is none
            for start in ("held", "vented", *common):
                if start == input_model.start:
                    continue
                structure = replace(model.structure, input_model=replace(input_model, start=start))
                tried = self.fit((structure, best.values), 3, 2)
                if tried is not None and (tried.residual**2).mean() < T.BETTER_START * now:
                    best, now = tried, float((tried.residual**2).mean())
        best = self.with_instants(self.with_pauses(best), 1)
        return self.fitter.fit(best.structure, best.values, 8)

    def begun(self, model: BodyModel) -> BodyModel:
        """The model with a pause before each trial, where that matters and is better."""
        input_model = model.structure.input_model
        if not goes_on(model.pipeline):
            return model
        if input_model.start == "held":
            structure = replace(model.structure, input_model=replace(input_model, start=PAUSES_S[4]))
            tried = self.with_pauses(self.fitter.fit(structure, model.values, 0))
        else:
            tried = self.with_pauses(model)
        return tried if (tried.residual**2).mean() < T.BETTER_START * (model.residual**2).mean() else model

    def with_pauses(self, model: BodyModel) -> BodyModel:
        """The model with the pause before each trial that suits it, re-fitted, where that is better."""
        start = model.structure.input_model.start
        if start == "held":
            return model
        for _ in range(3):  # pauses and constants move each other
            input_model = replace(model.structure.input_model, start=RESTED_S if start == "vented" else start)
            data, f = self.fitter.data(input_model), self.fitter
            own = pauses(f.recording, data, f.rows, model.pipeline, model.theta)
            if own is None:
                return model
            structure = replace(model.structure, input_model=replace(input_model, start=own))
            moved = f.fit(structure, model.values, 6)
            if (moved.residual**2).mean() > T.BETTER_START * (model.residual**2).mean():
                return model
            model, start = moved, own
        return model

    def removable(self, model: BodyModel) -> list[str]:
        return [e for e in model.structure.effects if e not in self.required]

    def without(self, model: BodyModel, *effects: str) -> BodyModel:
        """The model re-fitted without effects; without one of the air, steps seem to come otherwise."""
        left = self.bare(model, *effects)
        of_air = any(get_effect(e).stage == "pneumatics" for e in effects)
        return self.refine_actuation(left) if of_air else left

    def bare(self, model: BodyModel, *effects: str) -> BodyModel:
        """The model re-fitted without effects, at the same instants; a second instance becomes the first."""
        old = model.structure.without(*effects)
        new = replace(old, effects=()).plus(*(e.partition(" #")[0] for e in old.effects))
        values = dict(model.values)
        for before, after in zip(old.effects, new.effects, strict=True):
            of = {k: v for k, v in model.values.items() if k.rpartition(".")[0] == before}
            values |= {f"{after}.{k.rpartition('.')[2]}": v for k, v in of.items()}
        return self.fitter.fit(new, values, 8)

    def idle(self, model: BodyModel, effect: str) -> bool:
        """Whether an effect ended where it does nothing: it moves no prediction or is too quick to show."""
        pipe, data = model.pipeline, self.fitter.data(model.structure.input_model).thin(self.fitter.rows)
        off = []
        for i, v in zip(model.free, model.v, strict=True):
            spec = pipe.specs[i]
            if pipe.names[i].rpartition(".")[0] == effect and spec.unit in QUICKER:
                off.append(v > 1 - T.AT_BOUND if spec.neutral > model.bounds.upper[i] else v < T.AT_BOUND)
        if off and all(off):
            return True
        bare = self.fitter.pipeline(model.structure.without(effect))
        theta = np.array([model.values[n] for n in bare.names])
        seen, without = (
            self._values(p, p.run(data.inputs, x), data) for p, x in ((pipe, model.theta), (bare, theta))
        )
        moved = (seen - without)[:, : model.counted]
        return bool(
            (moved**2).mean() < T.IDLE_OF_RESIDUAL**2 * (model.residual[:, : model.counted] ** 2).mean()
        )

    # ---------------------------------------------------------------- how it was recorded

    def with_instants(self, model: BodyModel, every: int) -> BodyModel:
        """The model with the instant of each step of the command, within its sample, re-fitted once."""
        input_model, recording = model.structure.input_model, self.fitter.recording
        if input_model.switch is None or not len(self._steps):
            return model
        steps = self.fitter.steps(input_model)
        if not steps.unknown.any():
            return model
        share = by_row(recording, steps, model.pipeline, model.theta)
        structure = replace(model.structure, input_model=replace(input_model, switch=tuple(share)))
        return self.fitter.fit(structure, model.values, 6, every)


def _actuation_starts(actuation: tuple[str, ...]) -> list[dict[str, float]]:
    """Starting values of an actuation model: quick and slow, and several tones where it may ring."""
    out = []
    for delay, fill, vent in ((0.03, 0.05, 0.05), (0.03, 0.5, 0.7), (0.3, 0.1, 0.1)):
        lag = {"dead_time.delay_s": delay, "valve_lag.fill_time_s": fill, "valve_lag.vent_time_s": vent}
        out.append(
            lag | {"orifice_flow.fill_rate_1_per_s": 0.2 / fill, "orifice_flow.vent_rate_1_per_s": 0.2 / vent}
        )
    if "air_resonance" in actuation:
        tones = [(w, z) for w in (5.0, 11.0, 24.0, 48.0) for z in (0.1, 0.4)]
        name = "air_resonance"
        out = [out[0] | {f"{name}.frequency_rad_per_s": w, f"{name}.damping_ratio": z} for w, z in tones]
    return out[: 1 if not actuation else None]


def _parallel(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether one of two columns, of any shape, is a multiple of the other."""
    aa, bb, ab = (float((x * y).sum()) for x, y in ((a, a), (b, b), (a, b)))
    return ab**2 > (1 - 1e-6) * aa * bb
