"""The one definition of what a PneuTac robot senses and does, shared by world, environment, robot and policy.

Units: joint angles rad, joint rates rad/s, positions m, contact area a fraction of the image (s/N),
contact pixels log(1 + s), pressure kPa. Actions: end-effector velocity in m/s with orientation held, and
pressure set-point in kPa. The paper's displacement per step is `velocity / CONTROL_HZ`.
"""

from functools import cache
from importlib.metadata import entry_points

import numpy as np

CONTROL_HZ = 15
TRIAL_S = 20  # after which a trial has failed
DEMONSTRATION_S = 14  # of an episode of lerobot-record, where it is not told; a search of all lanes takes 15
TASK_NAMES = ("switch", "egg", "card")
TASK_GROUP = "pneutac.tasks"  # entry points by which other packages bring tasks of their own
FIDELITIES = ("surrogate", "mpm", "probe")  # how finger and gel of a world deform
RENDERS = ("mesh", "splats")  # how a world is drawn
IMAGE_SHAPE = (320, 240, 3)
IMAGE_NAME = "tactile"
CAMERA_SHAPE = (240, 320)  # height and width of a scene camera's picture, where they are not told, px

JOINT_NAMES = tuple(f"joint_{i}" for i in range(1, 8))
STATE_NAMES = (
    *(f"{j}.pos" for j in JOINT_NAMES),
    *(f"{j}.vel" for j in JOINT_NAMES),
    "ee_x.pos",
    "ee_y.pos",
    "ee_z.pos",
    "contact_area.pos",
    "contact_pixels.pos",
    "pressure.pos",
)
ACTION_NAMES = ("dx.vel", "dy.vel", "dz.vel", "pressure.pos")

MAX_SPEED_M_S = 0.1
MAX_PRESSURE_KPA = 15.0  # of the paper's finger; another twin has a `pressure_range_kpa` of its own
PAPER_RANGE_KPA = (0.0, MAX_PRESSURE_KPA)


@cache
def task_names() -> tuple[str, ...]:
    """Names of the library's tasks, then of those that installed packages bring; none is loaded."""
    others = {p.name for p in entry_points(group=TASK_GROUP)}
    return (*TASK_NAMES, *sorted(others - set(TASK_NAMES)))


def action_limits(pressure_range_kpa: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest action (4,) float32 as `ACTION_NAMES`, of a finger with that range of pressures."""
    low, high = pressure_range_kpa
    speed = [MAX_SPEED_M_S] * 3
    return np.array([*np.negative(speed), low], np.float32), np.array([*speed, high], np.float32)


ACTION_LOW, ACTION_HIGH = action_limits(PAPER_RANGE_KPA)

# Franka Emika Panda joint limits (rad, rad/s) from the manufacturer's published specification.
JOINT_LOW = np.array([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973])
JOINT_HIGH = np.array([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])
JOINT_SPEED = np.array([2.1750, 2.1750, 2.1750, 2.1750, 2.6100, 2.6100, 2.6100])

N_PIXELS = IMAGE_SHAPE[0] * IMAGE_SHAPE[1]


def state_limits(pressure_range_kpa: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest state (20,) float32 as `STATE_NAMES`, of a finger with that range of pressures."""
    low, high = pressure_range_kpa
    lowest = np.concatenate([JOINT_LOW, -JOINT_SPEED, [-0.9, -0.9, -0.3, 0.0, 0.0, low]])
    highest = np.concatenate([JOINT_HIGH, JOINT_SPEED, [0.9, 0.9, 1.2, 1.0, np.log1p(N_PIXELS), high]])
    return lowest.astype(np.float32), highest.astype(np.float32)


STATE_LOW, STATE_HIGH = state_limits(PAPER_RANGE_KPA)
