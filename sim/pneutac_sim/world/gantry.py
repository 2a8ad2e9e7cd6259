"""The world for planners: with its orientation held, the arm is three slides that carry the finger.

A step is cheaper than one with the arm's joints and its inverse kinematics, and flange and finger go
the same ways, because the slides follow their targets with the same lag as the arm's servos.
"""

import copy
import time
from collections import deque
from dataclasses import replace
from typing import override

import mujoco
import numpy as np

from pneutac_sim.features import PRESSURES
from pneutac_sim.gel.probe import COLS, ROWS, probe_grids
from pneutac_sim.gel.sensor import centre_mm
from pneutac_sim.world.base import Observation
from pneutac_sim.world.panda import HOME_JOINTS, SERVO_LAG_S, forward_kinematics
from pneutac_sim.world.touch import Touch
from pneutac_sim.world.world import World

SLIDES = ("slide_x", "slide_y", "slide_z")
STIFFNESS_N_M = 40000.0  # of the flange: about 12 kN m/rad at the arm's half metre
INERTIA_KG = 1.0


class Gantry(World):
    """The reduced world of a world: starts where that one is, and tries sequences of actions.

    The finger has the stiffness of the world's own where it was mirrored, held while the gantry looks ahead;
    the gel's face has the spring for what lies before it in each control step. The gel is the world's own too
    where a network is; where the world's are material points, it is the formula, and how far the world's
    area is from it is held.

    Attributes:
        centre_mm: (H, 2) middles of the imprints in the last `rollout`, see `gel.sensor.centre_mm`.
        steps: control steps tried so far.
        seconds: seconds spent in them: `physics`, `touch`.
    """

    _soft_body: tuple[np.ndarray, np.ndarray] | None = None  # the soft body's stiffness and torque

    def __init__(self, world: World):
        """A gantry for `world`; its state is taken over by `mirror`.

        Raises InputError: as `World`.
        """
        limits = {"pressure_range_kpa": world.pressure_range_kpa, "station": world.station}
        super().__init__(world.task.name, world.twin, "area", "probe", world.conditions, **limits)
        self.touch = Touch(self.model, self.sensor, "area", world.touch.network)
        self.steps, self.seconds = 0, {"physics": 0.0, "touch": 0.0}
        named = [(self.model.geom(g).name, g) for g in range(self.model.ngeom)]
        self._geoms = np.transpose([(world.model.geom(name).id, g) for name, g in named if name])
        root, hand = self.model.body_rootid, self.model.body("gantry").id
        loose = [j for j in range(self.model.njnt) if root[self.model.jnt_bodyid[j]] != hand]
        self._loose = [(self.model.joint(j), self.data.joint(j)) for j in loose]
        self.reset(0)

    @override
    def _make_arm(self):
        return _Slides()

    @override
    def _compiled(self, xml):
        spec = mujoco.MjSpec.from_string(xml)
        spec.compiler.discardvisual = True  # nobody looks at it
        return spec.compile()

    def mirror(self, world: World) -> None:
        """Takes over the state of `world`: poses, speeds, pressures, and what the task remembers."""
        here, there = self.data, world.data
        self._take(world)
        jacobian = np.zeros((3, world.model.nv))
        mujoco.mj_comPos(world.model, there)
        mujoco.mj_jacSite(world.model, there, jacobian, None, world._flange)
        here.qpos[self._arm], here.qvel[self._arm] = world.flange_m, jacobian @ there.qvel
        here.time, here.qacc_warmstart[:] = there.time, 0.0
        self.variation, self._rest_rad = world.variation, world._rest_rad
        self.target_m, self._joints = world.target_m.copy(), world.target_m.copy()
        self.spine_target_rad = world.spine_target_rad.copy()
        self._soft_body = world._resist(world._drive)
        self._drive, self._rate = world._drive.copy(), world._rate.copy()
        self._pipeline = world._pipeline.copy()
        self._queue = deque(world._queue)
        self._placing.set(self.model, world._placing.poses.copy())
        self._memory = _memory(vars(world.task))
        mujoco.mj_kinematics(self.model, here)
        self.touch.sense(here)
        self._residual_area = world.touch.area - self.touch.area
        self._friction = self.model.dof_frictionloss.copy()
        self._store()

    def _take(self, world: World) -> None:
        """Poses, masses, friction, positions, speeds, controls of all but the arm, first in both models."""
        one, other, arm = world.model, self.model, len(SLIDES)
        a, b = (m.body("flange").id + 1 for m in (one, other))
        for name in ("body_pos", "body_quat", "body_mass"):
            getattr(other, name)[b:] = getattr(one, name)[a:]
        other.geom_friction[self._geoms[1]] = one.geom_friction[self._geoms[0]]
        other.dof_frictionloss[arm:] = one.dof_frictionloss[arm - other.nv :]
        for name in ("qpos", "qvel", "ctrl"):
            mine, theirs = getattr(self.data, name), getattr(world.data, name)
            mine[arm:] = theirs[arm - len(mine) :]

    def stage(self, seed: int, shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        """Lays the objects out as `reset` does with this seed, moved by `shift_m`; the hand stays."""
        model, here = self.model, self.data
        mujoco.mj_setState(model, here, self._state, _STATE)
        for joint, state in self._loose:
            state.qpos[:], state.qvel[:] = joint.qpos0, 0.0
        self._stage(np.random.default_rng(seed), replace(self.variation, shift_m=shift_m))
        mujoco.mj_forward(model, here)
        here.qacc_warmstart[:] = 0.0
        self._friction = model.dof_frictionloss.copy()
        self._memory = _memory(vars(self.task))
        self._store()

    def _store(self) -> None:
        self._state = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, self._state, _STATE)
        self._poses = self._placing.poses

    def rollout(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tries actions (H, 3 + C), as `features.action_names` within the limits, from the mirrored state.

        What was sent before and acts too late goes first. The state is then that after the last action.

        Returns:
            flange positions (H, 3), metres, and contact areas (H,) after each step.
        """
        flange, area, depth = self._try(actions[None])
        window = self.sensor.model.window_mm
        self.centre_mm = np.array([centre_mm(d, window) for d in depth]).reshape(-1, 2)
        self.centre_mm[~(area[0] > 0)] = np.nan
        return flange[0], area[0]

    def rollouts(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As `rollout`, for sequences (S, H, 3 + C), each from the mirrored state; felt together.

        Returns:
            flange positions (S, H, 3), metres, and contact areas (S, H).
        """
        return self._try(actions)[:2]

    def _try(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Flange positions, contact areas and probe grids (S * H, 80, 59) of sequences."""
        S, H = actions.shape[:2]
        sent = np.array(self._queue, float).reshape(1, -1, actions.shape[2])
        acting = np.concatenate([np.repeat(sent, S, 0), actions], 1)[:, :H]
        began = time.perf_counter()
        rows = [row for sequence in acting for row in self._follow(sequence)]
        moved = time.perf_counter()
        flange_m, *poses = map(np.array, zip(*rows, strict=True))
        touch, gel = self.touch, self.sensor.model
        size = gel.window_mm, gel.thickness_mm, np.empty((S * H, ROWS, COLS), np.float32)
        depth = probe_grids(touch.kinds, touch.sizes, *poses, *size, self.sensor.triangles)
        felt = self.sensor.areas(depth)
        area = np.where(felt > 0, np.maximum(felt + self._residual_area, 0.0), 0.0)
        self.steps += S * H
        self.seconds["physics"] += moved - began
        self.seconds["touch"] += time.perf_counter() - moved
        return flange_m.reshape(S, H, 3), area.reshape(S, H), depth

    def _follow(self, acting: np.ndarray) -> list[list[np.ndarray]]:
        """One sequence (H, 3 + C): after each step the flange's place, and poses of objects and gel."""
        mujoco.mj_setState(self.model, self.data, self._state, _STATE)
        self.model.dof_frictionloss[:] = self._friction
        vars(self.task).update(_memory(self._memory))
        self._placing.set(self.model, self._poses)
        mujoco.mj_kinematics(self.model, self.data)
        saved = self.target_m, self._joints, self.spine_target_rad, self._drive, self._rate, self._pipeline
        self._pipeline, target, rows = self._pipeline.copy(), self.target_m, []
        for action in acting:
            target = np.clip(target + action[:3] * self.dt_s, *self.workspace_m)
            self._advance(target, self._pipeline.step(action[PRESSURES], self.dt_s))
            self.task.update(self.model, self.data, self.dt_s)
            poses = self.data.site_xpos[self._flange], *self.touch.objects(self.data)[2:]
            rows.append([x.copy() for x in poses])
        self.target_m, self._joints, self.spine_target_rad, self._drive, self._rate, self._pipeline = saved
        return rows

    @override
    def _resist(self, drive):
        return super()._resist(drive) if self._soft_body is None else self._soft_body

    @override
    def _observe(self):
        return Observation(np.append(self.flange_m, self.touch.area).astype(np.float32), None)


_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


def _memory(attributes: dict) -> dict:
    return {k: copy.copy(v) for k, v in attributes.items() if isinstance(v, int | float | tuple | np.ndarray)}


class _Slides:
    """Three slides in an arm's place, whose positions are the flange's own in the world."""

    joints, base_m, missing_m = len(SLIDES), np.zeros(3), 0.0

    def body(self, payload: str = "") -> str:
        """MJCF of them; `payload` as for the arm."""
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

    def servos(self) -> str:
        servo = f'kp="{STIFFNESS_N_M}" kv="{SERVO_LAG_S * STIFFNESS_N_M}"'
        return "".join(f'<position name="servo_{j}" joint="{j}" {servo}/>' for j in SLIDES)

    def solver(self) -> "_Slides":
        return self

    def reset(self, q=None) -> None:
        pass

    def pose(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return forward_kinematics(HOME_JOINTS)[:3, :3], q

    def solve(self, position: np.ndarray) -> np.ndarray:
        return np.array(position, float)
