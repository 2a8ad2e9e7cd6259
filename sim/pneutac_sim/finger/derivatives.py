"""How a pipeline's outputs change with its parameters: one-sided differences, taken link by link.

Up to the drive the changed pressures of all parameters pass each effect side by side. Behind it nothing is
remembered as a rule, so a change of pressure or of joint angles is worth its derivative at each sample.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pneutac_sim.finger.inputs import Inputs
from pneutac_sim.finger.kinematics import tip_derivatives
from pneutac_sim.finger.pipeline import Pipeline, Run
from pneutac_sim.finger.stages import EffectLink, Markers

_SMALL = 1e-4  # of the pressure's range, of the length, or rad: where a derivative is taken
_LEAST_WEIGHT = 1e-3  # from which on a linear effect is scaled rather than run again


def changes(
    pipeline: Pipeline,
    inputs: Inputs,
    run: Run,
    columns: Sequence[str],
    indices: np.ndarray,
    values: np.ndarray,
) -> np.ndarray:
    """(n, D, F) what D outputs change by where one parameter alone takes another value, to first order.

    Args:
        pipeline: the model.
        inputs: that drive it.
        run: from which the changes count.
        columns: (D,) outputs.
        indices: (F,) parameters.
        values: (F,) what each is moved to.
    """
    only_air = pipeline.until(columns) <= pipeline.drive
    end = pipeline.reads_pressure if only_air else pipeline.drive
    link = [next((k for k, e in enumerate(pipeline.chain) if i in e.indices), None) for i in indices]
    early = [j for j, k in enumerate(link) if k is not None and k < end]
    out = np.zeros((len(inputs.rows), len(columns), len(indices)))
    if early:
        moved = _pressures(pipeline, inputs, run, indices[early], values[early], end)
        if only_air:
            change = (moved - run.signals[end][:, None])[inputs.rows]
            chambers = [_chamber(c) for c in columns]
            out[:, :, early] = change[:, :, chambers].transpose(0, 2, 1)
        else:
            out[:, :, early] = _by_pressure(pipeline, inputs, run, columns, moved)
    at = pipeline.outputs(run, columns)
    late = [j for j, k in enumerate(link) if not only_air and k is not None and k >= end]
    bare = pipeline.thins_at == end and isinstance(pipeline.chain[end + 1], Markers)
    if bare and not any(c.startswith("q_") for c in columns):
        of_drive = [j for j in late if link[j] == end]
        out[:, :, of_drive] = _by_joints(
            pipeline, inputs, run, columns, indices[of_drive], values[of_drive], at
        )
        late = [j for j in late if link[j] != end]
    for j in late:
        theta = run.theta.copy()
        theta[indices[j]] = values[j]
        out[:, :, j] = pipeline.outputs(pipeline.run(inputs, theta, run), columns) - at
    return out


def _chamber(column: str) -> int:
    number = column.split("_")[1]
    return int(number) - 1 if number.isdigit() else 0


def _pressures(
    pipeline: Pipeline, inputs: Inputs, run: Run, indices: np.ndarray, values: np.ndarray, end: int
) -> np.ndarray:
    """(m, F, chambers) what enters link `end` where each parameter of a link before takes its other value."""
    conditions = inputs.conditions_with({}, False)
    x = np.zeros((len(inputs.dt_s), 0, run.signals[0].shape[1]))
    order: list[int] = []
    for link, before, after in zip(pipeline.chain[:end], run.signals, run.signals[1:], strict=False):
        assert isinstance(link, EffectLink)
        if order:
            x = link.side_by_side(x, inputs.dt_s, run.theta, conditions)
        own = [j for j, i in enumerate(indices) if i in link.indices]
        new = []
        for j in own:
            now, value = run.theta[indices[j]], values[j]
            if pipeline.names[indices[j]].endswith(f".{link.effect.linear}") and abs(now) > _LEAST_WEIGHT:
                new.append(after + (after - before) * ((value - now) / now))
                continue
            theta = run.theta.copy()
            theta[indices[j]] = value
            state = np.zeros(link.state_size(before.shape[1]))
            new.append(link(before, inputs.dt_s, theta, conditions, state))
        if own:
            x, order = np.concatenate([x, np.stack(new, axis=1)], axis=1), order + own
    return x[:, np.argsort(order)]


def _by_pressure(
    pipeline: Pipeline, inputs: Inputs, run: Run, columns: Sequence[str], moved: np.ndarray
) -> np.ndarray:
    """(n, D, F) what outputs change by where other pressures (m, F, chambers) bend the body."""
    at, u = pipeline.outputs(run, columns), run.signals[pipeline.drive]

    def outputs(pressure: np.ndarray) -> np.ndarray:
        return pipeline.outputs(pipeline.run(inputs, run.theta, run, pressure), columns) - at

    if pipeline.thins_at > pipeline.drive:
        return np.stack([outputs(np.ascontiguousarray(moved[:, j])) for j in range(moved.shape[1])], axis=2)
    eps, out = _SMALL * inputs.pressure_range_kpa, 0.0
    change = moved[inputs.rows] - u[inputs.rows][:, None]
    for c in range(u.shape[1]):
        other = u.copy()
        other[:, c] += eps
        out = out + (outputs(other) / eps)[:, :, None] * change[:, None, :, c]
    return np.asarray(out)


def _by_joints(
    pipeline: Pipeline,
    inputs: Inputs,
    run: Run,
    columns: Sequence[str],
    indices: np.ndarray,
    values: np.ndarray,
    at: np.ndarray,
) -> np.ndarray:
    """(n, D, F) what outputs change by with parameters of the drive, where markers follow from its joints."""
    g, drive = pipeline.geometry, pipeline.chain[pipeline.drive]
    u, state = run.signals[pipeline.drive][inputs.rows], np.zeros(0)
    conditions = inputs.conditions_with({}, True)
    turned = []
    for i, value in zip(indices, values, strict=True):
        theta = run.theta.copy()
        theta[i] = value
        turned.append(drive(u, inputs.sample_dt_s, theta, conditions, state) - run.joints)
    if not turned:
        return np.zeros((*at.shape, 0))
    by_joint = tip_derivatives(run.joints, np.array(g.joint_positions_mm), g.length_mm, g.axes)
    markers = np.einsum("nmq,nqf->nmf", by_joint, np.stack(turned, axis=2))
    out = np.zeros((*at.shape, len(indices)))
    for m in range(5):
        if by_joint[:, m].any():
            eps = _SMALL * (g.length_mm if m < 3 else 1.0)
            other = run.signals[pipeline.reads_joints + 1].copy()
            other[:, m] += eps
            seen = (pipeline.outputs(_seen(pipeline, inputs, run, other), columns) - at) / eps
            out += seen[:, :, None] * markers[:, None, m]
    return out


def _seen(pipeline: Pipeline, inputs: Inputs, run: Run, markers: np.ndarray) -> Run:
    """The run with other markers (n, 5) of the body, as effects of markers and the observation show them."""
    conditions = inputs.conditions_with(pipeline.computed(run.signals, inputs, True), True)
    for link in pipeline.chain[pipeline.reads_joints + 1 :]:
        markers = link(markers, inputs.sample_dt_s, run.theta, conditions, np.zeros(0))
    return replace(run, markers=markers)
