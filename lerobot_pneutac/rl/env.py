"""A task for reinforcement learning: the actor feels, the critic sees the object as well.

Progress and approach are differences between steps, so that going to and fro earns nothing. The paper names
progress, approach, contact, tactile depth, success and action rate; a spoilt trial costs as well.
"""

from dataclasses import dataclass

import gymnasium
import numpy as np
from gymnasium import spaces

from pneutac_sim.errors import InputError
from pneutac_sim.features import ACTION_NAMES, CHAMBERS, EE, PANDA_JOINTS, PRESSURE, action_limits
from pneutac_sim.gel.probe import COLS, ROWS
from pneutac_sim.twin import Twin
from pneutac_sim.world.base import Variation
from pneutac_sim.world.checks import Conditions
from pneutac_sim.world.station import Station
from pneutac_sim.world.tasks import Task
from pneutac_sim.world.world import World

LENGTH_M = 0.05  # scales lengths of the object's state to about one


@dataclass(frozen=True)
class Seen:
    """The object in one world, or in N worlds with a first axis (N,): what the reward and the critic see."""

    point_m: np.ndarray  # (..., 3) where it should be touched, metres in the world, as the next
    geom_m: np.ndarray  # (..., 3) middle of the geom that should be
    gel_m: np.ndarray  # (..., 3) middle of the gel's window
    body_m: np.ndarray  # (..., 3) where it stands
    yaw_rad: np.ndarray  # (...,) heading
    q: np.ndarray  # (..., J) of its joints
    dq: np.ndarray  # (..., J) their speeds
    press_mm: np.ndarray  # (...,) how far the gel's surface is pressed in
    progress: np.ndarray  # (...,) how much of the task is done

    @property
    def distance_m(self) -> np.ndarray:
        return np.linalg.norm(self.point_m - self.gel_m, axis=-1)

    def state(self) -> np.ndarray:
        """The object's state (..., 13 + 2 J), about one in size.

        Object relative to the gel, place and heading in the world, joints, their speeds, progress, imprint.
        """
        parts = [
            (self.point_m - self.gel_m) / LENGTH_M,
            (self.geom_m - (0.5, 0.0, 0.1)) / LENGTH_M,
            (self.body_m - (0.55, 0.0, 0.0)) / LENGTH_M,
        ]
        yaws = np.stack([np.sin(self.yaw_rad), np.cos(self.yaw_rad), self.progress, self.press_mm], -1)
        return np.concatenate([*parts, yaws, self.q, np.tanh(self.dq)], -1)


class TaskView:
    """Goal and object of a task in a world; `size` is the length of `Seen.state()`."""

    def __init__(self, world: World):
        model, name = world.model, world.task.name
        self._world, self.goal = world, world.task.goal
        if self.goal is None:
            raise InputError(f"The task '{name}' has no goal for reinforcement learning; give its class one.")
        try:
            self._body, self._geom = model.body(name).id, model.geom(self.goal.geom).id
        except KeyError as e:
            needs = f"a body '{name}' and the geom '{self.goal.geom}' of its goal"
            raise InputError(f"The task '{name}' needs {needs}: {e}") from e
        joints = np.flatnonzero(model.body_rootid[model.jnt_bodyid] == self._body)
        self._qpos, self._qvel = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        self._pad = int(model.joint("pad").qposadr[0])
        self._corner = np.multiply(self.goal.side, model.geom_size[self._geom])
        self.size = 13 + 2 * len(joints)

    def seen(self) -> Seen:
        """The object in this world."""
        model, d = self._world.model, self._world.data
        poses = (d.geom_xpos, d.geom_xmat.reshape(-1, 3, 3), d.site_xpos)
        progress = np.asarray(self.progress(self._world.task))
        return self.seen_in(*poses, model.body_pos, model.body_quat, d.qpos, d.qvel, progress)

    def progress(self, task: Task) -> float:
        """How far a task has come; raises InputError where its goal fails or gives no finite number."""
        try:
            found = float(self.goal.progress(task))
            why = "" if np.isfinite(found) else f"gives {found}, not a finite number"
        except Exception as e:  # whatever a class of others raises
            why = f"fails ({type(e).__name__}: {e})"
        if why:
            raise InputError(f"The task '{task.name}': the progress of its goal {why}; correct its class.")
        return found

    def seen_in(self, geom_m, geom_mat, site_m, body_m, body_quat, qpos, qvel, progress) -> Seen:
        """The object in worlds of this model, from arrays as MuJoCo names them, with a first axis or none."""
        at, quat = geom_m[..., self._geom, :], body_quat[..., self._body, :]
        point, gel = at + geom_mat[..., self._geom, :, :] @ self._corner, site_m[..., self._world._gel, :]
        places = point, at.copy(), gel.copy(), body_m[..., self._body, :].copy()
        yaw, joints = 2 * np.arctan2(quat[..., 3], quat[..., 0]), qpos[..., self._qpos]
        return Seen(*places, yaw, joints, qvel[..., self._qvel], -1e3 * qpos[..., self._pad], progress)


# Weight of each term in one control step. Over an episode the whole progress earns 2, coming from 10 cm away
# 1.5, 50 steps of a good imprint 0.5, and success as much as all of these.
WEIGHTS: dict[str, float] = {
    "progress": 2.0,  # of the whole task
    "approach": 15.0,  # per metre
    "contact": 0.002,
    "depth": 0.008,
    "success": 4.0,
    "failure": -1.0,
    "action_rate": -0.0005,
}


@dataclass(frozen=True)
class Moment:
    """What the reward looks at after a control step: numbers of one world, or arrays (N,) of many."""

    progress: np.ndarray | float  # how much of the task is done
    distance_m: np.ndarray | float  # gel to where the object should be touched
    depth_mm: np.ndarray | float  # deepest point of the probe grid
    success: np.ndarray | bool = False  # the trial has ended so
    failure: np.ndarray | bool = False  # or so


def reward_terms(
    before: Moment, after: Moment, goal_depth_mm: float, previous: np.ndarray, action: np.ndarray
) -> dict[str, np.ndarray]:
    """The terms (...,) of one control step, before their weights; actions (..., 4) have entries in [-1, 1].

    `depth` is 1 at the wanted imprint `goal_depth_mm` and falls to 0 at none and at twice of it,
    `action_rate` is the mean square of the change.
    """
    wanted = 1 - abs(after.depth_mm - goal_depth_mm) / goal_depth_mm
    return {
        "progress": after.progress - before.progress,
        "approach": before.distance_m - after.distance_m,
        "contact": np.greater(after.depth_mm, 0).astype(float),
        "depth": np.maximum(0.0, wanted),
        "success": np.asarray(after.success, float),
        "failure": np.asarray(after.failure, float),
        "action_rate": np.mean(np.square(np.subtract(action, previous)), -1),
    }


def total(terms: dict[str, np.ndarray]) -> np.ndarray:
    return sum(WEIGHTS[name] * value for name, value in terms.items())


GRID = (10, 8)  # cells of the actor's probe grid, rows and columns
EPISODE_S = 40 / 3  # shorter than a trial, for more starts
JOINT_RANGE_RAD, JOINT_RATE_RAD_S = 0.6, 0.4  # what a joint moves about home, and how fast, in these tasks
FRICTION, BEND_GAIN = (0.8, 1.25), (0.93, 1.07)  # ranges of randomisation, factors
_LIMIT = 20.0  # observations are clipped there; none comes near it in a trial that goes well

POOL_ROWS = np.arange(GRID[0]) * ROWS // GRID[0]  # where the cells begin
POOL_COLS = np.arange(GRID[1]) * COLS // GRID[1]


def actor_size(joints: int = PANDA_JOINTS) -> int:
    """How many numbers an actor observes of a robot whose arm has so many joints."""
    proprioception = 2 * joints + 4  # joints, their rates, flange, pressure
    return proprioception + len(ACTION_NAMES) + GRID[0] * GRID[1]


def pool(depth_mm: np.ndarray) -> np.ndarray:
    """Deepest point (mm) of each cell of a coarse grid `GRID`, from probe grids (..., 80, 59)."""
    return np.maximum.reduceat(np.maximum.reduceat(depth_mm, POOL_ROWS, -2), POOL_COLS, -1)


def to_action(normal: np.ndarray, pressure_range_kpa: tuple[float, float]) -> np.ndarray:
    """An action (..., 4) as `features.ACTION_NAMES` from one in [-1, 1]; what exceeds these is clipped."""
    share, (low, high) = (np.clip(normal, -1, 1) + 1) / 2, action_limits(pressure_range_kpa)
    return low + share * (high - low)


def draw_start(rng: np.random.Generator, randomise: bool) -> tuple[int, Variation]:
    """Seed and variation of an episode's start."""
    factors = {"friction": rng.uniform(*FRICTION), "bend_gain": rng.uniform(*BEND_GAIN)} if randomise else {}
    return int(rng.integers(2**31)), Variation(**factors)


def actor_observation(
    world: World, state: np.ndarray, previous: np.ndarray, cells_mm: np.ndarray
) -> np.ndarray:
    """What the actor observes, (..., actor_size(N)) float32: proprioception, its last action, the probe grid.

    The states (..., 2 N + 6) are as `features.state_names`; their contact area needs an image and is left
    out. Cells (..., 10, 8) of the probe grid are as by `pool`, in mm.
    """
    n, (low, high) = world.arm.joints, world.pressure_range_kpa
    corners = np.array([world.station.workspace_low_m, world.station.workspace_high_m]) - world.arm.base_m
    parts = (
        (state[..., :n] - world.arm.home_rad) / JOINT_RANGE_RAD,
        state[..., n : 2 * n] / JOINT_RATE_RAD_S,
        (state[..., EE] - corners.mean(0)) / (np.diff(corners, axis=0)[0] / 2),
        (state[..., PRESSURE, None] - low) * (2 / (high - low)) - 1,
        previous,
        cells_mm.reshape(*cells_mm.shape[:-2], -1),
    )
    return np.clip(np.concatenate(parts, -1), -_LIMIT, _LIMIT).astype(np.float32)


def critic_observation(seen: Seen, friction: np.ndarray, bend_gain: np.ndarray) -> np.ndarray:
    """What the critic alone observes (..., size + 2) float32: the object's state and the drawn factors."""
    drawn = np.stack([5 * (np.asarray(friction) - 1), 10 * (np.asarray(bend_gain) - 1)], -1)
    return np.clip(np.concatenate([seen.state(), drawn], -1), -_LIMIT, _LIMIT).astype(np.float32)


class PpoEnv(gymnasium.Env):
    """A task with a shaped reward, in the world whose finger and gel follow formulas.

    Observation: `actor` (actor_size(N),), see `actor_observation`, and `object`, the object's state, for the
    critic alone. Action (4,) in [-1, 1], see `to_action`. `info` has `terms`, the reward's terms before
    their weights, `is_success` and `failure`. An episode terminates on success and failure, and is cut off
    after `length` control steps, those of `EPISODE_S` if omitted. With `randomise` friction and bend of the
    finger change with every episode.
    """

    metadata = {"render_modes": []}

    def __init__(
        self,
        task: str = "switch",
        twin: Twin | None = None,
        randomise: bool = True,
        length: int | None = None,
        conditions: Conditions | None = None,
        station: Station | None = None,
    ):
        if twin is not None and CHAMBERS.get(twin.device, 1) > 1:
            other = f"this twin is of an '{twin.device}'; give a finger's"
            raise InputError(f"An actor commands one chamber, and {other}.")
        self.world = World(task, twin, "probe", "probe", conditions, station=station)
        self.view = TaskView(self.world)
        self.randomise, self.length = randomise, length or self.world.station.steps(EPISODE_S)
        self.action_space = spaces.Box(-1.0, 1.0, (len(ACTION_NAMES),), np.float32)
        sizes = {"actor": actor_size(self.world.arm.joints), "object": self.view.size + 2}  # friction, gain
        boxes = {name: spaces.Box(-_LIMIT, _LIMIT, (n,), np.float32) for name, n in sizes.items()}
        self.observation_space = spaces.Dict(boxes)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[dict, dict]:
        """Starts an episode; a seed decides it and all that follow."""
        super().reset(seed=seed)
        start, self.world.variation = draw_start(self.np_random, self.randomise)
        observed = self.world.reset(start)
        self._previous, self._done = np.zeros(len(ACTION_NAMES)), 0
        self._moment = self._look()
        return self._observe(observed.state), {"is_success": False, "failure": ""}

    def step(self, action: np.ndarray) -> tuple[dict, float, bool, bool, dict]:
        normal = np.clip(action, -1, 1).astype(float)
        observed = self.world.step(to_action(normal, self.world.pressure_range_kpa))
        moment = self._look()
        terms = reward_terms(self._moment, moment, self.view.goal.depth_mm, self._previous, normal)
        self._moment, self._previous = moment, normal
        self._done += 1
        info = {"terms": terms, "is_success": moment.success, "failure": self.world.failure or ""}
        over = moment.success or moment.failure
        return self._observe(observed.state), float(total(terms)), over, self._done >= self.length, info

    def _look(self) -> Moment:
        self._seen, w = self.view.seen(), self.world
        felt = float(w.touch.depth_mm.max()), bool(w.success), w.failure is not None
        return Moment(float(self._seen.progress), float(self._seen.distance_m), *felt)

    def _observe(self, state: np.ndarray) -> dict[str, np.ndarray]:
        v = self.world.variation
        return {
            "actor": actor_observation(self.world, state, self._previous, pool(self.world.touch.depth_mm)),
            "object": critic_observation(self._seen, v.friction, v.bend_gain),
        }
