"""What a policy remembers of its episode: where it last touched, and what it sensed a little while ago.

A finger that has lost the touch, or searches to and fro, senses at one place what it sensed there before; one
observation does not say what comes next.
"""

import numpy as np
import torch
from torch import Tensor

from pneutac_sim.features import SPECKS, Places

POSITION_M, AREA = 0.01, 0.1  # what counts as much as one, also of the state
EARLIER_S = (8 / 15, 16 / 15)  # before the present frame
FADES_S = 2.0  # in which the last touch counts a factor e less
FAR_M, FARTHEST = 2 * POSITION_M, 3.0  # displacement that counts 1, and how much one may count


class Memory:
    """Of B episodes that go on side by side, of a finger with so many chambers and a control rate."""

    def __init__(self, chambers: int, control_hz: int):
        self._places, self._hz = Places.of(chambers), control_hz
        self._states: list[Tensor] = []  # the last ones, oldest first
        self._touch_m = self._ago_s = None

    def recall(self, state: Tensor) -> Tensor:
        """What there is to remember with a present state (B, 2 N + 5 + C); keeps nothing.

        Returns:
            (B, 4 + 2 (4 + C)): exp(-s / `FADES_S`) of the seconds s since the last touch, and as much of the
            displacement from there in `POSITION_M`; for each of `EARLIER_S` the displacement since, the
            contact area then in `AREA` and the pressures then less the present ones, kPa. Zeros before the
            first touch; the first frame stands for those before it.
        """
        at = self._places
        touch_m, ago_s = self._touched(state)
        lately = torch.exp(-ago_s / FADES_S)[:, None]
        found = [lately, lately * (state[:, at.ee] - touch_m) / POSITION_M]
        for seconds in EARLIER_S:
            then = self._state(round(seconds * self._hz), state)
            moved = (state[:, at.ee] - then[:, at.ee]) / FAR_M
            found += [
                moved.clamp(-FARTHEST, FARTHEST),
                then[:, [at.area]] / AREA,
                then[:, at.pressure] - state[:, at.pressure],
            ]
        return torch.cat(found, 1)

    def keep(self, state: Tensor) -> None:
        """Goes on by a frame."""
        self._touch_m, self._ago_s = self._touched(state)
        longest = round(max(EARLIER_S) * self._hz)
        self._states = [*self._states, state][-longest:]

    def _state(self, frames: int, present: Tensor) -> Tensor:
        return self._states[max(len(self._states) - frames, 0)] if self._states else present

    def _touched(self, state: Tensor) -> tuple[Tensor, Tensor]:
        """Where the last touch was (B, 3), and how long ago (B,), infinite before the first."""
        here_m, touches = state[:, self._places.ee], state[:, self._places.area] >= SPECKS
        if self._touch_m is None:
            touch_m, ago_s = torch.zeros_like(here_m), torch.full_like(here_m[:, 0], torch.inf)
        else:
            touch_m, ago_s = self._touch_m, self._ago_s + 1 / self._hz
        return torch.where(touches[:, None], here_m, touch_m), torch.where(touches, 0.0, ago_s)


def size(chambers: int) -> int:
    """How many numbers `Memory.recall` gives."""
    return 4 + len(EARLIER_S) * (4 + chambers)


def of_touch(chambers: int) -> list[int]:
    """Which of them a policy without touch must not see."""
    each = 4 + chambers
    return [*range(4), *(4 + k * each + 3 for k in range(len(EARLIER_S)))]


def scaled(recalled: Tensor, kpa: Tensor) -> Tensor:
    """What `Memory.recall` gives with the pressures in units (C,)."""
    units, each = torch.ones_like(recalled[0]), 4 + len(kpa)
    for k in range(len(EARLIER_S)):
        units[(k + 1) * each + 4 - len(kpa) : (k + 1) * each + 4] = kpa
    return recalled / units


def of_episodes(states: Tensor, episodes: np.ndarray, chambers: int, control_hz: int) -> Tensor:
    """What is remembered at every frame (F, `size`) of states (F, 2 N + 5 + C) and their episodes (F,)."""
    found, of, memory = [], None, None
    for state, episode in zip(states.split(1), episodes, strict=True):
        if episode != of:
            of, memory = episode, Memory(chambers, control_hz)
        found.append(memory.recall(state))
        memory.keep(state)
    return torch.cat(found)
