"""The world for planners: with its orientation held, the arm is three slides that carry the finger.

A step is cheaper than one with the arm's seven joints and its inverse kinematics, and flange and finger go
the same ways, because the slides follow their targets with the same lag as the arm's servos.
"""

import copy
import time
from collections import deque
from dataclasses import replace
from typing import override

import mujoco
import numpy as np

from pneutac_sim.gel.sensor import TactileSensor, centre_mm
from pneutac_sim.world import scene
from pneutac_sim.world.following import Follower
from pneutac_sim.world.observation import Observation
from pneutac_sim.world.panda import (
    HOME_JOINTS,
    SERVO_LAG_S,
    WORKSPACE_HIGH,
    WORKSPACE_LOW,
    forward_kinematics,
)
from pneutac_sim.world.placing import Placing
from pneutac_sim.world.soft_finger import Springs, mjcf
from pneutac_sim.world.substeps import Substeps
from pneutac_sim.world.touch import Touch
from pneutac_sim.world.varied import VariedWorld, _Staged
from pneutac_sim.world.world import DT

SLIDES = ("slide_x", "slide_y", "slide_z")
STIFFNESS_N_M = 40000.0  # of the flange: about 12 kN m/rad at the arm's half metre
INERTIA_KG = 1.0


def body(payload: str = "") -> str:
    """MJCF of three slides whose positions are the flange's in the world; `payload` as for the arm."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, forward_kinematics(HOME_JOINTS)[:3, :3].ravel())
    slides = "".join(
        f'<joint name="{name}" type="slide" axis="{axis}" armature="{INERTIA_KG}"/>'
        for name, axis in zip(SLIDES, ("1 0 0", "0 1 0", "0 0 1"), strict=True)
    )
    site = '<site name="flange" size=".001" group="5"/>'
    # The joints' axes are in the frame of their body: the turned flange is a body of its own.
    flange = f'<body name="flange" quat="{" ".join(map(repr, quat.tolist()))}">{site}{payload}</body>'
    return f'<body name="gantry" gravcomp="1">{slides}{flange}</body>'


def actuators() -> str:
    """MJCF position servos of the slides."""
    kv = SERVO_LAG_S * STIFFNESS_N_M
    return "".join(f'<position name="servo_{j}" joint="{j}" kp="{STIFFNESS_N_M}" kv="{kv}"/>' for j in SLIDES)


class _Straight:
    """Inverse kinematics of the slides."""

    def reset(self, q) -> None:
        """Nothing to start from."""

    def solve(self, position: np.ndarray) -> np.ndarray:
        """Slide positions (3,), metres: the flange's own."""
        return np.array(position, float)


class Gantry(VariedWorld):
    """The reduced world of a world: starts where that one is, and tries sequences of actions.

    The finger has the stiffness of the world's own where it was mirrored, held while the gantry looks ahead.
    The gel is the world's own too where a network is; where the world's are material points, it is the
    formula, and how far the world's area is from it is held.

    Attributes:
        centre_mm: (H, 2) middles of the imprints in the last `rollout`, see `gel.sensor.centre_mm`.
        steps: control steps taken in `rollout` so far.
        seconds: seconds spent in them: `physics`, `touch`.
    """

    _held: tuple[np.ndarray, np.ndarray] | None = None  # the soft body's stiffness and torque

    def __init__(self, world: VariedWorld):
        """A gantry for `world`; its state is taken over by `mirror`.

        Raises:
            InputError: as `World`.
        """
        super().__init__(world.task.name, world.twin, "area", "probe", world.conditions)
        task = self.task.inner
        self.model = mujoco.MjModel.from_xml_string(scene.build(task, mjcf(self.twin), body, actuators))
        self.data = mujoco.MjData(self.model)
        self.task = _Staged(task, self.model)
        self.sensor = TactileSensor(self.twin)
        self.touch = Touch(self.model, self.sensor, "area", world.touch.network)
        self._ik = _Straight()
        self._flange, self._gel = self.model.site("flange").id, self.model.site("gel").id
        self._tip, self._placing = self.model.site("tip").id, Placing(self.model)
        n = self._spine.stop - self._spine.start
        self._physics = Substeps(self.model, self.data)
        damping, whole = "joint_damping_nms_per_rad", "joint_stiffness_nm_per_rad"
        self._springs = Springs(self.model, n, self.twin.parameter(damping), self.twin.parameter(whole))
        self._follower = Follower(self.model, n)
        self._arm, self._spine = slice(0, 3), slice(3, 3 + n)
        self.steps, self.seconds = 0, {"physics": 0.0, "touch": 0.0}
        self._pair(world)
        root, hand = self.model.body_rootid, self.model.body("gantry").id
        loose = [j for j in range(self.model.njnt) if root[self.model.jnt_bodyid[j]] != hand]
        self._loose = [(self.model.joint(j), self.data.joint(j)) for j in loose]
        self.reset(0)

    def mirror(self, world: VariedWorld) -> None:
        """Takes over the state of `world`: poses, speeds, pressures, and what the task remembers."""
        here, there = self.data, world.data
        for theirs, ours, names in self._fields:
            getattr(self.model, names)[ours] = getattr(world.model, names)[theirs]
        here.qpos[self._qpos[1]], here.qvel[self._dofs[1]] = (
            there.qpos[self._qpos[0]],
            there.qvel[self._dofs[0]],
        )
        here.ctrl[self._ctrl[1]] = there.ctrl[self._ctrl[0]]
        jacobian = np.zeros((3, world.model.nv))
        mujoco.mj_comPos(world.model, there)
        mujoco.mj_jacSite(world.model, there, jacobian, None, world._flange)
        here.qpos[self._arm], here.qvel[self._arm] = world.flange_m, jacobian @ there.qvel
        here.time, here.qacc_warmstart[:] = there.time, 0.0
        self.variation, self._rest_rad = world.variation, world._rest_rad
        self.target_m, self._joints = world.target_m.copy(), world.target_m.copy()
        self.spine_target_rad = world.spine_target_rad.copy()
        self._held = world._resist(world._drive)
        self._drive, self._rate = world._drive.copy(), world._rate.copy()
        self._pipeline = world._pipeline.copy()
        self._sent = deque(world._sent)
        self._placing.set(self.model, world._placing.poses.copy())
        self._memory = _memory(vars(world.task.inner))
        mujoco.mj_kinematics(self.model, here)
        self.touch.sense(here)
        self._residual_area = world.touch.area - self.touch.area
        self._friction = self.model.dof_frictionloss.copy()
        self._keep()

    def stage(self, seed: int, shift_m: tuple[float, float, float]) -> None:
        """Lays the objects out as `reset` does, moved by `shift_m`; the hand stays as it was mirrored.

        Args:
            seed: of the task's own start.
            shift_m: displacement (3,) of the objects, metres.
        """
        model, here = self.model, self.data
        mujoco.mj_setState(model, here, self._state, _STATE)
        for joint, state in self._loose:
            state.qpos[:], state.qvel[:] = joint.qpos0, 0.0
        self.task.variation = replace(self.variation, shift_m=shift_m)
        self.task.reset(model, here, np.random.default_rng(seed))
        mujoco.mj_forward(model, here)
        here.qacc_warmstart[:] = 0.0
        self._friction = model.dof_frictionloss.copy()
        self._memory = _memory(vars(self.task.inner))
        self._keep()

    def _keep(self) -> None:
        """Remembers the state from which `rollout` starts."""
        self._state = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, self._state, _STATE)
        self._poses = self._placing.poses

    def rollout(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tries actions from the mirrored state; what was sent before and acts too late goes first.

        Args:
            actions: (H, 4) as `features.ACTION_NAMES`, within the limits.

        Returns:
            flange positions (H, 3), metres, and contact areas (H,) after each step.
        """
        mujoco.mj_setState(self.model, self.data, self._state, _STATE)
        self.model.dof_frictionloss[:] = self._friction
        vars(self.task.inner).update(_memory(self._memory))
        saved = self.target_m, self._joints, self.spine_target_rad, self._drive, self._rate, self._pipeline
        self._pipeline, target = self._pipeline.copy(), self.target_m
        self._placing.set(self.model, self._poses)
        flange, area = np.empty((len(actions), 3)), np.empty(len(actions))
        self.centre_mm = np.full((len(actions), 2), np.nan)
        acting = np.vstack([*self._sent, actions])[: len(actions)]
        for t, action in enumerate(acting):
            target = np.clip(target + action[:3] * DT, WORKSPACE_LOW, WORKSPACE_HIGH)
            began = time.perf_counter()
            self._advance(target, self._pipeline.step(action[3], DT))
            self.task.update(self.model, self.data, DT)
            moved = time.perf_counter()
            self.touch.sense(self.data)
            self.seconds["physics"] += moved - began
            self.seconds["touch"] += time.perf_counter() - moved
            felt = self.touch.area
            if felt:
                self.centre_mm[t] = centre_mm(self.touch.depth_mm, self.sensor.model.window_mm)
            flange[t], area[t] = self.flange_m, max(felt + self._residual_area, 0.0) if felt else 0.0
        self.steps += len(actions)
        self.target_m, self._joints, self.spine_target_rad, self._drive, self._rate, self._pipeline = saved
        return flange, area

    @override
    def _resist(self, drive):
        return super()._resist(drive) if self._held is None else self._held

    @override
    def _observe(self):
        return Observation(np.append(self.flange_m, self.touch.area).astype(np.float32), None)

    def _pair(self, world: VariedWorld) -> None:
        """Indices, in the world's model and in this one, of everything that both have."""
        a, b = world.model, self.model

        def both(kind: str, count: int) -> list[str]:
            names = [getattr(b, kind)(i).name for i in range(count)]
            known = {getattr(a, kind)(i).name for i in range(getattr(a, f"n{_COUNTS[kind]}"))}
            return [n for n in names if n and n in known]

        def indices(names: list[str], find) -> tuple[np.ndarray, np.ndarray]:
            return tuple(np.concatenate([find(m, n) for n in names]).astype(int) for m in (a, b))

        joints, bodies = both("joint", b.njnt), both("body", b.nbody)
        geoms, motors = both("geom", b.ngeom), both("actuator", b.nu)
        bodies = [n for n in bodies if n not in ("world", "flange")]
        self._qpos = indices(joints, lambda m, n: _span(m.joint(n).qposadr[0], m.joint(n).qpos0))
        self._dofs = indices(joints, lambda m, n: _span(m.joint(n).dofadr[0], m.joint(n).armature))
        self._ctrl = indices(motors, lambda m, n: [m.actuator(n).id])
        body = indices(bodies, lambda m, n: [m.body(n).id])
        geom = indices(geoms, lambda m, n: [m.geom(n).id])
        self._fields = [
            *((*body, name) for name in ("body_pos", "body_quat", "body_mass")),
            (*geom, "geom_friction"),
            (*self._dofs, "dof_frictionloss"),
        ]


_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_COUNTS = {"joint": "jnt", "body": "body", "geom": "geom", "actuator": "u"}


def _span(first: int, like: np.ndarray) -> np.ndarray:
    return first + np.arange(len(np.atleast_1d(like)))


def _memory(attributes: dict) -> dict:
    """What a task remembers as numbers, not its handles into a model."""
    return {k: copy.copy(v) for k, v in attributes.items() if isinstance(v, int | float | tuple | np.ndarray)}
