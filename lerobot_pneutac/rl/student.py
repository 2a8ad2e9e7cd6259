"""Demonstrations of a trained actor, for a student that has a camera instead of a probe grid."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from lerobot.utils.constants import ACTION, OBS_STR
from lerobot.utils.feature_utils import combine_feature_dicts, hw_to_dataset_features

from lerobot_pneutac.rl.actor import Actor
from lerobot_pneutac.rl.env import EPISODE_S, actor_observation, pool, to_action
from lerobot_pneutac.rl.options import StudentRef
from pneutac_datasets.demonstrations.episodes import Episode, save_episode
from pneutac_datasets.demonstrations.save import create_dataset, quiet_encoders
from pneutac_sim.errors import InputError
from pneutac_sim.executor import Progress, no_progress
from pneutac_sim.features import ACTION_NAMES, IMAGE_NAME, state_names
from pneutac_sim.twin import Twin
from pneutac_sim.world.checks import Conditions
from pneutac_sim.world.station import Station
from pneutac_sim.world.world import World

ROBOT = "pneutac"  # type of the robot in recorded demonstrations, so that they merge
PATIENCE = 10  # trials for each demonstration that is wanted


def record_student(
    actor_dir: str | Path,
    task: str,
    twin: Twin | None,
    seed: int,
    student: StudentRef,
    progress: Progress = no_progress,
    conditions: Conditions | None = None,
    station: Station | None = None,
) -> tuple[int, int]:
    """Writes a LeRobotDataset with the features of recorded demonstrations; rollouts that fail are left out.

    Stored are the actor's means; the robot carries them out with noise, so that the student also sees what to
    do off the path. Returns how many demonstrations of how many trials. Raises InputError where the actor is
    missing, damaged or another task's, the dataset's folder exists, or the actor succeeds too rarely.
    """
    world = World(task, twin, "image", student.fidelity, conditions, station=station)
    _loaded(actor_dir, world)
    observed = dict.fromkeys(state_names(world.arm.joints), float) | {IMAGE_NAME: world.tactile_shape}
    features = combine_feature_dicts(
        hw_to_dataset_features(dict.fromkeys(ACTION_NAMES, float), ACTION, student.video),
        hw_to_dataset_features(observed, OBS_STR, student.video),
    )
    fps, steps = world.station.control_hz, world.station.steps(EPISODE_S)
    dataset = create_dataset(student.repo_id, student.root, fps, features, ROBOT, student.video, steps)
    if station:
        station.save(Path(student.root) / "meta")
    stored = trials = 0
    with quiet_encoders():
        try:
            for episode in rolled_out(actor_dir, world, seed, student):
                trials += 1
                if episode is not None:
                    save_episode(dataset, episode)
                    stored += 1
                progress("recording demonstrations", stored, student.episodes)
        finally:
            dataset.finalize()
    return stored, trials


def rolled_out(
    actor_dir: str | Path, world: World, seed: int, student: StudentRef
) -> Iterator[Episode | None]:
    """Yields the actor's trials, None for a failed one, until as many as are wanted have succeeded."""
    actor, rng = _loaded(actor_dir, world), np.random.default_rng(seed)
    stored = trials = 0
    while stored < student.episodes:
        if trials >= PATIENCE * max(stored + 1, 2):
            share = f"{stored} of {trials} trials with fidelity '{student.fidelity}'"
            remedy = "train it for longer, or lower the noise"
            raise InputError(f"The actor in '{actor_dir}' succeeded in {share}; {remedy}.")
        episode = roll_out(actor, world, rng, student.noise)
        trials, stored = trials + 1, stored + bool(world.success)
        yield episode if world.success else None


def _loaded(actor_dir: str | Path, world: World) -> Actor:
    actor, task = Actor.load(actor_dir), world.task.name
    if actor.card.get("task", task) != task:
        raise InputError(f"The actor in '{actor_dir}' was trained on '{actor.card['task']}', not '{task}'.")
    if actor.joints != world.arm.joints:
        both = f"an arm of {actor.joints} joints, and the station's has {world.arm.joints}"
        remedy = "give its station by --station="
        raise InputError(f"The actor in '{actor_dir}' was trained with {both}; {remedy}.")
    return actor


def roll_out(actor: Actor, world: World, rng: np.random.Generator, noise: float) -> Episode:
    """One trial from a start that `rng` draws, until success, failure or the last step."""
    observed = world.reset(int(rng.integers(2**31)))
    previous, kpa = np.zeros(len(ACTION_NAMES)), world.pressure_range_kpa
    states, actions, images = [], [], []
    while len(states) < world.station.steps(EPISODE_S) and not (world.success or world.failure):
        mean = actor.act(actor_observation(world, observed.state, previous, pool(world.touch.depth_mm)))
        states.append(observed.state)
        actions.append(to_action(mean, kpa).astype(np.float32))
        images.append(observed.tactile)
        previous = np.clip(mean + noise * rng.standard_normal(len(mean)), -1, 1)
        observed = world.step(to_action(previous, kpa))
    recorded = np.array(states), np.array(actions), np.array(images)
    return Episode(*recorded, world.task.description, world.station.control_hz)
