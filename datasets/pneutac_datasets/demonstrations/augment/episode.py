"""One new demonstration out of recorded ones: a pure function of seed and index."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from itertools import count
from typing import NamedTuple

import numpy as np
from lerobot.utils.constants import OBS_IMAGES

from pneutac_datasets.demonstrations.augment.library import (
    Followers,
    Library,
    lagged_answers,
    regular,
    start_spread_m,
)
from pneutac_datasets.demonstrations.augment.options import AugmentConfig
from pneutac_datasets.demonstrations.augment.planner import CemPlanner, Course
from pneutac_datasets.demonstrations.augment.reference import (
    EXTRA_STEPS,
    Reference,
    onset_sigma_m,
    reaction_hz,
)
from pneutac_datasets.demonstrations.augment.scene import Scene, command_latency, find_scene
from pneutac_datasets.demonstrations.episodes import POINTS
from pneutac_datasets.demonstrations.replaying import FEEDBACK_HZ, follow
from pneutac_sim.errors import InputError
from pneutac_sim.features import MAX_PRESSURE_KPA, PRESSURES, VELOCITY_NAMES, Places
from pneutac_sim.gel.sensor import centre_mm
from pneutac_sim.least_squares import Z95
from pneutac_sim.twin import Twin
from pneutac_sim.world.base import Variation
from pneutac_sim.world.checks import Conditions, draw
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.gantry import Gantry
from pneutac_sim.world.scene import DivergedError
from pneutac_sim.world.station import Station
from pneutac_sim.world.task_env import SceneCameras, tactile_points
from pneutac_sim.world.world import World

# Standard deviations.
FRICTION = 0.15  # of the factor on the gel's friction
PEAK_KPA = 0.5  # of the peak pressure of a finger of 0 to 15 kPa; of another in proportion to its range
BEND_GAIN = 0.04  # of the factor on pressure to bend, at most, and where the twin has no interval of its own
ASIDE_M = 0.005  # of the object's place along y, at most: the way there stays, and a gel is 16 mm wide
LATE = 1  # control steps by which touch is shown too late, at most


@dataclass(frozen=True)
class Variant:
    """One draw of the domain randomisation."""

    source: int  # index of the reference
    # (3,) displacement of the object and, from the touch on, of the reference trajectory; its height stays,
    # as objects stand on the table. Until the touch the trajectory stays: nothing else shows where the object
    # is.
    shift_m: tuple[float, float, float]
    friction: float  # factor on the gel's friction
    peak_kpa: float  # added to the peak pressure, and in proportion below it
    bend_gain: float  # factor on pressure to bend
    late_commands: int = 0  # control steps by which commands act too late, as they did in the demonstrations
    late_touch: int = 0  # control steps by which touch is shown too late, which is not recorded
    conditions: dict[str, float] = field(default_factory=dict)  # of the world

    @classmethod
    def draw(
        cls,
        source: int,
        sigma_m: np.ndarray,
        late_commands: int,
        rng: np.random.Generator,
        conditions: Conditions | None = None,
        bend_gain_sd: float = BEND_GAIN,
    ) -> "Variant":
        """A variant of a reference; factors stay within two standard deviations."""
        friction, peak, gain = np.clip(rng.standard_normal(3), -2, 2)
        sigma_m = np.array([sigma_m[0], min(sigma_m[1], ASIDE_M), 0.0])
        shift = np.clip(rng.standard_normal(3), -2, 2) * sigma_m
        return cls(
            source,
            tuple(shift.tolist()),
            float(1 + FRICTION * friction),
            float(PEAK_KPA * peak),
            float(1 + bend_gain_sd * gain),
            late_commands,
            int(rng.integers(0, LATE + 1)),
            draw(conditions or {}, rng),
        )

    def of_world(self, start_m: np.ndarray, shift_m: Sequence[float] = (0.0, 0.0, 0.0)) -> Variation:
        """The world's own: the flange starts at `start_m` (3,), objects stand `shift_m` (3,) aside, m."""
        start, shift = tuple(np.asarray(start_m).tolist()), tuple(np.add(shift_m, self.shift_m).tolist())
        late = self.late_commands, self.late_touch
        return Variation(start, shift, self.bend_gain, self.friction, *late, self.conditions)


def bend_gain_sd(twin: Twin | None) -> float:
    """Standard deviation of the factor on pressure to bend: by the interval of the twin's own gain.

    Where gain and rest pressure can stand in for each other that interval may even include zero, though they
    fix the bend together; it is then no measure of how far the bend may be off.
    """
    gain = twin.parameters.get("gain_rad_per_kpa") if twin else None
    if gain is None or gain.ci95 is None or not gain.value:
        return BEND_GAIN
    return min((gain.ci95[1] - gain.ci95[0]) / (2 * Z95 * abs(gain.value)), BEND_GAIN)


FEED_FORWARD_M_S = 0.01  # velocity added along the motion in contact for a friction factor higher by one
START_M = 0.004  # standard deviation of the start; its height stays, by which many a contact is met at all
SHORTEST = 8  # control steps of the paper's rate; what is done sooner was done by where the object stood
DIVERGED = "the physics diverged"
IN_THE_WAY = "the object stood where the hand starts"
TRIES = 10  # variants of one reference before another one gets its turn
# Noise that is carried out and not stored, so that labels show the way back (Laskey et al., DART, CoRL 2017).
NOISE_FREE_M_S, NOISE_TOUCH_M_S, NOISE_SHARE = 0.010, 0.00075, 1 / 120  # the last: of the pressure range
NOISE_CORRELATION = 0.8  # from one control step to the next
# For a demonstration without a reference, at most: control steps of the paper's rate, and by the longest
# recorded one, as a whole, until its first touch and from there on. Of 140 accepted without the latter (all
# three tasks), two took longer.
LONGEST, LONGER = 300, 1.5


@dataclass(frozen=True)
class AugmentSetup:
    """Everything that a demonstration depends on, besides its index: options, and what was recorded."""

    config: AugmentConfig
    references: list[Reference]  # the recorded demonstrations, in the station's frame
    task: str  # of the world
    station: Station | None = None  # None for the paper's
    further: dict[str, dict] = field(default_factory=dict)  # features that demonstrations have besides touch
    videos: tuple[str, ...] = ()  # features that are stored as videos
    candidates: int = 48  # scenes drawn to find where the object stood

    @cached_property
    def start_range_m(self) -> tuple[float, float, float]:
        """Half widths by which starts lie about the recorded ones; not of the planner."""
        return self.config.start_range or start_spread_m(self.references)

    @property
    def cameras(self) -> dict[str, tuple[int, int]]:
        """Names of the scene cameras to height and width of their pictures."""
        return {k.split(".")[-1]: tuple(f["shape"][:2]) for k, f in self.further.items() if k != POINTS}

    def world(self, touch: str = "image", fidelity: str | None = None) -> World:
        """The world in which demonstrations are carried out, in another fidelity if one is given."""
        c = self.config
        twin = Twin.load(c.twin) if c.twin else None
        world = World(self.task, twin, touch, fidelity or c.fidelity, c.conditions, station=self.station)
        world.widen_starts(c.start_width)
        return world

    @property
    def limits(self) -> tuple[int, int, int]:
        """Control steps after which an attempt without a reference is over: untouched, touched, in all."""
        recorded = np.array([(r.onset, len(r) - r.onset, len(r)) for r in self.references])
        until, after, longest = np.ceil(LONGER * recorded.max(0)).astype(int).tolist()
        longest = min(self.references[0].frames(LONGEST), longest)
        return min(until, longest), after, longest


@dataclass
class Attempt:
    """What came of a variant."""

    state: np.ndarray  # (T, 2 N + 5 + C), action: (T, 3 + C), images: uint8 (T, H, W, 3) as recorded
    action: np.ndarray
    images: np.ndarray | None
    reason: str | None  # why it was rejected, or None
    cost: float  # mean of the plans' costs
    area_rmse: float  # root mean square error of the contact area from its onset on
    start: tuple[int, Variation]  # seed and variation of the world at the start
    # (T, ...) of further features, such as scene cameras' pictures, by their names in the dataset
    more: dict[str, np.ndarray] = field(default_factory=dict)
    # (T, 3 + C) the actions with the noise that was carried out; None where there was none
    carried_out: np.ndarray | None = None

    @property
    def area(self) -> np.ndarray:
        """(T,) contact areas before each action."""
        return self.state[:, Places.of(self.action.shape[1] - len(VELOCITY_NAMES)).area]


CONTACT = slice(6, 8)  # contact area and log(1 + pixels) in a state of `BatchedWorld`


class Sensed(NamedTuple):
    """An attempt of T frames in a batch of worlds, which have neither the arm's joints nor images."""

    start: tuple[int, Variation]  # seed and variation
    states: np.ndarray  # (T, 8 + C) as `BatchedWorld.state`
    actions: np.ndarray  # (T, 3 + C) float32
    displacement_mm: dict[
        int, np.ndarray
    ]  # (80, 59) of the gel's face, of the frames in which it was touched


@dataclass
class Generator:
    """Makes demonstrations; holds one world and its gantry."""

    setup: AugmentSetup
    touch: str = "image"
    seconds: dict = field(default_factory=lambda: {"execution": 0.0})

    def __post_init__(self):
        s, method = self.setup, self.setup.config.method
        self.world = s.world(self.touch)
        self._scene = SceneCameras(self.world, s.cameras)
        self.gantry = Gantry(self.world)
        self.late_commands = command_latency(self.world, s.references)
        self.bend_gain_sd = bend_gain_sd(self.world.twin)
        if method == "library":
            width_kpa, answers = float(np.ptp(self.world.pressure_range_kpa)), lagged_answers(s.references)[0]
            self.library = Library.of([regular(r) for r in s.references], answers, width_kpa)
        if method == "planner":
            self.sigma_m, self.reaction_hz = onset_sigma_m(s.references), reaction_hz(s.references)

    def scene(self, source: int) -> Scene:
        """Where the object stood in a reference."""
        s, late = self.setup, self.late_commands
        return find_scene(self.world, self.gantry, s.references[source], s.config.seed, s.candidates, late)

    def episode(self, index: int, scenes: list[Scene]) -> tuple[Attempt, dict]:
        """The demonstration number `index`: variants are tried until one does the task.

        Of the planner, `scenes` are one for each reference.

        Returns:
            the accepted attempt, and its provenance with every rejection's reason.

        Raises InputError: none of `attempts` variants did the task.
        """
        rejected = []
        for number in range(self.setup.config.attempts):
            variant, where, rng = self.variant(index, number)
            try:
                if self.setup.config.method == "planner":
                    scene = scenes[variant.source]
                    attempt = self.carry_out(variant, scene, rng)
                    scores = {"cost": attempt.cost, "area_rmse": attempt.area_rmse, "scene": asdict(scene)}
                else:
                    attempt, scores = self.find_out(variant, rng)
            except DivergedError:
                rejected.append({"attempt": number, "reason": DIVERGED, **where})
                continue
            if attempt.reason is None:
                return attempt, self.provenance(index, number, where | scores, len(attempt.action), rejected)
            rejected.append({"attempt": number, "reason": attempt.reason, **where})
        raise self.none_worked(index, rejected)

    def variant(self, index: int, number: int) -> tuple[Variant, dict, np.random.Generator]:
        """What an attempt at a demonstration varies, its provenance, and what decides all the rest."""
        s, rng = self.setup, np.random.default_rng([self.setup.config.seed, index, number])
        source = (index + number // TRIES) % len(s.references)
        sigma_m = self.sigma_m if s.config.method == "planner" else np.zeros(3)
        drawn = rng, s.config.conditions, self.bend_gain_sd
        variant = Variant.draw(source, sigma_m, self.late_commands, *drawn)
        return variant, {"source_episode": s.references[source].source, **asdict(variant)}, rng

    def provenance(self, index: int, number: int, made: dict, frames: int, rejected: list[dict]) -> dict:
        """Of an accepted demonstration."""
        c = self.setup.config
        key = {"episode": index, "seed": c.seed, "method": c.method, "attempt": number}
        return {**key, **made, "frames": frames, "rejected": rejected}

    def none_worked(self, index: int, rejected: list[dict]) -> InputError:
        reasons = ", ".join(sorted({r["reason"] for r in rejected}))
        tried = f"none of {self.setup.config.attempts} variants did the task '{self.setup.task}'"
        remedy = "are the recorded demonstrations of this task and this finger?"
        return InputError(f"Demonstration {index}: {tried} ({reasons}); {remedy}")

    def carry_out(self, variant: Variant, scene: Scene, rng: np.random.Generator) -> Attempt:
        """Plans a variant and carries it out in the world.

        Args:
            variant: what is different from the reference.
            scene: where the object stood in the reference.
            rng: decides the start's jitter and the planner's samples.
        """
        r = self.setup.references[variant.source]
        seed, self.world.variation = self.start_in(scene, variant, rng)
        return self._carried_out(self._plan(r, variant, rng), seed, r.area)

    def start_in(self, scene: Scene, variant: Variant, rng: np.random.Generator) -> tuple[int, Variation]:
        """Seed and variation of the world at the start of an attempt that follows a reference."""
        r = self.setup.references[variant.source]
        start = r.flange_m[0] + START_M * np.append(np.clip(rng.standard_normal(2), -2, 2), 0)
        return scene.seed, variant.of_world(start, scene.shift_m)

    def find_out(self, variant: Variant, rng: np.random.Generator) -> tuple[Attempt, dict]:
        """Does the task without a reference: start and object lie anywhere.

        The variant's source is the demonstration about whose start this one begins.

        Returns:
            the attempt, and its provenance: of the library `path`, the pieces that it consists of.
        """
        seed, self.world.variation = self.start(variant, rng)
        self._path: list[tuple[int, int, int]] = []
        if self.setup.config.method == "library":
            ways, noise = self._follow(rng), None
        else:  # without the tremor of a hand
            expert, noise = ScriptedExpert(self.world, rng, tremor=False), rng
            ways = (expert.action() for _ in count())
        attempt = self._carried_out(ways, seed, noise=noise)
        return attempt, pieces(self._path)

    def start(self, variant: Variant, rng: np.random.Generator) -> tuple[int, Variation]:
        """Seed and variation of the world at the start of an attempt without a reference."""
        s = self.setup
        start_m = s.references[variant.source].flange_m[0] + rng.uniform(-1, 1, 3) * s.start_range_m
        return int(rng.integers(2**31)), variant.of_world(start_m)

    def _follow(self, rng: np.random.Generator) -> Iterator[np.ndarray]:
        """Yields the library's actions; begins at the first, after the world was reset."""
        world = self.world
        follower = Followers(self.library, world.action_limits)
        follower.begin(0, rng, world.flange_m)
        self._path = follower.paths[0]
        while True:
            felt = (np.array(x, float)[None] for x in (world.touch.area, self._centre_mm(), world.flange_m))
            (action,), goes_on = follower.actions(np.zeros(1, int), *felt)
            if not goes_on:
                return
            yield action

    def _carried_out(
        self,
        ways: Iterator[np.ndarray],
        seed: int,
        demonstrated: np.ndarray | None = None,
        noise: np.random.Generator | None = None,
    ) -> Attempt:
        """Carries actions out in the world, from a reset with a seed, until the task is done or they end.

        Args:
            ways: asked for its next action once a control step.
            seed: of the task's own start.
            demonstrated: contact areas of the reference; None without one, where the time is limited.
            noise: draws what is carried out besides each action and not stored; None for nothing.
        """
        observation = self.world.reset(seed)
        begun, frames = (seed, self.world.variation), self.setup.references[0].frames
        if self.world.blocked:
            nothing = observation.state[None][:0], np.zeros((0, len(self.world.action_limits[0]))), None
            return Attempt(*nothing, IN_THE_WAY, 0.0, 1.0, begun)
        states, actions, images, areas, more, self._costs = [], [], [], [], [], []
        carried_out: list[np.ndarray] = []
        astray, missed = np.zeros(len(self.world.action_limits[0])), True
        end, after, longest = self.setup.limits
        while not (self.world.success or self.world.failure):
            action = next(ways, None)
            if action is None or demonstrated is None and len(actions) >= end:
                break
            states.append(observation.state)
            images.append(observation.tactile)
            more.append(self._further())
            actions.append(action.astype(np.float32))
            areas.append(self.world.touch.area)
            began = time.perf_counter()
            if noise is not None:
                astray = NOISE_CORRELATION * astray + np.sqrt(
                    1 - NOISE_CORRELATION**2
                ) * noise.standard_normal(len(astray))
            done = np.clip(actions[-1] + self._noise_size() * astray, *self.world.action_limits)
            carried_out.append(done.astype(np.float32))
            observation = self.world.step(carried_out[-1])
            if missed and self.world.touch.area > 0:
                missed, end = False, min(len(actions) + after, longest)
            self.seconds["execution"] += time.perf_counter() - began
        early = len(actions) < frames(SHORTEST)
        reason = rejection(self.world.failure, self.world.success, early, missed)
        return Attempt(
            np.array(states),
            np.array(actions),
            np.array(images) if images and images[0] is not None else None,
            reason,
            float(np.mean(self._costs)) if self._costs else 0.0,
            1.0 if demonstrated is None else area_rmse(np.array(areas), demonstrated),
            begun,
            {key: np.array([each[key] for each in more]) for key in (more[0] if more else ())},
            None if noise is None else np.array(carried_out),
        )

    def _noise_size(self) -> np.ndarray:
        """Standard deviations (3 + C,) of the noise that is carried out, now."""
        velocity = NOISE_TOUCH_M_S if self.world.touch.area > 0 else NOISE_FREE_M_S
        pressures = [NOISE_SHARE * float(np.ptp(self.world.pressure_range_kpa))] * self.world.chambers
        return np.array([velocity] * len(VELOCITY_NAMES) + pressures)

    def _further(self) -> dict[str, np.ndarray]:
        """Further features of this frame, by their names in the dataset."""
        points = {POINTS: tactile_points(self.world).ravel()} if POINTS in self.setup.further else {}
        return points | {f"{OBS_IMAGES}.{name}": p for name, p in self._scene.pictures().items()}

    def _plan(self, r: Reference, variant: Variant, rng: np.random.Generator) -> Iterator[np.ndarray]:
        """Yields the next action (3 + C,) for what is, until it is over."""

        def felt():
            return self.world.touch.area, self._centre_mm(), self.world.flange_m

        for asked in self.guided(r, variant, rng, felt, self._costs):
            if isinstance(asked, CemPlanner):
                self.gantry.mirror(self.world)
                asked.solve()
            else:
                yield asked

    def guided(
        self,
        r: Reference,
        variant: Variant,
        rng: np.random.Generator,
        felt: Callable[[], tuple[float, np.ndarray, np.ndarray]],
        costs: list[float],
    ) -> Iterator[np.ndarray | CemPlanner]:
        """Yields the next action (3 + C,), before it a planner whose plan is to be solved, until it is over.

        Args:
            r: the reference.
            variant: what is different from it.
            rng: decides the planner's samples.
            felt: contact area, middle of the imprint (2,) mm, NaN without touch, and flange (3,) m, now.
            costs: those of the plans are added to it.
        """
        config = self.setup.config.planner.at(r.control_hz)
        planner = CemPlanner(self.gantry, config, rng, r.control_hz)
        r = r.prolonged(r.frames(EXTRA_STEPS))
        demonstrated, course = self._warm(r, variant), Course(r, variant.shift_m[1], self.reaction_hz)
        steps, dt_s, limits = np.arange(config.horizon), self.world.dt_s, self.world.action_limits
        fades = (1 - FEEDBACK_HZ * dt_s) ** steps[:, None]
        action, queue = np.zeros(r.action.shape[1]), []
        while course.advance(*(now := felt())) and course.frame < len(r):
            t = course.frame
            if not (course.in_contact and queue):
                frames = np.minimum(t + steps, course.last)
                warm = demonstrated[frames].copy()
                if not course.waiting:
                    warm = follow(warm, now[2], r.flange_m[t] + course.offset_m, dt_s)
                queue = [warm[0]]
                if course.in_contact:
                    warm[t + steps > course.last, :3] = course.onward_m * r.control_hz
                    answer = course.answer * fades
                    warm += answer
                    ahead = t + 1 + steps
                    beyond = np.maximum(ahead - course.last, 0)[:, None] * course.onward_m
                    ahead = np.minimum(ahead, course.last)
                    goal = r.flange_m[ahead] + course.offset_m + beyond
                    goal += np.cumsum(answer[:, :3], 0) / r.control_hz
                    planner.begin(warm, action, course.area_goal(t + 1 + steps), goal)
                    yield planner
                    costs.append(planner.cost)
                    warm = planner.best - answer  # is to what is felt in each step, not when it was planned
                    queue = list(warm[: config.replan])
            action = np.clip(queue.pop(0) + course.answer, *limits)
            yield action

    def _centre_mm(self) -> np.ndarray:
        """(2,) middle of the imprint; NaN without touch."""
        touch = self.world.touch
        if not touch.area > 0:
            return np.full(2, np.nan)
        return centre_mm(touch.depth_mm, self.world.sensor.model.window_mm)

    def _warm(self, r: Reference, variant: Variant) -> np.ndarray:
        """The reference's actions (T, 3 + C) with jittered peak pressure and friction feed-forward."""
        action = r.action.copy()
        peak = np.abs(action[:, PRESSURES]).max()
        if peak > 0:
            width = np.ptp(self.world.pressure_range_kpa) / MAX_PRESSURE_KPA
            action[:, PRESSURES] += width * variant.peak_kpa * action[:, PRESSURES] / peak
        touching = (r.area > 0)[:, None]
        speed = np.linalg.norm(action[:, :3], axis=1, keepdims=True)
        along = action[:, :3] / np.maximum(speed, 0.01)
        action[:, :3] += touching * along * FEED_FORWARD_M_S * (variant.friction - 1)
        return np.clip(action, *self.world.action_limits)


def rejection(failure: str | None, success: bool, early: bool, missed: bool) -> str | None:
    """Why an attempt is rejected that ended so; None where it is accepted.

    Args:
        failure: what has spoilt the trial.
        success: whether the task was done.
        early: whether it ended within `SHORTEST`.
        missed: whether the object was not touched.
    """
    if failure:
        return failure
    if success and early:
        return IN_THE_WAY
    if missed:
        return "it did not touch the object"
    return None if success else "the task was not done by the end"


def pieces(path: list[tuple[int, int, int]]) -> dict:
    """Provenance of a path of `library.Followers`."""
    named = [dict(zip(("frame", "source_episode", "source_frame"), p, strict=True)) for p in path]
    return {"path": named} if named else {}


def area_rmse(area: np.ndarray, demonstrated: np.ndarray) -> float:
    """Root mean square error of a contact area (T,) from its onset on; 1 where it never touches."""
    frames = np.flatnonzero(area > 0)
    if not len(frames):
        return 1.0
    onset = int(np.flatnonzero(demonstrated > 0)[0])
    n = min(len(area) - frames[0], len(demonstrated) - onset)
    return float(np.sqrt(np.mean((area[frames[0] :][:n] - demonstrated[onset:][:n]) ** 2)))
