"""Planned demonstrations carried out once more by the full material points, and how far the two agree.

The same start, object and actions; what differs is how finger and gel deform. The last action goes on for a
second where the task takes longer.
"""

import time
from dataclasses import asdict, dataclass

import numpy as np

from pneutac_datasets.demonstrations.augment.episode import Attempt, AugmentSetup
from pneutac_datasets.demonstrations.augment.reference import EXTRA_STEPS, frames_at
from pneutac_datasets.demonstrations.augment.work import Work
from pneutac_sim.files import write_json
from pneutac_sim.progress import Progress
from pneutac_sim.twin import Twin
from pneutac_sim.world.world import World

STEP_S = 0.6  # of a control step by material points on one core, until it has been measured


@dataclass(frozen=True)
class Agreement:
    """One demonstration by two fidelities."""

    episode: int  # its number
    success: bool  # whether the task is done there too
    touched: tuple[int, int]  # steps with touch as planned, and as checked
    # root mean square difference of the contact areas, shares of the image, from the first touch of either on
    area_rmse: float
    area_peak: float  # largest contact area as planned, to compare it with
    image_rmse_levels: float  # the same of the tactile images in steps in which either touches, of 255
    seconds: float  # that the check took


def check(work: Work, setup: AugmentSetup, number: int, progress: Progress) -> None:
    """Writes the agreements of the first `number` demonstrations into their work folder; what is there stays.

    `progress` is called with the minutes that are left, and how many steps of how many are done.
    """
    missing = [k for k in range(number) if not work.check_file(k).exists()]
    attempts = {k: work.load_episode(k)[0] for k in missing}
    total, done, began, world = sum(len(a.action) for a in attempts.values()), 0, time.monotonic(), None

    def step() -> None:
        nonlocal done
        each = (time.monotonic() - began) / done if done else STEP_S
        minutes = each * (total - done) / 60
        progress(f"checking with material points, about {minutes:.0f} minutes left", done, total)
        done += 1

    for k, attempt in attempts.items():
        if world is None:
            world = checking_world(setup)
            began = time.monotonic()
        write_json(work.check_file(k), asdict(agreement(world, k, attempt, step)))


def checking_world(setup: AugmentSetup, fidelity: str = "mpm") -> World:
    """The world in which demonstrations are carried out once more."""
    twin = Twin.load(setup.twin) if setup.twin else None
    world = World(setup.task, twin, "image", fidelity, setup.conditions, station=setup.where)
    world.widen_starts(setup.start_width)
    return world


def agreement(world: World, episode: int, attempt: Attempt, step=lambda: None) -> Agreement:
    """Carries out a demonstration in another world; calls `step` before each of its actions."""
    began = time.monotonic()
    seed, variation = attempt.start
    world.variation = variation
    world.reset(seed)
    areas, errors, planned = [], [], attempt.area
    carried_out = attempt.action if attempt.carried_out is None else attempt.carried_out
    for t, action in enumerate(carried_out):
        step()
        areas.append(world.touch.area)
        if areas[t] > 0 or planned[t] > 0:
            errors.append(np.mean((world.touch.image.astype(float) - attempt.images[t]) ** 2))
        world.step(action)
    for _ in range(frames_at(world.station.control_hz, EXTRA_STEPS)):
        if world.success or world.failure:
            break
        world.step(attempt.action[-1])
    error, felt = np.array(areas) - planned, np.flatnonzero((np.array(areas) > 0) | (planned > 0))
    return Agreement(
        episode,
        bool(world.success and not world.failure),
        (int(np.sum(planned > 0)), int(np.sum(np.array(areas) > 0))),
        float(np.sqrt(np.mean(error[felt[0] :] ** 2))) if len(felt) else 0.0,
        float(planned.max()),
        float(np.sqrt(np.mean(errors))) if errors else 0.0,
        time.monotonic() - began,
    )
