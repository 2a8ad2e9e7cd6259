"""The table of laws that act on the pressure that bends a body, see `laws`."""

import math
from dataclasses import dataclass

from pneutac_sim.effects import memories as by
from pneutac_sim.effects.effect import Parameter


@dataclass(frozen=True)
class Row:
    """One law of the table.

    Attributes:
        memory: code.
        constants: of the memory.
        starts: constants with which a search begins, in units of the parameters' default.
        family: the library's name for such physics.
        equation: LaTeX.
        input: code.
        role: code.
        minus: 1 where the memory's input is taken off, so that nothing is left in steady state.
        condition: 0 none, 1 a factor, 2 moves a constant.
        columns: condition columns.
    """

    memory: int
    constants: tuple[Parameter, ...]
    starts: tuple[tuple[float, ...], ...]
    family: str
    equation: str
    input: int = by.P
    role: int = by.ADDED
    minus: float = 0.0
    condition: int = 0
    columns: tuple[str, ...] = ()


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
_SLOPE = Parameter("slope", "", 1.0, 0.1, 8.0, neutral=0.0, log=True)
_BEND = _width(0.5, 0.95, "threshold_kpa", 0.05)
_FLIP = (_width(0.05), _width(0.5, 1.2, "centre_kpa", 0.02), _width(0.15, 1.0, "slope_kpa", 0.03))
_FILL, _VENT = _time(0.3, 0.02, 5.0, "fill_time_s"), _time(0.6, 0.02, 5.0, "vent_time_s")
_CROSSING, _SMOOTHING = _width(0.1, 5.0, "rate_kpa_per_s", 0.005), _time(0.05, 0.005, 2.0)
_MODES = tuple((2 * math.pi * f, z) for f in (0.5, 1.0, 2.0, 4.0) for z in (0.1, 0.5))

# Name to law, in the order in which laws act: statics, plays, memories, history, conditions.
TABLE = {
    "power(p)": Row(by.POWER, (_POWER,), ((0.6,), (1.6,)), "stiffening", r"P\,(p/P)^c - p", minus=1.0),
    "tanh(p)": Row(
        by.TANH, (_SLOPE,), ((1.0,), (3.0,)), "gain_saturation", r"P\tanh(c\,p/P)/c - p", minus=1.0
    ),
    "hinge(p)": Row(by.HINGE, (_BEND,), ((0.3,), (0.6,)), "contact", r"\max(p - a, 0)"),
    "p^2": Row(by.PLAIN, (), ((),), "stiffening", r"p^2/P - p", input=by.P_SQUARED),
    "p^3": Row(by.CUBE, (), ((),), "stiffening", r"p^3/P^2 - p", minus=1.0),
    "step(p)": Row(
        by.STEP, _FLIP[1:], ((0.2, 0.15), (0.5, 0.15), (0.8, 0.15)), "stiffening", r"P\tanh((p - a)/b)"
    ),
    "play(p)": Row(
        by.PLAY, (_width(),), ((0.03,), (0.1,), (0.25,)), "hysteresis", r"\mathrm{play}_r(p) - p", minus=1.0
    ),
    "dead_band(p)": Row(
        by.DEAD_BAND,
        (_width(0.05),),
        ((0.02,), (0.06,), (0.15,)),
        "dead_band",
        r"\mathrm{band}_r(p) - p",
        minus=1.0,
    ),
    "play_two(p)": Row(
        by.PLAY_TWO,
        (_width(name="width_up_kpa"), _width(name="width_down_kpa")),
        ((0.1, 0.01), (0.01, 0.1)),
        "hysteresis",
        r"\mathrm{play}_{r,l}(p) - p",
        minus=1.0,
    ),
    "play(p)^3": Row(
        by.PLAY_CUBED, (_width(),), ((0.1,),), "hysteresis", r"\mathrm{play}_r(p)^3/P^2 - p", minus=1.0
    ),
    "loop(p)": Row(
        by.LOOP, (_width(lower=0.01),), ((0.03,), (0.1,), (0.25,)), "hysteresis", r"\mathrm{loop}_r(p)"
    ),
    "p play(p)": Row(
        by.PLAY,
        (_width(),),
        ((0.1,),),
        "hysteresis",
        r"p\,(\mathrm{play}_r(p) - p)/P",
        role=by.GAIN,
        minus=1.0,
    ),
    "flip(p)": Row(
        by.FLIP,
        _FLIP,
        ((0.05, 0.2, 0.15), (0.05, 0.5, 0.15), (0.05, 0.8, 0.15)),
        "snap",
        r"P\tanh((\mathrm{play}_r(p) - a)/b)",
    ),
    "lag(p)": Row(by.LAG, (_time(),), _TIMES, "creep", r"\mathrm{lag}_\tau(p) - p", minus=1.0),
    "lag(p^2)": Row(by.LAG, (_time(),), _TIMES, "creep", r"\mathrm{lag}_\tau(p^2)/P", input=by.P_SQUARED),
    "power_law_memory(p)": Row(
        by.SPECTRUM,
        (_EXPONENT,),
        ((0.0,), (-0.4,), (0.4,)),
        "creep",
        r"\mathrm{springpot}_m(p) - p",
        minus=1.0,
    ),
    "power_law_memory(p^2)": Row(
        by.SPECTRUM, (_EXPONENT,), ((0.0,),), "creep", r"\mathrm{springpot}_m(p^2)/P", input=by.P_SQUARED
    ),
    "p lag(p)": Row(
        by.LAG, (_time(),), ((1.0,), (10.0,), (60.0,)), "creep", r"p\,\mathrm{lag}_\tau(p)/P", role=by.GAIN
    ),
    "p lag(p^2)": Row(
        by.LAG,
        (_time(),),
        ((1.0,), (10.0,), (60.0,)),
        "creep",
        r"p\,\mathrm{lag}_\tau(p^2)/P^2",
        input=by.P_SQUARED,
        role=by.GAIN,
    ),
    "lag(p; time moves with p)": Row(
        by.LAG_PRESSURE,
        (_time(), _BY_PRESSURE),
        ((3.0, 0.3), (20.0, 0.3)),
        "creep",
        r"\mathrm{lag}_{\tau k^{p/P}}(p) - p",
        minus=1.0,
    ),
    "fill_vent(p)": Row(
        by.FILL_VENT, (_FILL, _VENT), ((0.3, 0.6),), "valve_lag", r"\mathrm{lag}_{\tau_\pm}(p) - p", minus=1.0
    ),
    "mode(p)": Row(
        by.MODE, (_OMEGA, _ZETA), _MODES, "ringing", r"\mathrm{mode}_{\omega,\zeta}(p) - p", minus=1.0
    ),
    "held(p)": Row(
        by.HELD,
        (Parameter("rate_1_per_s", "1/s", 0.05, 0.001, 2.0, log=True),),
        ((0.05,),),
        "leak",
        r"-\int k\,p \text{ while held}",
    ),
    "tanh(dp/dt)": Row(
        by.TANH_OF,
        (_CROSSING, _SMOOTHING),
        ((0.1, 0.05), (0.5, 0.05)),
        "friction",
        r"P\tanh(\mathrm{lag}_\tau(\dot p)/r)",
        input=by.RATE,
    ),
    "p tanh(|dp/dt|)": Row(
        by.TANH_OF,
        (_CROSSING, _SMOOTHING),
        ((0.3, 0.05),),
        "rate",
        r"p\tanh(\mathrm{lag}_\tau|\dot p|/r)",
        input=by.SPEED,
        role=by.GAIN,
    ),
    "p root lag(|dp/dt|)": Row(
        by.ROOT_LAG,
        (_time(0.2, 0.02, 3.0),),
        ((0.2,),),
        "rate",
        r"p\sqrt{\mathrm{lag}_\tau|\dot p|/P}",
        input=by.SPEED,
        role=by.GAIN,
    ),
    "p fading_max(p)": Row(
        by.FADING,
        (_time(10.0, 0.2),),
        ((1.0,), (10.0,), (60.0,)),
        "cyclic_softening",
        r"p\,(\max_\tau(p) - p)/P",
        role=by.GAIN,
        minus=1.0,
    ),
    "p below_max(p)": Row(
        by.BELOW,
        (Parameter("exponent", "", 1.5, 0.3, 4.0, log=True),),
        ((1.5,),),
        "cyclic_softening",
        r"p\,(1 - p/p_{max})^c",
        role=by.GAIN,
    ),
    "p path(p)": Row(
        by.PATH,
        (_width(10.0, 200.0, "path_kpa", 0.5),),
        ((10.0,),),
        "cyclic_softening",
        r"p\,n/(n + n_0), \; n = \int |dp|",
        role=by.GAIN,
    ),
    "p lag(|dp/dt|)": Row(
        by.LAG,
        (_time(90.0, 3.0, 200.0),),
        ((30.0,), (90.0,)),
        "self_heating",
        r"p\,\mathrm{lag}_\tau|\dot p|/P",
        input=by.SPEED,
        role=by.GAIN,
    ),
    "p lag(p |dp/dt|)": Row(
        by.LAG,
        (_time(90.0, 3.0, 200.0),),
        ((30.0,), (90.0,)),
        "self_heating",
        r"p\,\mathrm{lag}_\tau(p|\dot p|)/P^2",
        input=by.WORK,
        role=by.GAIN,
    ),
    "p exp(-t)": Row(
        by.FADING_TIME,
        (_time(100.0, 10.0, 2000.0),),
        ((60.0,), (200.0,)),
        "warm_up",
        r"p\,e^{-t/\tau}",
        role=by.GAIN,
        condition=2,
        columns=("session_time_s",),
    ),
    "p lag(dT)": Row(
        by.LAG,
        (_time(60.0, 3.0, 1000.0),),
        ((20.0,), (100.0,), (400.0,)),
        "thermal",
        r"p\,\mathrm{lag}_\tau(\Delta T)",
        input=by.CONDITION,
        role=by.GAIN,
        condition=2,
        columns=("temperature_c",),
    ),
    "p dT": Row(by.PLAIN, (), ((),), "thermal", r"p\,\Delta T", condition=1, columns=("temperature_c",)),
    "lag(p) dT": Row(
        by.LAG,
        (_time(),),
        ((1.0,), (10.0,), (60.0,)),
        "thermal",
        r"(\mathrm{lag}_\tau(p) - p)\,\Delta T",
        minus=1.0,
        condition=1,
        columns=("temperature_c",),
    ),
    "lag(p; time moves with dT)": Row(
        by.LAG_WARM,
        (_time(), _BY),
        ((1.0, 0.37), (10.0, 0.37), (50.0, 0.37)),
        "creep",
        r"\mathrm{lag}_{\tau k^{\Delta T}}(p) - p",
        minus=1.0,
        condition=2,
        columns=("temperature_c",),
    ),
}
