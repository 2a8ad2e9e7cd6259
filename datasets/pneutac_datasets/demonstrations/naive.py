"""Naive augmentation: more demonstrations out of a few, without a simulator (the paper's N-Aug).

Time warping, demonstration mix-up, kinematic and pressure jitter, and jitter of the tactile image's
appearance. What is physically tied together is changed together as far as the data alone allow: warped time
scales the velocities, a displaced approach moves joints and commands too, and contact pixels follow from the
contact area. Nothing knows whether the altered demonstration would have done the task.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata

from pneutac_datasets.demonstrations.augment.options import AugmentConfig
from pneutac_datasets.demonstrations.augment.run import describe_as, finish, summary_of
from pneutac_datasets.demonstrations.episodes import (
    TACTILE,
    Episode,
    demonstration_features,
    load_episode,
    readable,
    save_episode,
)
from pneutac_datasets.demonstrations.faults import Recorded
from pneutac_datasets.demonstrations.save import create_dataset, written
from pneutac_sim.errors import InputError
from pneutac_sim.executor import Progress, no_progress
from pneutac_sim.features import PANDA_JOINTS, PAPER_RANGE_KPA, PRESSURES, action_limits, state_limits
from pneutac_sim.files import whole
from pneutac_sim.world.station import Station

# How far each variation goes; small against the differences between phases of a demonstration.
SPEED = (0.85, 1.2)  # local speed of time
MIX_SHARE, MIX_WEIGHT = 0.5, (0.1, 0.4)  # share of mixed demonstrations, weight of the partner
START_M = 0.003  # standard deviation of the displaced start
PRESSURE_GAIN = 0.03  # standard deviation of the pressure's factor
CONTRAST = (0.8, 1.25)  # factor on each colour channel's change by contact
BRIGHTNESS = 2.0  # standard deviation of each channel's offset, levels of 255


def augment_naive(
    recorded: Recorded,
    config: AugmentConfig,
    station: Station | None = None,
    progress: Progress = no_progress,
) -> dict:
    """Writes a LeRobotDataset of varied demonstrations that merges with its source.

    The recorded ones that have not failed take turns, and the seed decides every variation. `progress` is
    called with a text, and how many of how many are made. The result has the keys of `run.augment_guided`.
    Raises InputError: the source has other features, or the new folder exists.
    """
    new, seed, episodes, began = config.output, config.seed, config.episodes, time.monotonic()
    if new.root.exists():
        raise InputError(f"'{new.root}' exists; give a new folder for dataset '{new.repo_id}'.")
    recorded.refuse_damaged()
    with readable(recorded.folder):
        meta = LeRobotDatasetMetadata(config.dataset.repo_id, recorded.folder)
        features = demonstration_features(meta)
        source = LeRobotDataset(meta.repo_id, recorded.folder, video_backend="pyav")
    used = recorded.used
    if faults := recorded.motion_faults() or ([] if used else recorded.too_few()):
        raise InputError(faults[0])

    @lru_cache(maxsize=16)
    def load(index: int) -> Episode:
        with readable(recorded.folder):
            return load_episode(source, used[index])

    states, actions = map(np.concatenate, zip(*recorded.episodes.values(), strict=True))
    longest = int(np.ceil(max(meta.episodes["length"]) / SPEED[0])) + 1
    use_videos = features[TACTILE]["dtype"] == "video"
    provenance = [
        {"episode": k, "seed": seed, "source_episode": used[k % len(used)], "method": "naive"}
        for k in range(episodes)
    ]
    with whole(new.root) as part:
        out = create_dataset(new.repo_id, part, meta.fps, features, meta.robot_type, use_videos, longest)
        with written(out):
            for k, made in enumerate(varied(load, len(used), states, actions, episodes, seed)):
                progress("varying demonstrations", k, episodes)
                save_episode(out, made)
        describe_as(part, recorded.folder)
        finish(part, provenance, station)
    return summary_of(provenance, {}, [], began)


def varied(
    load: Callable[[int], Episode], n: int, states: np.ndarray, actions: np.ndarray, episodes: int, seed: int
) -> Iterator[Episode]:
    """Yields so many varied demonstrations of `n` recorded ones, which `load` gives by their numbers.

    They take turns; `states` and `actions` are those of all their frames.
    """
    slope = _joint_slope(states, load(0))
    # A recording does not say what its finger bears: no farther than the paper's, or than was demonstrated.
    pressures = actions[:, PRESSURES]
    low_kpa = min(float(pressures.min()), PAPER_RANGE_KPA[0])
    high_kpa = max(float(pressures.max()), PAPER_RANGE_KPA[1])
    for k in range(episodes):
        rng = np.random.default_rng([seed, k])
        partner = load(int(rng.integers(n))) if rng.random() < MIX_SHARE else None
        yield vary(load(k % n), partner, slope, rng, (low_kpa, high_kpa))


def vary(
    episode: Episode,
    partner: Episode | None,
    slope: np.ndarray,
    rng: np.random.Generator,
    pressure_range_kpa: tuple[float, float] = PAPER_RANGE_KPA,
) -> Episode:
    """One varied demonstration, with a partner mixed in where there is one.

    `slope` (3, N) is the change of the joint angles with the flange position, rad/m; pressures keep to the
    range.
    """
    if partner is not None:
        episode = _mix(episode, partner, rng.uniform(*MIX_WEIGHT))
    state, action = episode.state.copy(), episode.action.copy()
    _displace_approach(episode, state, action, slope, rng)
    gain = 1 + PRESSURE_GAIN * rng.standard_normal()
    state[:, episode.places.pressure] *= gain
    action[:, PRESSURES] *= gain
    varied = _warp_time(replace(episode, state=state, action=action), rng)
    varied.state = np.clip(varied.state, *_limits(varied, pressure_range_kpa)).astype(np.float32)
    limits = action_limits(pressure_range_kpa, varied.chambers)
    varied.action = np.clip(varied.action, *limits).astype(np.float32)
    varied.images = _change_appearance(varied.images, rng)
    return varied


def _limits(episode: Episode, pressure_range_kpa: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Of the state; of the joints only the Panda's are known."""
    sizes = {"pixels": episode.pixels, "chambers": episode.chambers}
    if episode.angles.stop == PANDA_JOINTS:
        return state_limits(pressure_range_kpa, **sizes)
    far = np.full(episode.angles.stop, np.inf)
    return state_limits(pressure_range_kpa, (-far, far, far), **sizes)


def _mix(episode: Episode, partner: Episode, weight: float) -> Episode:
    """Weighted mean of two demonstrations, their times aligned at start, first and last contact, and end."""
    a, b = episode.contact(), partner.contact()
    knots = [0, *(a if a and b else ()), len(episode) - 1]
    matched = [0, *(b if a and b else ()), len(partner) - 1]
    times = np.interp(np.arange(len(episode)), knots, matched)
    other = partner.at(times)
    state = (1 - weight) * episode.state + weight * other.state
    state[:, episode.places.pixels] = np.log1p(state[:, episode.places.area] * episode.pixels)
    images = np.stack(
        [((1 - weight) * i + weight * j).round() for i, j in zip(episode.images, other.images, strict=True)]
    )
    action = (1 - weight) * episode.action + weight * other.action
    return replace(episode, state=state, action=action, images=images.astype(np.uint8))


def _displace_approach(episode: Episode, state, action, slope, rng) -> None:
    """Displaces the start of the path; the displacement fades out until the first contact.

    Position, joint angles, their rates and the commanded velocity all follow the displaced path; in place.
    """
    contact = episode.contact()
    end = contact[0] if contact else len(episode) - 1
    fade = np.zeros(len(episode) + 1)
    fade[: end + 1] = 0.5 + 0.5 * np.cos(np.pi * np.arange(end + 1) / max(end, 1))
    shift = fade[:, None] * (START_M * rng.standard_normal(3))  # (T + 1, 3) m
    state[:, episode.places.ee] += shift[:-1]
    state[:, episode.angles] += shift[:-1] @ slope
    velocity = np.diff(shift, axis=0) * episode.fps
    state[:, episode.rates] += velocity @ slope
    action[:, :3] += velocity


def _warp_time(episode: Episode, rng: np.random.Generator) -> Episode:
    """Plays a demonstration at a smoothly varying speed; the velocities follow."""
    low, high = SPEED
    phase, cycles = rng.uniform(0, 2 * np.pi), rng.uniform(0.5, 2.0)
    middle = rng.uniform(low, high)
    swing = min(middle - low, high - middle)
    t, times = 0.0, []
    while t <= len(episode) - 1:
        times.append(t)
        t += middle + swing * np.sin(phase + 2 * np.pi * cycles * t / len(episode))
    return episode.at(np.array(times))


def _change_appearance(images: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Scales what contact changes in the images, and shifts their brightness, a channel at a time."""
    contrast = rng.uniform(*CONTRAST, 3).astype(np.float32)
    brightness = (BRIGHTNESS * rng.standard_normal(3)).astype(np.float32)
    first = images[0].astype(np.float32)
    # One image at a time: a whole episode in floats would take a gigabyte for some minutes of data.
    return np.stack(
        [
            np.clip(first + contrast * (i - first) + brightness, 0, 255).round().astype(np.uint8)
            for i in images
        ]
    )


def _joint_slope(states: np.ndarray, like: Episode) -> np.ndarray:
    """Least-squares change of the joint angles with the flange position over all states, (3, N) rad/m.

    With the orientation held this is the arm's inverse Jacobian where the demonstrations are; directions in
    which they hardly move stay out (singular values under 1 %).
    """
    state = states - states.mean(0)
    return np.linalg.lstsq(state[:, like.places.ee], state[:, like.angles], rcond=0.01)[0]
