"""The one definition of what a PneuTac robot senses and does, shared by world, environment, robot and policy.

Units: joint angles rad, joint rates rad/s, positions m, contact area a fraction of the image (s/N),
contact pixels log(1 + s), pressure kPa. Actions: end-effector velocity in m/s with orientation held, and
pressure set-point in kPa, of each chamber where the finger has several. The displacement per step is
velocity / control rate, 15 Hz in the paper.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points

import numpy as np

CHAMBERS = {"finger": 1, "arm": 3}  # device to how many
CONTROL_HZ = 15  # the paper's; a `Station` may have another
RATES_HZ = (5, 60)  # lowest and highest: hardware stops 0.25 s after a command, images come at 60 Hz at most
TRIAL_S = 20  # after which a trial has failed
DEMONSTRATION_S = 14  # of an episode of lerobot-record, by default; a search of all lanes takes 15
TASK_NAMES = ("switch", "egg", "card")
TASK_GROUP = "pneutac.tasks"  # entry points by which other packages bring tasks of their own
FIDELITIES = ("surrogate", "mpm", "probe")  # how finger and gel of a world deform
RENDERS = ("mesh", "splats")  # how a world is drawn
IMAGE_SHAPE = (320, 240, 3)  # of the built-in twin's DIGIT; another sensor's images have a size of their own
IMAGE_NAME = "tactile"
SPECKS = 50 / (240 * 320)  # of an image's pixels that a camera's noise alone may show as contact, by far
POINTS_KEY = "tactile.points"  # touch as data; LeRobot puts `observation.` before it
POINTS_SHAPE = (16, 12, 6)  # its rows, columns and values of a point; a millimetre apart on a DIGIT
POINTS_SIZE = 1152  # in observations and datasets they are one vector: LeRobot 0.6 merges nothing else
CAMERA_SHAPE = (240, 320)  # height and width of a scene camera's picture, by default, px

PANDA_JOINTS = 7
_AFTER_JOINTS = ("ee_x.pos", "ee_y.pos", "ee_z.pos", "contact_area.pos", "contact_pixels.pos")
VELOCITY_NAMES = ("dx.vel", "dy.vel", "dz.vel")
PRESSURES = slice(len(VELOCITY_NAMES), None)  # where the set-points are in an action of any finger


@dataclass(frozen=True)
class Places:
    """Where what comes after the joints is in a state (2 N + 5 + C,) of any arm, from its end.

    A state's first entries are the N joints' angles, then their rates.
    """

    ee: slice  # of the flange (3,)
    # area, pixels: of the contact
    area: int
    pixels: int
    pressure: slice  # of the C chambers (C,)

    @classmethod
    def of(cls, chambers: int) -> "Places":
        """Indices in the state of a finger with this number of chambers."""
        return cls(slice(-5 - chambers, -2 - chambers), -2 - chambers, -1 - chambers, slice(-chambers, None))


# The same with a finger of one chamber.
EE, AREA, PIXELS, PRESSURE = slice(-6, -3), -3, -2, -1


def pressure_names(chambers: int = 1) -> tuple[str, ...]:
    """Names of the pressures, in a state and in an action, of a finger of so many chambers."""
    if chambers == 1:
        return ("pressure.pos",)
    return tuple(f"pressure_{i}.pos" for i in range(1, chambers + 1))


def unit_of(name: str) -> str:
    """Unit of a number of the state or of the action, in words."""
    if name.startswith("joint"):
        return "rad" if name.endswith(".pos") else "rad/s"
    if name.startswith("pressure"):
        return "kPa"
    contact = {"contact_area.pos": "share of the image's pixels that are in contact"}
    contact["contact_pixels.pos"] = "log(1 + pixels in contact)"
    return contact.get(name) or ("m/s" if name.endswith(".vel") else "m")


def action_names(chambers: int = 1) -> tuple[str, ...]:
    """Names of the action (3 + C,) of a robot whose finger has C chambers, in order."""
    return (*VELOCITY_NAMES, *pressure_names(chambers))


def chamber_count(names: Iterable[str]) -> int:
    """Chambers of the finger whose pressures are among the names of a state or an action; 1 for none."""
    return sum(re.fullmatch(r"pressure_\d+\.pos", str(n)) is not None for n in names) or 1


def joint_names(joints: int) -> tuple[str, ...]:
    """Names of an arm's joints, from the base on, whatever its own description calls them."""
    return tuple(f"joint_{i}" for i in range(1, joints + 1))


def state_names(joints: int, chambers: int = 1) -> tuple[str, ...]:
    """Names of the state (2 N + 5 + C,) of a robot of N joints whose finger has C chambers, in order."""
    names = joint_names(joints)
    after = (*_AFTER_JOINTS, *pressure_names(chambers))
    return (*(f"{j}.pos" for j in names), *(f"{j}.vel" for j in names), *after)


def state_names_like(names: Iterable[str]) -> tuple[str, ...]:
    """Names of a state with as many joints as these have rates of (none: the Panda's), and their chambers."""
    names = list(names)
    joints = sum(n.startswith("joint_") and n.endswith(".vel") for n in names) or PANDA_JOINTS
    return state_names(joints, chamber_count(names))


def joint_count(size: int, chambers: int = 1) -> int:
    """Joints of the arm whose state has that size; 0 where no arm has such a one."""
    joints, odd = divmod(size - len(_AFTER_JOINTS) - chambers, 2)
    return 0 if odd or joints < 1 else joints


JOINT_NAMES, STATE_NAMES = joint_names(PANDA_JOINTS), state_names(PANDA_JOINTS)  # of the paper's arm
ACTION_NAMES = action_names()  # of the paper's finger

MAX_SPEED_M_S = 0.1
PAPER_LENGTH_MM = 110.0  # of the paper's finger, for which the tasks are laid out
MAX_PRESSURE_KPA = 15.0  # of the paper's finger; another twin has a `pressure_range_kpa` of its own
PAPER_RANGE_KPA = (0.0, MAX_PRESSURE_KPA)


@cache
def task_names() -> tuple[str, ...]:
    """Names of the library's tasks, then of those that installed packages bring; none is loaded."""
    others = {p.name for p in entry_points(group=TASK_GROUP)}
    return (*TASK_NAMES, *sorted(others - set(TASK_NAMES)))


def library_tasks() -> set[str]:
    """Names of the tasks that are the library's own, also where they come by an entry point."""
    own = {p.name for p in entry_points(group=TASK_GROUP) if p.module.startswith("pneutac_sim.")}
    return {*TASK_NAMES, *own}


def action_limits(
    pressure_range_kpa: tuple[float, float], chambers: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest action (3 + C,) float32 as `action_names(C)`, each chamber with that range."""
    low, high = ([pressure] * chambers for pressure in pressure_range_kpa)
    speed = [MAX_SPEED_M_S] * 3
    return np.array([*np.negative(speed), *low], np.float32), np.array([*speed, *high], np.float32)


ACTION_LOW, ACTION_HIGH = action_limits(PAPER_RANGE_KPA)

# Franka Emika Panda joint limits (rad, rad/s) from the manufacturer's published specification.
JOINT_LOW = np.array([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973])
JOINT_HIGH = np.array([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])
JOINT_SPEED = np.array([2.1750, 2.1750, 2.1750, 2.1750, 2.6100, 2.6100, 2.6100])
PAPER_JOINTS = (JOINT_LOW, JOINT_HIGH, JOINT_SPEED)

N_PIXELS = IMAGE_SHAPE[0] * IMAGE_SHAPE[1]


def state_limits(
    pressure_range_kpa: tuple[float, float],
    joints: tuple[np.ndarray, np.ndarray, np.ndarray] = PAPER_JOINTS,
    pixels: int = N_PIXELS,
    chambers: int = 1,
) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest state (2 N + 5 + C,) float32 as `state_names(N, C)`.

    Of a finger's range of pressures, an arm's joints: lowest and highest angle (N,), rad, and highest rate
    (N,), rad/s, and the number of pixels of the tactile image.
    """
    low, high = ([pressure] * chambers for pressure in pressure_range_kpa)
    lowest = np.concatenate([joints[0], -joints[2], [-0.9, -0.9, -0.3, 0.0, 0.0, *low]])
    highest = np.concatenate([joints[1], joints[2], [0.9, 0.9, 1.2, 1.0, np.log1p(pixels), *high]])
    return lowest.astype(np.float32), highest.astype(np.float32)


STATE_LOW, STATE_HIGH = state_limits(PAPER_RANGE_KPA)
