"""Demonstrations as a study needs them: what was measured, and what the twin's world answers to more bend.

Touch shows the bend only through the world: where the flange was, where the object stands, how far the
finger gives way. So each episode is replayed once for each of some bends besides the pressure's, and what
any model of the finger makes of the touch is read between them, without a further simulation.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Self

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from lerobot_pneutac.diagnosis import thresholds as T
from pneutac_datasets.demonstrations.replay.imprint import brightness, find_place, rest_image, strengths
from pneutac_datasets.demonstrations.replay.reading import Demonstrations
from pneutac_datasets.demonstrations.replay.replaying import Place, commanded, late, replay
from pneutac_sim.features import CONTROL_HZ, EE, PRESSURE
from pneutac_sim.finger.inputs import Inputs
from pneutac_sim.progress import Progress, no_progress
from pneutac_sim.twin import Twin, Value
from pneutac_sim.world.checks import USUAL
from pneutac_sim.world.soft_finger import GEL_ALONG_M
from pneutac_sim.world.world import World

MORE_RAD = (-0.10, -0.04, 0.0, 0.04, 0.10, 0.18)  # bends besides the pressure's that are replayed
LAGS_S = (0.1, 0.3, 1.0, 3.0)  # of the command
CHATTER = 3  # frames
BEFORE, AFTER = 6, 8  # frames about the touches in which touch is compared


@dataclass
class EpisodeData:
    """One episode."""

    place: Place  # of its objects, by inference
    command_kpa: np.ndarray  # (T,) commanded
    pressure_kpa: np.ndarray  # (T,) measured
    flange_m: np.ndarray  # (T, 3) measured
    commanded_m: np.ndarray  # (T, 3) where the flange goes in the twin's world when commands act at once
    imprint: np.ndarray  # (T,) strength measured, levels
    area: np.ndarray  # (T,) contact area measured
    press_n: np.ndarray  # (T, len(MORE_RAD)) force on the gel in the twin's world
    contact: np.ndarray  # (T,) frames in which touch is compared

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
        progress: called with how many are replayed.
        light: brightness (3,) of the gel at rest, levels, in which imprints are measured; None for their own.

    Raises:
        InputError: an episode's objects cannot be placed.
    """
    world, out = World(given.task, twin, "probe", "probe", station=given.station), []
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
                commanded(world, e.action, e.state[0, EE]),
                strengths(e.images, rest, gain),
                e.state[:, -3],
                _steady(np.stack([replay(world, e, place, m).press_n for m in MORE_RAD], 1)),
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


APART_RAD = np.linspace(-0.10, 0.18, 29)  # by which an object may stand elsewhere
ZOOM = np.linspace(-1, 1, 11)  # about the best of these, each time with a fifth of the step
TYPICAL = 2.0  # power of the force with which imprints grow where faint light is not counted
LEAST_N = 0.1
LEAST_PER_RAD = 0.05  # levels: fainter imprints show nothing of the bend


def touch(e: EpisodeData, more_rad: np.ndarray, growth: float, late: float) -> tuple[np.ndarray, float]:
    """Imprint strength (T,) predicted, with the episode's own gain, levels/N^growth, and bend apart."""
    grid, y = np.array(MORE_RAD), e.imprint[e.contact]
    rows, back = (
        np.arange(len(e))[:, None],
        [np.clip(np.arange(len(e)) - int(late) - d, 0, None) for d in (0, 1)],
    )

    def shown(log_ratio: np.ndarray) -> np.ndarray:
        x = np.clip(more_rad[:, None] + log_ratio, grid[0], grid[-1])
        k = np.clip(np.searchsorted(grid, x) - 1, 0, len(grid) - 2)
        share = (x - grid[k]) / (grid[k + 1] - grid[k])
        force = np.maximum(e.press_n[rows, k] * (1 - share) + e.press_n[rows, k + 1] * share, 0.0)
        return (1 - late % 1) * (force**growth)[back[0]] + late % 1 * (force**growth)[back[1]]

    tried, step = APART_RAD, APART_RAD[1] - APART_RAD[0]
    # As fine as that, the best moves smoothly with the model: a coarse grid makes its derivatives nonsense.
    for _ in range(4):
        B = shown(tried)[e.contact]
        gain = np.maximum(y @ B / np.maximum((B**2).sum(0), 1e-12), 0.0)
        best = np.clip(tried[np.argmin(((y[:, None] - gain * B) ** 2).sum(0))], APART_RAD[0], APART_RAD[-1])
        tried, step = best + step * ZOOM, step / 5
    ground = shown(np.array([best]))[:, 0]
    gain = max(float(y @ ground[e.contact]) / max(float((ground[e.contact] ** 2).sum()), 1e-12), 0.0)
    return gain * ground, gain


def imprint_per_rad(episodes: list[EpisodeData], stiff_n_per_rad: float) -> float:
    """By how many levels imprints grow with the bend, where they are strong: the median of the episodes.

    One for all: a faint imprint shows less of the bend, not more. Where an object gives way, or is gone once
    it is pressed, more bend does not press harder; there the finger's own stiffness says how much it takes.
    """
    middle, slopes = MORE_RAD.index(0.0), []
    for e in episodes:
        force = e.press_n[:, middle]
        by_rad = np.diff(e.press_n[:, [middle - 1, middle + 1]])[:, 0] / (
            MORE_RAD[middle + 1] - MORE_RAD[middle - 1]
        )
        strong = e.contact & (e.imprint > 0.5 * e.imprint.max()) & (force > LEAST_N)
        if strong.any():
            share = np.maximum(by_rad, stiff_n_per_rad)[strong] / force[strong]
            slopes.append(float(np.median(TYPICAL * e.imprint[strong] * share)))
    return max(float(np.median(slopes)), LEAST_PER_RAD) if slopes else LEAST_PER_RAD


def stiffness_n_per_rad(twin: Twin) -> float:
    """Force at the gel of a finger whose gel is held in place, per bend shared equally by its joints."""
    arms_m = 1e-3 * (twin.length_mm - np.asarray(twin.spine_joint_positions_mm)) + GEL_ALONG_M
    return float(twin.parameter("joint_stiffness_nm_per_rad") * arms_m.mean() / (arms_m**2).sum())


COMPLIANCE = "compliance"
STIFFNESS = "joint_stiffness_nm_per_rad"
MAD = 1.4826  # standard deviation of a normal distribution over its median absolute deviation
MEDIAN = 1.2533  # standard error of a median over that of a mean
FAINTEST = 1e-6  # levels


@dataclass(frozen=True)
class Strength:
    """How strong the imprints of some episodes are."""

    log_gain: float  # median over episodes of the logarithm of levels/N^growth
    error: float  # its standard error
    growth: float  # power of the force with which the imprints were taken to grow
    stiffness: float  # of the twin's joints that made the forces, N m/rad
    # brightness of the gel at rest, of red, green and blue, levels
    light: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @classmethod
    def of(cls, gains: np.ndarray, growth: float, twin: Twin) -> Self:
        """Of the gains (episodes,) that a model found, by whatever light."""
        logs = np.log(np.maximum(gains, FAINTEST))
        spread = MAD * float(np.median(np.abs(logs - np.median(logs))))
        error = float(MEDIAN * spread / np.sqrt(len(logs)))
        return cls(float(np.median(logs)), error, growth, twin.parameter(STIFFNESS))

    @classmethod
    def known(cls, history: Mapping, task: str) -> Self | None:
        """As a twin's history has it; None where it was fitted to no demonstrations of this task."""
        stored = history.get("imprint", {})
        if stored.get("task") != task:
            return None
        return cls(**stored["strength"] | {"light": tuple(stored["strength"]["light"])})

    def stored(self, task: str, light: Iterable[float]) -> dict:
        """As stored in a twin's history, with the light (3,) in which it was measured, levels."""
        return {"task": task, "strength": asdict(self) | {"light": [float(x) for x in light]}}

    def log_ratio(self, known: Self) -> float:
        """Logarithm of how much stronger imprints are than was known; 0 where one finger's differ by that.

        By another stiffness all forces differ, and imprints by the power `TYPICAL` of that.
        """
        expected = known.log_gain + (TYPICAL - known.growth) * np.log(self.stiffness / known.stiffness)
        log_ratio = float(self.log_gain - expected)
        limit = max(T.STRENGTH_DIFFERS, T.STRENGTH_ERRORS * self.off(known))
        return log_ratio if abs(log_ratio) > limit else 0.0

    def off(self, known: Self) -> float:
        return float(np.hypot(self.error, known.error))

    def pressing(self, twin: Twin, known: Self) -> Twin:
        """The twin, whose finger presses as hard as imprints are strong."""
        share, wide = np.exp(self.log_ratio(known) / TYPICAL), np.exp(2 * self.off(known) / TYPICAL)
        out, whole = twin.copy(), float(share * twin.parameter(STIFFNESS))
        out.parameters = out.parameters | {STIFFNESS: Value(whole, (whole / wide, whole * wide))}
        return out
