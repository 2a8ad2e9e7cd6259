"""Trials of a task from a start to their end."""

import numpy as np

from lerobot_robot_pneutac.standin.world import StandinWorld
from pneutac_datasets.demonstrations.episodes import Episode
from pneutac_sim.features import CONTROL_HZ
from pneutac_sim.world.expert import ScriptedExpert


def played(world, seed, pilot=ScriptedExpert, steps=300):
    """Observations (T + 1) and actions (T, A) of a pilot until it succeeds, fails or has had its steps."""
    seen, actions = [world.reset(seed)], []
    pilot = pilot(world, np.random.default_rng(seed))
    while len(actions) < steps and not (world.success or world.failure):
        actions.append(pilot.action())
        seen.append(world.step(actions[-1]))
    return seen, np.array(actions)


def succeeds(world, seed, pilot=ScriptedExpert, steps=300) -> bool:
    played(world, seed, pilot, steps)
    return bool(world.success and not world.failure)


def until(world, seed, reached) -> np.ndarray:
    """Plays the scripted expert from a start until `reached()`; returns its last action (A,)."""
    world.reset(seed)
    expert, action = ScriptedExpert(world, np.random.default_rng(seed)), np.zeros(3 + world.chambers)
    while not reached():
        action = expert.action()
        world.step(action)
    return action


def press_bar(world, away_m) -> int:
    """Sets the switch's bar this far from the gel, along its normal, and feels it; returns the bar's geom."""
    site, bar = world.data.site("gel"), world.model.geom("bar").id
    world.data.geom_xpos[bar] = site.xpos + away_m * site.xmat.reshape(3, 3)[:, 2]
    world.touch.sense(world.data)
    return bar


def episode_of(seen, actions, fps=CONTROL_HZ) -> Episode:
    state, images = np.array([o.state for o in seen[:-1]], float), np.stack([o.tactile for o in seen[:-1]])
    return Episode(state, np.array(actions, float), images, "press", fps)


def shown(count, seed, physics=None, task="button", drag_m=0.0, steps=220) -> list[Episode]:
    """Demonstrations of a scripted expert on the stand-in; one that fails is shown anew."""
    world, episodes = StandinWorld(task, physics=physics), []
    if drag_m:
        world.task.drag_m = drag_m
    while len(episodes) < count:
        seen, actions = played(world, seed, steps=steps)
        seed += 1
        if world.success:
            episodes.append(episode_of(seen, actions))
    return episodes
