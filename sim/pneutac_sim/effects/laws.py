"""Laws: effects that are not written by hand but composed of an input, a memory, a role and a condition.

A law acts on the pressure that bends a body (stage `drive`) by adding a term to it,

    p -> p + w c g,   g = M[f(p)]  (added)   or   g = p M[f(p)] / P  (a gain),

on where its tip is (stage `material`), or on what is read of it (stage `observation`). f is the input, M the
memory, c the condition, P the largest pressure. All laws are rows of one `TABLE`, run by one compiled
interpreter; a twin keeps a law as its name and its constants, so a found law is data and nothing that came
with a twin is executed.

The memories and their sources are in `memories`.
"""

import math
from functools import cache

from pneutac_sim.effects import memories as by
from pneutac_sim.effects.body_effect import BodyEffect
from pneutac_sim.effects.effect import Parameter
from pneutac_sim.effects.law_table import TABLE
from pneutac_sim.effects.law_words import CAUSES, CONSTANTS, WORDS, seen_by

REFERENCE_C = 23.0


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
    return [*TABLE, *_SEEN, TRACKER]


def is_law(name: str) -> bool:
    """Whether a name is that of a law, `lag(p)` or its second instance `lag(p) #2`."""
    structure, mark, number = name.partition(" #")
    known = structure in TABLE or structure in _SEEN or structure == TRACKER
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
            parameters=(Parameter("time_s", "s", 0.1, 0.005, 2.0, log=True),),
            state_size=lambda channels: 2 * channels,
            equation=r"\tau\,\dot y = x - y",
            cause="a slow tracker, time constant {time_s:.2g} s",
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
            cause="a sag to the side"
            if "g_y" in structure
            else f"an error of the measured {'tip' if of_tip else 'bend'}",
            summary=f"The {'tip' if of_tip else 'bend'} of your {{device}} is off: "
            + structure.replace("+=", "gains {weight:.2g} times")
            + ".",
            experiment="Look at the same motion with a second camera.",
        )
    row = TABLE[structure]
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
        cause=", ".join(
            [
                "creep over many time scales" if row.memory == by.SPECTRUM else CAUSES[row.family],
                *(CONSTANTS[p.name] for p in row.constants if p.name in CONSTANTS),
            ]
        ),
        summary=f"Your {{device}} {WORDS[row.family]}: the pressure p that bends it becomes "
        f"p + {{weight:.3g}} [{structure}]" + (f", {constants}." if constants else "."),
        experiment=seen_by(row.input, row.memory, row.role),
        derive=_hz,
    )


def _hz(values: dict[str, float]) -> dict[str, float]:
    """A frequency in Hz, of a law that has one."""
    w = values.get("frequency_rad_per_s")
    return {} if w is None else {"hz": w / (2 * math.pi)}


def family(name: str) -> str:
    """What the library calls the physics of a law; the name itself where it has no name for it."""
    structure = name.partition(" #")[0]
    if structure in TABLE:
        return TABLE[structure].family
    if structure == "tip_y += g_y":
        return "gravity"
    return "tracker" if structure in _SEEN or structure == TRACKER else name


def starts(name: str) -> tuple[tuple[float, ...], ...]:
    """Constants with which a search begins, in units of the parameters' own scale."""
    structure = name.partition(" #")[0]
    return TABLE[structure].starts if structure in TABLE else ((),)
