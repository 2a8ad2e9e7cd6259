"""Python files of effects: of the library's own as they are, of laws without other laws' branches."""

import ast
import importlib
import inspect
import re
from dataclasses import MISSING, fields

from pneutac_sim.effects import laws, memories
from pneutac_sim.effects.body_effect import BodyEffect
from pneutac_sim.effects.effect import Effect, Parameter
from pneutac_sim.effects.registry import BUILTIN, get_effect
from pneutac_sim.errors import InputError

CODES = (
    "source",
    "kind",
    "role",
    "condition",
    "out",
    "feature",
)  # arguments of the interpreter that a law fixes
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
    run = effect.run.py_func
    known = _codes(effect)
    functions = _needed(run, known)
    body = "\n\n\n".join(f"@kernel\n{ast.unparse(f)}" for f in functions)
    constants = [f"{n} = {_value(n)}" for n in ("SLOTS", "TIMES_S") if re.search(rf"\b{n}\b", body)]
    imports = ["import math", ""] if "math." in body else []
    imports += ["import numpy as np", ""] if re.search(r"\bnp\.|TIMES_S", body) else []
    imports += ["from pneutac_sim.effects import BodyEffect, Parameter, kernel", ""]
    own = file_name(effect.name)
    head = f'"""{effect.name}: {{}}\n\n{effect.equation}\n{PROJECT.format(name=own)}"""\n'
    head = head.replace("{}", "a law, as it acts in a twin.").replace("\\", "\\\\")
    size = effect.state_size(1), effect.state_size(2)
    step = size[1] - size[0]
    return "\n".join(
        [
            head, *imports, *constants, "", "", body, "", "", "EFFECT = BodyEffect(",
            f"    name={own!r},", f"    stage={effect.stage!r},", f"    signal={effect.signal!r},",
            f"    run={functions[-1].name},",
            "    parameters=(", *(f"        {_parameter(p)}," for p in effect.parameters), "    ),",
            f"    codes={effect.codes!r},", f"    columns={effect.columns!r},",
            f"    state_size=lambda channels: {step} * channels,",
            f"    equation={effect.equation!r},", f"    summary={effect.summary!r},",
            f"    experiment={effect.experiment!r},", ")", "",
        ]
    )  # fmt: skip


def _codes(effect: BodyEffect) -> dict[str, int]:
    """What the interpreter's codes are for one law."""
    if effect.run is memories.run_drive:
        source, kind, role, _, condition = map(int, effect.codes[:5])
        return {"source": source, "kind": kind, "role": role, "condition": condition}
    if effect.run is memories.run_seen:
        return {"out": int(effect.codes[0]), "feature": int(effect.codes[1])}
    return {}


def _needed(run, known: dict[str, int]) -> list[ast.FunctionDef]:
    """The function and those that it calls, callees first, with the codes put in."""
    out: dict[str, ast.FunctionDef] = {}

    def visit(function) -> None:
        tree = _Folded(known).visit(ast.parse(inspect.getsource(function)).body[0])
        tree.decorator_list = []
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id not in out:
                called = getattr(memories, node.func.id, None)
                if hasattr(called, "py_func"):
                    visit(called.py_func)
        out[tree.name] = ast.fix_missing_locations(tree)

    visit(run)
    return list(out.values())


class _Folded(ast.NodeTransformer):
    """Puts the codes in, and takes out the branches that they never reach."""

    def __init__(self, known: dict[str, int]):
        self.known = known

    def visit_FunctionDef(self, node):
        """Everything after a return is out of reach."""
        self.generic_visit(node)
        node.body = _reached(node.body)
        return node

    def visit_Assign(self, node):
        """Codes are not read any more."""
        names = [n.id for t in node.targets for n in getattr(t, "elts", [t]) if isinstance(n, ast.Name)]
        codes = [n for n in names if n in CODES]
        if codes and isinstance(node.value, ast.Tuple):
            rest = [(n, v) for n, v in zip(names, node.value.elts, strict=True) if n not in CODES]
            return [ast.Assign([ast.Name(n, ast.Store())], v, lineno=0) for n, v in rest]
        return self.generic_visit(node)

    def visit_Name(self, node):
        """A code's value, and what the table calls it."""
        if isinstance(node.ctx, ast.Load):
            value = self.known.get(node.id, getattr(memories, node.id, None) if node.id.isupper() else None)
            if isinstance(value, int) and node.id != "SLOTS":
                return ast.Constant(value)
        return node

    def visit_Compare(self, node):
        """Two numbers are compared now."""
        self.generic_visit(node)
        if len(node.ops) == 1 and isinstance(node.left, ast.Constant) and _is_number(node.comparators[0]):
            a, b = node.left.value, node.comparators[0].value
            kinds = {ast.Eq: a == b, ast.Gt: a > b, ast.GtE: a >= b, ast.Lt: a < b, ast.LtE: a <= b}
            if type(node.ops[0]) in kinds:
                return ast.Constant(kinds[type(node.ops[0])])
        return node

    def visit_BoolOp(self, node):
        """`or` and `and` of what is known."""
        self.generic_visit(node)
        stops = isinstance(node.op, ast.Or)
        left = [v for v in node.values if not (isinstance(v, ast.Constant) and v.value is (not stops))]
        if any(isinstance(v, ast.Constant) and v.value is stops for v in left):
            return ast.Constant(stops)
        if not left:
            return ast.Constant(not stops)
        return left[0] if len(left) == 1 else ast.BoolOp(node.op, left)

    def visit_If(self, node):
        """The branch that is taken."""
        self.generic_visit(node)
        if isinstance(node.test, ast.Constant):
            return node.body if node.test.value else node.orelse
        return node

    def visit_IfExp(self, node):
        """The value that is taken."""
        self.generic_visit(node)
        if isinstance(node.test, ast.Constant):
            return node.body if node.test.value else node.orelse
        return node


def _reached(body: list[ast.stmt]) -> list[ast.stmt]:
    for i, line in enumerate(body):
        if isinstance(line, ast.Return):
            return body[: i + 1]
    return body


def _is_number(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, int | float)


def _value(name: str) -> str:
    if name == "TIMES_S":
        return f"np.geomspace({memories.TIMES_S[0]:g}, {memories.TIMES_S[-1]:g}, {len(memories.TIMES_S)})"
    return repr(getattr(memories, name))


def _parameter(p: Parameter) -> str:
    told = [f"{p.name!r}, {p.unit!r}, {p.default!r}, {p.lower!r}, {p.upper!r}"]
    plain = {f.name: f.default for f in fields(Parameter)}
    told += [f"{k}={v!r}" for k, v in vars(p).items() if plain[k] is not MISSING and v != plain[k]]
    return f"Parameter({', '.join(told)})"


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
