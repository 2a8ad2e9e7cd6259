"""Options of an augmentation whose datasets are never opened, and demonstrations in the twin's world."""

from functools import cache
from itertools import count, islice
from pathlib import Path

import numpy as np

from pneutac_datasets.demonstrations.augment.episode import AugmentSetup
from pneutac_datasets.demonstrations.augment.options import AugmentConfig, DatasetRef
from pneutac_datasets.demonstrations.augment.reference import Reference
from pneutac_sim.features import AREA, EE
from pneutac_sim.gel.sensor import centre_mm
from pneutac_sim.world.base import Variation
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.world import World


def config_of(source: Path, new: Path, **options) -> AugmentConfig:
    """Of datasets that are named after their folders."""
    refs = {"dataset": DatasetRef(f"local/{source.name}", source)}
    return AugmentConfig(**refs, output=DatasetRef(f"local/{new.name}", new), **options)


def setup_of(references: list, task: str = "switch", candidates: int = 48, **options) -> AugmentSetup:
    """Of references; with the planner, formulas and seed 1 where the options do not say."""
    options = {"method": "planner", "fidelity": "probe", "seed": 1} | options
    config = config_of(Path("recorded"), Path("new"), **options)
    return AugmentSetup(config, references, task, candidates=candidates)


@cache
def recorded(task, seed, late=0, pilot=ScriptedExpert, width=0.0, after=10) -> Reference | None:
    """A demonstration by formulas, and so many frames after its end; None where it fails.

    Commands act `late` control steps too late; `width` is that of the starts.
    """
    world, rows = World(task, touch="area", fidelity="probe"), []
    world.variation = Variation(late_commands=late)
    world.widen_starts(width)
    observation, pilot = world.reset(seed), pilot(world, np.random.default_rng(seed))
    while after and len(rows) < 200 and not world.failure:
        after -= world.success
        touch, window = world.touch, world.sensor.model.window_mm
        middle = centre_mm(touch.depth_mm, window) if touch.area else np.full(2, np.nan)
        rows.append((observation.state.astype(float), pilot.action().astype(float), middle))
        observation = world.step(rows[-1][1])
    state, action, middle = map(np.array, zip(*rows, strict=True))
    works = world.success and not world.failure and state[:, AREA].any() and not state[0, AREA]
    return Reference(seed, state[:, EE], state[:, AREA], action, task, middle) if works else None


def demonstrations(task, number, late=0, **options) -> list[Reference]:
    """The first so many that work."""
    made = (recorded(task, seed, late, **options) for seed in count(1))
    return list(islice(filter(None, made), number))
