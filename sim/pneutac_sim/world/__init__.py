"""The world: Panda, pneumatic finger with its gel, and a task, on MuJoCo."""

from pneutac_sim.world.base import Observation
from pneutac_sim.world.world import World

__all__ = ["Observation", "World"]
