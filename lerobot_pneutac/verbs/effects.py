"""The effects and laws that a twin may have: sentence, equation and curves of each, and their files."""

import importlib
import inspect
import re
from dataclasses import MISSING, dataclass, fields
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd
from rich.table import Table

from lerobot_pneutac.cli.options import check_folder, check_report, parse_options
from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.reports.page import AFTER, BEFORE, COMMAND, MEASURED, Report
from lerobot_pneutac.verbs.export import Source
from lerobot_pneutac.verbs.result import Result
from pneutac_sim.effects.body_effect import BodyEffect
from pneutac_sim.effects.effect import Effect, Parameter, plain_equation
from pneutac_sim.effects.laws import FAMILIES, family, is_law, law, law_names, terms_of
from pneutac_sim.effects.registry import BUILTIN, all_effects, get_effect, of_sensor
from pneutac_sim.errors import InputError, refuse_given
from pneutac_sim.files import check_new_file, write_text
from pneutac_sim.twin import Twin, Value

TIP = ["tip_x_mm", "tip_y_mm", "tip_z_mm"]
TOP_KPA = 12.0


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ShownEffect(Result):
    """One effect or law."""

    heading = "{0.effect.name} ({0.effect.stage})"

    effect: Effect

    keys = (
        ("name", "effect.name"), ("stage", "effect.stage"), "sentence", ("latex", "effect.equation"),
        ("experiment", "effect.experiment"),
    )  # fmt: skip

    @property
    def sentence(self) -> str:
        values = {p.name: p.limits(TOP_KPA)[0] for p in self.effect.parameters}
        return self.effect.describe_any(values, "gel" if of_sensor([self.effect.name]) else "finger")

    def rows(self) -> list[dict]:
        return units(self.effect)

    def remarks(self) -> list[str]:
        e = self.effect
        out = [f"equation: {plain_equation(e.equation)}", f"LaTeX: {e.equation}"] if e.equation else []
        out += [f"where {line}" for line in terms_of(e.equation)] if is_law(e.name) else []
        out += [f"family: {family(e.name)}"] if is_law(e.name) else []
        columns = getattr(e, "columns", ())
        out += [f"needs on record: {', '.join(columns)}"] if columns else []
        return [*out, f"seen by: {e.experiment}"]

    def content(self) -> dict:
        e = self.effect
        out = {"family": family(e.name), "equation": plain_equation(e.equation), "parameters": self.rows()}
        return super().content() | out | {"columns": getattr(e, "columns", ())}

    def page(self) -> Report:
        page = super().page()
        if isinstance(self.effect, BodyEffect):
            page.heading("What it does")
            shown = "The built-in finger without it and with it, at the above start of a fit."
            page.figure(_figure(self.effect.name), shown)
        return page


def show_effect(name: str) -> ShownEffect:
    """One effect or law by its name; raises InputError where there is none."""
    return ShownEffect(effect=get_effect(name))


def list_effects() -> list[dict]:
    """All effects and laws: name, stage, family and equation."""
    return [
        {"name": e.name, "stage": e.stage, "family": family(e.name), "equation": plain_equation(e.equation)}
        for e in [*all_effects().values(), *map(get_effect, law_names())]
    ]


class Program:
    """A bench recording of stairs, a hold, triangles and random steps, without measurements."""

    device = "finger"

    def __init__(self, hz: float = 20.0):
        t = np.arange(0, 60, 1 / hz)
        steps = np.array([0.0, 4, 8, 12, 12, 12, 6, 0])[np.minimum(t // 4, 7).astype(int)]
        triangles = TOP_KPA * np.abs((t - 32) / 7 % 2 - np.round((t - 32) / 7 % 2 / 2) * 2)
        columns = {"trial": 0, "time_s": t, "pressure_cmd_kpa": np.where(t < 32, steps, triangles)}
        columns |= {"gravity_x": np.cos(t / 60 * np.pi / 2), "gravity_y": 0.0}
        columns |= {"gravity_z": -np.sin(t / 60 * np.pi / 2), "temperature_c": 20 + t / 6}
        columns |= {"payload_g": 50.0, "neighbour_kpa": np.where(t < 30, 0.0, 8.0)}
        self.samples = pd.DataFrame(columns | dict.fromkeys(TIP, 0.0))


def tips(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Steps and ramps of the built-in finger without and with one effect at its start of a fit.

    Returns time (n,) s, command (n,) kPa, and the tip without and with it (n, 3) mm.
    """
    from pneutac_sim.finger import simulate

    effect, twin, program = get_effect(name), Twin.builtin(), Program()
    twin.effects = {name: {p.name: Value(p.limits(TOP_KPA)[0]) for p in effect.parameters}}
    with_it, without = simulate(twin, program), simulate(twin, program, effects=[])
    rows = [with_it.data.columns.index(c) for c in TIP]
    time, command = (program.samples[c].to_numpy() for c in ("time_s", "pressure_cmd_kpa"))
    return time, command, without.model[:, rows], with_it.model[:, rows]


def _figure(name: str):
    from lerobot_pneutac.reports.figures import stacked  # plotly

    t, command, without, with_it = tips(name)
    difference = np.linalg.norm(with_it - without, axis=1)
    lines = (
        (1, "deflection without", t, without[:, 2].round(4), {"color": BEFORE}),
        (1, "deflection with it", t, with_it[:, 2].round(4), {"color": AFTER}),
        (1, "difference", t, difference.round(4), {"color": MEASURED}),
        (2, "command", t, command.round(4), {"color": COMMAND}),
    )
    return stacked(("tip, mm", "kPa"), (0.75, 0.25), lines=lines)


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
    """A stand-alone Python file of one of our effects or laws, to change and install as one of your own."""
    get_effect(name)
    if is_law(name):
        return _law_source(law(name))
    if name not in BUILTIN:
        raise InputError(f"'{name}' comes from another package; copy its file there.")
    text = inspect.getsource(importlib.import_module(f"pneutac_sim.effects.{name}"))
    own = file_name(name)
    head, _, rest = text.removeprefix('"""').partition('"""')
    return f'"""{head.rstrip()}\n{PROJECT.format(name=own)}"""' + rest.replace(
        f'name="{name}"', f'name="{own}"', 1
    )


def _law_source(effect: BodyEffect) -> str:
    run = effect.run if isinstance(effect.run, partial) else partial(effect.run)
    source = Source()
    expression = source.add(run)
    body = source.functions
    own = file_name(effect.name)
    summary = effect.summary.replace("{does}", FAMILIES.get(family(effect.name), ("",))[0])
    head = f'"""{effect.name}: a law, as it acts in a twin.\n\n{effect.equation}\n'
    head += f'{PROJECT.format(name=own)}"""\n'
    step, defaults = (
        effect.state_size(2) - effect.state_size(1),
        {f.name: f.default for f in fields(Parameter)},
    )
    parameters = []
    for p in effect.parameters:
        arguments = [f"{p.name!r}, {p.unit!r}, {p.default!r}, {p.lower!r}, {p.upper!r}"]
        named = ((k, v) for k, v in vars(p).items() if defaults[k] is not MISSING and v != defaults[k])
        arguments += [f"{k}={v!r}" for k, v in named]
        parameters.append(f"        Parameter({', '.join(arguments)}),")
    return "\n".join(
        [
            head.replace("\\", "\\\\"),
            "import math", f"from functools import {'cache, ' * ('@cache' in body)}partial", "",
            "import numpy as np",
            *(["from numba import njit"] if "@njit" in body else []), "",
            "from pneutac_sim.effects import BodyEffect, Parameter, kernel", "",
            *source.lines(), "", "", body, "", "", "EFFECT = BodyEffect(",
            f"    name={own!r},", f"    stage={effect.stage!r},", f"    signal={effect.signal!r},",
            f"    run={expression},",
            "    parameters=(", *parameters, "    ),",
            f"    columns={effect.columns!r},", f"    state_size=lambda channels: {step} * channels,",
            f"    equation={effect.equation!r},", f"    summary={summary!r},",
            f"    experiment={effect.experiment!r},", ")", "",
        ]
    )  # fmt: skip


def units(effect: Effect) -> list[dict[str, str]]:
    """Parameters with units and bounds, as rows; pressures in shares of the recording's largest, P."""
    rows = []
    for p in effect.parameters:
        share = {0: "", 1: " P"}.get(p.range_power, f" P^{p.range_power}")
        start, low, high = (f"{x:.4g}{share}" for x in (p.default, p.lower, p.upper))
        row = {"parameter": p.name, "unit": p.unit or "(a ratio)", "start of a fit": start}
        inside = bool(p.range_power) or p.lower <= p.neutral <= p.upper
        row |= {"bounds": f"{low} to {high}", "does nothing at": f"{p.neutral:.4g}" * inside}
        rows.append(row | {"": "held" if p.fixed else ""})
    return rows


ACTIONS = "list, show NAME, export NAME --out=FILE"


@dataclass
class EffectsConfig:
    """Options of `pneutac effects`."""

    names_a_file: ClassVar[bool] = True

    # folder for `result.json` and `report.html` (of `show`), or the Python file to write (of `export`; if
    # omitted, the effect's name here)
    out: Path | None = None


def command(argv: list[str], terminal: Terminal) -> None:
    action = argv[0] if argv else ""
    if action in ("-h", "--help"):
        print(f"usage: pneutac effects ACTION\n\nACTION is {ACTIONS}.\n")
        parse_options(EffectsConfig, argv, "What a twin may have, and files to begin with.")
    if action not in ("list", "show", "export"):
        raise InputError(f"'{action}' is no action of effects; give one of {ACTIONS}.")
    names = [] if action == "list" else argv[1:2]
    if action != "list" and (not names or names[0].startswith("--")):
        raise InputError(f"Name the effect: pneutac effects {action} NAME; `pneutac effects list` has all.")
    cfg = parse_options(EffectsConfig, argv[1 + len(names) :])
    if action == "list":
        refuse_given(cfg, ("out",), "is of `show` and `export`, and `list` writes nothing")
        table = Table("name", "stage", "family", "equation")
        for row in list_effects():
            table.add_row(*row.values())
        terminal.console.print(table)
    elif action == "show":
        if cfg.out is not None:
            check_folder("out", cfg.out)
            check_report(cfg.out, cfg, argv)
        terminal.finish(show_effect(names[0]), cfg.out)
    else:
        text, out = effect_source(names[0]), cfg.out or Path(f"{file_name(names[0])}.py")
        if out.suffix != ".py":
            raise InputError(f"--out={out} must name a new file that ends in .py.")
        check_new_file(out, f"--out={out}")
        write_text(out, text)
        terminal.say(f"effect: {out}; its first lines explain how a package offers it")
