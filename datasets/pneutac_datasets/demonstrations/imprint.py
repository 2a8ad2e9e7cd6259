"""What images show besides the contact area: the strength of an imprint, and the drift of the light.

Where a demonstration's objects stood: not recorded, found from the first touch.

Starts are drawn from the task. In each the objects are moved to where the gel, on the recorded path, feels
them at the recorded onset, with the imprint's middle where the images show it.

A comparison takes that place, off the table if need be: in it the twin feels the object when it was felt,
whatever its finger does wrong. Augmentation, whose twin is trusted, goes on from such places on the table to
the scene in which the whole demonstration happens again, see `augment.scene`.

Whether a gel sticks to what it presses: how its imprint turns while the arm drags the finger sideways.

A finger whose gel sticks is held at its tip: as the arm goes sideways the finger bends across and its tip
turns, by 3/2 of the way over its length however soft it is, and the imprint of a thing that is longer than
wide turns in the image. Where the gel slips the finger does not turn. Neither pressure, nor creep, nor
another stiffness does that. The twin's own finger bends in one plane, so nothing is replayed.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from typing import Self

import cv2
import numpy as np

from pneutac_datasets.demonstrations.episodes import Episode
from pneutac_datasets.demonstrations.replaying import Place, replay
from pneutac_sim.errors import InputError
from pneutac_sim.features import ACTION_NAMES, AREA, EE
from pneutac_sim.gel.contact import THRESHOLD_LEVELS, without_specks
from pneutac_sim.gel.sensor import centre_mm
from pneutac_sim.world.base import Variation
from pneutac_sim.world.world import World

REST_FRAMES, GAP = 12, 1  # frames before the first touch that show the gel at rest, but for the last ones
DRIFT_LEVELS, SHAPE_LEVELS = 2.0, 2.0  # of a rest image: less is noise, rounding and slow wander of a camera
FAINT_LEVELS = 5.0  # what noise changes
EVERY_PX = 4  # pixels whose brightness is measured
LEAST_SHOWN = 0.02  # levels over the image, below which an imprint has no direction


def rest_image(episode: Episode) -> np.ndarray:
    """The gel at rest in an episode, uint8 (H, W, 3): the mean of the frames before its first touch."""
    contact = episode.contact()
    until = len(episode) if contact is None else max(contact[0] - GAP, 1)
    frames = episode.images[max(until - REST_FRAMES, 0) : until]
    return frames.mean(0).round().astype(np.uint8)


def areas(images: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Contact areas (T,) of images uint8 (T, H, W, 3) against a rest image, without isolated noise pixels."""
    out = np.empty(len(images))
    for t, image in enumerate(images):
        change = cv2.blur(cv2.absdiff(image, rest), (3, 3)).sum(2, dtype=np.float32) / 3
        out[t] = float((change > THRESHOLD_LEVELS).mean())
    return out


def strengths(images: np.ndarray, rest: np.ndarray, gain: np.ndarray | float = 1.0) -> np.ndarray:
    """Strength (T,) of the imprints in images uint8 (T, H, W, 3), levels: mean change beyond `FAINT_LEVELS`.

    Contact area counts pixels above a threshold; this weighs them by their change. The light drifts while a
    finger presses, by about as much as an imprint grows: each colour of a frame is first brought to the
    brightness of the rest image, by the median of their ratio, as most of the gel is not touched. Each colour
    is brighter by `gain` (3,) than the light in which imprints are measured.
    """
    return np.array([change.mean() for change in _changes(images, rest, gain)])


def turns_deg(images: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """How each image's imprint is turned (T,), degrees: its long axis, by second moments; NaN where none."""
    out = np.full(len(images), np.nan)
    for t, change in enumerate(_changes(images, rest)):
        m = cv2.moments(change)
        if m["m00"] > LEAST_SHOWN * change.size:
            out[t] = np.degrees(0.5 * np.arctan2(2 * m["mu11"], m["mu20"] - m["mu02"]))
    return out


def brightness(rest: np.ndarray) -> np.ndarray:
    """Of each colour (3,) of a rest image uint8 (H, W, 3), levels."""
    return np.maximum(rest.mean((0, 1), dtype=float), 1.0)


def _changes(images: np.ndarray, rest: np.ndarray, gain: np.ndarray | float = 1.0) -> Iterator[np.ndarray]:
    """Change beyond `FAINT_LEVELS` of each image (H, W), levels; see `strengths`."""
    ground = np.maximum(rest, 1).astype(np.float32)
    few = (slice(None, None, EVERY_PX),) * 2
    for image in images:
        shown = np.median(image[few] / ground[few], axis=(0, 1)).astype(np.float32)
        change = (gain * np.abs(cv2.blur(image / shown - ground, (3, 3)))).mean(2)
        yield np.maximum(change - FAINT_LEVELS, 0)


@dataclass(frozen=True)
class LightDrift:
    """How the light of a gel at rest differs from the twin's."""

    levels: tuple[float, float, float]  # (3,) mean difference of red, green and blue, 8-bit levels
    shape_levels: float  # root mean square of what a factor on each colour does not explain
    gain: tuple[float, float, float]  # (3,) factor on each colour of the twin's rest image
    spread_levels: float  # standard deviation of `levels` from episode to episode

    @property
    def drifted(self) -> bool:
        """Whether it is more than episodes differ and than a camera's noise."""
        return max(map(abs, self.levels)) > max(DRIFT_LEVELS, 3 * self.spread_levels) or (
            self.shape_levels > SHAPE_LEVELS
        )

    @property
    def sentence(self) -> str:
        """Whether it has changed, and what to do."""
        r, g, b = (f"{100 * (x - 1):+.1f} %" for x in self.gain)
        if not self.drifted:
            return f"The gel's light is as when the twin was made (red {r}, green {g}, blue {b})."
        return (
            f"The gel's light has changed since the twin was made: red {r}, green {g}, blue {b}, and "
            f"{self.shape_levels:.2g} levels in its shape; `pneutac calibrate` with these demonstrations "
            "takes the new rest image."
        )

    def to_dict(self) -> dict:
        return asdict(self) | {"drifted": self.drifted}


def light_drift(episodes: list[Episode], rest: np.ndarray) -> LightDrift:
    """How the gel at rest in episodes differs from a twin's rest image, uint8 (H, W, 3)."""
    seen = np.stack([rest_image(e) for e in episodes]).astype(float)
    ground = rest.astype(float)
    each = (seen - ground).mean((1, 2))
    mean = seen.mean(0)
    gain = (mean * ground).sum((0, 1)) / np.maximum((ground**2).sum((0, 1)), 1e-9)
    residual = cv2.blur(mean - gain * ground, (9, 9))
    return LightDrift(
        tuple(each.mean(0).tolist()),
        float(np.sqrt((residual**2).mean())),
        tuple(gain.tolist()),
        float(each.std(0).max()) if len(each) > 1 else 0.0,
    )


DRAWS, ENOUGH = 128, 8  # starts drawn at most, and those in reach of which the nearest is taken
REACH_M, STEP_M = 0.08, 0.001  # how far objects are moved along the gel's view, in steps
CENTRES = 12  # frames from the onset on whose imprints are taken
SHALLOW_MM = 0.15  # depth of the first touch that a camera shows

Pose = tuple[np.ndarray, np.ndarray]  # position (3,) m and rotation (9,) of the gel


def find_place(world: World, episode: Episode) -> Place:
    """The start and displacement with which the twin first feels what the episode felt.

    Raises InputError: it touches nothing, or no object of the task comes into the gel's reach there.
    """
    contact = episode.contact()
    if contact is None:
        raise InputError("The episode never touches anything, so the position of its objects is unknown.")
    onset = contact[0]
    free = replay(world, episode)
    gel = free.gel_m[onset], free.gel_axes[onset]
    middles = world.sensor.imprint_centres_mm(episode.images, without_specks(episode.state[:, AREA]))
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
    world: World,
    lay_out: Callable[[int], object],
    starts: Iterable[int],
    gels: Sequence[Pose],
    axes: np.ndarray,
    seen_mm: np.ndarray,
) -> Iterator[Place]:
    """Places at which the gel just feels the objects, of starts whose seeds `lay_out` puts into the world.

    Of the poses `gels` the first that reaches them is taken. Objects are moved by the rows of `axes` (3, 3):
    across the gel, along it, and the way that it looks; `seen_mm` (T, 2) are middles of the imprint from the
    onset on, NaN where it is not known.
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


def _first_touch(world: World, gel: Pose, axes: np.ndarray, seen: np.ndarray | None):
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


def depth_mm(world: World, gel: Pose, shift: np.ndarray) -> np.ndarray:
    """Probe grid of the gel at a pose, of the objects moved by `shift` (3,) m."""
    touch, data = world.touch, world.data
    positions, rotations = data.geom_xpos[touch.felt] + shift, data.geom_xmat[touch.felt]
    return touch.sensor.probe(touch.kinds, touch.sizes, positions, rotations, *gel)


def _touching(world: World, gel: Pose, shift: np.ndarray, view: np.ndarray) -> float | None:
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


SIDEWAYS, DRAG_M_S = ACTION_NAMES.index("dy.vel"), 0.003  # of a command, and from which speed on it drags
LEAST_FRAMES, LEAST_MM = 30, 5.0  # of a drag in touch
SHOWN_LATE = 2  # frames by which images show a way late
LEAST = 3  # episodes
SLIPS = 0.5  # of the turn that was known
SIGNIFICANT = 2.0  # standard errors


@dataclass(frozen=True)
class Dragging:
    """How imprints turned where the finger was dragged."""

    turn_deg_per_mm: float  # mean over episodes of the turn per way of the arm
    error: float  # its standard error
    episodes: int  # in which it was dragged

    @classmethod
    def of(cls, episodes: Sequence[Episode]) -> Self | None:
        """Of episodes; None where fewer than three drag the finger sideways in touch."""
        turns = np.array([t for t in map(turn_deg_per_mm, episodes) if t is not None])
        if len(turns) < LEAST:
            return None
        error = float(turns.std(ddof=1) / np.sqrt(len(turns)))
        return cls(float(turns.mean()), error, len(turns))

    @classmethod
    def known(cls, history: Sequence[Mapping], task: str) -> Self | None:
        """The last of a task that a twin's history has."""
        stored = [h["dragging"] for h in history if h.get("dragging", {}).get("task") == task]
        return cls(**stored[-1]["turn"]) if stored else None

    def slips(self, known: Self) -> bool:
        """Whether the gel, which stuck before, slips more now."""
        return self.less(known, SLIPS)

    def less(self, known: Self, share: float = 1.0) -> bool:
        """Whether the turn is significantly less than that share of a known one."""
        far = SIGNIFICANT * float(np.hypot(self.error, share * known.error))
        return self.turn_deg_per_mm + far < share * known.turn_deg_per_mm

    def sentence(self, known: Self | None) -> str:
        """The finding about the gel's friction, a sentence."""
        turned = (
            f"Dragged sideways, imprints turned by {self.turn_deg_per_mm:.2g} ({self.error:.1g}) degrees a mm"
        )
        if known is None:
            return f"{turned}; `pneutac calibrate` stores that, to detect a change of the gel's friction."
        was = f"{known.turn_deg_per_mm:.2g} ({known.error:.1g}) before"
        if self.slips(known):
            return f"{turned}, {was}: the gel has less friction than before and slips."
        if self.less(known):
            return f"{turned}, {was}: the gel sticks less than before; by how much is not identifiable."
        return f"{turned}, {was}: no loss of friction is significant."

    def to_history(self, task: str) -> dict:
        """Entry for a twin's history."""
        return {"task": task, "turn": asdict(self)}


def turn_deg_per_mm(episode: Episode) -> float | None:
    """Least-squares turn of the imprint by the arm's way sideways; None where it is not dragged far."""
    contact = episode.contact()
    if contact is None:
        return None
    touched = slice(contact[0], contact[1] + 1)
    rows = np.abs(episode.action[touched, SIDEWAYS]) > DRAG_M_S
    way = 1e3 * episode.state[:, EE][np.maximum(np.arange(*touched.indices(len(episode))) - SHOWN_LATE, 0), 1]
    if rows.sum() < LEAST_FRAMES or np.ptp(way[rows]) < LEAST_MM:
        return None
    images, rest = episode.images[touched], rest_image(episode)
    turn, strong = turns_deg(images, rest), strengths(images, rest)
    rows &= np.isfinite(turn)
    if rows.sum() < LEAST_FRAMES:
        return None
    frames = np.arange(len(turn))
    ground = np.stack([way, np.ones(len(way)), frames], 1)[rows]  # it may turn slowly as it creeps
    weight = np.sqrt(strong[rows])
    return float(np.linalg.lstsq(ground * weight[:, None], turn[rows] * weight, rcond=None)[0][0])
