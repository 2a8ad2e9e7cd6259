"""The world: Panda, pneumatic finger with its gel, and a task, on MuJoCo."""

from pneutac_sim.world.world import Observation, World

__all__ = ["Observation", "World"]
