"""Compares a twin with a recording of a finger or an arm: errors, where they are large, worst passages.

Within what a measurement should lie if the twin is right: prediction bands of a body's comparison.

To first order a sample's prediction varies by g C g^T, g its gradient to the parameters and C their
covariance (Seber and Wild, Nonlinear Regression, Wiley 1989, ch. 5.1); the measurement adds its noise. A twin
keeps the interval of each parameter but not how they go together: a bend that is a little too large may be
put down to gain or to rest pressure. So C has the form that least squares gives it on the recording's train
samples, and the size from the twin's intervals.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from lerobot_pneutac.diagnosis.bootstrap import deal
from lerobot_pneutac.diagnosis.design import read
from lerobot_pneutac.diagnosis.thresholds import NOISE
from lerobot_pneutac.reports.figures import worst_passages
from lerobot_pneutac.reports.page import Report
from lerobot_pneutac.study.pair import enough_to_compare
from lerobot_pneutac.verbs.result import Comparison, rms_of
from pneutac_datasets.recording.axes import Axis, axes
from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.mounts import align_mounts
from pneutac_datasets.recording.noise import NoiseFloor, noise_floor
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import plural
from pneutac_sim.effects.body_effect import REFERENCE_C
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError, option
from pneutac_sim.executor import Progress, no_progress
from pneutac_sim.finger import BodyData, Pipeline, simulate
from pneutac_sim.finger.instants import pauses_read
from pneutac_sim.finger.quantities import root_mean, squared_distance
from pneutac_sim.least_squares import Z95, independent
from pneutac_sim.twin import Twin

FEW_ROWS = 50  # below this no place where the error is large says anything
STEP = 0.05  # of a standard deviation: how far a parameter is moved to see what it does


@dataclass(frozen=True)
class Band:
    """95 % prediction bands of the columns that count."""

    half: np.ndarray  # (n, k) half width, in the unit of each column
    how: str  # what they are made from, in words


def prediction_band(twin: Twin, bench: BodyData, train: np.ndarray, noise: NoiseFloor) -> Band | None:
    """Bands from the intervals of a twin's parameters and the noise; None where these are unknown."""
    if noise.value is None:
        return None
    sensor = np.array([noise.by_column.get(c, 0.0) for c in bench.columns[: bench.counted]])
    moved = _moved(twin, bench)
    if moved.shape[-1] == 0:
        how = "the noise alone, as no parameter of the twin has an interval"
        return Band(np.tile(Z95 * sensor, (len(bench), 1)), how) if sensor.any() else None
    trained = moved[train].reshape(-1, moved.shape[-1])
    known = independent(trained)  # what these do not separate varies by its own interval alone
    variance = (moved[..., ~known] ** 2).sum(axis=-1)
    if known.any():
        inverse = np.linalg.inv(trained[:, known].T @ trained[:, known])
        # counted in their own standard deviations, the diagonal of a covariance is one
        covariance = inverse / np.median(np.diag(inverse))
        variance += np.einsum("nki,ij,nkj->nk", moved[..., known], covariance, moved[..., known])
    half = Z95 * np.sqrt(variance + sensor**2)
    return Band(half, "the intervals of the twin's parameters and the noise")


def _moved(twin: Twin, bench: BodyData) -> np.ndarray:
    """(n, k, F): what one standard deviation of each parameter with an interval does to the prediction."""
    pipeline, columns = Pipeline.of(twin, bench.inputs), bench.columns[: bench.counted]
    theta = pipeline.theta(twin, bench.inputs.pressure_range_kpa)
    run = pipeline.run(bench.inputs, theta)
    here = pipeline.outputs(run, columns)
    out = [np.zeros((*here.shape, 0))]
    for i, (name, spec) in enumerate(zip(pipeline.names, pipeline.specs, strict=True)):
        effect, _, parameter = name.rpartition(".")
        value = (twin.effects.get(effect, {}) if effect else twin.parameters).get(parameter)
        if value is None or value.ci95 is None or value.ci95[0] == value.ci95[1]:
            continue
        inner, outer = (np.log, np.exp) if spec.log else (float, float)
        # the longer side: a bound may have cut the other one
        side = max((inner(end) - inner(value.value) for end in value.ci95), key=abs)
        there = theta.copy()
        there[i] = outer(inner(value.value) + STEP * side / Z95)
        moved = pipeline.outputs(pipeline.run(bench.inputs, there, run), columns)
        out.append((moved - here)[..., None] / STEP)
    return np.concatenate(out, axis=-1)


_PHRASES = {
    ("direction", "loading"): "while the pressure rises",
    ("direction", "unloading"): "while the pressure falls",
    ("direction", "hold"): "while the pressure is held",
    ("rate", "hold"): "while the pressure is held",
    "hold_time_s": "after a hold of {0}",
    "program": "in program '{0}'",
    "gravity": "with gravity along ({0})",
    "trial": "in trial {0}",
    "pressure_cmd_kpa": "at {0} kPa",
    "pressure_kpa": "where the measured pressure is {0} kPa",
    "temperature_c": "at {0} °C",
}


def phrase(axis: Axis, i: int) -> str:
    label = axis.labels[i]
    if axis.name == "rate" and label != "hold":
        moving = [x for x in axis.labels if x != "hold"]
        how = {moving[0]: " slowly", moving[-1]: " fast"}.get(label, " at middle speed")
        return f"when the pressure moves{how if len(moving) > 1 else ''}"
    text = _PHRASES.get((axis.name, label)) or _PHRASES.get(axis.name, "where {1} is {0}")
    return text.format(label, axis.name)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class BodyComparison(Comparison):
    """A twin against a recording, sample by sample."""

    recording: Recording  # without the rows that the data check left out
    findings: tuple[str, ...]
    columns: tuple[str, ...]  # (D,) compared columns; the first `counted` make the error
    counted: int
    measured: np.ndarray  # (n, D)
    model: np.ndarray  # (n, D)
    unit: str
    train_samples: np.ndarray  # (n,) mask of those that the twin was fitted to; none of a recording new to it
    noise: NoiseFloor
    band: Band | None  # within which a measurement should lie if the twin is right; None if unknown
    axes: list[Axis]
    pressure: np.ndarray | None  # (n,) squared error of the measured pressure, kPa^2; None without one
    twin: Twin
    bench: BodyData
    simulated: str = "by the pipeline, at every sample"  # by what, in words
    fidelity: str = "pipeline"  # `pipeline` or `mpm`
    out_of_range: float | None = None  # share of samples that the twin's action network was not trained for

    heading = "Twin against recording: {0.recording.folder.name}"
    keys = (
        "fidelity", "simulated", "unit", "sentence", "error", "noise_floor", "coverage", "out_of_range", "by",
        "worst", "history", ("checks", "findings"),
    )  # fmt: skip

    @cached_property
    def squared(self) -> np.ndarray:
        return squared_distance((self.measured - self.model)[:, : self.counted])

    @property
    def noise_floor(self) -> float | None:
        return self.noise.value

    @property
    def error(self) -> dict[str, float | None]:
        train, squared = self.train_samples, self.squared
        return {"all": rms_of(squared), "train": rms_of(squared[train]), "heldout": rms_of(squared[~train])}

    @cached_property
    def coverage(self) -> float | None:
        """Share of the test part's values inside their 95 % band."""
        if self.band is None or self.train_samples.all():
            return None
        left = (self.measured - self.model)[~self.train_samples, : self.counted]
        return float((np.abs(left) <= self.band.half[~self.train_samples]).mean())

    @property
    def pressure_error(self) -> dict | None:
        """Error of the modelled pressure by part, kPa, where it was measured."""
        if self.pressure is None:
            return None
        train = self.train_samples
        return {"train": rms_of(self.pressure[train]), "heldout": rms_of(self.pressure[~train])}

    @property
    def sentence(self) -> str:
        squared, noise = self.squared, self.noise.value
        heldout, where = squared[~self.train_samples], " where it was not fitted"
        if not len(heldout) or len(heldout) == len(squared):
            heldout, where = squared, ""
        error = root_mean(heldout)
        what = {"mm": "tip", "rad": "bend", "1/m": "curvature"}.get(self.unit, "device")
        who = "The twin" if self.fidelity == "pipeline" else "The twin's full simulation"
        text = f"{who} misses the measured {what} by {error:.3g} {self.unit}{where}"
        commanded = self.recording.samples[self.recording.pressure_columns].to_numpy(float)
        if np.ptp(commanded, axis=0).max() <= 1e-3:
            still = "The commanded pressure never moves in this recording, so it shows nothing about bending"
            return f"{still}; record steps or ramps. {text}."
        if noise:
            if error / noise <= NOISE:
                return f"{text}: at the noise ({noise:.2g} {self.unit})."
            text += f", {error / noise:.3g} times the noise of the measurement ({noise:.2g} {self.unit})"
        if len(squared) < FEW_ROWS:
            few = f"{plural(len(squared), 'row')} are too few to show where it is worst"
            return f"{text}; {few}; record longer."
        most, where = 1.5, ""  # where the error stands out most against all the rest
        for axis in (a for a in self.axes if len(a.labels) > 1):
            for i in range(len(axis.labels)):
                at = axis.bin == i
                if at.mean() < 0.02 or at.all():
                    continue
                ratio = np.sqrt(squared[at].mean() / max(squared[~at].mean(), 1e-300))
                if ratio > most:
                    most, where = ratio, f"; it is worst {phrase(axis, i)}"
        return f"{text}{where}."

    @property
    def inside_band(self) -> str:
        """The coverage, which must not be None, in words."""
        share = f"{100 * self.coverage:.0f} % of the {'' if self.train is None else 'test '}values"
        less = "with less something is missing from it, or its intervals are too narrow"
        return f"{share}; about 95 % is expected if the twin is right, {less}"

    @property
    def by(self) -> dict[str, list[dict]]:
        return {a.name: by_axis(a, self.squared, self.train_samples) for a in self.axes}

    @cached_property
    def worst(self) -> list[dict]:
        return worst_passages(self.recording, self.squared)

    def rows(self) -> list[dict]:
        def number(x: float | None) -> str:
            return "-" if x is None else f"{x:.3g} {self.unit}"

        rows = [("simulated", self.simulated)] * (self.fidelity != "pipeline")
        if self.train is None:
            rows.append(("error, all rows", number(self.heldout)))
        else:
            rows += [("test error", number(self.heldout)), ("training error", number(self.train))]
        value, how = self.noise.value, self.noise.how
        rows.append(("noise floor", how if value is None else f"{number(value)}, {how}"))
        if self.coverage is not None:
            rows.append(("inside the 95 % band", self.inside_band))
        if self.pressure_error:
            e = self.pressure_error["heldout"]
            part = "" if self.train is None else ", test"
            rows.append((f"pressure error{part}", "-" if e is None else f"{e:.3g} kPa"))
        for p in self.worst[:3]:
            where = f"trial {p['trial']}, {p['from_s']:.1f} to {p['to_s']:.1f} s"
            program = f" ({p['program']})" if p.get("program") else ""
            rows.append(("worst passage", f"{number(p['error'])} in {where}{program}"))
        if self.out_of_range is not None:
            rows.append(("out of the network's range", f"{100 * self.out_of_range:.2g}% of samples"))
        for v in self.history:
            error = "-" if v["heldout"] is None else f"{v['heldout']:.3g} {v['unit'] or ''}"
            rows.append((f"version {v['version']}", f"{v['change']}: test error {error}"))
        return [{"": name, "value": value} for name, value in rows]

    def content(self) -> dict:
        means = "measured pressure against what the twin makes of the command"
        pressure = self.pressure_error and {"unit": "kPa", "error": self.pressure_error, "means": means}
        left = zip(self.columns, (self.measured - self.model).T, strict=True)
        out = {"noise": {n: getattr(self.noise, n) for n in ("session", "how", "by_column")}}
        out |= {"band": None if self.band is None else {"level": 0.95, "how": self.band.how}}
        out |= {"columns": {name: rms_of(x**2) for name, x in left}, "pressure": pressure}
        return super().content() | out | {"samples": len(self.squared)}

    def page(self) -> Report:
        from lerobot_pneutac.reports.compare import comparison_page

        return comparison_page(self)


def compare_body(twin: Twin, recording: Recording) -> BodyComparison:
    """Checks the recording, runs the twin from the commanded pressure and sorts the errors."""
    clean, findings = check(recording)
    enough_to_compare(recording, clean)
    train = train_mask(twin, clean)
    reference_rows = train if train.any() else np.ones(len(clean), bool)
    clean, moved = align_mounts(clean, twin.length_mm, reference_rows)
    prediction = simulate(twin, read(clean, twin))
    findings += moved
    for name, why in prediction.left_out.items():
        as_at = get_effect(name).at_reference and why.endswith("temperature_c")
        findings.append(
            f"Effect '{name}' {f'acted as at {REFERENCE_C:g} °C' if as_at else 'could not act'}: {why}."
        )
    bench = prediction.data
    findings += _rested(twin, clean, bench)
    outside, range_finding = out_of_range(twin, bench)
    noise, pressure = noise_floor(clean), None
    if all(clean.has(n.replace("cmd_", "")) for n in clean.pressure_columns):
        pressure = squared_distance(simulate(twin, BodyData.of(clean, twin, target="pressure")).residual)
    return BodyComparison(
        recording=clean,
        findings=(*findings, *filter(None, [range_finding])),
        columns=bench.columns,
        counted=bench.counted,
        measured=bench.measured,
        model=prediction.model,
        unit=bench.unit,
        train_samples=train,
        noise=noise,
        band=prediction_band(twin, bench, reference_rows, noise),
        axes=axes(clean),
        pressure=pressure,
        twin=twin,
        bench=bench,
        out_of_range=outside,
    )


def _rested(twin: Twin, recording: Recording, bench: BodyData) -> tuple[str, ...]:
    """That pauses before runs were fitted to their poses, where they were."""
    own = pauses_read(recording, bench) if "pause_s" in twin.parameters else np.zeros(0)
    if not len(own) or np.ptp(own) == 0:
        return ()
    return (
        f"How long the device rested before {plural(len(own), 'run')} is not recorded, and effects of the "
        f"twin go on meanwhile: a pause was fitted to each, {own.min():.2g} to {own.max():.2g} s. State "
        "them under `trials` in recording.json; `pneutac measure` logs them.",
    )


def train_mask(twin: Twin, recording: Recording) -> np.ndarray:
    """Samples (n,) that the twin was fitted to, by its last version of this very recording; else none."""
    here = Path(recording.folder).resolve()
    for entry in reversed([*twin.history, *([twin.fitted_to] if twin.fitted_to else [])]):
        if entry.get("seed") is not None and Path(entry.get("recording") or "").resolve() == here:
            if "added" in str(entry.get("change", "")):  # it learns from all but its test part
                return deal(recording, int(entry["seed"])).learnt
            return recording.split(int(entry["seed"]))[0]
    return np.zeros(len(recording), bool)


def by_axis(axis: Axis, squared: np.ndarray, train: np.ndarray) -> list[dict]:
    """One row a bin: error, test error, number of samples and share of all squared error."""
    total = max(float(squared.sum()), 1e-300)
    rows = []
    for i, label in enumerate(axis.labels):
        at = axis.bin == i
        row = {"value": label}
        if axis.value is not None:
            row |= {"from": float(axis.value[at].min()), "to": float(axis.value[at].max())}
        row |= {"error": rms_of(squared[at]), "heldout": rms_of(squared[at & ~train])}
        rows.append(row | {"n": int(at.sum()), "share": float(squared[at].sum() / total)})
    return rows


def out_of_range(twin: Twin, bench: BodyData) -> tuple[float | None, str | None]:
    """Share of samples outside what the twin's action network was trained with, and a sentence.

    Each sample's joint angles count, as in the world in free air. Both are None where it has no network.
    """
    file = twin.networks.get("action")
    if file is None:
        return None, None
    from pneutac_sim.surrogate.finger import network_of
    from pneutac_sim.surrogate.network import ActionNetwork

    network = network_of(twin, ActionNetwork.load(file))
    if network is None:
        old = "The twin's action network was trained before its body's shape or material changed"
        remedy = f"run `pneutac surrogate {option('twin', Path(file).parent)}`"
        return None, f"{old}, so its range is not valid; {remedy}."
    pipeline = Pipeline.of(twin, bench.inputs)
    joints = pipeline.run(bench.inputs, pipeline.theta(twin, bench.inputs.pressure_range_kpa)).joints
    outside = np.array([not network.resistance(q, q)[2] for q in joints])
    share = float(outside.mean())
    if not outside.any():
        return share, "All samples lie within what the twin's action network was trained with."
    low, high = network.low[-1], network.high[-1]
    needed_kpa = network.pressure_kpa(joints)
    return share, (
        f"{100 * share:.2g}% of samples lie outside what the twin's action network was trained with (bending "
        f"pressures from {low:.3g} to {high:.3g} kPa; the recording's go from {needed_kpa.min():.3g} to "
        f"{needed_kpa.max():.3g} kPa); there its torque is extrapolated linearly."
    )


# ---------------------------------------------------------------- by material points

SAMPLES = 200
DIGITS = 6  # joint targets that agree in so many, rad, are one equilibrium


def spread(count: int, samples: int, seed: int = 0) -> np.ndarray:
    """Rows to simulate, rising: one at random in each of `samples` equal stretches, to hit no period."""
    if count <= samples:
        return np.arange(count)
    edges = np.linspace(0, count, samples + 1)
    at = np.random.default_rng(seed).uniform(edges[:-1], edges[1:])
    return np.unique(np.minimum(at.astype(int), count - 1))


def by_mpm(
    c: BodyComparison, twin: Twin, samples: int, seed: int, progress: Progress = no_progress
) -> BodyComparison:
    count = len(c.bench)
    at = spread(count, samples, seed)
    model, solved = markers_by_mpm(twin, c.bench, at, progress)
    poses = plural(solved, "different pose")
    how = f"by full material points at {len(at)} of {plural(count, 'sample')}, spread over the recording"
    return replace(
        c,
        recording=c.recording.keep(np.isin(np.arange(count), at)),
        measured=c.measured[at],
        model=model,
        train_samples=c.train_samples[at],
        band=None if c.band is None else replace(c.band, half=c.band.half[at]),
        axes=[axis for axis in (_thinned(a, at) for a in c.axes) if axis.labels],
        pressure=None if c.pressure is None else c.pressure[at],
        simulated=f"{how} ({poses})",
        fidelity="mpm",
    )


def _thinned(axis: Axis, at: np.ndarray) -> Axis:
    """An axis of the samples `at` (k,) alone, without empty bins."""
    used, place = np.unique(axis.bin[at], return_inverse=True)
    none = int(used[0] == -1)
    value = None if axis.value is None else axis.value[at]
    return Axis(axis.name, value, place - none, [axis.labels[i] for i in used[none:]])


def markers_by_mpm(
    twin: Twin, bench: BodyData, samples: np.ndarray, progress: Progress = no_progress
) -> tuple[np.ndarray, int]:
    """Columns (k, D) of some rows of a recording as material points at rest show them, and how many rests.

    The pipeline gives the joint targets of all samples, so that effects with a memory miss none. At those of
    `samples` the body is brought to rest; its spine is then observed as the pipeline's is.
    """
    from pneutac_sim.mpm import devices  # which starts a compiler

    solver = devices.BODIES[twin.device](twin)
    pipeline = Pipeline.of(twin, bench.inputs)
    run = pipeline.run(bench.inputs, pipeline.theta(twin, bench.inputs.pressure_range_kpa))
    targets, inverse = np.unique(run.joints[samples].round(DIGITS), axis=0, return_inverse=True)
    joints, tips = (x[inverse.ravel()] for x in _at_rest(solver, targets, progress))
    axes = pipeline.geometry.axes
    bend = np.zeros((len(samples), 2))
    bend[:, :axes] = joints.reshape(len(samples), -1, axes).sum(1)
    markers, inputs = np.hstack([1e3 * tips, bend]), bench.inputs.thin(samples)
    computed = pipeline.computed(run.signals, inputs, at_samples=True)
    conditions = inputs.conditions_with(computed, at_samples=True)
    for link in pipeline.chain[pipeline.reads_joints + 1 :]:  # effects of the observation
        state = np.zeros(link.state_size(markers.shape[1]))
        markers = link(markers, inputs.sample_dt_s, run.theta, conditions, state)
    shown = replace(run, pressure_kpa=run.pressure_kpa[samples], joints=joints, markers=markers)
    return pipeline.outputs(shown, bench.columns), len(targets)


def _at_rest(solver, targets: np.ndarray, progress) -> tuple[np.ndarray, np.ndarray]:
    """Angles (m, H) and tips (m, 3) m at joint targets (m, H), each begun from the one nearest in bend."""
    from pneutac_sim.mpm import devices
    from pneutac_sim.mpm.solve import MpmDiverged, solve_equilibrium
    from pneutac_sim.mpm.total_lagrangian import Loads

    joints, tips = np.empty_like(targets), np.empty((len(targets), 3))
    centred = targets - targets.mean(0)
    order = np.argsort(centred @ np.linalg.svd(centred, full_matrices=False)[2][0], kind="stable")
    for done, i in enumerate(order):
        progress("material points", done, len(order))
        try:
            rest = solve_equilibrium(solver, Loads(q_cmd=targets[i][None]), warm=done > 0)
        except MpmDiverged as e:
            raise InputError(f"{e.finding}; compare by fidelity=pipeline, or leave that sample out.") from e
        joints[i], tips[i] = rest.q[0], devices.spine_points(solver, rest.q)[0, -1]
    return joints, tips
