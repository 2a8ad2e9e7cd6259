"""An episode carried out once more in the twin's world: its pressures, along the path that the arm went.

The flange is led along the recorded path, so that what differs is the finger's: its pressure, its bend and
its touch. Frame t of a replay is what the twin predicts for frame t of the episode.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_filter

from pneutac_datasets.demonstrations.episodes import Episode
from pneutac_sim.features import CONTROL_HZ, EE, MAX_SPEED_M_S
from pneutac_sim.twin import Twin
from pneutac_sim.world.base import Variation
from pneutac_sim.world.world import World

AWAY_M = (0.0, 0.0, -5.0)  # out of everything's way
SMOOTH = 5  # frames
FEEDBACK_HZ = 2.0  # rate at which the flange returns to the recorded path


@dataclass(frozen=True)
class Place:
    """Where an episode's objects stand."""

    seed: int  # of the task's own start
    shift_m: tuple[float, float, float]  # displacement (3,) of the objects from it


NOWHERE = Place(0, AWAY_M)


@dataclass(frozen=True)
class Replayed:
    """What a twin predicts of an episode of T frames."""

    flange_m: np.ndarray  # (T, 3) where the flange went
    area: np.ndarray  # (T,) contact areas; 0 where the world has no images
    press_mm: np.ndarray  # (T,) how far the gel's face is pressed in
    press_n: np.ndarray  # (T,) force on it
    pressure_kpa: np.ndarray  # (T,) in the chamber
    gel_m: np.ndarray  # (T, 3) middle of the gel's face, in the recorded flange's place
    gel_axes: np.ndarray  # (T, 9) its rotation
    images: np.ndarray | None  # uint8 (T, H, W, 3); None where they were not asked for
    success: bool  # whether the task was done


def follow(action: np.ndarray, flange_m: np.ndarray, goal_m: np.ndarray, dt_s: float) -> np.ndarray:
    """Actions (H, 3 + C) along a path that begins at `goal_m`, led back to it from the flange's place."""
    out = np.array(action, float)
    fade = (1 - FEEDBACK_HZ * dt_s) ** np.arange(len(out))
    out[:, :3] += FEEDBACK_HZ * fade[:, None] * (goal_m - flange_m)
    out[:, :3] = np.clip(out[:, :3], -MAX_SPEED_M_S, MAX_SPEED_M_S)
    return out


def along(path: np.ndarray, pressures: np.ndarray, dt_s: float) -> np.ndarray:
    """Actions (T - 1, 3 + C) that go along a path (T, 3) m with pressures (T, C) kPa."""
    return np.hstack([np.diff(path, axis=0) / dt_s, pressures[:-1]])


def frames_of(
    world: World, path: np.ndarray, pressures: np.ndarray, place: Place, more_rad: float = 0.0
) -> Iterator[int]:
    """Carries a demonstration out from a reset; yields the number of each frame when the world shows it.

    Path (T, 3) m of the flange, pressures (T, C) kPa when they act: commands act at once, and who delays them
    delays the pressures. `more_rad` is a bend in addition to that of the pressure, shared by the joints.
    """
    world.variation = Variation(tuple(path[0]), place.shift_m, at_once=True, more_rad=more_rad)
    world.reset(place.seed)
    yield 0
    for t, action in enumerate(along(path, pressures, world.dt_s)):
        led = follow(action[None], world.flange_m, path[t], world.dt_s)[0]
        world.step(np.clip(led, *world.action_limits))
        yield t + 1


def replay(
    world: World, episode: Episode, place: Place = NOWHERE, more_rad: float = 0.0, keep: bool = False
) -> Replayed:
    """Carries an episode out in a world of the twin, in any state; images are stored if they are to `keep`.

    The world's touch is `image` or, faster, `probe`; without a place the objects are out of the way.
    """
    path, pressures = smooth(episode.state[:, EE]), late(episode.action[:, 3:], latency_s(world.twin))
    rows, images = [], []
    for t in frames_of(world, path, pressures, place, more_rad):
        touch = world.touch.area, world.press_mm, world.press_n
        rows.append((world.flange_m, *touch, world.pressure_kpa, *gel_pose(world, path[t])))
        if keep:
            images.append(world.touch.image)
    columns = [np.array(c) for c in zip(*rows, strict=True)]
    done = bool(world.success and not world.failure)
    return Replayed(*columns, np.stack(images) if keep else None, done)


def gel_pose(world: World, recorded_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) m and rotation (9,) of the gel, where the recorded flange and not the replayed one is."""
    return world.gel_m + recorded_m - world.flange_m, world.data.site("gel").xmat.copy()


def commanded(world: World, action: np.ndarray, start_m: np.ndarray) -> np.ndarray:
    """Where the flange goes, (T, 3) m, by actions (T, 3 + C) that act at once, with nothing in its way."""
    world.variation = Variation(tuple(start_m), AWAY_M, at_once=True)
    world.reset(0)
    path = [world.flange_m]
    for each in np.clip(action[:-1], *world.action_limits):
        world.step(each)
        path.append(world.flange_m)
    return np.array(path)


def smooth(path: np.ndarray) -> np.ndarray:
    """A path (T, 3) without the noise of its encoders: lines fitted to `SMOOTH` frames about each."""
    return path if len(path) < SMOOTH else savgol_filter(path, SMOOTH, 1, axis=0, mode="interp")


def latency_s(twin: Twin) -> float:
    """By which commands act late: the twin's `command_latency_s`, fitted to demonstrations as a whole."""
    known = twin.parameters.get("command_latency_s")
    return known.value if known else 0.0


def late(command: np.ndarray, latency_s: float, hz: float = CONTROL_HZ) -> np.ndarray:
    """Commands (T, ...), each held for a frame, `latency_s` later; before the first there was none."""
    whole, part = divmod(latency_s * hz, 1.0)
    padded = np.concatenate([np.zeros((int(whole) + 1, *command.shape[1:])), command])
    return (1 - part) * padded[1 : len(command) + 1] + part * padded[: len(command)]
