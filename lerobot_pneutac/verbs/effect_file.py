"""Python files of effects: the library's own as they are, of a law its entry and the source that it runs."""

import importlib
import inspect
import re
from dataclasses import MISSING, fields
from functools import partial

from lerobot_pneutac.verbs.source import Source
from pneutac_sim.effects import laws
from pneutac_sim.effects.body_effect import BodyEffect
from pneutac_sim.effects.effect import Effect, Parameter
from pneutac_sim.effects.registry import BUILTIN, get_effect
from pneutac_sim.errors import InputError

PROJECT = """
Entry point, in the pyproject.toml of your package:

    [project.entry-points."pneutac.effects"]
    {name} = "{name}:EFFECT"
"""


def file_name(name: str) -> str:
    """A law's or effect's name as one of Python: `lag(p^2)` is `lag_p_2`, `creep` is `my_creep`."""
    plain = re.sub(r"\W+", "_", name).strip("_").lower()
    return f"my_{name}" if plain == name else plain


def effect_source(name: str) -> str:
    """A stand-alone Python file of an effect or a law, to change and to install as one of your own.

    Raises:
        InputError: there is no such effect, or it comes from another package.
    """
    get_effect(name)
    if laws.is_law(name):
        return _law_source(laws.law(name))
    if name not in BUILTIN:
        raise InputError(f"'{name}' comes from another package; copy its file there.")
    text = inspect.getsource(importlib.import_module(f"pneutac_sim.effects.{name}"))
    own = file_name(name)
    head, _, rest = text.removeprefix('"""').partition('"""')
    return f'"""{head.rstrip()}\n{PROJECT.format(name=own)}"""' + rest.replace(
        f'name="{name}"', f'name="{own}"', 1
    )


def _law_source(effect: BodyEffect) -> str:
    """The row of the catalogue, and the source of what it runs."""
    run = effect.run if isinstance(effect.run, partial) else partial(effect.run)
    source = Source()
    expression = source.add(run)
    body = source.functions
    own = file_name(effect.name)
    head = f'"""{effect.name}: a law, as it acts in a twin.\n\n{effect.equation}\n'
    head += f'{PROJECT.format(name=own)}"""\n'
    step = effect.state_size(2) - effect.state_size(1)
    return "\n".join(
        [
            head.replace("\\", "\\\\"),
            "import math", "from functools import partial", "", "import numpy as np",
            *(["from numba import njit"] if "@njit" in body else []), "",
            "from pneutac_sim.effects import BodyEffect, Parameter, kernel", "",
            *source.lines(), "", "", body, "", "", "EFFECT = BodyEffect(",
            f"    name={own!r},", f"    stage={effect.stage!r},", f"    signal={effect.signal!r},",
            f"    run={expression},",
            "    parameters=(", *(f"        {_parameter(p)}," for p in effect.parameters), "    ),",
            f"    columns={effect.columns!r},", f"    state_size=lambda channels: {step} * channels,",
            f"    equation={effect.equation!r},", f"    summary={effect.summary!r},",
            f"    experiment={effect.experiment!r},", ")", "",
        ]
    )  # fmt: skip


def _parameter(p: Parameter) -> str:
    arguments = [f"{p.name!r}, {p.unit!r}, {p.default!r}, {p.lower!r}, {p.upper!r}"]
    plain = {f.name: f.default for f in fields(Parameter)}
    arguments += [f"{k}={v!r}" for k, v in vars(p).items() if plain[k] is not MISSING and v != plain[k]]
    return f"Parameter({', '.join(arguments)})"


def units(effect: Effect) -> list[dict[str, str]]:
    """Parameters with units and bounds, as rows; pressures in shares of the recording's largest, P."""
    rows = []
    for p in effect.parameters:
        share = {0: "", 1: " P"}.get(p.range_power, f" P^{p.range_power}")
        rows.append(
            {
                "parameter": p.name, "unit": p.unit or "(a ratio)",
                "start of a fit": f"{p.default:.4g}{share}",
                "bounds": f"{p.lower:.4g}{share} to {p.upper:.4g}{share}",
                "does nothing at": f"{p.neutral:.4g}", "": "held" if p.fixed else "",
            }
        )  # fmt: skip
    return rows
