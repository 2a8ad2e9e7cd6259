"""Laws: effects that are not written by hand but composed of an input, a memory, a role and a condition.

A law acts on the pressure that bends a body (stage `drive`) by adding a term to it,

    p -> p + w c g,   g = M[f(p)]  (added)   or   g = p M[f(p)] / P  (a gain),

on where its tip is (stage `material`), or on what is read of it (stage `observation`). f is the input, M the
memory, c the condition, P the largest pressure. All laws are rows of one table, run by one compiled
interpreter; a twin keeps a law as its name and its constants, so a found law is data and nothing that came
with a twin is executed.

The memories and their sources are in `memories`.
"""

import math
from dataclasses import dataclass
from functools import cache

from pneutac_sim.effects import memories as by
from pneutac_sim.effects.body_effect import BodyEffect
from pneutac_sim.effects.effect import Parameter
from pneutac_sim.effects.law_words import WORDS, seen_by

REFERENCE_C = 23.0


@dataclass(frozen=True)
class Row:
    """One law of the table.

    Attributes:
        input: code.
        memory: code.
        role: code.
        minus: 1 where the memory's input is taken off, so that nothing is left in steady state.
        condition: 0 none, 1 a factor, 2 moves a constant.
        columns: condition columns.
        constants: of the memory.
        starts: constants with which a search begins, in units of the parameters' default.
        family: the library's name for such physics.
        equation: LaTeX.
    """

    input: int
    memory: int
    role: int
    minus: float
    condition: int
    columns: tuple[str, ...]
    constants: tuple[Parameter, ...]
    starts: tuple[tuple[float, ...], ...]
    family: str
    equation: str


def _time(default: float = 1.0, lower: float = 0.02, upper: float = 200.0, name: str = "time_s") -> Parameter:
    return Parameter(name, "s", default, lower, upper, log=True)


def _width(
    default: float = 0.1, upper: float = 0.9, name: str = "width_kpa", lower: float = 0.003
) -> Parameter:
    return Parameter(name, "kPa", default, lower, upper, log=True, range_power=1)


_TIMES = ((0.1,), (0.3,), (1.0,), (3.0,), (10.0,), (30.0,), (100.0,))
_BY = Parameter("times_per_10_k", "", 0.4, 0.05, 3.0, neutral=1.0, log=True)
_BY_PRESSURE = Parameter("times_at_full_pressure", "", 0.3, 0.01, 10.0, neutral=1.0, log=True)
_EXPONENT = Parameter("exponent", "", 0.0, -1.1, 1.1, neutral=9.0)
_OMEGA = Parameter("frequency_rad_per_s", "rad/s", 10.0, 0.5, 60.0, log=True)
_ZETA = Parameter("damping_ratio", "", 0.3, 0.02, 2.0, log=True)
_POWER = Parameter("exponent", "", 1.0, 0.2, 5.0, neutral=1.0, log=True)
_MODES = tuple((2 * math.pi * f, z) for f in (0.5, 1.0, 2.0, 4.0) for z in (0.1, 0.5))


@cache
def table() -> dict[str, Row]:
    """Name to law, in the order in which laws act: statics, plays, memories, history, conditions."""
    out: dict[str, Row] = {}

    def put(
        name, memory, constants, starts, family, equation, source=by.P, role=by.ADDED, minus=0.0, **condition
    ):
        kind, columns = condition.get("kind", 0), condition.get("columns", ())
        out[name] = Row(
            source, memory, role, minus, kind, columns, tuple(constants), tuple(starts), family, equation
        )

    one = ((),)
    put("power(p)", by.POWER, [_POWER], ((0.6,), (1.6,)), "stiffening", r"P\,(p/P)^c - p", minus=1.0)
    slope = Parameter("slope", "", 1.0, 0.1, 8.0, neutral=0.0, log=True)
    put("tanh(p)", by.TANH, [slope], ((1.0,), (3.0,)), "gain_saturation", r"P\tanh(c\,p/P)/c - p", minus=1.0)
    bend = _width(0.5, 0.95, "threshold_kpa", 0.05)
    put("hinge(p)", by.HINGE, [bend], ((0.3,), (0.6,)), "contact", r"\max(p - a, 0)")
    put("p^2", by.PLAIN, [], one, "stiffening", r"p^2/P - p", source=by.P_SQUARED)
    put("p^3", by.CUBE, [], one, "stiffening", r"p^3/P^2 - p", minus=1.0)
    put(
        "play(p)",
        by.PLAY,
        [_width()],
        ((0.03,), (0.1,), (0.25,)),
        "hysteresis",
        r"\mathrm{play}_r(p) - p",
        minus=1.0,
    )
    up, down = _width(name="width_up_kpa"), _width(name="width_down_kpa")
    put(
        "dead_band(p)",
        by.DEAD_BAND,
        [_width(0.05)],
        ((0.02,), (0.06,), (0.15,)),
        "dead_band",
        r"\mathrm{band}_r(p) - p",
        minus=1.0,
    )
    put(
        "play_two(p)",
        by.PLAY_TWO,
        [up, down],
        ((0.1, 0.01), (0.01, 0.1)),
        "hysteresis",
        r"\mathrm{play}_{r,l}(p) - p",
        minus=1.0,
    )
    put(
        "play(p)^3",
        by.PLAY_CUBED,
        [_width()],
        ((0.1,),),
        "hysteresis",
        r"\mathrm{play}_r(p)^3/P^2 - p",
        minus=1.0,
    )
    put(
        "loop(p)",
        by.LOOP,
        [_width(lower=0.01)],
        ((0.03,), (0.1,), (0.25,)),
        "hysteresis",
        r"\mathrm{loop}_r(p)",
    )
    put(
        "p play(p)",
        by.PLAY,
        [_width()],
        ((0.1,),),
        "hysteresis",
        r"p\,(\mathrm{play}_r(p) - p)/P",
        role=by.GAIN,
        minus=1.0,
    )
    flip = (_width(0.05), _width(0.5, 1.2, "centre_kpa", 0.02), _width(0.15, 1.0, "slope_kpa", 0.03))
    put(
        "flip(p)",
        by.FLIP,
        flip,
        ((0.05, 0.2, 0.15), (0.05, 0.5, 0.15), (0.05, 0.8, 0.15)),
        "snap",
        r"P\tanh((\mathrm{play}_r(p) - a)/b)",
    )
    put("lag(p)", by.LAG, [_time()], _TIMES, "creep", r"\mathrm{lag}_\tau(p) - p", minus=1.0)
    put("lag(p^2)", by.LAG, [_time()], _TIMES, "creep", r"\mathrm{lag}_\tau(p^2)/P", source=by.P_SQUARED)
    put(
        "power_law_memory(p)",
        by.SPECTRUM,
        [_EXPONENT],
        ((0.0,), (-0.4,), (0.4,)),
        "creep",
        r"\mathrm{springpot}_m(p) - p",
        minus=1.0,
    )
    put(
        "power_law_memory(p^2)",
        by.SPECTRUM,
        [_EXPONENT],
        ((0.0,),),
        "creep",
        r"\mathrm{springpot}_m(p^2)/P",
        source=by.P_SQUARED,
    )
    put(
        "p lag(p)",
        by.LAG,
        [_time()],
        ((1.0,), (10.0,), (60.0,)),
        "creep",
        r"p\,\mathrm{lag}_\tau(p)/P",
        role=by.GAIN,
    )
    put(
        "p lag(p^2)",
        by.LAG,
        [_time()],
        ((1.0,), (10.0,), (60.0,)),
        "creep",
        r"p\,\mathrm{lag}_\tau(p^2)/P^2",
        source=by.P_SQUARED,
        role=by.GAIN,
    )
    put(
        "lag(p; time moves with p)",
        by.LAG_PRESSURE,
        [_time(), _BY_PRESSURE],
        ((3.0, 0.3), (20.0, 0.3)),
        "creep",
        r"\mathrm{lag}_{\tau k^{p/P}}(p) - p",
        minus=1.0,
    )
    fill, vent = _time(0.3, 0.02, 5.0, "fill_time_s"), _time(0.6, 0.02, 5.0, "vent_time_s")
    put(
        "fill_vent(p)",
        by.FILL_VENT,
        [fill, vent],
        ((0.3, 0.6),),
        "valve_lag",
        r"\mathrm{lag}_{\tau_\pm}(p) - p",
        minus=1.0,
    )
    put(
        "mode(p)",
        by.MODE,
        [_OMEGA, _ZETA],
        _MODES,
        "ringing",
        r"\mathrm{mode}_{\omega,\zeta}(p) - p",
        minus=1.0,
    )
    put(
        "held(p)",
        by.HELD,
        [Parameter("rate_1_per_s", "1/s", 0.05, 0.001, 2.0, log=True)],
        ((0.05,),),
        "leak",
        r"-\int k\,p \text{ while held}",
    )
    crossing = _width(0.1, 5.0, "rate_kpa_per_s", 0.005)
    smoothing = _time(0.05, 0.005, 2.0)
    put(
        "tanh(dp/dt)",
        by.TANH_OF,
        [crossing, smoothing],
        ((0.1, 0.05), (0.5, 0.05)),
        "friction",
        r"P\tanh(\mathrm{lag}_\tau(\dot p)/r)",
        source=by.RATE,
    )
    put(
        "p tanh(|dp/dt|)",
        by.TANH_OF,
        [crossing, smoothing],
        ((0.3, 0.05),),
        "rate",
        r"p\tanh(\mathrm{lag}_\tau|\dot p|/r)",
        source=by.SPEED,
        role=by.GAIN,
    )
    put(
        "p root lag(|dp/dt|)",
        by.ROOT_LAG,
        [_time(0.2, 0.02, 3.0)],
        ((0.2,),),
        "rate",
        r"p\sqrt{\mathrm{lag}_\tau|\dot p|/P}",
        source=by.SPEED,
        role=by.GAIN,
    )
    put(
        "p fading_max(p)",
        by.FADING,
        [_time(10.0, 0.2)],
        ((1.0,), (10.0,), (60.0,)),
        "cyclic_softening",
        r"p\,(\max_\tau(p) - p)/P",
        role=by.GAIN,
        minus=1.0,
    )
    put(
        "p below_max(p)",
        by.BELOW,
        [Parameter("exponent", "", 1.5, 0.3, 4.0, log=True)],
        ((1.5,),),
        "cyclic_softening",
        r"p\,(1 - p/p_{max})^c",
        role=by.GAIN,
    )
    put(
        "p path(p)",
        by.PATH,
        [_width(10.0, 200.0, "path_kpa", 0.5)],
        ((10.0,),),
        "cyclic_softening",
        r"p\,n/(n + n_0), \; n = \int |dp|",
        role=by.GAIN,
    )
    put(
        "p lag(|dp/dt|)",
        by.LAG,
        [_time(90.0, 3.0, 200.0)],
        ((30.0,), (90.0,)),
        "self_heating",
        r"p\,\mathrm{lag}_\tau|\dot p|/P",
        source=by.SPEED,
        role=by.GAIN,
    )
    put(
        "p lag(p |dp/dt|)",
        by.LAG,
        [_time(90.0, 3.0, 200.0)],
        ((30.0,), (90.0,)),
        "self_heating",
        r"p\,\mathrm{lag}_\tau(p|\dot p|)/P^2",
        source=by.WORK,
        role=by.GAIN,
    )
    put(
        "p exp(-t)",
        by.FADING_TIME,
        [_time(100.0, 10.0, 2000.0)],
        ((60.0,), (200.0,)),
        "warm_up",
        r"p\,e^{-t/\tau}",
        role=by.GAIN,
        kind=2,
        columns=("session_time_s",),
    )
    put(
        "p lag(dT)",
        by.LAG,
        [_time(60.0, 3.0, 1000.0)],
        ((20.0,), (100.0,), (400.0,)),
        "thermal",
        r"p\,\mathrm{lag}_\tau(\Delta T)",
        source=by.CONDITION,
        role=by.GAIN,
        kind=2,
        columns=("temperature_c",),
    )
    warm = {"kind": 1, "columns": ("temperature_c",)}
    put("p dT", by.PLAIN, [], one, "thermal", r"p\,\Delta T", **warm)
    put(
        "lag(p) dT",
        by.LAG,
        [_time()],
        ((1.0,), (10.0,), (60.0,)),
        "thermal",
        r"(\mathrm{lag}_\tau(p) - p)\,\Delta T",
        minus=1.0,
        **warm,
    )
    put(
        "lag(p; time moves with dT)",
        by.LAG_WARM,
        [_time(), _BY],
        ((1.0, 0.37), (10.0, 0.37), (50.0, 0.37)),
        "creep",
        r"\mathrm{lag}_{\tau k^{\Delta T}}(p) - p",
        minus=1.0,
        kind=2,
        columns=("temperature_c",),
    )
    return out


# output and feature: code of the output, code of the feature, columns
_SEEN = {
    **{f"tip_{a} += {f}": (i, j, ()) for i, a in enumerate("xyz") for j, f in enumerate(("z^2", "x z"))},
    **{f"tip_{a} += dT": (i, 2, ("temperature_c",)) for i, a in enumerate("xyz")},
    "tip_y += g_y": (1, 2, ("gravity_y",)),
    "bend += bend^2": (3, 3, ()),
    "bend += dT": (3, 2, ("temperature_c",)),
}
TRACKER = "tracker_lag"
# zero and unit in which a condition is counted
_COUNTED = {
    (): (0.0, 1.0),
    ("temperature_c",): (REFERENCE_C, 10.0),
    ("session_time_s",): (0.0, 1.0),
    ("gravity_y",): (0.0, 1.0),
}


def law_names() -> list[str]:
    """All laws, in the order in which they act."""
    return [*table(), *_SEEN, TRACKER]


def is_law(name: str) -> bool:
    """Whether a name is that of a law, `lag(p)` or its second instance `lag(p) #2`."""
    structure, mark, number = name.partition(" #")
    known = structure in table() or structure in _SEEN or structure == TRACKER
    return known and (not mark or number.isdigit())


@cache
def law(name: str) -> BodyEffect:
    """The effect that a law's name says; the same structure may act twice, the second as `lag(p) #2`.

    Raises:
        KeyError: the table has no such law.
    """
    structure = name.partition(" #")[0]
    if structure == TRACKER:
        return BodyEffect(
            name=name,
            stage="observation",
            run=by.run_tracker,
            parameters=(_time(0.1, 0.005, 2.0),),
            state_size=lambda channels: 2 * channels,
            equation=r"\tau\,\dot y = x - y",
            summary="What tracks your {device} lags by {time_s:.2g} s.",
            experiment="Watch a thing that is moved by hand with the tracker and with a ruler's shutter.",
        )
    if structure in _SEEN:
        out, feature, columns = _SEEN[structure]
        weight = Parameter("weight", "", 0.01, -1.0, 1.0)
        of_tip = structure.startswith("tip")
        return BodyEffect(
            name=name,
            stage="material" if of_tip else "observation",
            signal="markers",
            run=by.run_seen,
            parameters=(weight,),
            codes=(float(out), float(feature), *_COUNTED[columns]),
            columns=("length_mm", *columns),
            equation=structure.replace("+=", r"\mathrel{+}="),
            summary=f"The {'tip' if of_tip else 'bend'} of your {{device}} is off: "
            + structure.replace("+=", "gains {weight:.2g} times")
            + ".",
            experiment="Look at the same motion with a second camera.",
        )
    row = table()[structure]
    weight = Parameter("weight", "", 0.05, -3.0, 3.0)
    scale = Parameter("scale_kpa", "kPa", 1.0, 1e-3, 3.0, neutral=1.0, fixed=True, range_power=1)
    constants = ", ".join(f"{p.name} {{{p.name}:.3g}}" for p in row.constants)
    return BodyEffect(
        name=name,
        stage="drive",
        run=by.run_drive,
        parameters=(weight, scale, *row.constants),
        codes=(
            *map(float, (row.input, row.memory, row.role, row.minus, row.condition)),
            *_COUNTED[row.columns],
        ),
        columns=row.columns,
        state_size=lambda channels: by.SLOTS * channels,
        apart=True,
        linear="weight",
        equation=rf"p \to p + w\,({row.equation})",
        summary=f"Your {{device}} {WORDS[row.family]}: the pressure p that bends it becomes "
        f"p + {{weight:.3g}} [{structure}]" + (f", {constants}." if constants else "."),
        experiment=seen_by(row.input, row.memory, row.role),
    )


def family(name: str) -> str:
    """What the library calls the physics of a law; the name itself where it has no name for it."""
    structure = name.partition(" #")[0]
    if structure in table():
        return table()[structure].family
    if structure == "tip_y += g_y":
        return "gravity"
    return "tracker" if structure in _SEEN or structure == TRACKER else name


def starts(name: str) -> tuple[tuple[float, ...], ...]:
    """Constants with which a search begins, in units of the parameters' own scale."""
    structure = name.partition(" #")[0]
    return table()[structure].starts if structure in table() else ((),)
