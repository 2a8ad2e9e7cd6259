"""The finger pipeline: pressure command -> pneumatics -> drive -> load -> material -> observation.

One model for `finger` (N joints in a plane), `arm` (three chambers, two bending axes) and any single bending
segment, used by calibration, comparison, diagnosis, and step by step in the environment.

    from pneutac_sim.finger import BodyData, Pipeline, PressurePipeline, fit, simulate

    simulate(twin, recording)                 # -> Prediction: model, measured, residual (n, D), unit, error
    data = BodyData.of(recording, twin)       # prepares a recording once for many fits and simulations
    f = fit(twin, data, effects=["creep"], train=mask)     # refits everything; f.twin is the new twin
    model = Pipeline.of(twin, data.inputs, effects=[...])  # parameters `model.names`, e.g. creep.weight_4s
    run = model.run(data.inputs, theta)      # theta (P,); run.markers (n, 5), run.joints, run.pressure_kpa
    model.run(data.inputs, theta2, reuse=run)    # repeats only what follows the first changed parameter
    online = PressurePipeline(twin)
    online.step(pressure_cmd_kpa, dt_s)       # -> joint targets (N,), one control step; place, read: the tip

Time: samples may be spaced unevenly. Trials are separate: at its first sample a trial is taken to have
rested at that pressure for ever (or vented, see `Inputs`). What the material remembers for good is carried
from trial to trial in the order of the table: largest strain and cycles (cyclic_softening), plays
(hysteresis), where dry friction left the joint. Pressure is taken as a straight line between samples.

Where the measured pressure is the input, pneumatics are skipped except for the sensor's error. The body is
quasi-static: loads (gravity, payload) find their equilibrium with the elastic spine first, then temperature,
softening and creep act on the whole bend, so a payload creeps like a pressure does. The curl at rest,
G r_n p0, is the shape without stress and stays as it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pneutac_sim.effects.effect import Parameter
from pneutac_sim.effects.registry import get_effect, in_order, of_body
from pneutac_sim.errors import InputError, unknown_names
from pneutac_sim.finger.equilibrium import SoftBody
from pneutac_sim.finger.inputs import Inputs
from pneutac_sim.finger.stages import (
    FORCES,
    BodyLink,
    Drive,
    EffectLink,
    Geometry,
    LoadLink,
    Markers,
    base_parameters,
)
from pneutac_sim.twin import Twin, Value

BENDING_PRESSURE = "bending_pressure_kpa"


@dataclass(frozen=True)
class Run:
    """One simulation."""

    theta: np.ndarray  # (P,) its parameters
    signals: list[np.ndarray]  # what enters each link of the chain, and what leaves the last
    pressure_kpa: np.ndarray  # (n, chambers) in the chambers, as their sensor reads it
    joints: np.ndarray  # (n, N) or (n, 2 N) joint angles, rad
    markers: np.ndarray  # (n, 5) tip x, y, z in mm, bend towards +z and towards +y in rad


class Pipeline:
    """The model of one device with some effects switched on.

    Args:
        geometry: the device.
        effects: names, in any order; they act in the library's order.
        measured: True where the input will be the measured pressure.
        columns: condition columns that the input has; None for all. Effects without theirs are left out.
        body: the soft body round a finger's spine, so that its modulus can be separated from the joints'
            total stiffness by loaded poses; None where springs of the whole stiffness will do.

    Attributes:
        names: (P,) parameter names, base parameters first, then `effect.parameter`.
        specs: (P,) what each may be.
        left_out: effects that cannot act in full on this input, and why.
        chain: the links, in order.
        reads_pressure: index of the link that the sensed pressure enters.
        reads_joints: index of the link that the joint angles enter.
        observes: index of the link that the tip's true place enters.
        asks_pressure: whether an effect needs the pressure that bends the body.
        thins_at: index of the link from which on nothing is remembered, so that samples alone matter.
    """

    def __init__(
        self,
        geometry: Geometry,
        effects: Sequence[str] = (),
        measured: bool = False,
        columns: set[str] | None = None,
        body: SoftBody | None = None,
    ):
        self.geometry = geometry
        self.effects = in_order(of_body(effects))
        self.asks_pressure = any(BENDING_PRESSURE in e.columns for e in self.effects)
        self.specs: list[Parameter] = list(base_parameters(geometry, body is not None))
        self.names: list[str] = [p.name for p in self.specs]
        stiffness = self.names.index("joint_stiffness_nm_per_rad")
        self.left_out: dict[str, str] = {}
        places = "pneumatics", "drive", "loads", "joints", "markers", "mount", "observation"
        links: dict[str, list[EffectLink]] = {place: [] for place in places}
        for e in self.effects:
            at = len(self.names)
            self.names += [f"{e.name}.{p.name}" for p in e.parameters]
            self.specs += e.parameters
            missing = [c for c in e.columns if columns is not None and c not in (*columns, BENDING_PRESSURE)]
            as_at = e.at_reference and missing == ["temperature_c"]
            if missing:
                self.left_out[e.name] = f"the recording has no column {', '.join(missing)}"
            if missing and not as_at:
                continue
            if e.several and geometry.chambers == 1:
                self.left_out[e.name] = "the device has one chamber"
            elif measured and e.of_air:
                self.left_out[e.name] = "the measured pressure is the input"
            else:
                by_signal = e.stage in ("load", "material") or e.signal == "mount"
                link = EffectLink(e, tuple(range(at, len(self.names))))
                links[e.signal if by_signal else e.stage].append(link)
        drive = Drive(geometry, tuple(range(stiffness)))
        measured_force = columns is not None and set(FORCES) <= columns
        load = LoadLink(geometry, tuple(links["loads"]), stiffness, measured_force, body)
        loads = [load] if links["loads"] or measured_force else []
        body = [BodyLink(e.effect, e.indices, drive) for e in links["joints"]]
        to_joints = [*links["pneumatics"], *links["drive"], drive]
        to_markers = [*to_joints, *loads, *body, Markers(geometry)]
        to_tip = [*to_markers, *links["markers"], *links["mount"]]
        self.chain = [*to_tip, *links["observation"]]
        gauge = [i for i, e in enumerate(links["pneumatics"]) if e.effect.of_gauge]
        self.reads_pressure = gauge[0] if gauge else len(links["pneumatics"])
        self.reads_joints = len(to_markers) - 1
        self.observes = len(to_tip)
        self.drive = len(to_joints) - 1
        self.thins_at = max([self.drive, *(i + 1 for i, e in enumerate(self.chain) if e.remembers)])

    @classmethod
    def of(
        cls,
        twin: Twin,
        inputs: Inputs | None = None,
        effects: Sequence[str] | None = None,
        body: SoftBody | None = None,
    ) -> "Pipeline":
        """The pipeline of a twin, for given inputs, with its own effects or these instead."""
        geometry = Geometry(twin.device, twin.length_mm, tuple(twin.spine_joint_positions_mm))
        names = list(twin.effects) if effects is None else list(effects)
        if inputs is None:
            return cls(geometry, names, body=body)
        return cls(geometry, names, inputs.measured, set(inputs.columns), body)

    # ---------------------------------------------------------------- parameters

    def theta(self, twin: Twin, pressure_range_kpa: float = 1.0) -> np.ndarray:
        """(P,) values in the twin; what it lacks has its defaults for this largest pressure.

        Raises InputError where an effect has a parameter too many.
        """
        for name, values in twin.effects.items():
            known = [p.name for p in get_effect(name).parameters]
            for fault in unknown_names(values, known, "parameter"):
                raise InputError(f"The twin's effect '{name}': {fault}")
        out = np.empty(len(self.names))
        for i, (name, spec) in enumerate(zip(self.names, self.specs, strict=True)):
            effect, _, parameter = name.rpartition(".")
            values = twin.effects.get(effect, {}) if effect else twin.parameters
            out[i] = values[parameter].value if parameter in values else spec.limits(pressure_range_kpa)[0]
        return out

    def neutral(self, theta: np.ndarray, effects: Sequence[str]) -> np.ndarray:
        """A copy of `theta` (P,) in which these effects do nothing."""
        out = theta.copy()
        for i, (name, spec) in enumerate(zip(self.names, self.specs, strict=True)):
            if name.partition(".")[0] in effects:
                out[i] = spec.neutral
        return out

    def update(
        self, twin: Twin, theta: np.ndarray, ci95: dict[str, tuple[float, float]] | None = None
    ) -> Twin:
        """A copy of the twin with these parameters and exactly this pipeline's effects."""
        new = twin.copy()
        new.effects = {k: v for k, v in new.effects.items() if k not in of_body(new.effects)}
        for name, value, spec in zip(self.names, theta, self.specs, strict=True):
            effect, _, parameter = name.rpartition(".")
            values = new.effects.setdefault(effect, {}) if effect else new.parameters
            if not effect and spec.fixed and value == spec.neutral and name not in values:
                continue  # a part of the base model that this twin does without
            values[parameter] = Value(float(value), (ci95 or {}).get(name))
        return new

    # ---------------------------------------------------------------- simulation

    def run(
        self,
        inputs: Inputs,
        theta: np.ndarray,
        reuse: Run | None = None,
        bending_pressure_kpa: np.ndarray | None = None,
        until: int | None = None,
    ) -> Run:
        """Simulates all samples.

        Args:
            inputs: made for the same device, source and columns as this pipeline.
            theta: (P,) parameters.
            reuse: an earlier run on the same inputs; what comes before the first changed parameter is not
                repeated.
            bending_pressure_kpa: (m, chambers) bends the body instead of what air and drive would make of the
                command; needs `reuse` with these parameters.
            until: number of links to run, see `until`; what comes behind them is left empty.
        """
        theta = np.asarray(theta, dtype=float)
        at, signals = 0, [inputs.pressure_kpa]
        if reuse is not None:
            changed = set(np.flatnonzero(theta != reuse.theta).tolist())
            while at < len(self.chain) and not changed.intersection(self.chain[at].indices):
                at += 1
            signals = reuse.signals[: at + 1]
        if bending_pressure_kpa is not None:
            at, signals = self.drive, [*signals[: self.drive], bending_pressure_kpa]
        computed: dict[bool, dict[str, np.ndarray]] = {}
        for i in range(at, len(self.chain) if until is None else until):
            link, x = self.chain[i], signals[-1]
            thin = i >= self.thins_at
            if i == self.thins_at:
                x = x[inputs.rows]
            if i > self.drive and thin not in computed:
                computed[thin] = self.computed(signals, inputs, thin)
            state = np.zeros(link.state_size(x.shape[1]))
            dt = inputs.sample_dt_s if thin else inputs.dt_s
            signals.append(link(x, dt, theta, inputs.conditions_with(computed.get(thin, {}), thin), state))

        def at_samples(i: int) -> np.ndarray:
            if i >= len(signals):
                return np.zeros((0, 0))
            return signals[i] if i > self.thins_at else signals[i][inputs.rows]

        seen = (at_samples(i) for i in (self.reads_pressure, self.reads_joints, len(self.chain)))
        return Run(theta, signals, *seen)

    def computed(self, signals: list[np.ndarray], inputs: Inputs, at_samples: bool) -> dict[str, np.ndarray]:
        """Condition columns (m,) or (n,) that follow from the signals: the bending pressure, where asked."""
        if not self.asks_pressure:
            return {}
        pressure = signals[self.drive]
        return {BENDING_PRESSURE: (pressure[inputs.rows] if at_samples else pressure).mean(axis=1)}

    def until(self, columns: Sequence[str]) -> int:
        """Number of links that these outputs need."""
        air = all(c.startswith("pressure_") for c in columns)
        return self.reads_pressure if air else len(self.chain)

    def outputs(self, run: Run, columns: Sequence[str]) -> np.ndarray:
        """(n, len(columns)) model values of columns of a bench recording.

        An arm's `curvature_x` is its bend towards +z over its length, `curvature_y` towards +y.
        """
        values = [self._output(run, c) for c in columns]
        out = np.empty((len(values[0]), len(values)))  # several times as fast as np.stack
        for i, v in enumerate(values):
            out[:, i] = v
        return out

    def _output(self, run: Run, column: str) -> np.ndarray:
        tips = ("tip_x_mm", "tip_y_mm", "tip_z_mm")
        if column in tips:
            return run.markers[:, tips.index(column)]
        if column == "bend_angle_rad":
            to_z, to_y = run.markers[:, 3], run.markers[:, 4]
            return to_z if self.geometry.axes == 1 else np.hypot(to_z, to_y)
        if column in ("curvature_x_1_per_m", "curvature_y_1_per_m"):
            return run.markers[:, 3 + (column[10] == "y")] / (1e-3 * self.geometry.length_mm)
        kind, _, rest = column.partition("_")
        number = rest.partition("_")[0]
        if kind == "q" and number.isdigit() and 1 <= int(number) <= self.geometry.n_joints:
            return run.joints[:, (int(number) - 1) * self.geometry.axes]
        if column == "pressure_kpa" and self.geometry.chambers == 1:
            return run.pressure_kpa[:, 0]
        if kind == "pressure" and number.isdigit() and 1 <= int(number) <= self.geometry.chambers:
            return run.pressure_kpa[:, int(number) - 1]
        raise InputError(f"The model of a {self.geometry.device} has no output '{column}'.")
