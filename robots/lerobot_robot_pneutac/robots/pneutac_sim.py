"""The robot `pneutac_sim`: the simulated world behind LeRobot's Robot interface."""

import logging
from typing import Any, override
from weakref import WeakSet

import numpy as np
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from lerobot_robot_pneutac.options import standin_sensor, station_of, tactile_shape, twin_of
from lerobot_robot_pneutac.robots.base_robot import BaseRobot, BendCommands
from lerobot_robot_pneutac.robots.config_pneutac_sim import PneutacSimConfig
from lerobot_robot_pneutac.robots.episode_hooks import EpisodeHooks
from pneutac_sim import features
from pneutac_sim.errors import InputError
from pneutac_sim.features import IMAGE_NAME, POINTS_KEY, Places
from pneutac_sim.gel.contact import SPECKS
from pneutac_sim.pace import DONE
from pneutac_sim.twin import Twin
from pneutac_sim.world.scene import OBJECT_GROUP
from pneutac_sim.world.task_env import SceneCameras, tactile_points
from pneutac_sim.world.tasks.base import WIDER_M

# A pose command this near to one of the task's starts brings the arm home; their jitter is less.
HOME_RADIUS_M = 0.010
NOT_DONE = "the task was not done"

logger = logging.getLogger(__name__)

_connected: list["PneutacSim"] = []
_made: WeakSet["PneutacSim"] = WeakSet()


class SpreadStarts:
    """Chooses seeds so that the mean distance to the nearest start done is least, one after the other.

    The greedy way through the k-median problem: Cornuejols, Fisher and Nemhauser, Management Science 23
    (1977) 789. Of each seed are given the places (N, 3) of the things, m.
    """

    def __init__(self, places: dict[int, np.ndarray]):
        self._seeds = list(places)
        points = np.array(list(places.values()))
        between = points[:, None] - points[None]
        self._distance_m = np.linalg.norm(between, axis=-1).mean(-1)  # (starts, starts)
        self._nearest_m = np.full(len(points), np.inf)
        self._given: list[int] = []

    def next(self) -> int:
        """The seed that helps most, and was not given before while there are others."""
        if len(self._given) == len(self._seeds):
            self._given.clear()
        left = [k for k in range(len(self._seeds)) if k not in self._given]
        mean_m = np.minimum(self._nearest_m, self._distance_m[left]).mean(-1)
        self._given.append(left[int(np.argmin(mean_m))])
        return self._seeds[self._given[-1]]

    def done(self, seed: int) -> None:
        """There is a demonstration of this start now."""
        self._nearest_m = np.minimum(self._nearest_m, self._distance_m[self._seeds.index(seed)])


class PneutacSim(BaseRobot):
    """A simulated robot that moves on by one control step of its station with every action that it is sent.

    An action is a dict of `features.action_names`, with `--robot.bend=true` with `bend.pos` in place of the
    pressure, clipped to its limits. With the additional key `reset` (true) the scene starts afresh after the
    step, as a person would put the object back between demonstrations, where nobody announces episodes. A
    pose (`ee_x.pos`, `ee_y.pos`, `ee_z.pos` and pressures), as lerobot-rollout sends it between episodes and
    at the end, moves the arm one step towards that pose; at the task's home it starts the scene afresh.

    Every episode that LeRobot announces starts with a fresh scene.

    Attributes:
        recording: whether an episode that LeRobot has announced is going on; None where it announced none.
        scenes: how many scenes were started, the present one included.
        successes: for each finished episode whether the task was done at its end.
        cameras: the tactile image, and the scene cameras' options; their pictures come with the observation.
            LeRobot counts them and writes PNG files in as many times four threads.
    """

    config_class = PneutacSimConfig

    def __init__(self, config: PneutacSimConfig):
        super().__init__(config)
        self.config = config
        _made.add(self)
        self.cameras = {IMAGE_NAME: None, **config.cameras}
        self._image_shape = tactile_shape("robot.twin", config.twin)
        self.world = None
        self.recording: bool | None = None
        self.scenes = 0
        self.successes: list[bool] = []
        self._outcome: str | None = None
        self._hooks = EpisodeHooks(config.control_hz, self, waits=True)
        self._places = Places.of(self.chambers)

    @property
    def image_shape(self) -> tuple[int, int, int]:
        """Height, width and channels of the tactile image, those of the twin's sensor."""
        return self._image_shape

    @property
    def observation_features(self) -> dict[str, type | tuple]:
        """Those of every robot of the plugin, then the scene cameras."""
        return super().observation_features | {n: (*size, 3) for n, size in self.config.sizes.items()}

    @property
    def is_connected(self) -> bool:
        return self.world is not None

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Builds the world and starts the first episode."""
        self.recording = None
        self._hooks.connect()
        logger.info(
            "Building the world; on a new machine this compiles for about a minute, once. If it is stopped,"
            " what is compiled by then stays."
        )
        self.world = _world(self.config)
        self.world.widen_starts(self.config.start_width)
        self.world.touch.prepare()
        self._scene = SceneCameras(self.world, self.config.sizes, self.config.randomise_look)
        self._spread = self._starts()
        self._begin(self.config.seed)
        _connected.append(self)

    @check_if_not_connected
    def get_observation(self) -> dict[str, Any]:
        """State (floats), tactile image uint8 (H, W, 3), and what else was asked for."""
        self._hooks.observed()
        state = zip(self.state_names, self._observation.state.tolist(), strict=True)
        touch: dict[str, Any] = {IMAGE_NAME: self._observation.tactile}
        if self.config.tactile_points:
            touch[POINTS_KEY] = tactile_points(self.world).ravel()
        return dict(state) | touch | self._scene.pictures()

    @override
    def send_action(self, action: dict[str, Any]) -> dict[str, float]:
        """Moves the world on by one control step; returns the action that was carried out, after clipping.

        Raises InputError where keys are missing, or a value is not a finite number.
        """
        sent = super().send_action(action)
        if action.get("reset"):
            self.reset()
        return sent

    @override
    def _carry_out(self, values: np.ndarray, pose: bool) -> np.ndarray:
        (self._go_to if pose else self._step)(values)
        return self.world.command

    @override
    def announced(self, begins: bool) -> None:
        """An episode begins, with a fresh scene; or it has ended, and how it went is logged."""
        if begins:
            self._outcome = None
        if self.is_connected and begins and self._moved:
            self._begin()
        elif self.is_connected and self.recording and not begins:
            self._log_outcome()
        self.recording = begins

    def reset(self) -> None:
        """Starts the scene afresh at the next random start, and logs how the episode went."""
        if self.recording is not False:  # what goes on between episodes is none
            self._log_outcome()
        self._begin()

    def _log_outcome(self) -> None:
        self.successes.append(bool(self.world.success))
        logger.info(
            "Touch in %d of %d frames; %s.",
            *(self._touched, self._frames),
            self.world.failure or ("the task is done" if self.successes[-1] else "the task is not done"),
        )
        if self.successes[-1] and self._spread:
            self._spread.done(self._seed)

    @property
    @override
    def outcome(self) -> str | None:
        return self._outcome

    @check_if_not_connected
    def disconnect(self) -> None:
        """Frees the world; logs how an episode went that nobody announced, as of lerobot-replay."""
        if self.recording is None and self._frames:
            self._log_outcome()
        _connected.remove(self)
        self._hooks.disconnect()
        self.world.close()
        self.world = None

    def _begin(self, seed: int | None = None) -> None:
        if self._spread:
            self._seed = seed = self._spread.next()
        self._observation = self.world.reset(seed)
        self._scene.begin(seed)
        self._moved, self._touched, self._frames = False, 0, 0
        self.scenes += 1
        if self.config.bend:
            conditions = getattr(self.world, "conditions", {})
            self._bend = BendCommands(twin_of(self.config.twin), conditions, self.world.dt_s)

    def _starts(self) -> SpreadStarts | None:
        """Random starts to choose from, by the places of flange (half of the weight) and objects."""
        places = {}
        for seed in np.random.default_rng(self.config.seed).integers(2**31, size=self.config.spread).tolist():
            self.world.reset(seed)
            objects = self.world.data.geom_xpos[self.world.model.geom_group == OBJECT_GROUP]
            places[seed] = np.concatenate([objects, np.tile(self.world.flange_m, (len(objects), 1))])
        return SpreadStarts(places) if places else None

    def _step(self, action) -> None:
        self._observation = self.world.step(action)
        self._moved = True
        self._frames += 1
        self._touched += bool(self._observation.state[self._places.area] >= SPECKS)
        if self.recording and self._outcome in (None, NOT_DONE):
            self._outcome = self.world.failure or (DONE if self.world.success else NOT_DONE)
        if self.config.bend:
            self._bend.sent(float(self.world.command[3]))

    def _go_to(self, pose: np.ndarray) -> None:
        """One step towards a pose: (3 + C,) flange position m, pressures kPa."""
        task, base_m = self.world.task, self.world.arm.base_m  # poses are in the arm's frame
        away = pose[:3] - (self.world.home_m - base_m)
        away[1] -= np.clip(away[1], min(task.starts_m), max(task.starts_m))
        jitter_m = np.linalg.norm(self.config.start_width * WIDER_M)
        if np.linalg.norm(away) < HOME_RADIUS_M + jitter_m:  # of the line on which all starts lie
            if self._moved:
                self.reset()
            return
        velocity = (pose[:3] - self._observation.state[self._places.ee]) / self.world.dt_s
        limits = features.action_limits(self.world.pressure_range_kpa, self.chambers)
        self._step(np.clip(np.append(velocity, pose[3:]), *limits))


def made_robot() -> PneutacSim | None:
    """A simulated robot that exists in this process, connected or not yet."""
    return _connected[-1] if _connected else next(iter(_made), None)


def connected_robot() -> PneutacSim:
    """The simulated robot that is connected in this process; raises InputError where none is."""
    if not _connected:
        raise InputError(
            "pneutac_scripted drives a simulated robot of the same process and none is connected; use"
            " --robot.type=pneutac_sim."
        )
    return _connected[-1]


def _world(config: PneutacSimConfig):
    station = station_of(config.station)
    if config.standin:
        from lerobot_robot_pneutac.standin.world import StandinWorld

        return StandinWorld(config.task, station=station, **standin_sensor(config.twin))
    from pneutac_sim.world.world import World

    twin = Twin.load(config.twin) if config.twin else None
    more = {"pressure_range_kpa": config.pressure_range_kpa, "station": station}
    return World(config.task, twin, "image", config.fidelity, config.conditions, config.render, **more)
