"""Where a demonstration's objects stood: not recorded, found from the first touch.

Starts are drawn from the task. In each the objects are moved to where the gel, on the recorded path, feels
them at the recorded onset, with the imprint's middle where the images show it.

A comparison takes that place, off the table if need be: in it the twin feels the object when it was felt,
whatever its finger does wrong. Augmentation, whose twin is trusted, goes on from such places on the table to
the scene in which the whole demonstration happens again, see `augment.scene`.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice

import numpy as np

from pneutac_datasets.demonstrations.episodes import Episode
from pneutac_datasets.demonstrations.replay.imprint import imprint_centres_mm
from pneutac_datasets.demonstrations.replay.replaying import Place, replay
from pneutac_sim.errors import InputError
from pneutac_sim.features import AREA
from pneutac_sim.gel.contact import without_specks
from pneutac_sim.gel.sensor import centre_mm
from pneutac_sim.world.varied import Variation, VariedWorld

DRAWS, ENOUGH = 128, 8  # starts drawn at most, and those in reach of which the nearest is taken
REACH_M, STEP_M = 0.08, 0.001  # how far objects are moved along the gel's view, in steps
CENTRES = 12  # frames from the onset on whose imprints are taken
SHALLOW_MM = 0.15  # depth of the first touch that a camera shows

Pose = tuple[np.ndarray, np.ndarray]  # position (3,) m and rotation (9,) of the gel


def find_place(world: VariedWorld, episode: Episode) -> Place:
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
    free = replay(world, episode)
    gel = free.gel_m[onset], free.gel_axes[onset]
    middles = imprint_centres_mm(episode.images, without_specks(episode.state[:, AREA]), world.sensor)
    world.variation = Variation(tuple(episode.state[0, -6:-3]))
    starts = np.random.default_rng([0, 11]).integers(2**31, size=DRAWS).tolist()
    seen = middles[onset : onset + CENTRES]
    touches = first_touches(world, world.reset, starts, [gel], gel[1].reshape(3, 3).T, seen)
    found = list(islice(touches, ENOUGH))
    if not found:
        raise InputError(
            f"No object of the task '{world.task.name}' comes into the gel's reach at the first touch, frame "
            f"{onset}; is the episode of another task, or the twin of another finger?"
        )
    return min(found, key=lambda place: float(np.linalg.norm(place.shift_m)))


def first_touches(
    world: VariedWorld,
    lay_out: Callable[[int], object],
    starts: Iterable[int],
    gels: Sequence[Pose],
    axes: np.ndarray,
    seen_mm: np.ndarray,
) -> Iterator[Place]:
    """Places at which the gel just feels the objects.

    Args:
        world: whose objects are laid out.
        lay_out: puts them where the task's start of a seed has them.
        starts: seeds.
        gels: poses at which the gel may first have felt them; the first that reaches them is taken.
        axes: (3, 3), rows by which objects are moved: across the gel, along it, and the way that it looks.
        seen_mm: (T, 2) middles of the imprint from the onset on; NaN where it is not known.
    """
    seen = np.nanmedian(seen_mm, axis=0) if np.isfinite(seen_mm).any() else None
    for start in starts:
        lay_out(start)
        shifts = (_first_touch(world, gel, axes, seen) for gel in gels)
        shift = next((s for s in shifts if s is not None), None)
        if shift is not None:
            yield Place(start, tuple(shift.tolist()))


def on_table(gel: Pose) -> np.ndarray:
    """(3, 3) axes of `first_touches` that leave objects on the table."""
    view = gel[1].reshape(3, 3)[:, 2] * (1, 1, 0)
    view /= max(np.linalg.norm(view), 1e-9)
    across = np.array([-view[1], view[0], 0.0])
    across *= np.sign(across @ gel[1].reshape(3, 3)[:, 0] or 1.0)
    return np.stack([across, np.zeros(3), view])


def _first_touch(world: VariedWorld, gel: Pose, axes: np.ndarray, seen: np.ndarray | None):
    """Displacement (3,) m at which the gel just feels the objects, or None."""
    shift = np.zeros(3)
    for _ in range(2):  # once to the gel, then away from it
        far = _touching(world, gel, shift, axes[2])
        if far is None:
            return None
        shift = shift + far * axes[2]
        if seen is not None:
            there = centre_mm(depth_mm(world, gel, shift), world.sensor.model.window_mm)
            shift = shift + 1e-3 * (seen - there) @ axes[:2]
    far = _touching(world, gel, shift, axes[2])
    return None if far is None else shift + far * axes[2]


def depth_mm(world: VariedWorld, gel: Pose, shift: np.ndarray) -> np.ndarray:
    """Probe grid of the gel at a pose, of the objects moved by `shift` (3,) m."""
    touch, data = world.touch, world.data
    positions, rotations = data.geom_xpos[touch.felt] + shift, data.geom_xmat[touch.felt]
    return touch.sensor.probe(touch.kinds, touch.sizes, positions, rotations, *gel)


def _touching(world: VariedWorld, gel: Pose, shift: np.ndarray, view: np.ndarray) -> float | None:
    """How far (m) beyond `shift` along the view the objects are just felt, or None within `REACH_M`."""

    def deep(far: float) -> bool:
        return depth_mm(world, gel, shift + far * view).max() > SHALLOW_MM

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
