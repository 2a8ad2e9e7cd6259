"""An episode carried out once more in the twin's world: its pressures, on the way that the arm went.

The flange is led along the recorded path, so that what differs is the finger's: its pressure, its bend and
its touch. Frame t of a replay is what the twin predicts for frame t of the episode.
"""

from dataclasses import dataclass
from typing import override

import numpy as np
from scipy.signal import savgol_filter

from pneutac_datasets.demonstrations.episodes import Episode
from pneutac_sim.features import CONTROL_HZ, EE, MAX_SPEED_M_S
from pneutac_sim.twin import Twin
from pneutac_sim.world.station import Station
from pneutac_sim.world.varied import Variation, VariedWorld

AWAY_M = (0.0, 0.0, -5.0)  # out of everything's way
SMOOTH = 5  # frames
FEEDBACK_HZ = 3.0  # rate at which the flange returns to the recorded path


@dataclass(frozen=True)
class Place:
    """Where an episode's objects stand.

    Attributes:
        seed: of the task's own start.
        shift_m: displacement (3,) of the objects from it.
    """

    seed: int
    shift_m: tuple[float, float, float]


NOWHERE = Place(0, AWAY_M)


@dataclass(frozen=True)
class Replayed:
    """What a twin predicts of an episode of T frames.

    Attributes:
        flange_m: (T, 3) where the flange went.
        area: (T,) contact areas; 0 where the world has no images.
        press_mm: (T,) how far the gel's face is pressed in.
        press_n: (T,) force on it.
        pressure_kpa: (T,) in the chamber.
        gel_m: (T, 3) middle of the gel's face, in the recorded flange's place.
        gel_axes: (T, 9) its rotation.
        images: uint8 (T, H, W, 3); None where they were not asked for.
        success: whether the task was done.
    """

    flange_m: np.ndarray
    area: np.ndarray
    press_mm: np.ndarray
    press_n: np.ndarray
    pressure_kpa: np.ndarray
    gel_m: np.ndarray
    gel_axes: np.ndarray
    images: np.ndarray | None
    success: bool


class ReplayWorld(VariedWorld):
    """A world whose finger may be bent by so much more than its pressure bends it.

    Its own command latency is left out: the path is the measured one, and `delayed` delays the pressure.

    Attributes:
        more_rad: bend in addition to that of the pressure, shared by the joints.
    """

    more_rad = 0.0

    def __init__(self, task: str, twin: Twin, touch: str = "probe", station: Station | None = None):
        """A world of a task; `touch` as of `World`: `image` or, faster, `probe`."""
        super().__init__(task, twin, touch, "probe", station=station)

    @property
    @override
    def _late_commands(self):
        return 0

    @override
    def _bend(self, q_cmd: np.ndarray) -> np.ndarray:
        return super()._bend(q_cmd) + self.more_rad / len(q_cmd)

    def replay(
        self, episode: Episode, place: Place = NOWHERE, more_rad: float = 0.0, keep: bool = False
    ) -> Replayed:
        """Carries an episode out.

        Args:
            episode: as recorded.
            place: of its objects; if omitted, they are out of the way.
            more_rad: see the class.
            keep: whether to keep the tactile images.
        """
        path = smooth(episode.state[:, EE])
        pressure = delayed(episode.action[:, 3], self.twin)
        self.more_rad = more_rad
        self.variation = Variation(tuple(path[0]), place.shift_m)
        self.reset(place.seed)
        rows, images = [self._row(path[0])], [self.touch.image]
        for t in range(len(path) - 1):
            speed = (path[t + 1] - path[t]) / self.dt_s + FEEDBACK_HZ * (path[t] - self.flange_m)
            action = np.append(np.clip(speed, -MAX_SPEED_M_S, MAX_SPEED_M_S), pressure[t])
            self.step(np.clip(action, *self.action_limits))
            rows.append(self._row(path[t + 1]))
            if keep:
                images.append(self.touch.image)
        columns = [np.array(c) for c in zip(*rows, strict=True)]
        kept = np.stack(images) if keep else None
        return Replayed(*columns, kept, bool(self.success and not self.failure))

    def commanded(self, episode: Episode) -> np.ndarray:
        """Where the flange goes, (T, 3) m, when the commands act at once and nothing is in its way."""
        actions = np.clip(episode.action, *self.action_limits)
        self.variation = Variation(tuple(episode.state[0, EE]), AWAY_M)
        self.reset(0)
        path = [self.flange_m]
        for action in actions[:-1]:
            self.step(action)
            path.append(self.flange_m)
        return np.array(path)

    def _row(self, recorded_m: np.ndarray) -> tuple:
        at = self.gel_m + recorded_m - self.flange_m
        axes = self.data.site("gel").xmat.copy()
        touch = self.touch.area, self.press_mm, self.press_n
        return self.flange_m, *touch, self.pressure_kpa, at, axes


def smooth(path: np.ndarray) -> np.ndarray:
    """A path (T, 3) without the noise of its encoders: lines fitted to `SMOOTH` frames about each."""
    return path if len(path) < SMOOTH else savgol_filter(path, SMOOTH, 1, axis=0, mode="interp")


def delayed(command: np.ndarray, twin: Twin) -> np.ndarray:
    """Commands (T,), each held for a frame, as late as the twin's `command_latency_s`."""
    known = twin.parameters.get("command_latency_s")
    return late(command, known.value if known else 0.0)


def late(command: np.ndarray, latency_s: float) -> np.ndarray:
    """Commands (T,), each held for a frame, `latency_s` later; before the first there was none."""
    whole, part = divmod(latency_s * CONTROL_HZ, 1.0)
    padded = np.concatenate([np.zeros(int(whole) + 1), command])
    return (1 - part) * padded[1 : len(command) + 1] + part * padded[: len(command)]
