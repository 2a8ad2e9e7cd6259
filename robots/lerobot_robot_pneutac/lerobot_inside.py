"""All that PneuTac uses of LeRobot's datasets and commands beyond what their packages export.

Tried on LeRobot 0.6.1 (`TRIED_ON`). A new LeRobot is tried by the tests of this module's users: episode hooks
(`robots.episode_hooks`) and the repair of killed recordings (`pneutac_datasets.demonstrations.repair`). What
would make each part superfluous stands in docs/upstream.
"""

import contextlib
import importlib
import importlib.metadata
import logging
import re
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from shlex import quote
from typing import override

from draccus.utils import DecodingError, ParsingError
from huggingface_hub.constants import HF_HUB_OFFLINE
from lerobot.configs import PreTrainedConfig
from lerobot.configs.parser import get_cli_overrides
from lerobot.utils.constants import ACTION, HF_LEROBOT_HOME, OBS_STATE
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from safetensors import SafetensorError, safe_open

from pneutac_sim.dataset_files import ROBOT, Files
from pneutac_sim.errors import InputError, printable, unknown_names
from pneutac_sim.features import CHAMBERS, action_names, library_tasks, state_names
from pneutac_sim.files import check_writable, inside, read_json, refuse_pointer
from pneutac_sim.pace import DONE, info_file, read_info, read_outcomes, refuse_version
from pneutac_sim.twin import Twin

TRIED_ON = "0.6.1"
KNOWN = TRIED_ON.rpartition(".")[0]  # series of LeRobot whose inside `LeRobotHooks` knows
# So lerobot-record and lerobot-rollout announce that an episode begins, and that one has ended.
BEGINS, ENDS = "Recording episode", ("Reset the environment", "Stop recording")
ROLLOUT_HZ = 30.0  # of lerobot-rollout where no --fps is given

logger = logging.getLogger(__name__)


class LeRobotHooks(logging.Handler):
    """Hooks into LeRobot, which has none of its own.

    LeRobot stores frame / fps as a frame's time, and observes a robot in the pause between episodes too. What
    it announces in the log, and how many frames it counts, show which observations belong to an episode: the
    first ones after the last announcement. It makes the robot, then the dataset, and connects the robot last.

    `announced` is called with whether an episode begins (or else has ended), `write_json` in place of the
    function that writes the files of a dataset's `meta`.
    """

    def __init__(self, announced: Callable[[bool], None], write_json: Callable[[dict, Path], None]):
        super().__init__(logging.INFO)
        self._announced, self._write_json, self._warned = announced, write_json, False

    def install(self) -> bool:
        """Whether LeRobot's datasets are in use here; they are written by `write_json` from now on.

        In LeRobot's client of remote inference every observation is used from now on.
        """
        io_utils = sys.modules.get("lerobot.datasets.io_utils")
        client = sys.modules.get("lerobot.async_inference.helpers")
        if io_utils is None and client is None:
            return False
        version = importlib.metadata.version("lerobot")
        if not version.startswith(f"{KNOWN}."):
            if not self._warned:
                logger.warning(
                    "LeRobot %s is unknown to this version of PneuTac, so the rate of datasets is not"
                    " checked, no station and no pace are stored with them, and a policy server may drop"
                    " observations of slow changes; install LeRobot %s, or a newer PneuTac.",
                    *(version, KNOWN),
                )
            self._warned = True
            return False
        if client is not None:
            client.TimedObservation.must_go = property(lambda _: True, _must_go)
        if io_utils is None:
            return False
        io_utils.write_json = self._write_json
        return True

    def listen(self) -> None:
        """From now on episodes are noticed, where the hooks can be installed."""
        if self.install():
            logging.getLogger().addHandler(self)

    def ignore(self) -> None:
        logging.getLogger().removeHandler(self)

    @override
    def emit(self, record: logging.LogRecord) -> None:
        message = record.getMessage()
        if message.startswith((BEGINS, *ENDS)):
            self._announced(message.startswith(BEGINS))


def _must_go(observation, _) -> None:
    """Whatever the client sets, the server shall use an observation, and none is dropped as similar.

    The server drops one whose state lies within 1 of the last that it used, by the norm over all numbers. In
    rad, m and kPa few motions are as large, and creep is not; the robot ran out of actions and waited.
    """
    vars(observation)["must_go"] = True


def paced() -> bool:
    """Whether a command of LeRobot's runs here; those keep time by the clock."""
    program = Path(sys.argv[0])
    return program.name.startswith("lerobot-") or "lerobot" in program.parts


# Errors that are meant for who typed the command, and those of what is to be downloaded.
_OF_USERS = (InputError, DecodingError, DeviceNotConnectedError, DeviceAlreadyConnectedError)
_OF_HUB = ("huggingface_hub", "httpx", "urllib")  # packages whose errors those are


NO_FFMPEG = (
    "torchcodec finds no FFmpeg, so videos are read through PyAV, which is installed: nothing is lost. With"
    " FFmpeg's libraries installed (apt install ffmpeg) they are read faster."
)


class OneLine(logging.Filter):
    """Says once, and in one line, what LeRobot logs with the linker's hundred where FFmpeg is missing."""

    shown = False

    @override
    def filter(self, record: logging.LogRecord) -> bool:
        if "'torchcodec' is installed but cannot be loaded" not in record.getMessage():
            return True
        record.msg, record.args, again, self.shown = NO_FFMPEG, (), self.shown, True
        return not again


def prepare() -> None:
    """Has a command of LeRobot's refuse bad folders at once, and end in one sentence where its user erred.

    It imports the plugin before it reads its options, and would end in a traceback of anything raised later.

    Raises SystemExit: a dataset that is to be read is none, or a folder that is to be written cannot be.
    """
    logging.getLogger("lerobot.utils.import_utils").addFilter(OneLine())
    if not paced():
        return
    shown = sys.excepthook

    def one_sentence(kind: type[BaseException], error: BaseException, trace) -> None:
        sentence = explained(error)
        if sentence is None:
            shown(kind, error, trace)
        else:
            sys.stderr.write(f"error: {sentence}\n")

    sys.excepthook = one_sentence
    try:
        _check_counts(_options())
        _check_folders(_options())
        _check_rates(_options())
    except InputError as e:
        sys.exit(f"error: {e}")


def _options() -> dict[str, str]:
    """What the command line gives, by option; of a training that goes on also the dataset of its file."""
    words, out = sys.argv[1:], {}
    for word, following in zip(words, [*words[1:], "--"], strict=False):
        name, given, value = word.partition("=")
        if name.startswith("--") and (given or not following.startswith("--")):
            out[name.removeprefix("--")] = value if given else following
    if (file := _training_file(out)) and file.is_file():
        with suppress(InputError, AttributeError):  # which LeRobot says
            stored = read_json(file).get("dataset", {}).items()
            out = {f"dataset.{k}": str(v) for k, v in stored if k in STORED and v is not None} | out
    return out


STORED = ("repo_id", "root", "episodes")  # of a dataset in a train_config.json


def _training_file(options: dict[str, str]) -> Path | None:
    """The train_config.json by which a training is to go on; None of another command."""
    if "train" not in Path(sys.argv[0]).stem or "config_path" not in options:
        return None
    path = Path(options["config_path"])
    return path if path.is_file() else path / "train_config.json"


def _records(options: dict[str, str]) -> bool:
    """Whether the command makes a new dataset."""
    makes = Path(sys.argv[0]).stem.replace("_", "-") in ("lerobot-record", "lerobot-rollout")
    return makes and options.get("resume") != "true"


COUNTS = ("steps", "batch_size", "eval.n_episodes", "dataset.num_episodes")


def _check_counts(options: dict[str, str]) -> None:
    """Raises InputError where there is nothing to do, and LeRobot would divide by the number."""
    for name in COUNTS:
        if re.fullmatch(r"0|-\d+", value := options.get(name, "")):
            raise InputError(f"--{name} is {value}; it must be 1 or more.")


def _check_rates(options: dict[str, str]) -> None:
    """Raises InputError where actions would come at another rate than the robot's control rate."""
    from pneutac_sim.world.station import Station  # MuJoCo

    program, root = Path(sys.argv[0]).stem, options.get("dataset.root", "")
    if options.get("robot.type") not in ("pneutac", "pneutac_sim") or "config_path" in options:
        return
    station = options.get("robot.station")
    try:
        hz = (Station.load(station) if station else Station()).control_hz
    except InputError:  # which the option's own check says
        return
    fps, name, remedy = hz, "", ""
    if "rollout" in program:
        name, remedy = "--fps is", f"give --fps={hz}, or --robot.station=FILE with that control_hz"
        with suppress(ValueError):  # of what is no number, as its parser says
            fps = float(options.get("fps", ROLLOUT_HZ))
    elif "replay" in program and (Path(root) / "meta" / "info.json").is_file():
        name, fps = f"--dataset.root={root} has the rate", read_info(info_file(root)).get("fps", hz)
        remedy = "give --robot.station=FILE, the station.yaml of its recording"
    if fps != hz:
        raise InputError(f"{name} {fps:g} Hz and the robot is controlled at {hz} Hz; {remedy}.")


def _check_folders(options: dict[str, str]) -> None:
    """Raises InputError where a folder is unfit; LeRobot would notice after its work, or not say which."""
    if out := options.get("output_dir"):
        check_writable(Path(out), f"--output_dir={out}")
        for name in ("dataset.root", "policy.path"):
            if (source := options.get(name)) and Path(source).is_dir() and inside(Path(source), Path(out)):
                raise InputError(f"--output_dir={out} lies in --{name}={source}; give another folder.")
    policy = Path(options.get("policy.path", ""))
    if (policy.is_absolute() or policy.is_dir()) and (fault := _fault_of_policy(options)):
        raise InputError(fault)
    if options.get("resume") == "true" and (file := _training_file(options)):
        if not file.is_file():
            raise InputError(
                f"--config_path={options['config_path']} holds no train_config.json; give that of a"
                " checkpoint, as in --config_path=OUTPUT/checkpoints/last/pretrained_model/train_config.json."
            )
        check_policy(file.parent)
    if _records(options) and not options.get("dataset.single_task", "given").strip():
        raise InputError("--dataset.single_task is blank; give the instruction, such as 'flip the switch'.")
    root, own = options.get("dataset.root"), HF_LEROBOT_HOME / options.get("dataset.repo_id", "")
    if not root and not _records(options) and (own / "meta" / "info.json").is_file():
        root = str(own)
    if not root:
        return
    if _records(options):
        if not Path(root).exists():
            check_writable(Path(root), f"--dataset.root={root}")
            return
        empty = False
        with suppress(InputError):
            empty = not read_info(info_file(root)).get("total_episodes")
        remedy = "it holds no episode: delete it" if empty else "--resume=true adds episodes to a dataset"
        raise InputError(f"--dataset.root={root} exists; give a new folder ({remedy}).")
    try:
        file = info_file(root)
    except InputError as e:
        if HF_HUB_OFFLINE:
            raise InputError(f"--dataset.root: {e}") from e
        return  # to be downloaded
    refuse_version(file, info := read_info(file))
    # Of other robots LeRobot may read what is no demonstration's.
    if info.get("robot_type") == ROBOT or options.get("policy.type") == "pneutac_bc":
        files = Files(root)
        files.refuse_damaged()
        if any(name in Path(sys.argv[0]).stem for name in ("train", "replay")):
            files.refuse_not_finite()
        if "train" in Path(sys.argv[0]).stem:
            _name_failed(Path(root), options.get("dataset.episodes", ""), info.get("total_episodes", 0))


def _name_failed(root: Path, chosen: str, total: int) -> None:
    """Warns of demonstrations that failed and are trained on; `chosen` lists episodes, all where empty."""
    numbers = set(map(int, re.findall(r"\d+", chosen))) or set(range(total))
    outcomes = read_outcomes(root / "meta")
    failed = sorted(e for e in numbers if outcomes.get(e, DONE) != DONE)
    if failed:
        each = ", ".join(f"{e} ({outcomes[e]})" for e in failed)
        others = [str(e) for e in sorted(numbers - set(failed))]
        logging.getLogger(__name__).warning(
            "%s: failed demonstrations are trained on, episode%s %s; leave them out by"
            ' --dataset.episodes="[%s]".',
            *(printable(str(root)), "s" * (len(failed) > 1), printable(each)),
            ",".join(others[:10]) + ",..." * (len(others) > 10),
        )


def explained(error: BaseException) -> str | None:
    """The sentence for an error that the user of a LeRobot command can correct; None for any other."""
    parsed = False
    while isinstance(error, ParsingError) and isinstance(error.__cause__, Exception):
        error, parsed = error.__cause__, True
    if isinstance(error, _OF_USERS):
        return printable(str(error))
    options = _options()
    frames = traceback.extract_tb(error.__traceback__)
    files = [frame.filename.replace("\\", "/") for frame in frames]
    reason = " ".join(str(error).split())
    of_hub = type(error).__module__.partition(".")[0] in _OF_HUB
    usual = of_hub or isinstance(error, OSError | ValueError | NotImplementedError)
    if usual and not _records(options) and any("/lerobot/datasets/" in file for file in files):
        where = f"{files[-1].rpartition('/site-packages/')[2]}, line {frames[-1].lineno}"
        return _fault_of_dataset(options, f"{type(error).__name__} in {where}: {reason}")
    if (of_hub or isinstance(error, FileNotFoundError)) and (fault := _fault_of_policy(options)):
        return fault
    if of_hub:
        return printable(f"What LeRobot wanted to download was not reached: {reason}")
    given = any(len(value) > 1 and value in reason for value in options.values())
    return printable(reason) if usual and (parsed or given or "/lerobot/configs/" in files[-1]) else None


def _fault_of_policy(options: dict[str, str]) -> str | None:
    """What is wrong with the folder of a policy; None where it holds one, or the Hub may have it."""
    path = options.get("policy.path")
    if not path:
        return None
    if (Path(path) / "config.json").is_file():
        try:
            _refuse_other(check_policy(Path(path)), options)
        except InputError as e:
            return f"--policy.path: {e}"
        return None
    return printable(
        f"--policy.path={path} holds no policy (no config.json); give a folder `pretrained_model` of"
        " lerobot-train, or the name of a policy on the Hub that can be reached."
    )


def _refuse_other(policy: PreTrainedConfig, options: dict[str, str]) -> None:
    """Raises InputError where a policy is given to a robot of another rate, body or camera, or task."""
    from pneutac_sim.gel.model import GelModel
    from pneutac_sim.world.station import Station  # MuJoCo
    from pneutac_sim.world.tasks import tasks_named

    for group in ("env", "robot"):
        given = {k.removeprefix(f"{group}."): v for k, v in options.items() if k.startswith(f"{group}.")}
        if given.get("type") not in ("pneutac", "pneutac_sim", "pneutac_standin"):
            continue
        try:
            station = Station.load(given["station"]) if "station" in given else Station()
            twin = Twin.load(given["twin"]) if "twin" in given else Twin.builtin()
        except InputError:  # which the option's own check says
            continue
        if (own := getattr(policy, "control_hz", None) or station.control_hz) != station.control_hz:
            raise InputError(
                f"the policy was trained at {own} Hz and the robot is controlled at {station.control_hz} Hz;"
                f" give --{group}.station=FILE, the station.yaml of its demonstrations, or train it again."
            )
        if group == "env" or given["type"] == "pneutac_sim":
            standin = given["type"] == "pneutac_standin" or given.get("standin", "").lower() == "true"
            chambers = 1 if standin else CHAMBERS.get(twin.device, 1)
            here = len(state_names(station.joints, chambers)), len(action_names(chambers))
            features = {**(policy.input_features or {}), **(policy.output_features or {})}
            there = tuple(
                features[key].shape[0] if key in features else size
                for key, size in zip((OBS_STATE, ACTION), here, strict=True)
            )
            if there != here:
                raise InputError(
                    f"the policy takes {there[0]} numbers of state and gives {there[1]} of action, and the"
                    f" robot has {here[0]} and {here[1]}: an arm of other joints, or other chambers; give"
                    f" --{group}.twin and --{group}.station of its demonstrations, or train it again."
                )
            if check_size := getattr(policy, "check_size", None):
                height, width, colours = GelModel.from_twin(twin).rest_image.shape
                check_size((colours, height, width), f"--{group}.twin")
            asked = {f"{group}.task": given.get("task", "switch")}
        else:
            asked = {k: options[k] for k in ("task", "dataset.single_task") if k in options}
        trains = "train" in Path(sys.argv[0]).stem  # for the task of its dataset
        texts = [] if trains else getattr(policy, "instructions", None) or []
        known = [tasks_named(text) for text in texts]
        for name, task in asked.items():
            wanted = [task] if name.startswith(group) else tasks_named(task)
            if not wanted or not {*wanted} <= library_tasks():  # own ones may have any instruction
                continue
            if known and all(named and not {*named} & {*wanted} for named in known):
                raise InputError(
                    f"the policy was trained for '{texts[0]}' and --{name} is '{task}'; give its own task, or"
                    " --policy.instructions=null to try it there."
                )


def check_policy(folder: Path) -> PreTrainedConfig:
    """A policy's options; InputError where one of its files is missing or damaged, before LeRobot's work."""
    config, weights = folder / "config.json", folder / "model.safetensors"
    again = "copy the whole folder again that lerobot-train wrote"
    kind = read_json(config).get("type")
    for fault in unknown_names([kind], PreTrainedConfig.get_known_choices(), "policy"):
        raise InputError(f"{config}: field 'type': {fault}")
    for file in folder.glob("policy_*processor.json"):
        read_json(file)
    try:
        options = PreTrainedConfig.from_pretrained(folder, cli_overrides=get_cli_overrides("policy") or [])
    except Exception as error:  # what an option's own type raises, too
        cause: BaseException = error
        while cause.__cause__ is not None and not isinstance(cause, _OF_USERS):
            cause = cause.__cause__
        reason = " ".join(str(cause).split()).rstrip(".")
        raise InputError(f"{config}: {reason}; {again}, or train again with this version.") from error
    if (folder / "adapter_config.json").is_file():
        return options  # its weights are another policy's and an adapter
    if not weights.is_file():
        raise InputError(f"{weights} is missing; {again}.")
    refuse_pointer(weights)
    try:
        with safe_open(weights, "np"):
            pass
    except (SafetensorError, OSError) as e:
        raise InputError(f"{weights} is damaged ({e}); {again}.") from e
    return options


def _fault_of_dataset(options: dict[str, str], reason: str) -> str:
    """What is wrong with the dataset that the command line names and LeRobot did not read."""
    repo_id = options.get("dataset.repo_id", "")
    root = Path(options.get("dataset.root") or HF_LEROBOT_HOME / repo_id)
    try:
        info = read_info(info_file(root))
        refuse_version(info_file(root), info)
    except InputError as e:
        return f"Dataset '{repo_id}': {e}"
    episodes = options.get("dataset.episodes", options.get("dataset.episode", ""))
    total = info.get("total_episodes", 0)
    missing = [e for e in map(int, re.findall(r"-?\d+", episodes)) if not 0 <= e < total]
    if missing:
        return f"{root} has no episode {missing[0]}; give one of 0 to {total - 1}."
    return printable(
        f"LeRobot fails at the dataset {root} ({reason}); `pneutac check {quote(str(root))}` lists what is"
        " wrong with it."
    )


# Functions by which LeRobot describes what it has recorded, by their module in `lerobot.datasets`; repair and
# augmentation call them again. They are imported when asked for: robots do without, and they take seconds.
_OF_DATASETS = {
    "DatasetInfo": "utils",
    "RunningQuantileStats": "compute_stats",
    "StreamingVideoEncoder": "video_utils",
    "aggregate_stats": "compute_stats",
    "cast_stats_to_numpy": "io_utils",
    "compute_episode_stats": "compute_stats",
    "decode_video_frames": "video_utils",
    "get_hf_features_from_features": "feature_utils",
    "get_video_info": "video_utils",
    "load_info": "io_utils",
    "update_chunk_file_indices": "utils",
    "write_info": "io_utils",
    "write_stats": "io_utils",
    "write_table_one_row_group_per_episode": "io_utils",
    "write_tasks": "io_utils",
}


@contextlib.contextmanager
def replaced(module: str, name: str, by: Callable) -> Iterator[None]:
    """While it lasts, a module of LeRobot, or of what it uses, calls this in place of its own `name`."""
    inside = importlib.import_module(module)
    before = getattr(inside, name)
    setattr(inside, name, by)
    try:
        yield
    finally:
        setattr(inside, name, before)


def __getattr__(name: str):
    if name not in _OF_DATASETS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"lerobot.datasets.{_OF_DATASETS[name]}"), name)
