"""A modelled person at a joystick: the scripted experts, seen and moved by someone slow, uneven, imprecise.

Strength 0 is the expert itself, 1 the person; what lies between scales every imperfection. A person answers
touch late (simple reactions to touch take 0.15 s, with a choice 0.3 s and more: Woodworth and Schlosberg,
Experimental Psychology, 1954; Hick, Q. J. Exp. Psychol. 4 (1952) 11), on top of the camera's step. The hand
follows its wish by a first-order lag of 0.1 s (the neuromuscular lag of an operator: McRuer and Jex, IEEE
Trans. Human Factors in Electronics 8 (1967) 231). For the rest nothing was measured: speeds, pauses, errors
of the eye, lapses and slips are assumptions, chosen so that ten demonstrations leave room for more.
"""

from collections import deque
from dataclasses import replace
from typing import override

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.world.expert import TOUCH, Habits, ScriptedExpert, Wish
from pneutac_sim.world.world import World

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

    Args:
        world: whose task is demonstrated.
        rng: draws habits, errors and the unrest of the hand.
        strength: of all imperfections, 0 to 1.

    Raises:
        InputError: the strength is out of range, or the task has no scripted expert.
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
    return replace(
        expert,
        **{
            name: (1 - strength) * getattr(expert, name) + strength * rng.uniform(*between)
            for name, between in drawn.items()
        },
    )


def demonstrator(world: World, rng: np.random.Generator, strength: float) -> ScriptedExpert:
    """The scripted expert at strength 0, else a person; see `Person`."""
    return Person(world, rng, strength) if strength else ScriptedExpert(world, rng)
