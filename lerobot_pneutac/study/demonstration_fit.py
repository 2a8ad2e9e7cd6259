"""What was measured in demonstrations, what the twin's world answers to more bend, and fits of the finger.

Touch shows the bend only through the world: where the flange was, where the object stands, how far the
finger gives way. So each episode is replayed once for each of some bends besides the pressure's, and what
any model of the finger makes of the touch is read between them, without a further simulation.

Flange, pressure and touch are predicted together. All errors are in mm at the finger's tip: the flange's own;
a pressure's by the bend that it makes in the twin; a touch's by the bend that would make it. What belongs to
an episode and not to the finger is fitted beside it, from that episode alone: by how much its object stands
elsewhere, as a bend, and how strong its imprints show where it pressed. Touch is shown `touch_late` frames
late, and grows as a power of the force, alike in all.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Self

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import least_squares
from scipy.signal import lfilter

from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.diagnosis.search import Scored, Space, Start, Structure
from pneutac_datasets.demonstrations.imprint import brightness, find_place, rest_image, strengths
from pneutac_datasets.demonstrations.reading import Demonstrations
from pneutac_datasets.demonstrations.replaying import Place, commanded, late, replay
from pneutac_sim.effects.effect import Parameter
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.executor import Progress, no_progress
from pneutac_sim.features import CONTROL_HZ, EE, PRESSURE
from pneutac_sim.finger import Pipeline
from pneutac_sim.finger.inputs import Inputs
from pneutac_sim.least_squares import Z95
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

    Imprints are measured in the brightness `light` (3,) of the gel at rest, levels; in their own where None.
    Raises InputError where an episode's objects cannot be placed.
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
                # without the chatter of a rigid contact, whose period is `CHATTER` frames
                uniform_filter1d(
                    np.stack([replay(world, e, place, m).press_n for m in MORE_RAD], 1),
                    CHATTER,
                    axis=0,
                    mode="nearest",
                ),
                (frames >= first - BEFORE) & (frames <= last + AFTER),
            )
        )
    progress("replaying demonstrations", len(given.episodes), len(given.episodes))
    return out


def inputs_of(episodes: list[EpisodeData], latency_s: float, twin: Twin) -> Inputs:
    """What drives the pipeline, one row a frame: each frame follows the command before it."""
    rows = [np.append(0.0, late(e.command_kpa, latency_s)[:-1]) for e in episodes]
    pressure = np.concatenate(rows)[:, None]
    dt = np.concatenate([np.append(np.inf, np.full(len(r) - 1, 1 / CONTROL_HZ)) for r in rows])
    return _inputs(pressure, dt, False, float(np.abs(pressure).max()), twin)


def _inputs(pressure: np.ndarray, dt: np.ndarray, measured: bool, range_kpa: float, twin: Twin) -> Inputs:
    """Inputs of pressures (n, 1) under usual conditions, one sample a row."""
    n = len(pressure)
    columns = {name: np.full(n, value) for name, value in USUAL.items()}
    columns |= {"session_time_s": np.zeros(n), "length_mm": np.full(n, twin.length_mm)}
    return Inputs(pressure, dt, np.arange(n), columns, measured, range_kpa)


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


HZ = 5.0
STAIRS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 0.8, 0.6, 0.4, 0.2, 0.0)  # of the range
STAIR_S = 5.0  # on each
HELD, HELD_S, FREE_S = 0.8, 60.0, 25.0


class FreeBend:
    """The bend of a finger that touches nothing, in a program up to `range_kpa`."""

    def __init__(self, twin: Twin, range_kpa: float):
        levels = [np.full(round(STAIR_S * HZ), s) for s in STAIRS]
        levels += [np.full(round(HELD_S * HZ), HELD), np.zeros(round(FREE_S * HZ))]
        pressure = range_kpa * np.concatenate(levels)[:, None]
        dt = np.append(np.inf, np.full(len(pressure) - 1, 1 / HZ))
        self.inputs = _inputs(pressure, dt, True, range_kpa, twin)
        pipeline = Pipeline.of(twin, self.inputs)
        self._known = self._bend(pipeline, pipeline.theta(twin, range_kpa))

    def _bend(self, pipeline: Pipeline, theta: np.ndarray) -> np.ndarray:
        return pipeline.run(self.inputs, theta).markers[:, 3]

    def difference(self, pipeline: Pipeline, theta: np.ndarray) -> np.ndarray:
        """(n,) by how much a model of parameters `theta` (P,) bends otherwise, rad, whatever its input is."""
        effects = [e.name for e in pipeline.effects]
        free = Pipeline(pipeline.geometry, effects, True, set(self.inputs.columns))
        return self._bend(free, theta) - self._known


SHARES = (1.0, 0.5, 0.25, 0.1)


@dataclass
class DemonstrationModel:
    """A fitted model.

    Attributes:
        structure: what was free.
        values: name to value.
        residual: (n, k) of the rows and columns that were fitted, mm.
        jacobian: (n, k, P) of it by what was free, in units of its range.
        at_bound: names that stopped at a bound.
        unit: of what the Jacobian is by: name to its lower and upper bound, of the logarithm of those that
            are `logarithmic`.
        logarithmic: names.
        residual_at: (n, k) of it so far from what was found, (P,) in units of the range.
        bench: of what the free bend off the bench's counts: half the slope (P,), and the curvature (P, P).
    """

    structure: Structure
    values: dict[str, float]
    residual: np.ndarray
    jacobian: np.ndarray
    at_bound: list[str]
    unit: dict[str, tuple[float, float]]
    logarithmic: frozenset[str] = frozenset()
    residual_at: Callable[[np.ndarray], np.ndarray] = lambda step: np.empty(0)  # noqa: E731
    bench: tuple[np.ndarray, np.ndarray] = field(default_factory=lambda: (np.zeros(0), np.zeros((0, 0))))

    @property
    def cost(self) -> int:
        return self.jacobian.shape[2] + len(self.structure.effects)

    def cv_squared(self, fold: np.ndarray) -> np.ndarray:
        """(n,) squared errors, each by a fit without its own fold, one Gauss-Newton step away.

        A step that leads too far, where the remaining episodes hardly determine it, is shortened until it
        helps them.
        """
        squared = (self.residual**2).sum(1)
        if not self.jacobian.shape[2]:
            return squared
        out, (slope, curved) = squared.copy(), self.bench
        for k, step in zip(np.unique(fold), self._steps(fold), strict=True):
            mine = fold == k
            for share in SHARES:
                there, way = (self.residual_at(share * step) ** 2).sum(1), share * step
                if there[~mine].sum() + 2 * slope @ way + way @ curved @ way <= squared[~mine].sum():
                    out[mine] = there[mine]
                    break
        return out

    def _steps(self, fold: np.ndarray) -> np.ndarray:
        """(folds, P) Gauss-Newton steps from the whole fit to those without each fold."""
        J, r, out = self.jacobian, self.residual, []
        slope, curved = self.bench
        for k in np.unique(fold):
            rest = J[fold != k].reshape(-1, J.shape[2])
            H = rest.T @ rest + curved
            ridge = 1e-6 * np.trace(H) / max(len(H), 1) + 1e-12
            step = -np.linalg.solve(H + ridge * np.eye(len(H)), rest.T @ r[fold != k].ravel() + slope)
            out.append(np.clip(step, -T.TRUST, T.TRUST))
        return np.array(out)

    def intervals(self, fold: np.ndarray) -> dict[str, tuple[float, float]]:
        """95 % intervals of what was free, from fits without each fold (jackknife)."""
        if not self.unit:
            return {}
        steps = self._steps(fold)
        n = len(steps)
        sd = np.sqrt((n - 1) / n * ((steps - steps.mean(0)) ** 2).sum(0))
        out = {}
        for (name, (low, high)), s in zip(self.unit.items(), sd, strict=True):
            value, wide = self.values[name], Z95 * float(s) * (high - low)
            log = name in self.logarithmic
            out[name] = (value * np.exp(-wide), value * np.exp(wide)) if log else (value - wide, value + wide)
        return out


LATE = "late_commands"  # arm and air alike
LATENCY = Parameter("latency_s", "s", default=0.1, lower=0.0, upper=0.8)
GROWTH = Parameter("growth", "", default=TYPICAL, lower=0.5, upper=5.0)
MOST_LATE = 24.0  # frames by which clocks may have diverged
TOUCH_LATE = Parameter("touch_late", "frames", default=1.0, lower=0.0, upper=6.0)
# Of a residual's columns: the flange's x, y, z, and pressure; touch.
ARM, AIR, TOUCH = slice(0, 3), slice(0, 4), slice(4, 5)
START = {"growth": GROWTH.default, "touch_late": TOUCH_LATE.default}
STEP = 1e-3
BEGIN = 4  # frames


class Fitter:
    """Fits models of one twin to episodes.

    What a structure does not free stays as the twin has it; `rows` (N,) masks the frames that are fitted,
    over all episodes in a row.
    """

    def __init__(self, twin: Twin, episodes: list[EpisodeData], rows: np.ndarray):
        self.twin, self.episodes, self.rows = twin, episodes, rows
        self.known_s = latency_s(twin)
        self.free_bend = FreeBend(twin, self._range)
        self.ends = np.cumsum([0, *map(len, episodes)])
        self.slope = imprint_per_rad(episodes, stiffness_n_per_rad(twin))
        bare = self._run((), {}).markers
        self._bent, tip = bare[:, 3], bare[:, [0, 2]]
        reach = np.ptp(self._bent) or 1.0
        self.mm_per_rad = float(np.linalg.norm(np.ptp(tip, axis=0)) / reach)
        pressure = np.concatenate([e.pressure_kpa for e in episodes])
        self.mm_per_kpa = self.mm_per_rad * reach / max(float(np.ptp(pressure)), 1.0)

    # ---------------------------------------------------------------- parameters

    def free(self, structure: Structure, columns: slice = TOUCH) -> list[tuple[str, Parameter]]:
        """Names and specifications of what a structure fits to these columns."""
        out = [("growth", GROWTH), ("touch_late", TOUCH_LATE)] if columns == TOUCH else []
        pipeline = self._pipeline(structure.effects)
        for effect in structure.effects:
            if effect == LATE:
                out.append((f"{LATE}.latency_s", LATENCY))
            for name, spec in zip(pipeline.names, pipeline.specs, strict=True):
                if name.rpartition(".")[0] == effect and not spec.fixed:
                    out.append((name, spec))
        return out

    def start(self, effect: str) -> dict[str, float]:
        """Where an effect's parameters begin: as the twin has them, or at their defaults."""
        own = self.twin.effects.get(effect, {})
        range_kpa = self._range
        return {
            name: own[name.rpartition(".")[2]].value
            if name.rpartition(".")[2] in own
            else (self.known_s or LATENCY.default)
            if effect == LATE
            else spec.limits(range_kpa)[0]
            for name, spec in self.free(Structure((effect,)), AIR)
            if name.startswith(f"{effect}.")
        }

    @property
    def _range(self) -> float:
        return float(max(np.abs(e.command_kpa).max() for e in self.episodes))

    def _pipeline(self, effects: Sequence[str]) -> Pipeline:
        more = [e for e in effects if e != LATE and e not in self.twin.effects]
        columns = set(inputs_of(self.episodes[:1], 0.0, self.twin).columns)
        names = [*self.twin.effects, *more]
        whole = Pipeline.of(self.twin, None, names)
        return Pipeline(whole.geometry, names, False, columns)

    def _theta(self, effects: Sequence[str], values: Mapping[str, float]) -> tuple[Pipeline, np.ndarray]:
        pipeline = self._pipeline(effects)
        theta = pipeline.theta(self.twin, self._range)
        for i, name in enumerate(pipeline.names):
            theta[i] = values.get(name, theta[i])
        return pipeline, theta

    def _run(self, effects: Sequence[str], values: Mapping[str, float]):
        pipeline, theta = self._theta(effects, values)
        latency = values.get(f"{LATE}.latency_s", self.known_s)
        return pipeline.run(inputs_of(self.episodes, latency, self.twin), theta)

    def _off_bench(self, effects: Sequence[str], values: Mapping[str, float]) -> np.ndarray:
        """(n,) by how much the free bend differs from the twin's, mm, as much as it counts; none of air's."""
        if all(e == LATE or get_effect(e).of_air for e in effects):
            return np.zeros(0)
        difference = self.free_bend.difference(*self._theta(effects, values))
        return self.mm_per_rad * difference * np.sqrt(T.BENCH_WEIGHT * self.rows.sum() / len(difference))

    # ---------------------------------------------------------------- prediction

    def predict(
        self, structure: Structure, values: Mapping[str, float], columns: slice = slice(None)
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Residual (N, 5) of all frames, measured - predicted in mm, and the curves behind it, (N,) each.

        Columns that are not asked for may be left 0.
        """
        run = self._run(structure.effects, values)
        latency = values.get(f"{LATE}.latency_s", self.known_s) * CONTROL_HZ
        more, residual = run.markers[:, 3] - self._bent, np.zeros((self.ends[-1], 5))
        imprint = np.zeros(self.ends[-1])
        for e, a, b in zip(self.episodes, self.ends, self.ends[1:], strict=False):
            frames = np.arange(len(e))
            path = np.stack([np.interp(frames - latency, frames, c) for c in e.commanded_m.T], 1)
            residual[a:b, :3] = 1e3 * (moved(e.flange_m) - moved(path))
            residual[a:b, 3] = self.mm_per_kpa * (e.pressure_kpa - run.pressure_kpa[a:b, 0])
            if columns in (AIR, ARM):
                continue
            imprint[a:b], _ = touch(e, more[a:b], values["growth"], values["touch_late"])
            residual[a:b, 4] = (
                np.where(e.contact, (e.imprint - imprint[a:b]) / self.slope, 0.0) * self.mm_per_rad
            )
        return residual, {"pressure_kpa": run.pressure_kpa[:, 0], "imprint": imprint}

    def strength(self, model: DemonstrationModel, growth: float) -> Strength:
        """How strong the imprints of all episodes are, where they grow by that power of the force."""
        more = self._run(model.structure.effects, model.values).markers[:, 3] - self._bent
        rows = zip(self.episodes, self.ends, self.ends[1:], strict=False)
        gains = [touch(e, more[a:b], growth, model.values["touch_late"])[1] for e, a, b in rows]
        return Strength.of(np.array(gains), growth, self.twin)

    def fit(self, start: Start, columns: slice, steps: int = 12) -> DemonstrationModel:
        """A model, by bounded least squares with differences, on the columns `AIR` or `TOUCH`."""
        structure, begin = start
        names, specs = zip(*self.free(structure, columns), strict=True)
        known = ("", *structure.effects)
        given = {n: v for n, v in begin.items() if n.rpartition(".")[0] in known}
        low, high = np.array([_bounds(s, self._range) for s in specs]).T

        def free(v: np.ndarray) -> dict[str, float]:
            found = zip(names, specs, low + v * (high - low), strict=True)
            return given | {n: _value(s, x) for n, s, x in found}

        first = [_inside(s, given[n], self._range) for n, s in zip(names, specs, strict=True)]

        def residual(v: np.ndarray) -> np.ndarray:
            return self.predict(structure, free(v), columns)[0][self.rows, columns].ravel()

        def held(v: np.ndarray) -> np.ndarray:
            return np.concatenate([residual(v), self._off_bench(structure.effects, free(v))])

        def slopes(v: np.ndarray) -> np.ndarray:  # by steps of the range, not of what may be nearly 0
            steps = np.where(v < 0.5, STEP, -STEP)
            here = held(v)
            return np.stack([held(v + d) - here for d in np.diag(steps)], 1) / steps

        found = least_squares(
            held,
            np.clip(first, 1e-4, 1 - 1e-4),
            slopes,
            bounds=(0, 1),
            x_scale=0.1,
            max_nfev=steps,
            loss="linear",
        )
        size = int(self.rows.sum()) * len(range(5)[columns])
        r = found.fun[:size].reshape(int(self.rows.sum()), -1)
        edge = [n for n, v in zip(names, found.x, strict=True) if v < STEP or v > 1 - STEP]
        J = found.jac[:size].reshape(*r.shape, -1)
        moving = (found.x > STEP) & (found.x < 1 - STEP)
        masks = free(found.x)
        log = frozenset(n for n, s in zip(names, specs, strict=True) if s.log)
        unit = {n: (a, b) for n, a, b, m in zip(names, low, high, moving, strict=True) if m}

        def residual_at(step: np.ndarray) -> np.ndarray:
            there = found.x.copy()
            there[moving] = np.clip(there[moving] + step, 0, 1)
            return residual(there).reshape(r.shape)

        K = found.jac[size:][:, moving]
        bench = (found.fun[size:] @ K, K.T @ K)
        return DemonstrationModel(structure, masks, r, J[:, :, moving], edge, unit, log, residual_at, bench)

    def base(self, columns: slice) -> DemonstrationModel:
        if columns == AIR:
            r = self.predict(Structure(), START, AIR)[0][self.rows, AIR]
            return DemonstrationModel(Structure(), dict(START), r, np.zeros((*r.shape, 0)), [], {})
        return self.fit((Structure(), dict(START)), TOUCH, 20)

    def lateness(self, masks: list[np.ndarray]) -> float:
        """By how many frames touch is shown late in some frames of the episodes, (T,) masks each.

        How imprints grow is not fitted: where clocks part, that bends to make up for it.
        """
        episodes = [replace(e, contact=m) for e, m in zip(self.episodes, masks, strict=True)]
        part = Fitter(self.twin, episodes, np.concatenate(masks))
        tried = np.arange(0.0, MOST_LATE, 0.25)
        errors = []
        for shift in tried:
            r = part.predict(Structure(), START | {"touch_late": float(shift)}, TOUCH)[0][part.rows, TOUCH]
            errors.append(float(np.abs(r).sum()))  # by squares the few frames of chatter would decide
        best = tried[int(np.argmin(errors))]
        near = np.abs(tried - best) <= 1.0  # between frames errors are a little jagged: a parabola is not
        curve, slope, _ = np.polyfit(tried[near] - best, np.array(errors)[near], 2)
        return float(np.clip(best - slope / (2 * curve), 0.0, MOST_LATE)) if curve > 0 else float(best)

    def twin_with(self, model: DemonstrationModel, ci95: Mapping[str, tuple[float, float]]) -> Twin:
        twin, fitted = self.twin.copy(), {}
        pipeline = self._pipeline(model.structure.effects)
        theta = pipeline.theta(twin, self._range)
        for name, value in zip(pipeline.names, theta, strict=True):
            effect, _, parameter = name.rpartition(".")
            if effect in model.structure.effects:
                found = model.values[name] if name in model.values else float(value)
                fitted.setdefault(effect, {})[parameter] = Value(found, ci95.get(name))
        twin.effects = twin.effects | fitted
        if LATE in model.structure.effects:
            known = model.values[f"{LATE}.latency_s"]
            twin.parameters = twin.parameters | {
                "command_latency_s": Value(known, ci95.get(f"{LATE}.latency_s"))
            }
        return replace(twin)


def latency_s(twin: Twin) -> float:
    known = twin.parameters.get("command_latency_s")
    return known.value if known else 0.0


def moved(path: np.ndarray) -> np.ndarray:
    """A path (T, 3) from where it begins, the mean of its first frames."""
    return path - path[:BEGIN].mean(0)


def _bounds(spec: Parameter, range_kpa: float) -> tuple[float, float]:
    _, low, high = spec.limits(range_kpa)
    return (np.log(low), np.log(high)) if spec.log else (low, high)


def _value(spec: Parameter, x: float) -> float:
    return float(np.exp(x)) if spec.log else float(x)


def _inside(spec: Parameter, value: float, range_kpa: float) -> float:
    low, high = _bounds(spec, range_kpa)
    return ((np.log(max(value, 1e-12)) if spec.log else value) - low) / (high - low)


class DemonstrationSpace(Space):
    """What a search may try on the `columns` of the residual that count: those of the air, or touch."""

    def __init__(self, fitter: Fitter, base: DemonstrationModel, candidates: Sequence[str], columns: slice):
        self.fitter, self.base, self.candidates, self.columns = fitter, base, candidates, columns

    def bases(self) -> list[Start]:
        return [(Structure(), self.base.values)]

    def grow(self, model: DemonstrationModel, most: int, pairs: int) -> list[Start]:
        return [
            (model.structure.plus(e), model.values | self.fitter.start(e))
            for e in self.candidates
            if e not in model.structure.effects
        ]

    def fit(self, start: Start, steps: int, every: int = 1) -> DemonstrationModel:
        """A model; a rough one where `every` is above one."""
        if not start[0].effects:
            return self.base
        return self.fitter.fit(start, self.columns, (2 if every > 1 else 4) * steps)

    def refine(self, model: DemonstrationModel) -> DemonstrationModel:
        return self.fitter.fit(self.again(model), self.columns, 60)

    def without(self, model: DemonstrationModel, term: str) -> DemonstrationModel:
        structure = model.structure.without(term)
        if not structure.effects:
            return self.base
        return self.fitter.fit((structure, model.values), self.columns, 40)

    def pruned(
        self,
        model: Scored,
        score: Callable[[DemonstrationModel], Scored],
        least: Callable[[float], float],
    ) -> Scored:
        """Without terms that hardly count, which must not ride on others; the weightiest first.

        `least` gives the rise of the mean square error by which a term counts where so much is left with it.
        """
        while terms := model.model.structure.effects:
            without = {e: score(self.without(model.model, e)) for e in terms}
            weakest = min(without, key=lambda e: without[e].value)
            if without[weakest].value - model.value > least(model.value):
                model.model.structure = Structure(tuple(sorted(terms, key=lambda e: -without[e].value)))
                return model
            model = without[weakest]
        return model
