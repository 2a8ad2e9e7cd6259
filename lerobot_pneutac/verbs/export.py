"""A twin to take along: the finger as one Python file that needs NumPy alone, or its body as MJCF."""

import ast
import builtins
import dis
import inspect
import textwrap
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from shlex import quote
from types import CodeType, FunctionType, ModuleType
from typing import ClassVar

import numpy as np

from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.verbs.history import report
from pneutac_sim.effects.laws import family, is_law
from pneutac_sim.effects.registry import get_effect, of_body, of_sensor
from pneutac_sim.errors import InputError
from pneutac_sim.files import check_new_file, whole, write_text
from pneutac_sim.finger import stages
from pneutac_sim.finger.equilibrium import solve
from pneutac_sim.finger.online import COMPUTED
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.finger.stages import drive_line, gain_profile
from pneutac_sim.twin import PAPER_FINGER, Twin, Value

MODULES = {"math": "import math", "warnings": "import warnings", "numpy": "import numpy as np"}
IMPORTS = {
    "math.": MODULES["math"],
    "warnings.": MODULES["warnings"],
    "Callable": "from collections.abc import Callable",
    "@dataclass": "from dataclasses import dataclass",
    "@cache": "from functools import cache",
    "partial(": "from functools import partial",
}


@dataclass
class ExportConfig:
    """Options of `pneutac export`."""

    names_a_file: ClassVar[bool] = True

    twin: Path  # folder of the twin
    out: Path  # new file to write: `.py`, the finger in Python with NumPy, or `.xml`, its body in MJCF


class Source:
    """Collects functions and classes, and the functions and constants that these use, callees first."""

    def __init__(self, compiled: bool = True):
        self._compiled = compiled
        self._names: dict = {}
        self._texts: list[str] = []
        self.constants: dict[str, str] = {}

    @property
    def functions(self) -> str:
        return "\n\n\n".join(self._texts)

    def add(self, function, name: str = "") -> str:
        """Adds a function, a class or a `partial` of one; returns the expression that is it in the text.

        It is called by its own name where `name` is empty. Raises InputError where it uses something else
        than NumPy, `math`, functions and constants.
        """
        if isinstance(function, partial):
            chosen = [f"{k}={self.add(v) if callable(v) else repr(v)}" for k, v in function.keywords.items()]
            return f"partial({', '.join([self.add(function.func), *chosen])})"
        plain = _plain(function)
        if plain in self._names:
            return self._names[plain]
        name = name or plain.__name__
        if name in self._names.values():  # of another function
            name = f"{plain.__module__.rpartition('.')[2]}_{name.lstrip('_')}"
        self._names[plain] = name
        renamed = {}
        for used, value in _globals(plain).items():
            if (new := self._use(used, value, plain)) != used:
                renamed[used] = new
        text = textwrap.dedent(inspect.getsource(plain)).rstrip()
        decorated = isinstance(plain, type) or hasattr(function, "cache_info") or self._compiled
        self._texts.append(_rename(text, name, renamed, decorated))
        return name

    def _use(self, name: str, value, user) -> str:
        if inspect.isfunction(_plain(value)) or isinstance(value, type):
            return "ValueError" if value is InputError else self.add(value)
        if isinstance(value, ModuleType) and value.__name__ in MODULES:
            return name
        if isinstance(value, bool | int | float | str | tuple | np.ndarray):
            text = f"np.array({value.tolist()!r})" if isinstance(value, np.ndarray) else repr(value)
            if self.constants.get(name, text) != text:
                name = f"{user.__module__.rpartition('.')[2]}{'' if name[0] == '_' else '_'}{name}"
            self.constants[name] = text
            return name
        raise InputError(
            f"{user.__module__}.{user.__name__} uses '{name}'; a file that needs NumPy alone cannot have it."
        )

    def lines(self) -> list[str]:
        return [f"{name} = {text}" for name, text in self.constants.items()]


def _plain(function):
    """The function below a kernel or a `cache`."""
    return inspect.unwrap(getattr(function, "py_func", function))


def _globals(function) -> dict:
    """Names that a function or the methods of a class read from their module, and their values."""
    functions = [function]
    if isinstance(function, type):
        functions = [f for f in vars(function).values() if isinstance(f, FunctionType)]
        functions = [f for f in functions if f.__code__.co_filename == inspect.getfile(function)]
    found = {}
    for f in functions:
        names, there = sorted(_names(f.__code__)), f.__globals__
        found |= {n: there[n] for n in names if n in there and there[n] is not function}
        unknown = [n for n in names if n not in there and not hasattr(builtins, n)]
        if unknown:
            raise InputError(f"{f.__module__}.{f.__name__} uses '{unknown[0]}', which does not exist.")
    return found


def _names(code: CodeType) -> set[str]:
    own = {i.argval for i in dis.get_instructions(code) if i.opname == "LOAD_GLOBAL"}
    return own.union(*(_names(c) for c in code.co_consts if isinstance(c, CodeType)))


def _rename(text: str, name: str, renamed: dict[str, str], decorated: bool) -> str:
    """The source of one definition under a name, with others for what it uses."""
    node = ast.parse(text).body[0]
    names = (n for n in ast.walk(node) if isinstance(n, ast.Name) and n.id in renamed)
    lines = text.splitlines()
    for row, column, old in sorted(((n.lineno - 1, n.col_offset, n.id) for n in names), reverse=True):
        line = lines[row].encode()  # columns count bytes
        lines[row] = (line[:column] + renamed[old].encode() + line[column + len(old.encode()) :]).decode()
    first = node.lineno - 1
    lines[first] = lines[first].replace(f" {node.name}", f" {name}", 1)
    return "\n".join(lines if decorated else lines[first:])


def command(cfg: ExportConfig, terminal: Terminal) -> None:
    if cfg.out.suffix not in (".py", ".xml"):
        raise InputError(f"--out={cfg.out} must name a file that ends in .py or in .xml.")
    check_new_file(cfg.out, f"--out={cfg.out}")
    twin = Twin.load(cfg.twin)
    if cfg.out.suffix == ".py":
        write_text(cfg.out, python_file(twin))
        run = f"`python {quote(str(cfg.out))}` steps it once"
        terminal.say(f"model: {cfg.out}; {run}, its first lines explain it")
    else:
        with whole(cfg.out) as part:
            write_mjcf(twin, part)
        terminal.say(f"body: {cfg.out}; `python -m mujoco.viewer --mjcf={quote(str(cfg.out))}` shows it")


# ---------------------------------------------------------------- Python


def python_file(twin: Twin) -> str:
    """A finger or an arm as a Python module that needs NumPy alone and steps as the twin's pipeline does.

    Raises InputError where an effect of another package uses more than NumPy.
    """
    if twin.device == "gel":
        raise InputError("A gel has no pressure that bends it; export the twin of a finger or an arm.")
    model, source = Pipeline.of(twin), Source(compiled=False)
    theta, of_air = model.theta(twin), _knows_air(twin)
    for part in (Link, Pose, Finger):
        source.add(part)
    links = []
    for link in model.chain:
        if isinstance(link, stages.EffectLink):
            signal = link.effect.signal
            links.append(_effect(link, model, source, "markers" if signal == "mount" else signal))
        elif isinstance(link, stages.LoadLink):
            links += [_effect(e, model, source, "load") for e in link.effects]
            stiffness, size = (model.names[link.stiffness],), model.geometry.n_joints * model.geometry.axes
            links.append(_link("equilibrium", "equilibrium", source.add(solve), stiffness, memory=size))
        elif model.chain.index(link) == model.drive:
            links.append(_link("drive", "drive", None, tuple(model.names[i] for i in link.indices)))
        else:
            planar = model.geometry.axes == 1
            run = stages.forward_kinematics if planar else stages.forward_kinematics_spatial
            links.append(_link("kinematics", "kinematics", source.add(run)))
    constants = []
    for name, spec, value in zip(model.names, model.specs, theta, strict=True):
        effect, _, parameter = name.rpartition(".")
        known = (twin.effects[effect] if effect else twin.parameters).get(parameter, Value(0.0))
        number = repr(float(value)) if value == value and abs(value) != float("inf") else f'float("{value}")'
        interval = "95 % interval {:.4g} to {:.4g}".format(*known.ci95) if known.ci95 else ""
        remark = ", ".join(filter(None, [spec.unit, interval])) or "a ratio"
        constants.append(f"    {name!r}: {number},  # {remark}")
    reads = _place(model, model.reads_pressure) if of_air else 0, _place(model, model.observes)
    body = [
        *source.lines(), "", "", source.functions, "", "",
        "CONSTANTS = {", *constants, "}", "", "LINKS = (", *(f"    {link}," for link in links), ")", "", "",
        "def finger(**conditions) -> Finger:",
        '    """A new device, vented; see `Finger`."""',
        f"    joints_mm = {[float(x) for x in twin.spine_joint_positions_mm]!r}",
        f"    return Finger(LINKS, CONSTANTS, {float(twin.length_mm)!r}, joints_mm, "
        f"{model.geometry.chambers}, {reads!r}, {tuple(map(float, twin.pressure_range_kpa))!r}, conditions)",
        "", "",
        'if __name__ == "__main__":',
        f"    print({_call(model)}.step({_pressure(twin):g}, 0.02))", "",
    ]  # fmt: skip
    text = "\n".join(body)
    if not of_air:
        text = text.replace(GAUGE, COMMAND).replace(LAST, LAST + FORMER)
    needed = [line for used, line in IMPORTS.items() if used in text]
    head = f'"""{_docstring(twin, model)}"""\n\nfrom __future__ import annotations\n'
    return "\n".join([head.replace("\\", "\\\\"), *needed, "", "import numpy as np", "", text])


# A line of `Pose`, and what it is where the twin has no air between the command and the finger.
GAUGE = "    pressure_kpa: np.ndarray  # (chambers,) as the gauge reads it\n"
COMMAND = "    command_kpa: np.ndarray  # (chambers,) as commanded; that in the finger is not modelled\n"
LAST = "with the errors that the twin knows of\n"  # end of `Pose`
FORMER = '''
    @property
    def pressure_kpa(self):
        """`command_kpa` by its name until version 0.1."""
        warnings.warn("pressure_kpa is the command; read command_kpa.", FutureWarning, stacklevel=2)
        return self.command_kpa
'''


def _knows_air(twin: Twin) -> bool:
    """Whether a twin models the pressure in its chambers: its air, and no slow valve as part of the bend."""
    laws = {n: {k: v.value for k, v in values.items()} for n, values in twin.effects.items() if is_law(n)}
    slow = any(family(name, values) == "valve_lag" for name, values in laws.items())
    return not slow and any(get_effect(name).of_air for name in of_body(twin.effects))


def _place(model: Pipeline, index: int) -> int:
    """What `model.chain[index]` is in the file, where effects of the load are links of their own."""
    loads = [len(link.effects) for link in model.chain[:index] if isinstance(link, stages.LoadLink)]
    return index + sum(loads)


def _effect(link: stages.EffectLink, model: Pipeline, source: Source, kind: str) -> str:
    g, effect = model.geometry, link.effect
    channels = {"pressure": g.chambers, "joints": g.n_joints * g.axes, "load": 6, "markers": 5}[kind]
    name = f"run_{effect.name}" if effect.name.isidentifier() else ""
    run = source.add(effect.run, "" if "partial" in type(effect.run).__name__ else name)
    constants = tuple(model.names[i] for i in link.indices)
    return _link(effect.name, kind, run, constants, effect.columns, link.state_size(channels))


def _link(name, kind, run, constants=(), columns=(), memory=0) -> str:
    return f"Link({name!r}, {kind!r}, {run}, {constants!r}, {tuple(columns)!r}, {memory})"


def _docstring(twin: Twin, model: Pipeline) -> str:
    needed = _needed(model)
    left = [*of_sensor(twin.effects), *(n for n in ("command_latency_s",) if n in twin.parameters)]
    low, high = twin.pressure_range_kpa
    read = "pressure_kpa" if _knows_air(twin) else "command_kpa"
    tested = [
        f"- version {e['version']}, {e['change']}: {e['heldout']:.4g} {e.get('unit') or ''} off "
        f"on test blocks{', of ' + str(e['recording']) if e.get('recording') else ''}"
        for e in twin.history
        if isinstance(e.get("heldout"), int | float)
    ]
    judged = "Judged on data that it was not fitted to (root mean square):\n"
    paragraphs = [
        f"A pneumatic {twin.device}: pressure in, pose out. Written by `pneutac export`; needs NumPy alone.",
        report(twin).sentence,
        *([judged + "\n".join(tested[-5:])] if tested else []),
        f"It was measured from {low:g} to {high:g} kPa; beyond these it is extrapolated.",
        *report(twin).described(),
        "    from THIS_FILE import finger\n\n"
        f"    f = {_call(model)}\n"
        f"    pose = f.step({_pressure(twin):g}, 0.02)  # command in kPa, step in s\n"
        f"    pose.tip, pose.measured, pose.joints_rad, pose.{read}",
        *([f"Conditions that it needs: {', '.join(needed)}."] if needed else []),
        *([f"Not in this file: {', '.join(left)}."] if left else []),
    ]
    lines = (line for s in paragraphs for line in (*s.split("\n"), ""))
    wrapped = "\n".join(line if line.startswith("    ") else textwrap.fill(line, 100) for line in lines)
    return wrapped.replace('"""', "'''")


def _needed(model: Pipeline) -> list[str]:
    return sorted({c for e in model.effects for c in e.columns if c not in COMPUTED})


def _call(model: Pipeline) -> str:
    plain = {"temperature_c": "23.0", "gravity_x": "1.0"}
    return f"finger({', '.join(f'{c}={plain.get(c, "0.0")}' for c in _needed(model))})"


def _pressure(twin: Twin) -> float:
    low, high = twin.pressure_range_kpa
    return 0.5 * (high if high > 0 else low)


# ---------------------------------------------------------------- MJCF


def write_mjcf(twin: Twin, file: Path) -> None:
    """Writes the body that the world uses, hanging from a fixed flange, with a DIGIT at its tip.

    A motor's control is the angle in rad at which its free joint rests, `joints_rad` of the Python file; of
    an arm the rotation about x, y, z of the link before: 0, -angle towards +z, angle towards +y. Raises
    InputError: the twin is of a gel.
    """
    if twin.device == "gel":
        raise InputError("A gel has no joints; export the twin of a finger or an arm.")
    import mujoco

    from pneutac_sim.world import panda, scene, soft_finger
    from pneutac_sim.world.soft_finger import Pad

    stiffness = twin.parameter("joint_stiffness_nm_per_rad")
    known = twin.parameters.get("joint_damping_nms_per_rad")
    damping = known.value if known else PAPER_FINGER["joint_damping_nms_per_rad"]
    finger, joints = soft_finger.mjcf(twin, motor_gear=stiffness), len(twin.spine_joint_positions_mm)
    height = 0.05 + 1e-3 * (twin.length_mm + 60)
    model = mujoco.MjModel.from_xml_string(f"""
<mujoco model="pneutac_finger">
  <compiler angle="radian"/>
  <option timestep="{1 / scene.PHYSICS_HZ!r}" integrator="implicitfast" iterations="20"/>
  <default>{finger.defaults}</default>
  <asset>{panda.MATERIALS}{finger.materials}</asset>
  <worldbody>
    <light pos=".3 -.5 .8" dir="-.3 .5 -.8"/>
    <body name="flange" pos="0 0 {height}" quat="0 1 0 0">{finger.body}</body>
  </worldbody>
  <actuator>{finger.actuators}</actuator>
  {finger.tendons}
</mujoco>""")
    soft_finger.Springs(model, joints, damping, stiffness).set(stiffness * np.eye(joints))
    Pad(model, twin)
    mujoco.mj_saveLastXML(str(file), model)


# ---------------------------------------------------------------- in every Python file


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
            both = f"The command {pressure_cmd_kpa!r} kPa and the step {dt_s!r} s"
            raise ValueError(f"{both} must be numbers.") from e
        if not np.isfinite(command).all() or command.shape not in ((), (1,), (self._chambers,)):
            remedy = f"give a finite number, or one for each of {self._chambers} chambers"
            raise ValueError(f"The command is {pressure_cmd_kpa} kPa; {remedy}.")
        if not 0 < dt_s < np.inf:
            raise ValueError(f"The step dt_s is {dt_s} s; give a finite number above 0.")
        low, high = self._range
        if not self._warned and ((command < low) | (command > high)).any():
            self._warned = True
            beyond = f"The command {pressure_cmd_kpa} kPa lies beyond {low:g} to {high:g} kPa"
            why = "where it was measured; poses there are extrapolated. Later ones do not warn"
            warnings.warn(f"{beyond}, {why}.", stacklevel=2)
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
