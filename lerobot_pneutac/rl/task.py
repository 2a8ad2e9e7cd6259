"""What reinforcement learning needs of a task: its progress, and where the object should be touched.

Only reward and critic see this; the actor does not.
"""

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.world.tasks.base import Goal, Task
from pneutac_sim.world.world import World

LENGTH_M = 0.05  # scales lengths of the object's state to about one


GOALS: dict[str, Goal] = {
    "switch": Goal(
        lambda t: np.clip((t.lever_rad + t.well_rad) / (2 * t.well_rad), 0, 1), "bar", (-1, 0, 0), 1.0
    ),
    # From below, at the front edge of the tab.
    "egg": Goal(lambda t: np.clip(t.lid_rad / t.open_rad, 0, 1), "carton_tab", (-1, 0, -1), 0.6),
    # The front face, below the upper edge: what the second card gives is lost.
    "card": Goal(
        lambda t: np.clip(t.drawn_m(1) / t.draw_m, 0, 1) - np.clip(t.drawn_m(2) / t.second_m, 0, 1),
        "card_1",
        (-1, 0, 0.85),
        0.5,
    ),
}


def goal_of(task: Task) -> Goal:
    """The goal of a task; raises InputError where it has none."""
    goal = GOALS.get(task.name) or task.goal
    if goal is None:
        raise InputError(
            f"The task '{task.name}' has no goal for reinforcement learning; give its class one."
        )
    return goal


class TaskView:
    """Goal and privileged state of the object in one world.

    Attributes:
        goal: of the task.
        size: length of `state()`.
    """

    def __init__(self, world: World):
        model, name = world.model, world.task.name
        self._world = world
        self.goal = goal_of(self._inner())
        try:
            self._body, self._geom = model.body(name).id, model.geom(self.goal.geom).id
        except KeyError as e:
            raise InputError(
                f"The task '{name}' needs a body '{name}' and the geom '{self.goal.geom}' of its goal: {e}"
            ) from e
        self._joints = np.flatnonzero(model.body_rootid[model.jnt_bodyid] == self._body)
        self._corner = np.multiply(self.goal.side, model.geom_size[self._geom])
        self.size = 13 + 2 * len(self._joints)

    def progress(self) -> float:
        """How much is done, see `Goal`."""
        return float(self.goal.progress(self._inner()))

    def contact_point_m(self) -> np.ndarray:
        """Where the object should be touched (3,), metres in the world."""
        d = self._world.data
        return d.geom_xpos[self._geom] + d.geom_xmat[self._geom].reshape(3, 3) @ self._corner

    def distance_m(self) -> float:
        """From the middle of the gel to that point, metres."""
        return float(np.linalg.norm(self.contact_point_m() - self._world.gel_m))

    def state(self) -> np.ndarray:
        """The object's state (size,), about one in size.

        Object relative to the gel, place and heading in the world, joints, their speeds, progress, imprint.
        """
        w, model, data = self._world, self._world.model, self._world.data
        place = model.body(self._body)
        yaw = 2 * np.arctan2(place.quat[3], place.quat[0])
        q = data.qpos[model.jnt_qposadr[self._joints]]
        dq = data.qvel[model.jnt_dofadr[self._joints]]
        return np.concatenate(
            [
                (self.contact_point_m() - w.gel_m) / LENGTH_M,
                (data.geom_xpos[self._geom] - (0.5, 0.0, 0.1)) / LENGTH_M,
                (place.pos - (0.55, 0.0, 0.0)) / LENGTH_M,
                [np.sin(yaw), np.cos(yaw), self.progress(), w.press_mm],
                q,
                np.tanh(dq),
            ]
        )

    def _inner(self) -> Task:
        """The task itself, where a `VariedWorld` wraps it."""
        return getattr(self._world.task, "inner", self._world.task)
