"""What `pneutac export` writes into every file of a finger: how its links are stepped one after the other."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pneutac_sim.finger.stages import drive_line, gain_profile


@dataclass(frozen=True)
class Link:
    """One step of the way from the command to the tip."""

    name: str  # of the effect, or what it does
    # the signal that it changes: `pressure` (chambers,) kPa, `load` (6,) N, `joints` rad less the curl at
    # rest, `markers` (5,) mm and rad; or `drive`, `equilibrium` and `kinematics`, between.
    kind: str
    run: Callable | None = None  # the function; None for the drive
    constants: tuple[str, ...] = ()  # names in `CONSTANTS` of what it is given, in order
    columns: tuple[str, ...] = ()  # conditions that it needs
    memory: int = 0  # numbers that it remembers


@dataclass(frozen=True)
class Pose:
    """Where the finger is; frame of its base: x along the straight finger, z where pressure bends it."""

    pressure_kpa: np.ndarray  # (chambers,) as the gauge reads it
    joints_rad: np.ndarray  # (N,) angles of the joints, of an arm (N, 2) towards +z and towards +y
    tip: np.ndarray  # (5,) x, y, z in mm, bend towards +z and towards +y in rad
    measured: np.ndarray  # (5,) as a camera or tracker reads it, with the errors that the twin knows of


class Finger:
    """A pneumatic finger or arm, one step at a time; what it remembers stays from step to step.

    Args:
        links: in the order in which they act.
        constants: by name.
        length_mm: of the straight finger.
        joints_mm: (N,) arc length of each joint from the base.
        chambers: number of pressures.
        reads: number of links before the pressure gauge, and before the camera.
        range_kpa: lowest and highest pressure that it was measured at; the first command beyond warns.
        conditions: what effects ask for, such as `temperature_c`; change them by `set_conditions`.

    Raises:
        ValueError: a condition is missing or is not a finite number.
    """

    def __init__(self, links, constants, length_mm, joints_mm, chambers, reads, range_kpa, conditions):
        self._links, self._chambers, self._reads = links, chambers, reads
        self._range, self._warned = range_kpa, False
        self._joints, self._length = np.array(joints_mm, dtype=float), float(length_mm)
        parts = np.diff(np.append(self._joints, length_mm))
        self._parts = np.concatenate([1e-3 * parts, parts / length_mm])
        self._theta = [np.array([constants[name] for name in link.constants]) for link in links]
        n, drive = len(joints_mm), [link.kind for link in links].index("drive")
        values = self._theta[drive]
        profile = gain_profile(n, float(values[1]), float(values[2]))
        self._gain, self._still = drive_line(values, profile, 1 if chambers == 1 else 2)
        self.set_conditions(**conditions)
        self.reset()

    def set_conditions(self, **conditions):
        """Conditions from now on, such as `temperature_c=25.0`; those that are not named stay as they are."""
        given = getattr(self, "_given", {"length_mm": self._length}) | conditions
        for name in {c for link in self._links for c in link.columns}:
            if name in ("session_time_s", "bending_pressure_kpa"):
                continue
            if not np.isfinite(given.get(name, np.nan)):
                raise ValueError(f"{name} is {given.get(name)}; give a finite number, as in {name}=1.0.")
        self._given = given

    def reset(self, pressure_kpa=0.0):
        """A new device that has rested at this pressure for ever, a number or (chambers,) kPa; its `Pose`."""
        self._state = [np.zeros(link.memory) for link in self._links]
        self._given["session_time_s"] = 0.0
        return self._run(pressure_kpa, np.inf)

    def step(self, pressure_cmd_kpa, dt_s):
        """Advances by `dt_s` seconds, in which the command goes straight to this one; returns a `Pose`.

        Args:
            pressure_cmd_kpa: a number, or (chambers,) kPa.
            dt_s: length of the step, above zero.

        Raises:
            ValueError: the command is not a finite number or one a chamber, or the step is not above 0.
        """
        try:
            command, dt_s = np.asarray(pressure_cmd_kpa, dtype=float), float(dt_s)
        except (TypeError, ValueError) as e:
            raise ValueError(
                f"The command {pressure_cmd_kpa!r} kPa and the step {dt_s!r} s must be numbers."
            ) from e
        if not np.isfinite(command).all() or command.shape not in ((), (1,), (self._chambers,)):
            raise ValueError(
                f"The command is {pressure_cmd_kpa} kPa; give a finite number, or one for each of "
                f"{self._chambers} chambers."
            )
        if not 0 < dt_s < np.inf:
            raise ValueError(f"The step dt_s is {dt_s} s; give a finite number above 0.")
        low, high = self._range
        if not self._warned and ((command < low) | (command > high)).any():
            self._warned = True
            warnings.warn(
                f"The command {pressure_cmd_kpa} kPa lies beyond {low:g} to {high:g} kPa, where it was "
                "measured; poses there are extrapolated. Later ones do not warn.",
                stacklevel=2,
            )
        self._given["session_time_s"] += dt_s
        return self._run(pressure_cmd_kpa, dt_s)

    def _run(self, pressure_kpa, dt_s):
        x = np.broadcast_to(np.asarray(pressure_kpa, dtype=float), (self._chambers,)).reshape(1, -1)
        dt, loads = np.array([dt_s], dtype=float), np.zeros((1, 6))
        gauge, joints, tip = x, x, x
        with np.errstate(all="ignore"):  # a lag of no time divides by zero, on purpose
            for i, link in enumerate(self._links):
                gauge, tip = x if i == self._reads[0] else gauge, x if i == self._reads[1] else tip
                if link.kind == "drive":
                    self._given["bending_pressure_kpa"] = float(x.mean())
                    x = x @ self._gain + self._still
                elif link.kind == "load":
                    self._apply(i, loads, dt)
                elif link.kind == "equilibrium":
                    x = x.copy()
                    link.run(x, loads, self._theta[i][0], self._parts, self._state[i])
                elif link.kind == "kinematics":
                    joints, x = x, self._markers(link.run, x)
                elif link.kind == "joints":  # acts on what is strained, not on the curl at rest
                    strained = x - self._still
                    x = x + (self._apply(i, strained.copy(), dt) - strained)
                else:
                    x = self._apply(i, x.copy(), dt)
        tip = x if self._reads[1] == len(self._links) else tip
        angles = joints[0] if self._chambers == 1 else joints[0].reshape(-1, 2)
        return Pose(gauge[0].copy(), angles.copy(), tip[0].copy(), x[0].copy())

    def _apply(self, i, x, dt):
        link = self._links[i]
        conditions = np.array([[self._given[c] for c in link.columns]], dtype=float)
        link.run(x, dt, self._theta[i], conditions, self._state[i])
        return x

    def _markers(self, kinematics, q):
        out = np.zeros((1, 5))
        if self._chambers == 1:
            tip, bend = kinematics(q, self._joints, self._length)
            out[0, [0, 2]], out[0, 3] = tip[0], bend[0]
        else:
            out[:, :3], out[:, 3:] = kinematics(q.reshape(1, -1, 2), self._joints, self._length)
        return out
