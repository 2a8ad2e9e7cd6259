"""The pipeline one control step at a time, for the environment and for real time."""

import copy
import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pneutac_sim.effects.registry import get_effect, of_body
from pneutac_sim.errors import InputError, check_between
from pneutac_sim.finger.pipeline import BENDING_PRESSURE, Pipeline
from pneutac_sim.finger.stages import BodyLink, EffectLink
from pneutac_sim.twin import Twin

COMPUTED = ("session_time_s", "length_mm", BENDING_PRESSURE)  # conditions that nobody has to give
OTHERS = tuple(f"other_{i}_kpa" for i in (1, 2, 3))


def needed_conditions(twin: Twin) -> list[str]:
    """Names of what the effects of a twin's body ask for, such as `temperature_c`."""
    effects = (get_effect(name) for name in of_body(twin.effects))
    return sorted({column for effect in effects for column in effect.columns} - {*COMPUTED})


# Conditions beyond which a number can only be of another unit or mistyped.
LIMITS = {"temperature_c": (-50, 150, "°C"), "payload_g": (0, 10_000, "g")}
LIMITS |= {f"gravity_{axis}": (-1, 1, "of its length 1") for axis in "xyz"}


def check_conditions(given: Mapping[str, float | list[float]]) -> None:
    """Raises InputError where a condition, or an end of its range, is no finite number within `LIMITS`."""
    for name, value in given.items():
        low, high = value if isinstance(value, list | tuple) and len(value) == 2 else (value, value)
        numbers = all(type(v) in (int, float) and math.isfinite(v) for v in (low, high))
        if not (numbers and low <= high):
            raise InputError(f"conditions has {name}: {value}; give a finite number, or a range [low, high].")
        for end in (low, high):
            check_between(*LIMITS.get(name, (-math.inf, math.inf)), **{f"conditions has {name}, which": end})
    gravity = [given[f"gravity_{axis}"] for axis in "xyz" if f"gravity_{axis}" in given]
    fixed = not any(isinstance(g, list | tuple) for g in gravity)
    if gravity and fixed and (len(gravity) < 3 or abs(math.hypot(*gravity) - 1) > 0.01):
        raise InputError("conditions: give gravity_x, gravity_y and gravity_z together, of length 1.")


def refuse_unused(twin: Twin, given: Mapping[str, float]) -> None:
    """Raises InputError for a condition that no effect of the twin asks for: a typing error would be lost."""
    check_conditions(given)
    needed = needed_conditions(twin)
    for name in given:
        if name in needed or (name.endswith("_kpa") and {*OTHERS} & {*needed}):
            continue
        wanted = f"ask for {', '.join(needed)}" if needed else "ask for none, omit it"
        where = f" at {twin.folder}" if twin.folder else ""
        raise InputError(
            f"conditions has '{name}', which the twin{where} has no use for: its effects {wanted}."
        )


class PressurePipeline:
    """A twin's pipeline in three parts, between which a simulator moves the body.

    `step` makes joint targets of the command (pneumatics, drive, loads, material), `place` says where the
    body's tip is at joint angles (stretch, mount), and `read` what is measured of it (observation). On a
    uniform grid the three in a row equal `Pipeline.run`.

    A session begins with a new device. `reset` begins a trial: the device has rested, as at the first sample
    of a trial on the bench, and as there session time and what the material remembers for good (largest
    strain, cycles) go on within a session.

    Args:
        twin: a `finger` or an `arm`.
        conditions: what its effects ask for, such as `temperature_c`; further `*_kpa` are the pressures of
            other chambers, in their order.

    Attributes:
        pressure_kpa: (chambers,) in the chambers after the last step, as their gauge reads it.
        moves: whether an effect moves the tip from where the joints put it.
        measures: whether an effect changes what is read of the tip.

    Raises InputError: an effect's condition was not given, or is not a finite number.
    """

    def __init__(self, twin: Twin, conditions: Mapping[str, float] | None = None):
        self._model = Pipeline.of(twin)
        self._theta = self._model.theta(twin)
        self._arm = self._model.geometry.axes == 2
        chain, self._tip = list(enumerate(self._held())), self._model.reads_joints
        self._to_joints, self._to_read = chain[: self._tip], chain[self._model.observes :]
        self._to_tip = chain[self._tip : self._model.observes]
        self.moves, self.measures = len(self._to_tip) > 1, bool(self._to_read)
        self._given: dict[str, float] = {}
        self.set_conditions(conditions or {})
        self.reset()

    def _held(self) -> list:
        """The chain, its drive once for all at the twin's parameters."""
        chain = self._model.chain
        drive = chain[self._model.drive]
        drive = replace(drive, held=drive.line(self._theta))
        chain = [replace(link, drive=drive) if isinstance(link, BodyLink) else link for link in chain]
        chain[self._model.drive] = drive
        return chain

    def set_conditions(self, conditions: Mapping[str, float]) -> None:
        """Conditions from now on, in place of all given before; raises InputError as the constructor."""
        others = [v for name, v in conditions.items() if name.endswith("_kpa")]
        if others:
            conditions = dict(zip(OTHERS, [*others, 0.0, 0.0], strict=False)) | dict(conditions)
        for effect in self._model.effects:
            for name in effect.columns:
                if name in COMPUTED:
                    continue
                if name not in conditions:
                    raise InputError(
                        f"The twin's effect '{effect.name}' needs the condition '{name}'; give it, as in "
                        f"conditions={{{name}: NUMBER}}."
                    )
                if not math.isfinite(conditions[name]):
                    raise InputError(f"conditions has {name}: {conditions[name]}; give a finite number.")
        clock = {name: value for name, value in self._given.items() if name in COMPUTED}
        self._given = dict(conditions) | {"length_mm": self._model.geometry.length_mm} | clock

    def reset(self, pressure_kpa: float | np.ndarray = 0.0, same_session: bool = False) -> None:
        """A device that has long been at this pressure: a new one, or the same in a further trial."""
        n = self._model.geometry.chambers
        self.pressure_kpa = np.broadcast_to(np.asarray(pressure_kpa, dtype=float), (n,)).copy()
        self._rested = self.pressure_kpa.copy()
        self._began: set[int] = set()  # links that have been at rest in this trial
        if not same_session:
            self._states: dict[int, np.ndarray] = {}
            self._given["session_time_s"] = 0.0

    def copy(self) -> "PressurePipeline":
        """A pipeline that goes its own way from here on."""
        new = copy.copy(self)
        new._states = {i: s.copy() for i, s in self._states.items()}
        new._given, new._began = self._given.copy(), self._began.copy()
        return new

    @property
    def mounted(self) -> bool:
        """Whether all that moves the tip from where the joints put it is how the base stands."""
        effects = [link.effect for _, link in self._to_tip[1:]]
        return all(e.signal == "mount" and not e.columns and not e.state_size(1) for e in effects)

    def rest(self) -> np.ndarray:
        """Joint targets with which a trial begins, as of `step`."""
        joints = self._run(self._to_joints, self._rested, math.inf)
        return joints.reshape(-1, 2) if self._arm else joints

    def step(self, pressure_cmd_kpa: float | np.ndarray, dt_s: float) -> np.ndarray:
        """Advances by one control step of `dt_s` under a command, a number or (chambers,).

        Returns joint targets at which the free body rests, (N,) for a finger, (N, 2) for an arm, rad.
        """
        if 0 not in self._began:
            self.rest()
        self._given["session_time_s"] += dt_s
        joints = self._run(self._to_joints, np.asarray(pressure_cmd_kpa, dtype=float), dt_s)
        return joints.reshape(-1, 2) if self._arm else joints

    def predict(self, pressure_cmd_kpa: np.ndarray, dt_s: float) -> np.ndarray:
        """Where the free tip will be after each of further control steps, (n, 5) as `place`.

        None of them is done. Commands are (n,) or (n, chambers).
        """
        ahead = self.copy()
        if 0 not in ahead._began:
            ahead.rest()
        commands = np.asarray(pressure_cmd_kpa, dtype=float).reshape(len(pressure_cmd_kpa), -1)
        ahead._given["session_time_s"] += dt_s * np.arange(1, len(commands) + 1)
        joints = ahead._run_rows(ahead._to_joints, commands, dt_s)
        return ahead._run_rows(ahead._to_tip, joints, dt_s)

    def place(self, joints: np.ndarray, dt_s: float) -> np.ndarray:
        """Where the tip is (5,): x, y, z in mm in the base's frame, bend towards +z and +y in rad.

        At joint angles as `step` returns them; where contact bends the body, the bent ones.
        """
        return self._run(self._to_tip, np.ravel(joints), dt_s)

    def place_without(self, joints: np.ndarray) -> np.ndarray:
        """As `place`, where no effect moves the tip: (5,)."""
        return self._run(self._to_tip[:1], np.ravel(joints), 0.0)

    def place_base(self, dt_s: float) -> np.ndarray:
        """Where the same effects put a marker on the base itself, which is at zero without them: (5,)."""
        return self._run(self._to_tip[1:], np.zeros(5), dt_s, of_base=True)

    def read(self, markers: np.ndarray, dt_s: float) -> np.ndarray:
        """What is measured of a tip that is at `markers` (5,): the same, (5,)."""
        return self._run(self._to_read, np.asarray(markers, dtype=float), dt_s)

    def _run(self, links, x: np.ndarray, dt_s: float, of_base: bool = False) -> np.ndarray:
        size = self._model.geometry.chambers if links is self._to_joints else x.size
        x = x.reshape(1, -1) if x.size == size else np.full((1, size), x)
        return self._run_rows(links, x, dt_s, of_base)[0]

    def _run_rows(self, links, x: np.ndarray, dt_s: float, of_base: bool = False) -> np.ndarray:
        n = len(x)
        steady = np.full(n, dt_s)

        def conditions(names):
            rows = np.empty((n, len(names)))
            for k, c in enumerate(names):
                rows[:, k] = self._given[c]
            return rows

        for i, link in links:
            if i == self._model.reads_pressure:
                self.pressure_kpa = x[-1].copy()
            if i == self._model.drive and self._model.asks_pressure:
                self._given[BENDING_PRESSURE] = x.mean(axis=1)
            key, dt = -i if of_base else i, steady
            if key not in self._states:
                self._states[key] = np.zeros(link.state_size(x.shape[1]))
            if key not in self._began:  # it has rested here for ever
                self._began.add(key)
                dt = np.concatenate([[math.inf], steady[1:]])
            x = link(x, dt, self._theta, conditions, self._states[key])
        return x


class ManyPipelines:
    """`PressurePipeline.step` of K devices of one twin and one chamber together, all at rest at 0 kPa first.

    Devices are channels of the effects that remember. Where one of these cannot be run so, each device has a
    pipeline of its own, which is slow.

    Args:
        one: the pipeline, which stays as it is.
        devices: K.
        forked: whether `states` and `resume` are called, so that each device needs a clock of its own.

    Attributes:
        pressure_kpa: (K, 1) after the last step, as of `PressurePipeline`.
    """

    def __init__(self, one: PressurePipeline, devices: int, forked: bool = False):
        self._one, self._links = one.copy(), one._to_joints
        self._one.reset(0.0)
        self._one.rest()
        remember = [(i, link) for i, link in self._links if link.remembers]
        effects = [link.effect for _, link in self._links if isinstance(link, EffectLink)]
        clocked = any("session_time_s" in e.columns for e in effects)  # each has begun at its own time
        together = not clocked and all(
            i < one._model.drive
            and e.effect.apart
            and not e.effect.columns
            and not (forked and e.state_size(0))
            for i, e in remember
        )
        self._own = None if together else [self._one.copy() for _ in range(devices)]
        self._states: dict[int, np.ndarray] = {}
        self._rows: dict[int, tuple[np.ndarray, np.ndarray]] = {}  # a column a device, and those at rest
        for i, link in remember if together else ():
            shared, rested = np.split(self._one._states[i], [link.state_size(0)])
            self._states[i] = np.concatenate([shared, np.repeat(rested, devices)])
            self._rows[i] = self._states[i][len(shared) :].reshape(-1, devices), rested[:, None]
        self.pressure_kpa = np.zeros((devices, 1))

    def restart(self, devices: np.ndarray) -> None:
        """Puts devices (k,), indices, to rest at 0 kPa."""
        if self._own is not None:
            for k in devices:
                self._own[k] = self._one.copy()
        for rows, rested in self._rows.values():
            rows[:, devices] = rested

    def states(self, devices: np.ndarray) -> list:
        """What devices (k,), indices, remember, for `resume`."""
        if self._own is not None:
            return [self._own[k].copy() for k in devices]
        return [rows[:, devices] for rows, _ in self._rows.values()]

    def resume(self, devices: np.ndarray, states: list) -> None:
        """Lets devices (k,) remember `states` of as many, of these or of others of the same twin."""
        if self._own is not None:
            for k, pipeline in zip(devices, states, strict=True):
                self._own[k] = pipeline.copy()
            return
        for (rows, _), columns in zip(self._rows.values(), states, strict=True):
            rows[:, devices] = columns

    def step(self, pressure_cmd_kpa: np.ndarray, dt_s: float) -> np.ndarray:
        """Joint targets (K, N), rad, one control step of `dt_s` on under commands (K, 1)."""
        if self._own is not None:
            joints = [p.step(c, dt_s) for p, c in zip(self._own, pressure_cmd_kpa, strict=True)]
            self.pressure_kpa = np.stack([p.pressure_kpa for p in self._own])
            return np.stack(joints)
        one, x, dt = self._one, np.asarray(pressure_cmd_kpa, float), np.full(1, dt_s)
        for i, link in self._links:
            if i == one._model.reads_pressure:
                self.pressure_kpa = x
            if link.remembers:
                side_by_side = np.ascontiguousarray(x.reshape(1, -1))
                state, no_conditions = self._states[i], lambda names: np.empty((1, 0))
                x = link(side_by_side, dt, one._theta, no_conditions, state).reshape(-1, 1)
            else:
                x = one._run_rows([(i, link)], x, math.inf)
        return x
