"""Options of the environments `pneutac` and `pneutac_standin` for lerobot-eval and lerobot-train."""

import runpy
from dataclasses import dataclass, field
from pathlib import Path
from typing import override

from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig, HubEnvConfig
from lerobot.utils.constants import ACTION, OBS_IMAGES, OBS_STATE, OBS_STR

# Both register the Gymnasium ids. Workers of lerobot-eval get them by unpickling this module's config.
import lerobot_robot_pneutac.standin  # noqa: F401
import pneutac_sim  # noqa: F401
from lerobot_robot_pneutac import options
from lerobot_robot_pneutac.options import refuse_if, standin_sensor, station_of
from pneutac_sim import features as own
from pneutac_sim.features import CAMERA_SHAPE, IMAGE_NAME, POINTS_KEY, action_names, state_names
from pneutac_sim.twin import Twin

TACTILE = f"pixels/{IMAGE_NAME}"
MOST_LENGTH = 10**6  # control steps of a trial: 18 h


@dataclass
class PneutacTaskConfig(options.SceneOptions, EnvConfig):
    """What every environment of this robot has."""

    task: str | None = "switch"  # `switch`, `egg`, `card`, `fruit`, `cable`, `button`, or your own
    fps: int = 0  # control rate, Hz; if omitted, the station's, and there is no other
    # control steps after which a trial counts as failed; if omitted, those of 20 s
    episode_length: int | None = None
    # scene cameras besides the tactile image, such as [front,wrist]
    cameras: list[str] = field(default_factory=list)
    observation_height: int = CAMERA_SHAPE[0]  # rows of their pictures, px
    observation_width: int = CAMERA_SHAPE[1]  # columns of their pictures, px
    features: dict[str, PolicyFeature] = field(
        default_factory=lambda: {
            ACTION: PolicyFeature(FeatureType.ACTION, (len(own.ACTION_NAMES),)),
            "agent_pos": PolicyFeature(FeatureType.STATE, (len(own.STATE_NAMES),)),
            TACTILE: PolicyFeature(FeatureType.VISUAL, own.IMAGE_SHAPE),
        }
    )
    features_map: dict[str, str] = field(
        default_factory=lambda: {
            ACTION: ACTION,
            "agent_pos": OBS_STATE,
            TACTILE: f"{OBS_IMAGES}.{IMAGE_NAME}",
        }  # fmt: skip
    )

    def __post_init__(self):
        if self.task is not None or not isinstance(self, HubEnvConfig):
            options.check_choice("env.task", self.task, own.task_names())
        options.check_range("--env.episode_length", self.episode_length, 1, MOST_LENGTH)
        options.check_scene("env", self.start_width, self._sizes)
        if self.tactile_points:
            self.features[POINTS_KEY] = PolicyFeature(FeatureType.STATE, (own.POINTS_SIZE,))
            self.features_map[POINTS_KEY] = f"{OBS_STR}.{POINTS_KEY}"
        for name, size in self._sizes.items():
            key = f"pixels/{name}"
            self.features[key] = PolicyFeature(FeatureType.VISUAL, (*size, 3))
            self.features_map[key] = f"{OBS_IMAGES}.{name}"

    @property
    def gym_kwargs(self) -> dict:
        given = {"cameras": self._sizes, "randomise_look": self.randomise_look}
        given |= {"points": self.tactile_points, "start_width": self.start_width}
        return {"max_episode_steps": self.episode_length} | {k: v for k, v in given.items() if v}

    def _set_tactile(self, twin: Path | None) -> None:
        """Sets the size of the tactile image to that of the twin's sensor."""
        shape = options.tactile_shape("env.twin", twin)
        self.features[TACTILE] = PolicyFeature(FeatureType.VISUAL, shape)

    def _set_station(self, file: Path | None, chambers: int = 1) -> None:
        """Sets the size of state and action by the station's arm and the finger, and the control rate."""
        options.check_station("env.station", file)
        station = station_of(file)
        size = (len(state_names(station.joints, chambers)),)
        self.features["agent_pos"] = PolicyFeature(FeatureType.STATE, size)
        self.features[ACTION] = PolicyFeature(FeatureType.ACTION, (len(action_names(chambers)),))
        self.fps = self.fps or station.control_hz
        refuse_if(
            self.fps != station.control_hz,
            f"--env.fps is {self.fps}; the simulated robot is controlled at {station.control_hz} Hz, the "
            f"control_hz of its station.",
        )
        self.episode_length = self.episode_length or station.steps(own.TRIAL_S)

    @property
    def _sizes(self) -> dict[str, tuple[int, int]]:
        return dict.fromkeys(self.cameras, (self.observation_height, self.observation_width))


def _station(file: Path | None) -> dict:
    return {} if file is None else {"station": station_of(file)}


@EnvConfig.register_subclass("pneutac")
@dataclass
class PneutacEnvConfig(options.WorldOptions, PneutacTaskConfig):
    """A manipulation task on the simulated robot."""

    # folder of the finger's twin, or of an arm's of several chambers; default the built-in finger's
    twin: Path | None = None

    def __post_init__(self):
        super().__post_init__()
        options.check_world("env", self)
        self._set_station(self.station, options.chambers_of("env.twin", self.twin))
        self._set_tactile(self.twin)
        if self.render == "splats":
            options.check_gl("env.render")

    @property
    def package_name(self) -> str:
        return "pneutac_sim"

    @property
    def gym_kwargs(self) -> dict:
        twin = {"twin": Twin.load(self.twin)} if self.twin else {}
        own = {"fidelity": self.fidelity, "conditions": self.conditions, "render": self.render}
        own |= {"pressure_range_kpa": self.pressure_range_kpa}
        return super().gym_kwargs | own | twin | _station(self.station)


@EnvConfig.register_subclass("pneutac_hub")
@dataclass
class PneutacHubConfig(PneutacTaskConfig, HubEnvConfig):
    """Tasks by a repo on the Hub whose `env.py` makes them, such as our folder `envhub`.

    A folder of this machine is tried without the Hub: LeRobot asks it only where `hub_path` is set.

    Attributes:
        hub_path: such as `you/pneutac-switch` or `you/pneutac-switch@revision`; or a folder with an `env.py`,
            which moves to `folder`.
    """

    task: str | None = None  # one task of the repo's; all of them if omitted
    folder: Path | None = None  # the repo before it is uploaded; its `env.py` is executed

    def __post_init__(self):
        super().__post_init__()
        if self.hub_path and Path(self.hub_path).is_dir():
            self.folder, self.hub_path = Path(self.hub_path), None
        refuse_if(
            self.folder is not None and not (self.folder / "env.py").is_file(),
            f"--env.hub_path: the folder '{self.folder}' has no env.py; give one like envhub.",
        )
        refuse_if(
            self.fps != 0, f"--env.fps is {self.fps}; the repo's env.py says the rate, so leave it out."
        )
        refuse_if(
            not (self.hub_path or self.folder),
            "--env.hub_path is missing; give the repo of an env.py, such as you/pneutac-switch, or a folder.",
        )

    @override
    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict:
        """The environments of the folder's `env.py`, as LeRobot makes those of a repo."""
        return runpy.run_path(str(self.folder / "env.py"))["make_env"](n_envs, use_async_envs, self)


@EnvConfig.register_subclass("pneutac_standin")
@dataclass
class PneutacStandinConfig(PneutacTaskConfig):
    """The same tasks on the stand-in for reality, which no twin describes beforehand."""

    # folder of the twin that was calibrated on it; as on the real robot, its gel's contact threshold says
    # which pixels are in contact, and its images have their size; nothing else comes from it
    twin: Path | None = None
    # file `station.yaml` of arm, workspace, mount and control rate; default the paper's
    station: Path | None = None

    def __post_init__(self):
        super().__post_init__()
        options.check_twin_folder("env.twin", self.twin)
        self._set_tactile(self.twin)
        self._set_station(self.station)

    @property
    def package_name(self) -> str:
        return "pneutac_standin"

    @property
    def gym_kwargs(self) -> dict:
        return super().gym_kwargs | standin_sensor(self.twin) | _station(self.station)
