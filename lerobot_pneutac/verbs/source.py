"""Functions of the library as text that runs without it: their source with all that they call and read."""

import ast
import builtins
import dis
import inspect
import textwrap
from functools import partial
from types import CodeType, FunctionType, ModuleType

import numpy as np

from pneutac_sim.errors import InputError

MODULES = {"math": "import math", "numpy": "import numpy as np"}


class Source:
    """Collects functions and classes, and the functions and constants that these use, callees first.

    Attributes:
        constants: name to its line of Python.
    """

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

        Args:
            function: of the library or of an effect's package.
            name: by which the text calls it; its own where it is empty.

        Raises:
            InputError: it uses something else than NumPy, `math`, functions and constants.
        """
        if isinstance(function, partial):
            chosen = [f"{k}={self.add(v) if callable(v) else repr(v)}" for k, v in function.keywords.items()]
            return f"partial({', '.join([self.add(function.func), *chosen])})"
        plain = getattr(function, "py_func", function)
        if plain in self._names:
            return self._names[plain]
        name = self._free(name or plain.__name__, plain)
        self._names[plain] = name
        renamed = {}
        for used, value in _globals(plain).items():
            if (new := self._use(used, value, plain)) != used:
                renamed[used] = new
        text = textwrap.dedent(inspect.getsource(plain)).rstrip()
        self._texts.append(_rename(text, name, renamed, isinstance(plain, type) or self._compiled))
        return name

    def _use(self, name: str, value, user) -> str:
        if inspect.isfunction(getattr(value, "py_func", value)) or isinstance(value, type):
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

    def _free(self, name: str, function) -> str:
        """The name, with the module's before it where another function has it."""
        module = function.__module__.rpartition(".")[2]
        return f"{module}_{name.lstrip('_')}" if name in self._names.values() else name

    def lines(self) -> list[str]:
        return [f"{name} = {text}" for name, text in self.constants.items()]


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
