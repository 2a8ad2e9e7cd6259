"""Demonstrations as references for the planner: what was done and felt, and how their contacts scatter."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from pneutac_datasets.demonstrations.faults import UNTOUCHED, Recorded
from pneutac_sim.errors import InputError
from pneutac_sim.features import CONTROL_HZ, PRESSURES, Places
from pneutac_sim.gel.contact import without_specks
from pneutac_sim.gel.sensor import TactileSensor

if TYPE_CHECKING:
    from lerobot.datasets import LeRobotDatasetMetadata

# Frames are of the paper's rate; at another they are as many as last as long, see `frames_at`.
EXTRA_STEPS = 15  # frames by which a demonstration goes on where the task is about to be done
MARGIN = 4  # frames before the first and after the last contact that still count as contact phase
FIRM = 0.15  # of a contact's largest area; what is smaller, and comes last, only brushes
VENTED = 0.5  # of the highest pressure commanded in a contact; who commands less lets go
LOSS = 8  # frames without touch that still belong to a contact
LEAST_SEEN = 30  # frames from which a reaction is estimated
STARTLED = 3  # first frames of a contact, in which a hand has not answered yet
ANSWERS = 0.5  # share of a velocity's variance that the imprint's middle must explain to be what it answers


def frames_at(control_hz: int, paper: int) -> int:
    """Frames of a rate that last as long as so many of the paper's, at least one."""
    return max(1, round(paper * control_hz / CONTROL_HZ))


@dataclass
class Reference:
    """One recorded demonstration, without its images."""

    source: int  # index of the episode
    flange_m: np.ndarray  # (T, 3) flange positions
    area: np.ndarray  # (T,) contact areas
    action: np.ndarray  # (T, 3 + C) as `features.action_names`
    task: str  # the instruction
    # (T, 2) middle of the imprint across and along the finger, from the middle of the image; NaN without
    # touch. None where the images were not read.
    centre_mm: np.ndarray | None = None
    control_hz: int = CONTROL_HZ  # rate of its frames

    def __post_init__(self):
        for name in ("flange_m", "area", "action"):
            if not np.isfinite(getattr(self, name)).all():
                raise InputError(
                    f"Episode {self.source} holds numbers that are not finite ({name}); delete it."
                )

    def __len__(self) -> int:
        return len(self.action)

    def frames(self, paper: int) -> int:
        """Its frames that last as long as so many of the paper's, see `frames_at`."""
        return frames_at(self.control_hz, paper)

    def prolonged(self, steps: int) -> "Reference":
        """The same, going on by `steps` frames as it ended: what follows a success that comes later."""
        last = self.action[-1]
        ahead = np.arange(1, steps + 1)[:, None] * last[:3] / self.control_hz
        nowhere = np.full((steps, 2), np.nan)
        return replace(
            self,
            flange_m=np.vstack([self.flange_m, self.flange_m[-1] + ahead]),
            area=np.append(self.area, np.full(steps, self.area[-1])),
            action=np.vstack([self.action, np.tile(last, (steps, 1))]),
            centre_mm=None if self.centre_mm is None else np.vstack([self.centre_mm, nowhere]),
        )

    @property
    def onset(self) -> int:
        """First frame in contact; raises InputError where there is none, or none before it."""
        frames = np.flatnonzero(self.area > 0)
        if not len(frames) or frames[0] == 0:
            fault = (
                "touches something in its first frame (pressed, or in another light than the rest image)"
                if len(frames)
                else UNTOUCHED
            )
            raise InputError(
                f"Episode {self.source} {fault}; leave it out with lerobot-edit-dataset"
                f' --operation.type=delete_episodes --operation.episode_indices="[{self.source}]".'
            )
        return int(frames[0])

    @property
    def contacts(self) -> list[tuple[int, int]]:
        """First frame of each contact and that of its release; short losses of touch do not part them.

        The release is where the area falls below `FIRM` of its largest, as what follows only brushes, or
        where the demonstration lets the air out, whatever the finger brushes on its way back.
        """
        frames = np.flatnonzero(self.area > 0)
        held, found = np.abs(self.action[:, PRESSURES]), []
        # Several chambers may hold a bend that is no press: they are let go where they come near it.
        held = held[:, 0] if held.shape[1] == 1 else held.max(1) - held.max(1).min()
        for part in np.split(frames, np.flatnonzero(np.diff(frames) > self.frames(LOSS)) + 1):
            if len(part):
                firm = self.area[part] >= FIRM * self.area[part].max()
                pressure = held[part[0] : part[np.flatnonzero(firm)[-1]] + 1]
                vented = np.flatnonzero(pressure < VENTED * np.maximum.accumulate(pressure))
                found.append((int(part[0]), int(part[0] + (vented[0] if len(vented) else len(pressure)))))
        return found

    @property
    def contact_phase(self) -> tuple[int, int]:
        """First frame of the contact phase and the one after its last."""
        last = int(np.flatnonzero(self.area > 0)[-1])
        margin = self.frames(MARGIN)
        return max(0, self.onset - margin), min(len(self), last + margin + 1)


def felt_and_done(references: list[Reference], skip: int, lag: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Touch `lag` frames before, and velocity (n, 3) m/s, in all frames in contact but the first `skip`.

    The touch (n, 3) is the imprint's middle across and along the finger, metres, and its area.
    """
    felt, done = [np.empty((0, 3))], [np.empty((0, 3))]
    for r in references:
        for first, end in r.contacts if r.centre_mm is not None else ():
            t = np.arange(first + skip, end)
            t = t[np.isfinite(r.centre_mm[t - lag, 0])]
            felt.append(np.column_stack([1e-3 * r.centre_mm[t - lag], r.area[t - lag]]))
            done.append(r.action[t, :3])
    return np.concatenate(felt), np.concatenate(done)


def reaction_hz(references: list[Reference]) -> np.ndarray:
    """How demonstrations answer where the touch is on the gel: (3, 2), 1/s.

    The change of the velocity (3,) with the middle (2,) of the imprint, by least squares over all frames in
    contact. A row is zero where it explains less than `ANSWERS`, as in a task that asks for no such thing.
    """
    felt, velocity = felt_and_done(references, references[0].frames(STARTLED))
    if len(felt) < LEAST_SEEN:
        return np.zeros((3, 2))
    centre, velocity = felt[:, :2] - felt[:, :2].mean(0), velocity - velocity.mean(0)
    gain = np.linalg.lstsq(centre, velocity, rcond=None)[0].T
    left = np.sum((velocity - centre @ gain.T) ** 2, 0)
    return np.where((left < (1 - ANSWERS) * np.sum(velocity**2, 0))[:, None], gain, 0.0)


def onset_sigma_m(references: list[Reference]) -> np.ndarray:
    """Standard deviation (3,) of the flange position at the contact onset over demonstrations, metres.

    Raises InputError: fewer than two demonstrations, or one without contact.
    """
    if len(references) < 2:
        raise InputError(
            f"The spread of the contacts needs two demonstrations or more; the dataset has {len(references)}."
        )
    return np.std([r.flange_m[r.onset] for r in references], axis=0, ddof=1)


def read_references(
    recorded: Recorded, repo_id: str, sensor: TactileSensor | None = None
) -> tuple["LeRobotDatasetMetadata", list[Reference]]:
    """The recorded demonstrations that have not failed, without their images.

    With the twin's `sensor` the images are read, for the middles of the imprints. Raises InputError: it is
    damaged, its features are not those of the robot, or an episode is not finite.
    """
    from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata  # seconds, which --help need not wait

    from pneutac_datasets.demonstrations.episodes import demonstration_features, load_episode, readable

    recorded.refuse_damaged()
    with readable(recorded.folder):
        meta = LeRobotDatasetMetadata(repo_id, recorded.folder)
        demonstration_features(meta)
        dataset = LeRobotDataset(repo_id, recorded.folder, video_backend="pyav")
    references, places = [], Places.of(recorded.chambers)
    for i in recorded.used:
        (state, action), task = recorded.episodes[i], meta.episodes[i]["tasks"][0]
        area = without_specks(state[:, places.area])
        r = Reference(i, state[:, places.ee], area, action, task, control_hz=meta.fps)
        if sensor is not None:
            with readable(recorded.folder):
                images = load_episode(dataset, i).images
            r.centre_mm = sensor.imprint_centres_mm(images, r.area)
        references.append(r)
    return meta, references
