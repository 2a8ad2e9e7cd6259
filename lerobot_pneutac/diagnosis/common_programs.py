"""Programs that are no law's own: steps, strokes, stairs, loops, holds, and turns of several chambers.

Of several chambers each program is driven on each alone, on each two and on all, and some turn the bend about
the axis.
"""

from collections.abc import Iterator

import numpy as np

from lerobot_pneutac.diagnosis.law_programs import STEP_S
from lerobot_pneutac.diagnosis.limits import Limits

Share = float | np.ndarray  # of the range, of all chambers alike or of each (chambers,)
Knots = list[tuple[float, Share]]  # seconds since the one before, and where to


def ways(chambers: int) -> Iterator[tuple[str, np.ndarray]]:
    """Which chambers go along: a name, empty of one chamber, and the share of each (chambers,)."""
    one = np.eye(chambers)
    if chambers == 1:
        yield "", one[0]
        return
    for i in range(chambers):
        yield f"chamber {i + 1}", one[i]
    for i in range(chambers if chambers > 2 else 0):
        other = (i + 1) % chambers
        a, b = sorted((i + 1, other + 1))
        yield f"chambers {a} and {b}", one[i] + one[other]
    yield "all chambers", one.sum(axis=0)


def on_chambers(name: str, way: str) -> str:
    """A program's name with the chambers that it goes to."""
    return f"{name}, {way}" if way else name


def turning(chambers: int, turn_s: float, share: float, turns: float) -> Knots:
    """The bend goes round the axis, the last half of the turns backwards; from rest to rest."""
    steps = 24
    phase = np.arange(round(turns * steps) + 1)
    phase = np.minimum(phase, phase[-1] - phase) * 2 * np.pi / steps
    around = np.maximum(np.cos(phase[:, None] - 2 * np.pi * np.arange(chambers) / chambers), 0.0)
    way = [(turn_s / steps, share * x) for x in around[1:]]
    return [(turn_s / 4, share * around[0]), *way, (turn_s / 4, 0.0)]


def first_program(limits: Limits) -> tuple[np.ndarray, np.ndarray]:
    """Time (n,) and command (n, chambers) of what to begin with: stairs, steps, a hold, strokes or turns."""
    if limits.chambers > 1:
        return sampled(_first_of_several(limits.chambers), limits)
    stairs = [0.0, 0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0]
    knots = [k for x in stairs for k in hold(x, 2.0)]
    knots += [(8.0, 0.9), (8.0, 0.0), (2.0, 1.0), (2.0, 0.0), *hold(0.8, 9.0), *hold(0.0, 5.0)]
    knots += [*hold(0.5, 3.0), *hold(0.2, 3.0), *hold(1.0, 3.0), *hold(0.0, 2.0)]
    return sampled(knots, limits)


def _first_of_several(chambers: int) -> Knots:
    one = np.eye(chambers)
    knots: Knots = hold(0.0, 1.0)
    for alone in one:
        knots += [k for x in (0.33, 0.67, 1.0, 0.5, 0.0) for k in hold(x * alone, 2.0)]
    knots += turning(chambers, 12.0, 0.9, 2.0)
    knots += [*hold(0.5 * one.sum(0), 2.0), *hold(one.sum(0), 3.0), *hold(0.0, 2.0)]
    knots += [*hold(0.8 * one[0], 9.0), *hold(0.0, 5.0)]
    knots += [*hold(0.5 * one[1], 3.0), *hold(0.2 * one[1], 3.0), *hold(one[1], 3.0), *hold(0.0, 2.0)]
    return knots


def common_programs(limits: Limits) -> Iterator[tuple[str, str, np.ndarray, np.ndarray]]:
    """Name, kind, time (n,) and command (n, chambers) of each."""
    for name, kind, knots in _grid():
        for way, shares in ways(limits.chambers):
            along: Knots = [(s, x * shares) for s, x in knots]
            yield on_chambers(name, way), kind, *sampled(along, limits)
    for share in (0.4, 0.7, 1.0) if limits.chambers > 1 else ():
        for turn_s in (4.0, 12.0, 29.0):
            turns = max(1.0, round(58 / turn_s) - 0.5)
            knots = turning(limits.chambers, turn_s, share, turns)
            yield f"turns at {share:.0%} in {turn_s:g} s", "turns", *sampled(knots, limits)


def _grid() -> Iterator[tuple[str, str, Knots]]:
    """Amplitude x pace x hold, each about 60 s long and from rest to rest."""
    for a in (0.4, 0.7, 1.0):
        for hold_s in (2.0, 6.0, 15.0):
            count = max(1, round(60 / (2 * hold_s)))
            yield (
                f"steps to {a:.0%}, held {hold_s:g} s", "steps",
                [*hold(0.0, 1.0), *([*hold(a, hold_s), *hold(0.0, hold_s)] * count)],
            )  # fmt: skip
        for half in (1.5, 4.0, 15.0):
            count = max(1, round(60 / (2 * half)))
            yield f"strokes to {a:.0%} in {half:g} s", "strokes", [(half, a), (half, 0.0)] * count
    for a in (0.6, 1.0):
        for dwell in (2.0, 5.0):
            levels = a * np.r_[0:7, 5:-1:-1] / 6
            count = max(1, round(60 / (dwell * len(levels))))
            knots = [k for x in np.tile(levels, count) for k in hold(x, dwell)]
            yield f"stairs to {a:.0%}, {dwell:g} s each", "stairs", knots
    for span in (0.1, 0.3):
        for half in (1.0, 4.0):
            for middle in (0.35, 0.65):
                count = max(1, round(50 / (2 * half)))
                turns = [(half, middle + span), (half, middle - span)] * count
                yield (
                    f"loops of {span:.0%} about {middle:.0%} in {half:g} s", "loops",
                    [(3.0, middle - span), *turns, (3.0, 0.0)],
                )  # fmt: skip
    for a in (0.4, 0.9):
        yield f"hold at {a:.0%}", "hold", [*hold(0.0, 1.0), *hold(a, 40.0), *hold(0.0, 19.0)]
    turn = np.arange(600) * 0.1
    chirp = 0.5 - 0.4 * np.cos(2 * np.pi * 0.03 * 60 / np.log(30) * (30 ** (turn / 60) - 1))
    yield "chirp", "chirp", [(0.1, float(x)) for x in chirp]
    rng = np.random.default_rng(0)
    for number in (1, 2):
        levels, holds = rng.uniform(0, 1, 24), np.exp(rng.uniform(np.log(0.5), np.log(6.0), 24))
        holds *= 60 / holds.sum()
        knots = [k for x, s in zip(levels, holds, strict=True) for k in hold(float(x), float(s))]
        yield f"random holds {number}", "random holds", knots


def hold(share: Share, seconds: float) -> Knots:
    """A step, and then nothing."""
    return [(STEP_S, share), (seconds - STEP_S, share)]


def sampled(knots: Knots, limits: Limits) -> tuple[np.ndarray, np.ndarray]:
    """Time (n,) and pressure (n, chambers) of shares of the range at times for a length of 60 s."""
    scale = limits.length_s / 60.0
    time_s = np.array([0.0, *(s for s, _ in knots)])
    share = np.array([np.broadcast_to(x, limits.chambers) for x in (0.0, *(x for _, x in knots))])
    time_s = np.cumsum(np.where(time_s <= STEP_S, time_s, scale * time_s))
    grid = np.arange(round(time_s[-1] * limits.hz) + 1) / limits.hz
    kpa = limits.pressure_kpa(np.stack([np.interp(grid, time_s, x) for x in share.T], axis=1))
    return grid, np.clip(kpa, limits.low_kpa, limits.high_kpa)  # rounding
