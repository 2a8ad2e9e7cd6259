"""Demonstrations as a study needs them: what was measured, and what the twin's world answers to more bend.

Touch tells the bend only through the world: where the flange was, where the object stands, how far the
finger gives way. So each episode is replayed once for each of some bends beside the pressure's, and what
any model of the finger makes of the touch is read between them, without a further simulation.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from pneutac_datasets.demonstrations.replay.imprint import brightness, rest_image, strengths
from pneutac_datasets.demonstrations.replay.placing import find_place
from pneutac_datasets.demonstrations.replay.reading import Demonstrations
from pneutac_datasets.demonstrations.replay.replaying import Place, ReplayWorld, late
from pneutac_sim.features import CONTROL_HZ, EE, PRESSURE
from pneutac_sim.finger.inputs import Inputs
from pneutac_sim.progress import Progress, no_progress
from pneutac_sim.twin import Twin
from pneutac_sim.world.conditions import USUAL

MORE_RAD = (-0.10, -0.04, 0.0, 0.04, 0.10, 0.18)  # bends beside the pressure's that are replayed
LAGS_S = (0.1, 0.3, 1.0, 3.0)  # of the command
CHATTER = 3  # frames
BEFORE, AFTER = 6, 8  # frames about the touches in which touch is compared


@dataclass
class EpisodeData:
    """One episode.

    Attributes:
        place: of its objects, by inference.
        command_kpa: (T,) commanded.
        pressure_kpa: (T,) measured.
        flange_m: (T, 3) measured.
        commanded_m: (T, 3) where the flange goes in the twin's world when commands act at once.
        imprint: (T,) strength measured, levels.
        area: (T,) contact area measured.
        press_n: (T, len(MORE_RAD)) force on the gel in the twin's world.
        contact: (T,) frames in which touch is compared.
    """

    place: Place
    command_kpa: np.ndarray
    pressure_kpa: np.ndarray
    flange_m: np.ndarray
    commanded_m: np.ndarray
    imprint: np.ndarray
    area: np.ndarray
    press_n: np.ndarray
    contact: np.ndarray

    def __len__(self) -> int:
        return len(self.command_kpa)


def episode_data(
    twin: Twin,
    given: Demonstrations,
    progress: Progress = no_progress,
    light: Sequence[float] | None = None,
) -> list[EpisodeData]:
    """Replays every episode of the demonstrations in the twin's world.

    Args:
        twin: of the finger.
        given: the episodes.
        progress: is told how many are replayed.
        light: brightness (3,) of the gel at rest, levels, as by which imprints are told; None for their own.

    Raises:
        InputError: an episode's objects cannot be placed.
    """
    world, out = ReplayWorld(given.task, twin, station=given.station), []
    for i, e in enumerate(given.episodes):
        progress("replaying demonstrations", i, len(given.episodes))
        place = find_place(world, e)
        first, last = e.contact() or (0, 0)
        frames, rest = np.arange(len(e)), rest_image(e)
        gain = np.ones(3) if light is None else np.array(light) / brightness(rest)
        out.append(
            EpisodeData(
                place,
                e.action[:, 3],
                e.state[:, PRESSURE],
                e.state[:, EE],
                world.commanded(e),
                strengths(e.images, rest, gain),
                e.state[:, -3],
                _steady(np.stack([world.replay(e, place, m).press_n for m in MORE_RAD], 1)),
                (frames >= first - BEFORE) & (frames <= last + AFTER),
            )
        )
    progress("replaying demonstrations", len(given.episodes), len(given.episodes))
    return out


def _steady(press_n: np.ndarray) -> np.ndarray:
    """Forces (T, k) without the chatter of a rigid contact, whose period is `CHATTER` frames."""
    return uniform_filter1d(press_n, CHATTER, axis=0, mode="nearest")


def inputs_of(episodes: list[EpisodeData], latency_s: float, twin: Twin) -> Inputs:
    """What drives the pipeline, one row a frame: each frame follows the command before it."""
    rows = [np.append(0.0, late(e.command_kpa, latency_s)[:-1]) for e in episodes]
    pressure = np.concatenate(rows)[:, None]
    dt = np.concatenate([np.append(np.inf, np.full(len(r) - 1, 1 / CONTROL_HZ)) for r in rows])
    n = len(pressure)
    columns = {name: np.full(n, value) for name, value in USUAL.items()}
    columns |= {"session_time_s": np.zeros(n), "length_mm": np.full(n, twin.length_mm)}
    return Inputs(pressure, dt, np.arange(n), columns, False, float(np.abs(pressure).max()))


def command_signals(episodes: list[EpisodeData]) -> np.ndarray:
    """(N, 5 + lags) causal signals of command, contact and arm, a row a frame, for a black box."""
    out = []
    for e in episodes:
        u = e.command_kpa / max(float(np.abs(e.command_kpa).max()), 1e-9)
        keeps = [np.exp(-1 / (tau * CONTROL_HZ)) for tau in LAGS_S]
        lagged = [lfilter([1 - keep], [1, -keep], u) for keep in keeps]
        out.append(np.stack([u, e.contact, *np.gradient(e.flange_m, axis=0).T, *lagged], 1))
    return np.concatenate(out)
