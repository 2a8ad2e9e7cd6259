"""Where the object stood in a demonstration: not recorded, found from the touch.

Scenes are drawn from the task. In each the object is moved along the gel's view to where the gel, on the
recorded way, feels it at the recorded onset, or nearer, as the finger gives way before its gel feels it. If
the gel does not meet it there, it did shortly before: what is pressed softly is not seen at once.
There the demonstration is replayed. About those scenes in which it does the task, with contact areas near the
recorded ones, it is tried again a few millimetres away; the scene in the middle of the most that work is
taken: a demonstration that succeeded hardly did so by a millimetre.
"""

from dataclasses import dataclass, replace

import numpy as np

from pneutac_datasets.demonstrations.augment.reference import EXTRA_STEPS, FIRM, Reference, frames_at
from pneutac_sim.features import MAX_SPEED_M_S
from pneutac_sim.gel.sensor import centre_mm
from pneutac_sim.world.gantry import Gantry
from pneutac_sim.world.varied import Variation, VariedWorld

REACH_M = 0.08  # how far the object is moved at most
YIELDING_M = 0.03  # how far the finger may give way before its gel feels what its edge has touched
FEEDBACK_HZ = 2.0  # rate at which the path returns to the demonstrated one
AWAY_M = (0.0, 0.0, -5.0)  # out of everything's way
# Frames and control steps are of the paper's rate, see `reference.frames_at`.
LANE_STEPS = 30  # where the gel passed longer before the recorded onset it met nothing
UNSEEN_STEPS = 8  # so much before the recorded onset the gel may have met an object, too softly to be seen
EARLY_STEPS = 5  # a firm touch that comes so much before the recorded one is that of an object elsewhere
DRAWS = 8  # scenes drawn for each in which the gel reaches an object at all
PARENTS, CHILDREN = (6, 4, 2), 8  # scenes of each round about which others are tried, and how many about each
SPREADS_M = (0.006, 0.003, 0.0015)  # standard deviation of their displacement
FINALISTS = 3  # scenes of the reduced world that are tried in the full one
NUDGES_M = (0.002, 0.001, 0.0005, 0.00025)  # last trials where none of them works, along the gel's view
CENTRES, CENTRE_MM = 12, 10.0  # frames whose imprints are compared; their error that weighs as an area of 1
FAR_MM = 8.0  # error where the twin feels nothing of what was felt: half the gel
ELITES = 3  # neighbours that make the next middle
UNSTEADY = 0.5  # share of the area felt that is added to the misfit of a scene none of whose neighbours works
MOST_LATE, FREE_FRAMES = 4, 40  # control steps: latencies tried, frames of a free way compared


@dataclass(frozen=True)
class Scene:
    """A scene in which a demonstration can have happened.

    Attributes:
        seed: of the task's own start.
        shift_m: displacement (3,) of the objects from it.
        works: whether the demonstration, replayed there, does the task.
        area_rmse: root mean square difference of replayed and recorded contact areas in the contact phase.
        centre_rmse_mm: the same of the imprint's middle in the first `CENTRES` frames of it.
    """

    seed: int
    shift_m: tuple[float, float, float]
    works: bool
    area_rmse: float
    centre_rmse_mm: float

    @property
    def misfit(self) -> float:
        """What scenes are compared by; smaller is better."""
        return self.area_rmse + self.centre_rmse_mm / CENTRE_MM


def follow(action: np.ndarray, flange_m: np.ndarray, goal_m: np.ndarray, dt_s: float) -> np.ndarray:
    """The demonstrated actions (H, 3 + C), led back to the demonstrated path from where the flange is.

    Args:
        action: (H, 3 + C) demonstrated actions.
        flange_m: (3,) where the flange is.
        goal_m: (3,) where the demonstration was.
        dt_s: duration of a control step.
    """
    out = np.array(action, float)
    fade = (1 - FEEDBACK_HZ * dt_s) ** np.arange(len(out))
    out[:, :3] += FEEDBACK_HZ * fade[:, None] * (goal_m - flange_m)
    out[:, :3] = np.clip(out[:, :3], -MAX_SPEED_M_S, MAX_SPEED_M_S)
    return out


def command_latency(world: VariedWorld, gantry: Gantry, references: list[Reference]) -> int:
    """Control steps by which commands acted too late in demonstrations, from their motion in free air.

    Args:
        world: any state; it is reset.
        gantry: its gantry.
        references: the demonstrations.
    """
    errors = np.zeros(frames_at(world.station.control_hz, MOST_LATE) + 1)
    for late in range(len(errors)):
        for r in references:
            actions = np.clip(r.action[: min(r.onset, r.frames(FREE_FRAMES))], *world.action_limits)
            world.variation = Variation(tuple(r.flange_m[0]), AWAY_M, late_commands=late)
            world.reset(0)
            gantry.mirror(world)
            moved = gantry.rollout(actions)[0] - world.flange_m
            errors[late] += np.sum((moved - (r.flange_m[1 : len(moved) + 1] - r.flange_m[0])) ** 2)
    return int(np.argmin(errors))


def find_scene(
    world: VariedWorld, gantry: Gantry, reference: Reference, seed: int, candidates: int, late: int = 0
) -> Scene:
    """The scene of a demonstration; see the module's text.

    Args:
        world: any state; it is reset.
        gantry: its gantry.
        reference: the demonstration.
        seed: decides the candidates.
        candidates: number of scenes drawn.
        late: control steps by which commands acted too late.
    """
    rng = np.random.default_rng([seed, reference.source, 7])
    replays = _Replays(world, gantry, reference.prolonged(reference.frames(EXTRA_STEPS)), late)
    way = replays.free_way(int(rng.integers(2**31)))
    # Objects stand on the table, so they are moved on it, the way that the gel looks.
    forward = way[-1][1].reshape(3, 3)[:, 2] * (1, 1, 0)
    forward /= max(np.linalg.norm(forward), 1e-9)
    across = np.array([-forward[1], forward[0], 0.0])

    unseen, lane = reference.frames(UNSEEN_STEPS), reference.frames(LANE_STEPS)
    scenes = []
    for scene_seed in rng.integers(2**31, size=DRAWS * candidates).tolist():
        gantry.stage(scene_seed, (0.0, 0.0, 0.0))
        reached = (_touching_distance(gantry, gel, forward) for gel in way[: -unseen - 1 : -1])
        far = next((d for d in reached if d is not None), None)
        if far is None or any(_felt(gantry, gel, far * forward) for gel in way[:-lane]):
            continue
        scenes.append(replays.reduced(scene_seed, (far - YIELDING_M * rng.uniform()) * forward))
        if len(scenes) == candidates:
            break
    if not scenes:
        scenes.append(replays.reduced(int(rng.integers(2**31)), np.zeros(3)))
    scenes.sort(key=lambda s: s.misfit + UNSTEADY * replays.felt * (not s.works))
    for parents, spread_m in zip(PARENTS, SPREADS_M, strict=True):
        steady = []
        for scene in scenes[:parents]:
            moved = rng.normal(0, spread_m, (CHILDREN, 2)) @ [forward, across] + scene.shift_m
            working = [s for s in (replays.reduced(scene.seed, shift) for shift in moved) if s.works]
            if working:
                elite = sorted(working, key=_rank)[:ELITES]
                middle = tuple(np.mean([s.shift_m for s in elite], 0).tolist())
                lost = UNSTEADY * replays.felt * (1 - len(working) / CHILDREN)
                steady.append((lost + np.mean([s.misfit for s in elite]), replace(scene, shift_m=middle)))
        scenes = [s for _, s in sorted(steady, key=lambda s: s[0])] or scenes
    tried = []
    for scene in scenes[:FINALISTS]:
        tried.append(replays.full(scene.seed, np.array(scene.shift_m)))
        if tried[-1].works:
            return tried[-1]
    best = min(tried, key=_rank)
    for nudge in NUDGES_M:
        moved = (best.shift_m + sign * nudge * forward for sign in (-1, 1))
        best = min([best, *(replays.full(best.seed, shift) for shift in moved)], key=_rank)
    return best


class _Replays:
    """A demonstration replayed where its object may have stood, led back to the recorded path.

    Args:
        world: any state; it is reset.
        gantry: its gantry.
        reference: the demonstration.
        late: control steps by which commands acted too late.

    Attributes:
        onset: first frame in contact.
        felt: root mean square of the recorded contact area in the contact phase.
    """

    def __init__(self, world: VariedWorld, gantry: Gantry, reference: Reference, late: int):
        self._world, self._gantry, self._reference, self._late = world, gantry, reference, late
        self.onset = max(reference.onset, 1)
        self.felt = float(np.sqrt(np.mean(reference.area[slice(*reference.contact_phase)] ** 2)))
        self._begin = max(self.onset - reference.frames(LANE_STEPS), 0)

    def free_way(self, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Positions (3,) and rotations (9,) of the gel up to the onset.

        The gantry is left where the hand was `LANE_STEPS` before it; `reduced` begins there.
        """
        world, r = self._world, self._reference
        self._reset(seed, AWAY_M)
        way = []
        for t in range(self.onset):
            if t == self._begin:
                self._gantry.mirror(world)
            self._step(t)
            # The recorded path, not the replayed one, says where the gel was.
            at = world.gel_m + r.flange_m[t + 1] - world.flange_m
            way.append((at, world.data.site("gel").xmat.copy()))
        return way

    def reduced(self, seed: int, shift: np.ndarray) -> Scene:
        """In the gantry, with the object as the task's start `seed` has it, moved by `shift` (3,) m."""
        g, r, begin = self._gantry, self._reference, self._begin
        g.stage(seed, shift)
        if g.blocked:
            return Scene(seed, tuple(shift.tolist()), False, 1.0, FAR_MM)
        _, area = g.rollout(follow(r.action[begin:], g.flange_m, r.flange_m[begin], g.dt_s))
        area = np.append(np.zeros(begin), area)
        centres = np.vstack([np.full((begin, 2), np.nan), g.centre_mm])
        return self._scene(seed, shift, g.success and not g.failure, area, centres)

    def full(self, seed: int, shift: np.ndarray) -> Scene:
        """The same in the world, from the start."""
        world, area, spoilt = self._world, np.zeros(len(self._reference)), None
        centres = np.full((len(area), 2), np.nan)
        self._reset(seed, shift)
        if world.blocked:
            return Scene(seed, tuple(shift.tolist()), False, 1.0, FAR_MM)
        for t in range(len(area)):
            self._step(t)
            area[t], spoilt = world.touch.area, spoilt or world.failure
            if area[t]:
                centres[t] = centre_mm(world.touch.depth_mm, world.sensor.model.window_mm)
        return self._scene(seed, shift, world.success and not spoilt, area, centres)

    def _reset(self, seed: int, shift) -> None:
        start = tuple(self._reference.flange_m[0])
        self._world.variation = Variation(start, tuple(shift), late_commands=self._late)
        self._world.reset(seed)

    def _step(self, t: int) -> None:
        r, world = self._reference, self._world
        world.step(follow(r.action[t][None], world.flange_m, r.flange_m[t], world.dt_s)[0])

    def _scene(
        self, seed: int, shift: np.ndarray, done: bool, area: np.ndarray, centres: np.ndarray
    ) -> Scene:
        """What came of a replay that felt `area` (T,) about `centres` (T, 2) mm."""
        recorded = self._reference.area
        first, end = self._reference.contact_phase
        frames = self._reference.frames
        early = area[: max(self.onset - frames(EARLY_STEPS), 0)].max(initial=0.0) > FIRM * recorded.max()
        rmse = float(np.sqrt(np.mean((area[first : end - 1] - recorded[first + 1 : end]) ** 2)))
        away = 0.0
        if self._reference.centre_mm is not None:
            felt = slice(self.onset, self.onset + frames(CENTRES))
            there = self._reference.centre_mm[felt]
            apart = np.linalg.norm(centres[self.onset - 1 :][: len(there)] - there, axis=1)
            apart = np.where(np.isnan(apart), FAR_MM, apart)[np.isfinite(there[:, 0])]
            away = float(np.sqrt(np.mean(apart**2))) if len(apart) else 0.0
        return Scene(seed, tuple(shift.tolist()), bool(done and not early), rmse + early, away)


def _rank(scene: Scene) -> tuple[bool, float]:
    return not scene.works, scene.misfit


def _felt(world: Gantry, gel, shift: np.ndarray) -> float:
    """Contact area that the gel at pose `gel` feels of the objects, moved by `shift`."""
    touch, data = world.touch, world.data
    positions, rotations = data.geom_xpos[touch.felt] + shift, data.geom_xmat[touch.felt]
    depth = touch.sensor.probe(touch.kinds, touch.sizes, positions, rotations, *gel)
    return touch.sensor.contact_from_depth(depth).area if depth.any() else 0.0


def _touching_distance(world: Gantry, gel, forward: np.ndarray) -> float | None:
    """How far (m) the objects may move along `forward` for the gel at pose `gel` to feel them, or None."""

    def touches(distance: float) -> bool:
        return _felt(world, gel, distance * forward) > 0

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
