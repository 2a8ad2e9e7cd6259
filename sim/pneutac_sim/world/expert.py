"""Scripted experts: they find the object by touch, with the variation of a person at a joystick.

An expert is reactive: what it does depends on where the gel is, on the pressure it commanded last and on what
the gel feels, all of which a policy sees too. Nothing but touch shows it where the object is. The pressure is
what it is doing: vented, it withdraws; at low pressure it searches; above, it acts on what it has found.

A modelled person at a joystick: the scripted experts, seen and moved by someone slow, uneven, imprecise.

Strength 0 is the expert itself, 1 the person; what lies between scales every imperfection. A person answers
touch late (simple reactions to touch take 0.15 s, with a choice 0.3 s and more: Woodworth and Schlosberg,
Experimental Psychology, 1954; Hick, Q. J. Exp. Psychol. 4 (1952) 11), on top of the camera's step. The hand
follows its wish by a first-order lag of 0.1 s (the neuromuscular lag of an operator: McRuer and Jex, IEEE
Trans. Human Factors in Electronics 8 (1967) 231). For the rest nothing was measured: speeds, pauses, errors
of the eye, lapses and slips are assumptions, chosen so that ten demonstrations leave room for more.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import override

import numpy as np
from scipy.optimize import nnls

from pneutac_sim.errors import InputError
from pneutac_sim.features import MAX_PRESSURE_KPA, action_limits
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.twin import PAPER_FINGER, Twin
from pneutac_sim.world.tasks.base import Habits, Task, Wish
from pneutac_sim.world.tasks.card import CardTask
from pneutac_sim.world.tasks.egg import EggTask
from pneutac_sim.world.tasks.switch import SwitchTask
from pneutac_sim.world.world import World

PAPER_JOINTS = 4
GAIN_RAD_PER_KPA, REST_KPA = PAPER_FINGER["gain_rad_per_kpa"], PAPER_FINGER["rest_pressure_kpa"]
ACCELERATION = 0.8  # m/s2, how fast a hand changes the velocity
TOUCH = 0.25  # mm of imprint, or N, that count as a touch, see `pressed`
VENTED_KPA, SEARCH_KPA = 1.5, 4.5  # below the first it withdraws, from there to the second it searches
FAST_M_S = 0.095
WRAP_M = 0.08  # how much farther up after the last lane
KEEP_HZ = 3.0  # how fast it corrects its lane
NEAR_M = 0.005  # heights that it distinguishes


@dataclass(frozen=True)
class Lanes:
    """A search in lanes along x, from -y to +y, each begun at the near side."""

    height_m: float  # of the gel while it looks for the object, metres above the table
    rise_m: float  # how far above that it withdraws
    middles_m: tuple[float, ...]  # y of the flange in each lane, ascending and evenly spaced
    back_m: float  # x of the flange at which a lane begins

    def ahead(self, world: World, habits: Habits, speed: float) -> np.ndarray:
        """Velocity (3,) along the lane, at the height of the search."""
        return go_ahead(world, habits, self.height_m, speed) + self.keep(world)

    def withdraw(self, world: World, end: bool) -> np.ndarray:
        """Velocity (3,) back to the near side: from the `end` of a lane above everything, else straight.

        On the way down to the next lane it moves on by one; after the last lane it goes up farther, and there
        back to before the first.
        """
        x, y, _ = world.flange_m
        rise, first, last = world.gel_m[2] - self.height_m, self.middles_m[0], self.middles_m[-1]
        width = self.middles_m[1] - first
        if x < self.back_m:
            if rise > self.rise_m + WRAP_M / 2 and y > first - 1.5 * width:
                return np.array([0.0, -FAST_M_S, KEEP_HZ * (self.rise_m + WRAP_M - rise)])
            # Between two heights, so that neither inertia nor latency makes the lane wider.
            aside = width / (self.rise_m - NEAR_M) if NEAR_M < rise < self.rise_m else 0.0
            return FAST_M_S * np.array([0.0, aside, -1.0]) / np.hypot(1.0, aside)
        if end and rise < self.rise_m + WRAP_M * (y > last - width / 2):
            return np.array([0.0, 0.0, FAST_M_S])
        return np.array([-FAST_M_S, 0.0, 0.0]) + self.keep(world)

    def begins(self, world: World) -> bool:
        return world.flange_m[0] < self.back_m and world.gel_m[2] < self.height_m + NEAR_M

    def keep(self, world: World) -> np.ndarray:
        """Velocity (3,) to the middle of the nearest lane."""
        away = np.subtract(self.middles_m, world.flange_m[1])
        return np.array([0.0, KEEP_HZ * away[np.argmin(np.abs(away))], 0.0])


def go_ahead(world: World, habits: Habits, height_m: float, speed: float) -> np.ndarray:
    """Velocity (3,) along x, with the gel at the height of the search."""
    up = height_m + habits.offset_m - world.gel_m[2]
    return speed * habits.speed * np.array([1.0, 0.0, np.clip(30 * up, -1, 1)])


def touching(world: World) -> bool:
    """Whether the press on the gel exceeds `TOUCH`."""
    return pressed(world) > TOUCH


def pressed(world: World) -> float:
    """How hard the gel is pressed: its imprint in mm or the force on it in N, whichever is more.

    An edge makes a deep imprint with little force, a face hardly any with much; a person goes by both.
    """
    return max(world.press_mm, world.press_n)


class ScriptedExpert:
    """Demonstrates the world's task; call `action` once a control step, before `world.step`.

    Experts speak of the paper's finger, of 0 to 15 kPa. Another's pressures are as large a share of its own
    range, of its farther end where it bends by vacuum. Several chambers bend the body as far as the paper's
    finger would be bent, which is curled at 0 kPa already, or as far as they can. `rng` draws the habits and,
    unless switched off, the tremor of the hand.
    """

    def __init__(self, world: World, rng: np.random.Generator, tremor: bool = True):
        self._world = world
        self._rng = rng
        self._habits = Habits.draw(rng)
        if not tremor:
            self._habits = replace(self._habits, tremor=0.0)
        self._velocity, self._follows = np.zeros(3), 1.0  # share of a wish that the hand follows at once
        self._pressure = self._habits.low_kpa
        self._expert = _expert_of(world)
        self._limits = action_limits(world.pressure_range_kpa, world.chambers)
        self._pressures = pressures_of(world)

    def action(self) -> np.ndarray:
        """Next action (3 + C,) float32 as `features.action_names`, within its limits; rests when done."""
        wish, pressure = self._wish()
        change = self._follows * (wish - self._velocity)
        limit = ACCELERATION * self._world.dt_s
        self._velocity += change * min(1.0, limit / max(np.linalg.norm(change), 1e-9))
        # Only inflating takes care: the valve vents, and fills to the pressure of the search, at once.
        ramp = max(self._pressure + self._habits.ramp_kpa_s * self._world.dt_s, self._habits.low_kpa)
        self._pressure = min(pressure, ramp)
        action = np.append(self._velocity + self._trembling(wish), self._pressures(self._pressure))
        return np.clip(action, *self._limits).astype(np.float32)

    def _wish(self) -> Wish:
        if self._world.success:
            return np.zeros(3), self._pressure
        return self._expert(self._world, self._habits, self._pressure)

    def _trembling(self, wish: np.ndarray) -> np.ndarray:
        return self._rng.normal(0, self._habits.tremor, 3) if np.any(wish) else np.zeros(3)


def _expert_of(world: World) -> Callable[..., Wish]:
    task = world.task
    if task.name in EXPERTS:
        return EXPERTS[task.name]
    if type(task).expert is Task.expert:
        raise InputError(
            f"The task '{task.name}' has no scripted expert; give its class a method `expert`, or record"
            " by hand with --teleop.type=pneutac_keyboard or pneutac_gamepad."
        )
    return task.expert


def pressures_of(world: World) -> Callable[[float], np.ndarray]:
    """What the chambers (C,) are commanded in kPa for an expert's pressure: see `ScriptedExpert`."""
    far = max(world.pressure_range_kpa, key=abs)
    if world.chambers == 1:
        return lambda pressure: np.array([far / MAX_PRESSURE_KPA * pressure])
    full, reach_rad = towards_gel(world.twin, far)

    def of(pressure: float) -> np.ndarray:
        bend_rad = PAPER_JOINTS * GAIN_RAD_PER_KPA * (pressure + REST_KPA)
        return min(bend_rad / reach_rad, 1.0) * full

    return of


def towards_gel(twin: Twin, far_kpa: float) -> tuple[np.ndarray, float]:
    """Pressures (C,) in kPa that bend a body of several chambers towards its gel, +z, and by how much in rad.

    With the directions d_c of the pipeline's drive, sum of p_c d_c = (b, 0) with p >= 0 (p <= 0 if it bends
    by vacuum) and no more chambers than that takes; the highest pressure is `far_kpa`.

    Raises InputError: its chambers bend it so by no pressures.
    """
    pipeline = Pipeline.of(twin)
    gain = pipeline.chain[pipeline.drive].line(pipeline.theta(twin))[0]  # (C, 2 N) rad/kPa
    gain = np.sign(far_kpa) * gain.reshape(len(gain), -1, 2).sum(1)
    share, missing = nnls(gain.T, np.array([1.0, 0.0]))
    if missing > 1e-6:
        raise InputError(
            "No pressures of the twin's chambers bend it towards its gel, +z, alone; calibrate the twin,"
            " whose chamber_angle_rad and gains tell the directions."
        )
    full = far_kpa * share / share.max()
    return full, float(np.abs(full) @ gain[:, 0])


# Lanes are nearer to each other than gel and bar together are wide, so that the bar is never between two.
SWITCH_LANES = Lanes(height_m=0.118, rise_m=0.04, middles_m=SwitchTask.starts_m, back_m=0.415)
END_M = 0.512  # flange where the gel is behind the farthest bar
CENTRE_ACROSS_HZ, CENTRE_ALONG_HZ = 4.5, 3.0  # how fast it centres the imprint; the bar is lost to the side


def flip_switch(world: World, habits: Habits, pressure: float) -> Wish:
    """Search lane by lane, press on where it touches, let go when the touch is gone; `pressure` in kPa."""
    x = world.flange_m[0]
    if pressure < VENTED_KPA and not SWITCH_LANES.begins(world):
        return SWITCH_LANES.withdraw(world, x > END_M - 0.01), 0.0
    if touching(world):
        return _push(world, habits, pressure)
    if pressure > SEARCH_KPA or x > END_M:
        return np.zeros(3), 0.0
    return SWITCH_LANES.ahead(world, habits, 0.08), habits.low_kpa


def _push(world: World, habits: Habits, pressure: float) -> Wish:
    """Inflate and creep ahead with the imprint in the middle of the gel."""
    full = np.clip((pressure - habits.low_kpa) / (habits.high_kpa - habits.low_kpa), 0, 1)
    at = world.imprint_m
    across, along = (0.0, 0.0) if at is None else at
    ahead = 0.03 - 0.012 * full
    aside = np.array([CENTRE_ACROSS_HZ * across, CENTRE_ALONG_HZ * along])
    return habits.speed * np.array([ahead, *-aside]), habits.high_kpa


EDGE_M = EggTask().edge_m
# Lanes are closer than gel and tab are wide; the wall is touched below the lid's edge.
EGG_LANES = Lanes(height_m=EDGE_M - 0.02, rise_m=0.030, middles_m=EggTask.starts_m, back_m=0.425)
# A wall meets a corner of the gel, which yields to little: it is pressed by force.
SLIDES_N, PRESS_N = 0.35, 0.5  # on the wall: from which it goes up; while it begins to
SLIDE_N = 0.7  # while it slides up, lest it slips past the tab
PAST_M = 0.012  # gel above the lid's edge when it has slid past it, and past the tab


def open_carton(world: World, habits: Habits, pressure: float) -> Wish:
    """Touch the front wall, slide up along it, and so lift the lid's tab off the latch; `pressure` in kPa."""
    z = world.gel_m[2]
    past = z > EDGE_M + PAST_M
    if past or pressure < VENTED_KPA and not EGG_LANES.begins(world):
        return EGG_LANES.withdraw(world, past), 0.0
    if touching(world) or z > EDGE_M - 0.008:
        sliding = z > EDGE_M - 0.016
        missing = (SLIDE_N if sliding else PRESS_N) - world.press_n
        ahead = np.clip(0.15 * missing, -0.01, 0.025)
        up = 0.06 * (sliding or world.press_n > SLIDES_N)
        return habits.speed * np.array([ahead, 0.0, up]) + EGG_LANES.keep(world), habits.low_kpa
    return EGG_LANES.ahead(world, habits, 0.07), habits.low_kpa


LEAN_RAD = CardTask().lean_rad
MIDDLE_M = CardTask().middle_m - 0.003  # the card creeps down the gel while it is drawn
PRESS = 0.95  # while drawing, see `pressed`
DRAW = np.array([-np.sin(LEAN_RAD), 0.0, np.cos(LEAN_RAD)])
INTO = np.array([np.cos(LEAN_RAD), 0.0, np.sin(LEAN_RAD)])


def pull_card(world: World, habits: Habits, pressure: float) -> Wish:
    """Touch the deck, press lightly, draw along the lean under the same force; `pressure` in kPa."""
    if not touching(world) and pressure < SEARCH_KPA:
        return go_ahead(world, habits, MIDDLE_M, 0.06), habits.low_kpa
    error = PRESS - pressed(world)
    speed = 0.04 * habits.speed * np.clip(1 - 4 * abs(error), 0, 1)
    return speed * DRAW + 0.12 * np.clip(error, -0.2, 0.2) * INTO, 0.65 * habits.high_kpa


EXPERTS: dict[str, Callable[..., Wish]] = {"switch": flip_switch, "egg": open_carton, "card": pull_card}


REACTION_S = (0.15, 0.35)  # of an episode, from touch to answer
LAG_S = 0.12  # of the hand
# Ranges that habits are drawn from, in place of the expert's.
SPEED, LOW_KPA, HIGH_KPA, RAMP_KPA_S = (0.65, 1.25), (2.4, 4.0), (10.0, 13.5), (5.0, 15.0)
PAUSES_HZ, PAUSE_S = 0.3, (0.2, 0.8)  # the hand rests and the pressure is held
TREMOR_M_S, TREMOR_S = 0.006, 0.25  # slow unrest of the velocity, beside the expert's own
ASIDE_M, HEIGHT_M, DRIFT_S = 0.004, 0.0015, (2.0, 5.0)  # errors of the eye, drawn anew after so long
OTHER_WAY = 0.25  # share of episodes that search from the other side
LAPSE, LAPSE_S = 0.15, 0.5  # share of touches that are noticed so much later
SLIP, SLIP_S = 0.10, (0.3, 1.0)  # share of touches that are let go by mistake, after so long


class _Perceived:
    """The world as a person perceives it: late, with an error aside, perhaps mirrored.

    Attributes:
        aside_m, up_m: errors of the eye.
        blind: whether a touch goes unnoticed.
    """

    def __init__(self, world: World, delay: int, mirrored: bool):
        self._world, self.mirror = world, -1.0 if mirrored else 1.0
        self._felt: deque[tuple[float, float, np.ndarray | None]] = deque(
            [(0.0, 0.0, None)] * delay, maxlen=delay + 1
        )
        self.aside_m, self.up_m, self.blind = 0.0, 0.0, False

    def __getattr__(self, name: str):
        return getattr(self._world, name)

    def look(self) -> bool:
        """Takes in what the gel shows now; returns whether the touch that arrives is one."""
        self._felt.append((self._world.press_mm, self._world.press_n, self._world.imprint_m))
        return max(self._felt[0][:2]) > TOUCH

    @property
    def press_mm(self) -> float:
        return 0.0 if self.blind else self._felt[0][0]

    @property
    def press_n(self) -> float:
        return 0.0 if self.blind else self._felt[0][1]

    @property
    def imprint_m(self) -> np.ndarray | None:
        at = None if self.blind else self._felt[0][2]
        return None if at is None else at * (self.mirror, 1.0)

    @property
    def flange_m(self) -> np.ndarray:
        return self._world.flange_m * (1, self.mirror, 1) + (0, self.aside_m, 0)

    @property
    def gel_m(self) -> np.ndarray:
        return self._world.gel_m * (1, self.mirror, 1) + (0, self.aside_m, self.up_m)


class Person(ScriptedExpert):
    """Demonstrates the world's task as a person would; used as `ScriptedExpert`.

    `rng` draws habits, errors and the unrest of the hand; `strength` is that of all imperfections, 0 to 1.

    Raises InputError: the strength is out of range, or the task has no scripted expert.
    """

    def __init__(self, world: World, rng: np.random.Generator, strength: float = 1.0):
        if not 0 <= strength <= 1:
            raise InputError(f"person is {strength:g}; it must be from 0 (the scripted expert) to 1.")
        super().__init__(world, rng)
        self._strength, dt_s = strength, world.dt_s
        self._habits = _habits(self._habits, strength, rng)
        self._pressure = self._habits.low_kpa
        delay = round(strength * rng.uniform(*REACTION_S) / dt_s)
        self._seen = _Perceived(world, delay, rng.random() < OTHER_WAY * strength)
        self._follows = 1 - np.exp(-dt_s / (LAG_S * strength)) if strength else 1.0
        self._unrest = np.zeros(3)
        self._pause_s = self._drift_s = self._lapse_s = self._slip_s = 0.0
        self._touched = False

    @override
    def _wish(self) -> Wish:
        rng, h, dt_s, seen = self._rng, self._strength, self._world.dt_s, self._seen
        self._drift_s -= dt_s
        if self._drift_s <= 0:
            self._drift_s = rng.uniform(*DRIFT_S)
            seen.aside_m, seen.up_m = h * rng.normal(0, (ASIDE_M, HEIGHT_M))
        touched = seen.look()
        if touched and not self._touched:
            self._lapse_s = LAPSE_S if rng.random() < LAPSE * h else 0.0
            self._slip_s = rng.uniform(*SLIP_S) if rng.random() < SLIP * h else 0.0
        self._touched, self._lapse_s = touched, self._lapse_s - dt_s
        seen.blind = self._lapse_s > 0
        wish, pressure = np.zeros(3), self._pressure
        if not self._world.success:
            wish, pressure = self._expert(seen, self._habits, self._pressure)
            wish = np.asarray(wish) * (1, seen.mirror, 1)
        if self._slip_s > 0:
            self._slip_s -= dt_s
            if self._slip_s <= 0:
                wish, pressure = np.zeros(3), 0.0
        if self._pause_s > 0:
            self._pause_s -= dt_s
            wish, pressure = np.zeros(3), self._pressure
        elif rng.random() < PAUSES_HZ * h * dt_s:
            self._pause_s = rng.uniform(*PAUSE_S)
        return wish, pressure

    @override
    def _trembling(self, wish: np.ndarray) -> np.ndarray:
        keep = np.exp(-self._world.dt_s / TREMOR_S)
        fresh = np.sqrt(1 - keep**2) * self._rng.normal(0, TREMOR_M_S * self._strength, 3)
        self._unrest = keep * self._unrest + fresh
        return super()._trembling(wish) + self._unrest


def _habits(expert: Habits, strength: float, rng: np.random.Generator) -> Habits:
    """The expert's habits, moved towards ones drawn from a person's wider ranges."""
    drawn = {"speed": SPEED, "low_kpa": LOW_KPA, "high_kpa": HIGH_KPA, "ramp_kpa_s": RAMP_KPA_S}
    each = {n: rng.uniform(*between) for n, between in drawn.items()}
    return replace(expert, **{n: (1 - strength) * getattr(expert, n) + strength * x for n, x in each.items()})


def demonstrator(world: World, rng: np.random.Generator, strength: float) -> ScriptedExpert:
    """The scripted expert at strength 0, else a person; see `Person`."""
    return Person(world, rng, strength) if strength else ScriptedExpert(world, rng)
