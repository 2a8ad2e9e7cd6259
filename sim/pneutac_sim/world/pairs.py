"""What two models of one scene have in common, by name: state and properties are copied between them."""

import mujoco
import numpy as np

_COUNTS = {"joint": "njnt", "body": "nbody", "geom": "ngeom", "actuator": "nu"}


class Pairs:
    """Indices of everything that both models have.

    Args:
        one: MuJoCo's model.
        other: another one, with joints, bodies, geoms and actuators of the same names.
    """

    def __init__(self, one: mujoco.MjModel, other: mujoco.MjModel):
        def both(kind: str) -> list[str]:
            names = [
                [getattr(m, kind)(i).name for i in range(getattr(m, _COUNTS[kind]))] for m in (one, other)
            ]
            return [n for n in names[1] if n and n in names[0]]

        def indices(names: list[str], find) -> tuple[np.ndarray, ...]:
            return tuple(np.concatenate([find(m, n) for n in names]).astype(int) for m in (one, other))

        joints = both("joint")
        bodies = [n for n in both("body") if n not in ("world", "flange")]
        self._qpos = indices(joints, lambda m, n: _span(m.joint(n).qposadr[0], m.joint(n).qpos0))
        self._dofs = indices(joints, lambda m, n: _span(m.joint(n).dofadr[0], m.joint(n).armature))
        self._ctrl = indices(both("actuator"), lambda m, n: [m.actuator(n).id])
        body = indices(bodies, lambda m, n: [m.body(n).id])
        geom = indices(both("geom"), lambda m, n: [m.geom(n).id])
        self._fields = [
            *((*body, name) for name in ("body_pos", "body_quat", "body_mass")),
            (*geom, "geom_friction"),
            (*self._dofs, "dof_frictionloss"),
        ]

    def copy(
        self, one: mujoco.MjModel, here: mujoco.MjData, other: mujoco.MjModel, there: mujoco.MjData
    ) -> None:
        """Takes poses, masses and friction, positions, speeds and controls from `one` to `other`."""
        for a, b, name in self._fields:
            getattr(other, name)[b] = getattr(one, name)[a]
        there.qpos[self._qpos[1]], there.qvel[self._dofs[1]] = (
            here.qpos[self._qpos[0]],
            here.qvel[self._dofs[0]],
        )
        there.ctrl[self._ctrl[1]] = here.ctrl[self._ctrl[0]]


def _span(first: int, like: np.ndarray) -> np.ndarray:
    return first + np.arange(len(np.atleast_1d(like)))
