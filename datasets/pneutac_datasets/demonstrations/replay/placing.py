"""Where an episode's objects stood: not recorded, found from the first touch.

Starts are drawn from the task. In each the objects are moved to where the gel, on the recorded way, feels
them at the recorded onset, with the imprint's middle where the images show it.
"""

import numpy as np

from pneutac_datasets.demonstrations.augment.reference import imprint_centres_mm
from pneutac_datasets.demonstrations.episodes import Episode
from pneutac_datasets.demonstrations.replay.replaying import Place, ReplayWorld
from pneutac_sim.errors import InputError
from pneutac_sim.features import AREA
from pneutac_sim.gel.contact import without_specks
from pneutac_sim.gel.sensor import centre_mm
from pneutac_sim.world.varied import Variation

DRAWS, ENOUGH = 128, 8  # starts drawn at most, and those in reach of which the nearest is taken
REACH_M, STEP_M = 0.08, 0.001  # how far objects are moved along the gel's view, in steps
CENTRES = 12  # frames from the onset on whose imprints are taken
SHALLOW_MM = 0.15  # depth of the first touch that a camera shows


def find_place(world: ReplayWorld, episode: Episode) -> Place:
    """The start and displacement with which the twin first feels what the episode felt.

    Args:
        world: any state; it is reset.
        episode: with at least one touch.

    Raises:
        InputError: no object of the task comes into the gel's reach there.
    """
    contact = episode.contact()
    if contact is None:
        raise InputError("The episode never touches anything, so the position of its objects is unknown.")
    onset = contact[0]
    free = world.replay(episode)
    middle = imprint_centres_mm(episode.images, without_specks(episode.state[:, AREA]), world.sensor)
    shown = middle[onset : onset + CENTRES]
    seen = np.nanmedian(shown, axis=0) if np.isfinite(shown).any() else None
    gel = free.gel_m[onset], free.gel_axes[onset]
    x, y, z = gel[1].reshape(3, 3).T  # across and along the finger, and the gel's view
    found = []
    for start in np.random.default_rng([0, 11]).integers(2**31, size=DRAWS).tolist():
        world.variation = Variation(tuple(episode.state[0, -6:-3]), (0.0, 0.0, 0.0))
        world.reset(start)
        shift = np.zeros(3)
        for _ in range(2):  # once to the gel, then away from it
            far = _touching(world, gel, shift, z)
            if far is None:
                break
            shift = shift + far * z
            if seen is not None:
                there = centre_mm(_depth(world, gel, shift), world.sensor.model.window_mm)
                shift = shift + 1e-3 * ((seen[0] - there[0]) * x + (seen[1] - there[1]) * y)
        else:
            far = _touching(world, gel, shift, z)
            if far is not None:
                found.append((float(np.linalg.norm(shift)), start, tuple((shift + far * z).tolist())))
        if len(found) == ENOUGH:
            break
    if not found:
        raise InputError(
            f"No object of the task '{world.task.name}' comes into the gel's reach at the first touch, frame "
            f"{onset}; is the episode of another task, or the twin of another finger?"
        )
    _, start, shift = min(found)
    return Place(start, shift)


def _depth(world: ReplayWorld, gel, shift: np.ndarray) -> np.ndarray:
    touch, data = world.touch, world.data
    return touch.sensor.probe(
        touch.kinds, touch.sizes, data.geom_xpos[touch.felt] + shift, data.geom_xmat[touch.felt], *gel
    )


def _touching(world: ReplayWorld, gel, shift: np.ndarray, view: np.ndarray) -> float | None:
    """How far (m) beyond `shift` along the view the objects are just felt, or None within `REACH_M`."""

    def deep(far: float) -> bool:
        return _depth(world, gel, shift + far * view).max() > SHALLOW_MM

    far = REACH_M
    while not deep(far):
        far -= STEP_M
        if far < -REACH_M:
            return None
    near, far = far, far + STEP_M  # felt, and not
    for _ in range(5):
        middle = (near + far) / 2
        near, far = (middle, far) if deep(middle) else (near, middle)
    return near
