"""What a black box still finds in what a model of a body leaves."""

from typing import TYPE_CHECKING

import numpy as np

from lerobot_pneutac.diagnosis.black_box import share_left
from pneutac_sim.effects.laws import law
from pneutac_sim.finger.data import BodyData

if TYPE_CHECKING:
    from lerobot_pneutac.study.body import BodyStudy


def features(study: "BodyStudy") -> np.ndarray:
    """(n, f) causal signals of the command and the conditions, for a black box."""
    data = BodyData.of(study.recording, study.twin, source="command", start=study.start)
    u, dt = data.inputs.pressure_kpa / data.inputs.pressure_range_kpa, data.inputs.dt_s
    columns = [u]
    for name, values in (
        *(
            ("lag(p)", {"weight": 1.0, "scale_kpa": 1.0, "time_s": t})
            for t in (0.05, 0.15, 0.5, 1.5, 5.0, 20.0, 80.0)
        ),
        *(("play(p)", {"weight": 1.0, "scale_kpa": 1.0, "width_kpa": w}) for w in (0.05, 0.2)),
    ):
        effect = law(name)
        x = np.array(u)
        theta = np.array([*effect.codes, *(values[p.name] for p in effect.parameters)])
        effect.run(x, dt, theta, np.zeros((len(x), 0)), np.zeros(effect.state_size(x.shape[1])))
        columns.append(x - u)
    columns = [c[data.inputs.rows] for c in columns]
    for name in ("temperature_c", "payload_g", "gravity_x", "gravity_y", "gravity_z"):
        if study.recording.has(name):
            columns.append(study.recording.column(name).astype(float)[:, None])
    return np.concatenate(columns, axis=1)


def left_to_black_box(study: "BodyStudy", residual: np.ndarray) -> float:
    """Share of what a model leaves that a black box removes on test blocks."""
    parts = study.parts
    return share_left(residual, features(study), parts.learnt, parts.test, study.noise.floor)
