"""A twin's markers by full material points, for `pneutac compare --fidelity=mpm`."""

from dataclasses import replace

import numpy as np

from lerobot_pneutac.verbs.compare_body import BodyComparison
from pneutac_datasets.recording.axes import Axis
from pneutac_datasets.recording.wording import plural
from pneutac_sim.errors import InputError
from pneutac_sim.finger import BodyData, Pipeline
from pneutac_sim.finger.inputs import Inputs
from pneutac_sim.finger.pipeline import Run
from pneutac_sim.mpm import devices
from pneutac_sim.mpm.solve import MpmDiverged, solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads, TotalLagrangian
from pneutac_sim.progress import Progress, no_progress
from pneutac_sim.twin import Twin

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
    some = {name: getattr(c, name)[at] for name in ("measured", "train_samples", "rate", "still")}
    return replace(
        c,
        recording=c.recording.keep(np.isin(np.arange(count), at)),
        model=model,
        band=None if c.band is None else replace(c.band, half=c.band.half[at]),
        axes=[axis for axis in (_thinned(a, at) for a in c.axes) if axis.labels],
        pressure=None if c.pressure is None else c.pressure[at],
        simulated=f"{how} ({poses})",
        fidelity="mpm",
        **some,
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
    solver = devices.BODIES[twin.device](twin)
    pipeline = Pipeline.of(twin, bench.inputs)
    run = pipeline.run(bench.inputs, pipeline.theta(twin, bench.inputs.pressure_range_kpa))
    targets, inverse = np.unique(run.joints[samples].round(DIGITS), axis=0, return_inverse=True)
    joints, tips = (x[inverse.ravel()] for x in _at_rest(solver, targets, progress))
    axes = pipeline.geometry.axes
    bend = np.zeros((len(samples), 2))
    bend[:, :axes] = joints.reshape(len(samples), -1, axes).sum(1)
    seen = _observed(pipeline, run, bench.inputs.thin(samples), np.hstack([1e3 * tips, bend]))
    shown = replace(run, pressure_kpa=run.pressure_kpa[samples], joints=joints, markers=seen)
    return pipeline.outputs(shown, bench.columns), len(targets)


def _at_rest(solver: TotalLagrangian, targets: np.ndarray, progress) -> tuple[np.ndarray, np.ndarray]:
    """Angles (m, H) and tips (m, 3) m at joint targets (m, H), each begun from the one nearest in bend."""
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


def _observed(pipeline: Pipeline, run: Run, inputs: Inputs, markers: np.ndarray) -> np.ndarray:
    """Markers (k, 5) of the body as the pipeline's effects of the observation show them."""
    computed = pipeline.computed(run.signals, inputs, at_samples=True)
    conditions = inputs.conditions_with(computed, at_samples=True)
    for link in pipeline.chain[pipeline.reads_joints + 1 :]:
        state = np.zeros(link.state_size(markers.shape[1]))
        markers = link(markers, inputs.sample_dt_s, run.theta, conditions, state)
    return markers
