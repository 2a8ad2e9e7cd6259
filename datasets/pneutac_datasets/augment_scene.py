"""Where the object stood in a demonstration: it is not recorded, but the touch tells.

Candidate scenes are drawn from the task. In each the object is moved along the gel's view until it is
just felt at the frame of the recorded onset, with the recorded area; then the demonstration is replayed, and
the scene in which it does the task with the contact areas nearest to the recorded ones is taken.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from pneutac_datasets.augment_reference import EXTRA_STEPS, Reference
from pneutac_sim.features import ACTION_HIGH, ACTION_LOW
from pneutac_sim.world.gantry import Gantry
from pneutac_sim.world.varied import Variation, VariedWorld
from pneutac_sim.world.world import DT

REACH_M = 0.08  # how far the object is moved at most
YIELDING_M = 0.04  # how far the finger may give way before its gel feels what its edge has touched
FEEDBACK_HZ = 2.0  # rate at which the path returns to the demonstrated one
AWAY_M = (0.0, 0.0, -5.0)  # out of everything's way
NUDGES_M = (0.002, 0.001, 0.0005, 0.00025)  # last trials, along the gel's view: imprints are tenths of mm
FINALISTS = 3  # scenes of the reduced world that are tried in the full one
SIDESTEP_M = 0.005  # and across it


@dataclass(frozen=True)
class Scene:
    """A scene in which a demonstration can have happened.

    Attributes:
        seed: of the task's own start.
        shift_m: displacement (3,) of the objects from it.
        works: whether the demonstration, replayed there, does the task.
        area_rmse: root mean square difference of replayed and recorded contact areas in the contact phase.
    """

    seed: int
    shift_m: tuple[float, float, float]
    works: bool
    area_rmse: float


def follow(action: np.ndarray, flange_m: np.ndarray, goal_m: np.ndarray) -> np.ndarray:
    """The demonstrated actions (H, 4), led back to the demonstrated path from where the flange is.

    Args:
        action: (H, 4) demonstrated actions.
        flange_m: (3,) where the flange is.
        goal_m: (3,) where the demonstration was.
    """
    out = np.array(action, float)
    fade = (1 - FEEDBACK_HZ * DT) ** np.arange(len(out))
    out[:, :3] += FEEDBACK_HZ * fade[:, None] * (goal_m - flange_m)
    return np.clip(out, ACTION_LOW, ACTION_HIGH)


def find_scene(world: VariedWorld, gantry: Gantry, reference: Reference, seed: int, candidates: int) -> Scene:
    """The scene of a demonstration; see the module's text.

    Args:
        world: any state; it is reset.
        gantry: its gantry.
        reference: the demonstration.
        seed: decides the candidates.
        candidates: number of scenes drawn.
    """
    rng = np.random.default_rng([seed, reference.source, 7])
    reference = reference.prolonged(EXTRA_STEPS)
    start = tuple(reference.flange_m[0])
    onset = max(reference.onset, 1)
    world.variation = Variation(start, AWAY_M)
    world.reset(int(rng.integers(2**31)))
    gantry.mirror(world)
    gantry.rollout(follow(reference.action[:onset], world.flange_m, reference.flange_m[0]))
    gel = gantry.gel_m, gantry.data.site("gel").xmat.copy()
    # The recorded path, not the replayed one, says where the gel was.
    gel = gel[0] + reference.flange_m[onset] - gantry.flange_m, gel[1]
    # Objects stand on the table, so they are moved on it, the way that the gel looks.
    forward = gel[1].reshape(3, 3)[:, 2] * (1, 1, 0)
    forward /= max(np.linalg.norm(forward), 1e-9)

    first, end = reference.contact_phase

    def replay(scene_seed: int, shift: np.ndarray, reduced: bool = False) -> Scene:
        world.variation = Variation(start, tuple(shift.tolist()))
        world.reset(scene_seed)
        if world.blocked:
            return Scene(scene_seed, tuple(shift.tolist()), False, 1.0)
        if reduced:
            gantry.mirror(world)
            actions = follow(reference.action, world.flange_m, reference.flange_m[0])
            _, area = gantry.rollout(actions)
            done, spoilt = gantry.success, gantry.failure
        else:
            area, spoilt = np.zeros(len(reference)), None
            for t, action in enumerate(reference.action):
                world.step(follow(action[None], world.flange_m, reference.flange_m[t])[0])
                area[t], spoilt = world.touch.area, spoilt or world.failure
            done = world.success
        error = area[first : end - 1] - reference.area[first + 1 : end]
        rmse = float(np.sqrt(np.mean(error**2)))
        return Scene(scene_seed, tuple(shift.tolist()), bool(done and spoilt is None), rmse)

    def touched(scene_seed: int, shift: np.ndarray) -> bool:
        world.variation = Variation(start, tuple(shift.tolist()))
        world.reset(scene_seed)
        gantry.mirror(world)
        actions = follow(reference.action[:onset], world.flange_m, reference.flange_m[0])
        return gantry.rollout(actions)[1].max() >= reference.area[onset]

    scenes = []
    for scene_seed in rng.integers(2**31, size=candidates):
        world.variation = Variation(start)
        world.reset(int(scene_seed))
        far = _touching_distance(world, gel, forward, reference.area[onset])
        if far is None:
            continue
        near = far - YIELDING_M
        while far - near > 1e-4:
            middle = (near + far) / 2
            near, far = (middle, far) if touched(int(scene_seed), middle * forward) else (near, middle)
        scenes.append(replay(int(scene_seed), near * forward, reduced=True))
    if not scenes:
        scenes.append(replay(int(rng.integers(2**31)), np.zeros(3), reduced=True))
    finalists = sorted(scenes, key=_rank)[:FINALISTS]
    best = min((replay(s.seed, np.array(s.shift_m)) for s in finalists), key=_rank)
    across = np.array([-forward[1], forward[0], 0.0])
    for move in (SIDESTEP_M * across, *(nudge * forward for nudge in NUDGES_M)):
        best = min([best, *(replay(best.seed, best.shift_m + sign * move) for sign in (-1, 1))], key=_rank)
    return best


def _rank(scene: Scene) -> tuple[bool, float]:
    return not scene.works, scene.area_rmse


def _touching_distance(world: VariedWorld, gel, forward: np.ndarray, area: float) -> float | None:
    """How far (m) the objects must move along `forward` for the gel at pose `gel` to feel `area`, or None."""
    touch, data = world.touch, world.data
    mujoco.mj_kinematics(world.model, data)
    felt = touch._felt
    positions, rotations = data.geom_xpos[felt], data.geom_xmat[felt]

    def touches(distance: float) -> bool:
        depth = touch.sensor.probe(
            touch._kinds, touch._sizes, positions + distance * forward, rotations, gel[0], gel[1]
        )
        return bool(depth.any()) and touch.sensor.contact_from_depth(depth).area >= area

    far = REACH_M
    while not touches(far - 0.001):
        far -= 0.001
        if far < -REACH_M:
            return None
    near = far - 0.001
    for _ in range(4):
        middle = (near + far) / 2
        near, far = (middle, far) if touches(middle) else (near, middle)
    return near
