"""Scenes in which a demonstration can have happened: places of its first touch, refined by replays.

The object is moved from where `replay.placing` has the first touch, or nearer, as the finger gives way before
its gel feels it, and the demonstration is replayed. About those scenes in which it does the task, with
contact areas near the recorded ones, it is tried again a few millimetres away; the scene in the middle of the
most that work is taken: a demonstration that succeeded hardly did so by a millimetre.
"""

from dataclasses import dataclass, replace

import numpy as np

from pneutac_datasets.demonstrations.augment.reference import EXTRA_STEPS, FIRM, Reference, frames_at
from pneutac_datasets.demonstrations.imprint import SHALLOW_MM, Pose, depth_mm, first_touches, on_table
from pneutac_datasets.demonstrations.replaying import (
    AWAY_M,
    Place,
    along,
    commanded,
    follow,
    frames_of,
    gel_pose,
    latency_s,
    smooth,
)
from pneutac_datasets.demonstrations.replaying import late as delayed
from pneutac_sim.features import PRESSURES
from pneutac_sim.gel.sensor import centre_mm
from pneutac_sim.world.gantry import Gantry
from pneutac_sim.world.world import World

YIELDING_M = 0.03  # how far the finger may give way before its gel feels what its edge has touched
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
    """A scene in which a demonstration can have happened."""

    seed: int  # of the task's own start
    shift_m: tuple[float, float, float]  # displacement (3,) of the objects from it
    works: bool  # whether the demonstration, replayed there, does the task
    # root mean square difference of replayed and recorded contact areas in the contact phase
    area_rmse: float
    centre_rmse_mm: float  # the same of the imprint's middle in the first `CENTRES` frames of it

    @property
    def misfit(self) -> float:
        """What scenes are compared by; smaller is better."""
        return self.area_rmse + self.centre_rmse_mm / CENTRE_MM


def command_latency(world: World, references: list[Reference]) -> int:
    """Control steps by which commands acted too late, from the demonstrations' motion in free air."""
    errors = np.zeros(frames_at(world.station.control_hz, MOST_LATE) + 1)
    own = world.station.late_commands + world.station.steps(latency_s(world.twin))
    for r in references:
        free = min(r.onset, r.frames(FREE_FRAMES))
        path = commanded(world, r.action[: free + 1], r.flange_m[0])
        for steps in range(len(errors)):
            shifted = path[np.maximum(np.arange(len(path)) - own - steps, 0)]
            errors[steps] += np.sum((shifted - path[0] - r.flange_m[: len(path)] + r.flange_m[0]) ** 2)
    return int(np.argmin(errors))


def find_scene(
    world: World, gantry: Gantry, reference: Reference, seed: int, candidates: int, late: int = 0
) -> Scene:
    """The scene of a demonstration; see the module's text.

    World and gantry may be in any state. The seed decides `candidates` scenes, which are drawn; commands
    acted `late` control steps too late.
    """
    rng = np.random.default_rng([seed, reference.source, 7])
    replays = _Replays(world, gantry, reference.prolonged(reference.frames(EXTRA_STEPS)), late)
    way = replays.free_way(int(rng.integers(2**31)))
    axes = on_table(way[-1])
    across, _, forward = axes
    unseen, lane = reference.frames(UNSEEN_STEPS), reference.frames(LANE_STEPS)
    starts = rng.integers(2**31, size=DRAWS * candidates).tolist()
    gels = way[: -unseen - 1 : -1]
    scenes = []
    for place in first_touches(gantry, gantry.stage, starts, gels, axes, replays.seen):
        if any(depth_mm(gantry, gel, place.shift_m).max() > SHALLOW_MM for gel in way[:-lane]):
            continue
        nearer = YIELDING_M * rng.uniform() * forward
        scenes.append(replays.reduced(place.seed, place.shift_m - nearer))
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
    """A demonstration replayed where its object may have stood; see `find_scene`.

    Attributes:
        onset: first frame in contact.
        felt: root mean square of the recorded contact area in the contact phase.
        seen: (T, 2) middles of the imprint from the onset on, mm; NaN where it is not known.
    """

    def __init__(self, world: World, gantry: Gantry, reference: Reference, late: int):
        self._world, self._gantry, self._reference = world, gantry, reference
        self.onset = max(reference.onset, 1)
        self.felt = float(np.sqrt(np.mean(reference.area[slice(*reference.contact_phase)] ** 2)))
        known = reference.centre_mm is not None
        self.seen = reference.centre_mm[self.onset :] if known else np.empty((0, 2))
        self.seen = self.seen[: reference.frames(CENTRES)]
        self._begin = max(self.onset - reference.frames(LANE_STEPS), 0)
        acting = late * world.dt_s + world.station.latency_s + latency_s(world.twin)
        self._pressures = delayed(reference.action[:, PRESSURES], acting, reference.control_hz)
        self._path = smooth(reference.flange_m)

    def free_way(self, seed: int) -> list[Pose]:
        """Poses of the gel up to the onset, with nothing in its way.

        The gantry is left where the hand was `LANE_STEPS` before it; `reduced` begins there.
        """
        way = []
        for t in frames_of(self._world, self._path, self._pressures, Place(seed, AWAY_M)):
            if t == self._begin:
                self._gantry.mirror(self._world)
            way.append(gel_pose(self._world, self._path[t]))
            if t == self.onset:
                return way
        return way

    def reduced(self, seed: int, shift: np.ndarray) -> Scene:
        """In the gantry, with the object as the task's start `seed` has it, moved by `shift` (3,) m."""
        g, begin = self._gantry, self._begin
        g.stage(seed, tuple(shift))
        if g.blocked:
            return Scene(seed, tuple(shift.tolist()), False, 1.0, FAR_MM)
        actions = along(self._path[begin:], self._pressures[begin:], g.dt_s)
        led = follow(actions, g.flange_m, self._path[begin], g.dt_s)
        _, area = g.rollout(np.clip(led, *g.action_limits))
        area = np.append(np.zeros(begin + 1), area)
        centres = np.vstack([np.full((begin + 1, 2), np.nan), g.centre_mm])
        return self._scene(seed, shift, g.success and not g.failure, area, centres)

    def full(self, seed: int, shift: np.ndarray) -> Scene:
        """The same in the world, from the start."""
        world, area, spoilt = self._world, np.zeros(len(self._path)), None
        centres = np.full((len(area), 2), np.nan)
        for t in frames_of(world, self._path, self._pressures, Place(seed, tuple(shift))):
            if t == 0 and world.blocked:
                return Scene(seed, tuple(shift.tolist()), False, 1.0, FAR_MM)
            area[t], spoilt = world.touch.area, spoilt or world.failure
            if area[t]:
                centres[t] = centre_mm(world.touch.depth_mm, world.sensor.model.window_mm)
        return self._scene(seed, shift, world.success and not spoilt, area, centres)

    def _scene(
        self, seed: int, shift: np.ndarray, done: bool, area: np.ndarray, centres: np.ndarray
    ) -> Scene:
        """What came of a replay that felt `area` (T,) about `centres` (T, 2) mm."""
        recorded = self._reference.area
        phase = slice(*self._reference.contact_phase)
        before = max(self.onset - self._reference.frames(EARLY_STEPS), 0)
        early = area[:before].max(initial=0.0) > FIRM * recorded.max()
        rmse = float(np.sqrt(np.mean((area[phase] - recorded[phase]) ** 2)))
        off_mm = np.linalg.norm(centres[self.onset :][: len(self.seen)] - self.seen, axis=1)
        off_mm = np.where(np.isnan(off_mm), FAR_MM, off_mm)[np.isfinite(self.seen[:, 0])]
        away = float(np.sqrt(np.mean(off_mm**2))) if len(off_mm) else 0.0
        return Scene(seed, tuple(shift.tolist()), bool(done and not early), rmse + early, away)


def _rank(scene: Scene) -> tuple[bool, float]:
    return not scene.works, scene.misfit
