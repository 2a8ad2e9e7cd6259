"""The MJCF of a whole world: arm, finger, task and what makes it pleasant to look at.

Where cameras stand in a world's scene, as a lab has them around its robot.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.features import CONTROL_HZ
from pneutac_sim.world import panda
from pneutac_sim.world.tasks import Task

SETTLE_S = 0.53  # at rest before an episode
PHYSICS_HZ = 750  # steps of 1.33 ms, at which everything here was found stable
SUBSTEPS = PHYSICS_HZ // CONTROL_HZ  # of a control step of the paper's

# Geom groups: 0 decor, 1 arm and finger as seen, 2 task objects (seen and felt), 3 finger's collision shapes.
OBJECT_GROUP = 2
SEEN_GROUPS = (0, 1, 2)

DIVERGED = (  # what MuJoCo warns of, and answers with a fresh scene
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)


@dataclass(frozen=True)
class Finger:
    """MJCF of a finger with its gel."""

    body: str  # for the frame `flange`, with the sites `tip` and `gel` and the geom `pad`
    # defaults, materials: that it names
    defaults: str
    materials: str
    # actuators, tendons: it may have none
    actuators: str = ""
    tendons: str = ""


_DEFAULTS = f"""
  {panda.DEFAULTS}
  <default class="object">
    <geom contype="2" conaffinity="1" group="{OBJECT_GROUP}" friction=".4" solref=".004 1"
          solimp=".95 .99 .0005"/>
  </default>
  <default class="decor"><geom contype="0" conaffinity="0" group="0" mass="0"/></default>
"""

_ASSETS = f"""
  {panda.MATERIALS}
  <texture name="sky" type="skybox" builtin="gradient" rgb1=".93 .95 .98" rgb2=".62 .70 .80"
           width="64" height="64"/>
  <texture name="table" type="2d" builtin="checker" rgb1=".80 .77 .72" rgb2=".84 .81 .76"
           width="64" height="64"/>
  <material name="table" texture="table" texrepeat="10 10" texuniform="true" specular=".1"/>
  <material name="console" rgba=".36 .42 .50 1" specular=".3" shininess=".4"/>
  <material name="console_dark" rgba=".22 .25 .30 1" specular=".3" shininess=".4"/>
  <material name="steel" rgba=".80 .82 .86 1" specular=".9" shininess=".8"/>
  <material name="accent" rgba=".86 .22 .20 1" specular=".5" shininess=".6"/>
  <material name="carton" rgba=".62 .66 .58 1" specular=".05"/>
  <material name="carton_dark" rgba=".50 .54 .48 1" specular=".05"/>
  <material name="egg" rgba=".93 .82 .68 1" specular=".2"/>
  <material name="card" rgba=".97 .97 .94 1" specular=".3"/>"""

_VISUAL = """
<visual>
  <global offwidth="1280" offheight="960" fovy="42"/>
  <quality shadowsize="1024" offsamples="0" numslices="16" numstacks="9"/>
  <headlight ambient=".34 .34 .36" diffuse=".34 .34 .34" specular=".1 .1 .1"/>
  <map znear=".01" zfar="8" shadowclip=".6"/>
</visual>"""


def substeps(control_hz: int) -> int:
    """Physics steps of a control step; a step divides it, and is no longer than 1 / `PHYSICS_HZ`."""
    return math.ceil(PHYSICS_HZ / control_hz)


def build(
    task: Task,
    finger: Finger,
    arm: Callable[[str], str],
    servos: Callable[[], str],
    control_hz: int,
) -> str:
    """MJCF of the world with `task` and a finger, carried by an arm with its servos, for a control rate."""
    timestep = 1 / (control_hz * substeps(control_hz))
    return f"""
<mujoco model="pneutac_{task.name}">
  <compiler angle="radian"/>
  <option timestep="{timestep!r}" integrator="implicitfast" iterations="20"/>
  {_VISUAL}
  <default>{_DEFAULTS}{finger.defaults}</default>
  <asset>{_ASSETS}{finger.materials}{task.assets()}</asset>
  <worldbody>
    <light pos="1 -.5 1.1" dir="-.5 .5 -1" cutoff="35" exponent="3" diffuse=".57 .55 .52"
           specular=".2 .2 .2"/>
    <light pos=".3 -.9 .9" dir=".2 .9 -.6" cutoff="60" diffuse=".16 .16 .18" castshadow="false"/>
    <camera name="close" pos=".37 -.50 .31" xyaxes=".968 -.252 0 .057 .219 .974"/>
    {"".join(_mjcf(name) for name in SCENE_CAMERAS if name != "wrist")}
    <geom name="table" type="plane" size="0 0 .1" material="table" contype="2" conaffinity="1"/>
    {arm(finger.body + _mjcf("wrist"))}
    {task.mjcf()}
  </worldbody>
  <actuator>{servos()}{finger.actuators}{task.actuators()}</actuator>
  {finger.tendons}
</mujoco>"""


class DivergedError(InputError, FloatingPointError):
    """The physics of a world has diverged, by what it was made of: networks, conditions or a task."""


def check_physics(data: mujoco.MjData) -> None:
    """Raises DivergedError where the physics has diverged."""
    if any(data.warning[kind].number for kind in DIVERGED):
        raise DivergedError(
            "The physics has diverged: MuJoCo met values that are not finite or too large; train finer"
            " networks with `pneutac surrogate`, give fidelity=probe, which has none, or correct masses and"
            " stiffnesses of a task of your own."
        )


# Where each stands and what it looks at, metres: in the arm's base frame, `wrist` in the flange's, whose z
# points along the finger; the finger bends towards (x, -y) there.
_STANDS = {
    "front": ((1.02, 0.22, 0.42), (0.50, 0.0, 0.10), (0, 0, 1), 45),
    "side": ((0.50, -0.62, 0.30), (0.50, 0.0, 0.12), (0, 0, 1), 45),
    "wrist": ((0.062, -0.062, 0.0), (0.028, -0.028, 0.14), (1, -1, 0), 75),
}
SCENE_CAMERAS = tuple(_STANDS)
LARGEST = (960, 1280)  # what the scene's offscreen buffer takes


def _mjcf(name: str) -> str:
    place, aim, up, fovy = _STANDS[name]
    back = np.subtract(place, aim) / np.linalg.norm(np.subtract(place, aim))
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    axes = np.concatenate([right, np.cross(back, right)]).round(6)
    return (
        f'<camera name="{name}" pos="{" ".join(map(str, place))}" fovy="{fovy}"'
        f' xyaxes="{" ".join(map(str, axes))}"/>'
    )


def check_camera(name: str, size: tuple[int, int]) -> None:
    """Raises InputError where there is no such camera, or none of that height and width in px."""
    if name not in SCENE_CAMERAS:
        raise InputError(f"There is no camera '{name}' in the scene; choose of {', '.join(SCENE_CAMERAS)}.")
    if not (1 <= size[0] <= LARGEST[0] and 1 <= size[1] <= LARGEST[1]):
        raise InputError(
            f"The camera '{name}' is {size[1]} px wide and {size[0]} px high; it may have up to"
            f" {LARGEST[1]} x {LARGEST[0]}."
        )
