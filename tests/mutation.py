"""Changes the product's code in small ways, one at a time, and sees whether its tests notice.

    python tests/mutation.py --only=safety

A mutation turns a comparison around, drops a clause, a call or a sign, swaps plus and minus, `min` and
`max`, or changes a constant. Each is tried on a copy of the code with the tests that belong to the file; one
that passes them is a survivor and is printed. The exit code is 1 where a target leaves more than it may.
"""

import argparse
import ast
import contextlib
import os
import re
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COPIED = ("sim", "robots", "datasets", "lerobot_pneutac", "firmware", "tests", "pyproject.toml")
# Imported once before the processes fork; nothing of ours may be among them.
PRELOADED = "cv2 draccus mujoco numba numpy pandas pytest rich scipy.optimize torch serial".split()
PRELOADED += "lerobot.cameras lerobot.envs.utils lerobot.policies.factory lerobot.teleoperators".split()


@dataclass(frozen=True)
class Target:
    """Files that are changed.

    Attributes:
        files: relative to the repository.
        tests: that belong to them.
        most: mutations that are tried, evenly over the files; None: all.
        may_survive: of those.
    """

    files: tuple[str, ...]
    tests: tuple[str, ...]
    most: int | None = None
    may_survive: int = 0


TARGETS = {
    "safety": Target(
        (
            "robots/lerobot_robot_pneutac/hardware/safety.py",
            "robots/lerobot_robot_pneutac/hardware/limits.py",
        ),
        ("tests/robots/hardware/test_limits.py", "tests/robots/hardware/test_safety.py"),
    ),
    "firmware": Target(
        ("firmware/pressure_controller/controller.cpp", "firmware/pressure_controller/protocol.cpp"),
        (
            "tests/robots/hardware/test_pressure_exact.py",
            "tests/robots/hardware/test_pressure_firmware.py",
        ),
    ),
    "selection": Target(
        ("lerobot_pneutac/diagnosis/search.py",), ("tests/lerobot_pneutac/diagnosis/test_search.py",)
    ),
    "planner": Target(
        ("datasets/pneutac_datasets/demonstrations/augment/planner.py",),
        ("tests/pneutac_datasets/demonstrations/augment/test_planner.py",),
        most=60,
        may_survive=1,
    ),
    "optics": Target(
        ("sim/pneutac_sim/gel/optics.py",), ("tests/sim/gel/test_optics.py",), most=60, may_survive=1
    ),
}

# Mutations that change nothing that could be seen: "file: line before -> line after", and why.
# A key without " -> " stands for all mutations of its line.
_SYMMETRIC = "planner: the noise is as likely with the other sign"
_QUICKER = "optics: a short cut; what it leaves out is drawn to the same levels"
_MEMORY = "optics: a row of memory more, which nothing reads"
_TOO_FEW = "optics: what is left out cannot differ by more than the limit; the bound may be wider"
NO_CHANGE: dict[str, str] = {
    "controller.cpp: air_pa_ += (settings_.supply_pa - air_pa_) * "
    "clamp(drive_ * dt / settings_.fill_s, 0, 1); -> air_pa_ += (settings_.supply_pa - air_pa_) * "
    "clamp(drive_ * dt / settings_.fill_s, 0, 2);": "the supply's pressure is too much, and so is more",
    "protocol.cpp: uint8_t plain[kHeader + kMaxPayload + kCrc]; -> "
    "uint8_t plain[kHeader + kMaxPayload - kCrc];": "payloads that are written have 20 bytes at most",
    "search.py: without = {t: self.score(m) for t, m in zip(terms, models, strict=True)}": "one model a term",
    "planner.py: batch = mean + spread * self._noise(c.samples, len(warm)) -> "
    "batch = mean - spread * self._noise(c.samples, len(warm))": _SYMMETRIC,
    "planner.py: noise[:, t] = memory * noise[:, t - 1] + np.sqrt(1 - memory**2) * noise[:, t] -> "
    "noise[:, t] = memory * noise[:, t - 1] - np.sqrt(1 - memory**2) * noise[:, t]": _SYMMETRIC,
    "optics.py: @njit(cache=True)": "the compiled code is the same",
    "optics.py: _NO_SHADOW = np.zeros((1, 1), np.float32)": "no value of it is read",
    "optics.py: top = np.float32(0.0)": _QUICKER,
    "optics.py: if _blend_rows(light, i0[p], fy[p], row) == 0.0: -> "
    "if _blend_rows(light, i0[p], fy[p], row) == 1:": _QUICKER,
    "optics.py: first, last = cols, -1": _TOO_FEW,
    "optics.py: bound = np.float32(1.5) # three roundings": _TOO_FEW,
    "optics.py: if j + 1 < first or j > last: -> if (j + 1 < first):": _TOO_FEW,
    "optics.py: if j + 1 < first or j > last: -> if (j > last):": _TOO_FEW,
    "optics.py: if j + 1 < first or j > last: -> if j + 2 < first or j > last:": _TOO_FEW,
    "optics.py: row = np.empty((3, light.shape[2]), np.float32) -> "
    "row = np.empty((4, light.shape[2]), np.float32)": _MEMORY,
    "optics.py: row = np.empty((3, cols), np.float32) -> row = np.empty((4, cols), np.float32)": _MEMORY,
}


@dataclass(frozen=True)
class Mutation:
    """Bytes `start` to `end` of a file become `new`."""

    file: str
    start: int
    end: int
    new: str

    def apply(self, source: bytes) -> bytes:
        return source[: self.start] + self.new.encode() + source[self.end :]

    def __str__(self):
        source = (ROOT / self.file).read_bytes()
        first = source.rfind(b"\n", 0, self.start) + 1
        last = source.find(b"\n", self.end)
        before = source[first:last]
        after = before[: self.start - first] + self.new.encode() + before[self.end - first :]
        texts = (" ".join(t.decode().split()) for t in (before, after))
        return f"{Path(self.file).name}: {' -> '.join(texts)}"


# ---------------------------------------------------------------- Python

COMPARED = {"<": ">=", "<=": ">", ">": "<=", ">=": "<", "==": "!=", "!=": "=="}
COMPARED |= {"is": "is not", "is not": "is", "in": "not in", "not in": "in"}
CALCULATED = {"+": "-", "-": "+", "*": "/", "/": "*", "//": "*", "&": "|", "|": "&"}
OPERATOR = re.compile(r"\*\*|not in|is not|[<>=!]=|//|[-+*/&|<>]|\bis\b|\bin\b")
SWAPPED = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "argmin": "argmax"}
KEPT_CALLS = {"logger", "super"}  # what a log says is no behaviour


class PythonMutations(ast.NodeVisitor):
    """Collects (start, end, new text) over one file."""

    def __init__(self, source: str):
        self.source = source.encode()
        lines = self.source.splitlines(keepends=True)
        self._starts = [0]
        for line in lines:
            self._starts.append(self._starts[-1] + len(line))
        self.found: list[tuple[int, int, str]] = []
        self.visit(ast.parse(source))

    def span(self, node) -> tuple[int, int]:
        start = self._starts[node.lineno - 1] + node.col_offset
        return start, self._starts[node.end_lineno - 1] + node.end_col_offset

    def text(self, node) -> str:
        start, end = self.span(node)
        return self.source[start:end].decode()

    def between(self, left, right, swaps: dict[str, str]) -> None:
        """The operator between two operands is swapped."""
        start, end = self.span(left)[1], self.span(right)[0]
        operator = OPERATOR.search(self.source[start:end].decode())
        if operator and operator[0] in swaps:
            self.found.append((start + operator.start(), start + operator.end(), swaps[operator[0]]))

    def visit_Compare(self, node):
        for left, right in zip([node.left, *node.comparators], node.comparators, strict=False):
            self.between(left, right, COMPARED)
        self.generic_visit(node)

    def visit_BinOp(self, node):
        if not any(isinstance(n, ast.JoinedStr) or kind(n) == "str" for n in (node.left, node.right)):
            self.between(node.left, node.right, CALCULATED)
        self.generic_visit(node)

    def visit_AugAssign(self, node):
        self.between(node.target, node.value, CALCULATED)
        self.generic_visit(node)

    def visit_BoolOp(self, node):
        word = " and " if isinstance(node.op, ast.And) else " or "
        for dropped in node.values:
            rest = word.join(self.text(v) for v in node.values if v is not dropped)
            self.found.append((*self.span(node), f"({rest})"))
        self.generic_visit(node)

    def visit_UnaryOp(self, node):
        if isinstance(node.op, ast.USub | ast.Not):
            start = self.span(node)[0]
            self.found.append((start, start + (1 if isinstance(node.op, ast.USub) else len("not ")), ""))
        self.generic_visit(node)

    def visit_Constant(self, node):
        if kind(node) in ("int", "float", "bool"):
            self.found.append((*self.span(node), changed(self.text(node))))

    def visit_Name(self, node):
        if node.id in SWAPPED:
            self.found.append((*self.span(node), SWAPPED[node.id]))

    def visit_Attribute(self, node):
        if node.attr in SWAPPED:
            self.found.append((self.span(node)[1] - len(node.attr), self.span(node)[1], SWAPPED[node.attr]))
        self.generic_visit(node)

    def visit_Expr(self, node):
        """A call for its effect is dropped; docstrings stay."""
        if isinstance(node.value, ast.Call):
            name = self.text(node.value.func).split(".")[0].removesuffix("()")
            if name in KEPT_CALLS:
                return
            self.found.append((*self.span(node), "pass"))
        self.generic_visit(node)

    def visit_JoinedStr(self, node):
        """Wording is not changed."""

    def visit_FunctionDef(self, node):
        for part in (*node.decorator_list, *node.args.defaults, *node.body):
            self.visit(part)

    def visit_AnnAssign(self, node):
        if node.value:
            self.visit(node.value)


def kind(node) -> str:
    return type(node.value).__name__ if isinstance(node, ast.Constant) else "none"


def changed(constant: str) -> str:
    """Another constant: the other truth value, the next whole number, twice the number."""
    if constant in ("True", "False", "true", "false"):
        other = {"true": "false", "false": "true"}[constant.lower()]
        return other.capitalize() if constant[0].isupper() else other
    if re.fullmatch(r"\d+", constant):
        return str(int(constant) + 1)
    value = float(constant.rstrip("f"))
    return f"{2 * value if value else 1.0:.9g}{'f' if constant.endswith('f') else ''}"


# ---------------------------------------------------------------- C++

NUMBER = r"(?<![\w.])(?:\d+\.?\d*(?:e-?\d+)?f?|true|false)(?![\w.])"
C_PATTERNS = [
    (r"(?<= )(?:<=|>=|==|!=|<|>)(?= )", lambda m: COMPARED[m[0]]),
    (r"(?<= )(?:&&|\|\|)(?= )", lambda m: {"&&": "||", "||": "&&"}[m[0]]),
    (r"(?<=[\w)] )[-+*/](?= [\w(])", lambda m: CALCULATED[m[0]]),
    (r"!(?=[\w(])", lambda m: ""),
    (r"(?<![\w)] )-(?=[a-z])", lambda m: ""),
    (r"(?<= )(?:\|=|&=|\+=)(?= )", lambda m: {"|=": "&=", "&=": "|=", "+=": "-="}[m[0]]),
    (NUMBER, lambda m: changed(m[0])),
    (r"(?m)^ +(?:\w+\(.*\)|(?:\+\+)?\w+(?: [|&+]?= .*)?);$", lambda m: ""),  # one statement
]


def c_mutations(source: str) -> list[tuple[int, int, str]]:
    """(start, end, new text); of a line its comment and the preprocessor's lines stay."""
    blank = re.sub(r"//.*|^#.*|\"[^\"\n]*\"", lambda m: "\0" * len(m[0]), source, flags=re.MULTILINE)
    found = []
    for pattern, new in C_PATTERNS:
        found += [(m.start(), m.end(), new(m)) for m in re.finditer(pattern, blank.replace("\0", " "))]
    return found


def mutations(target: Target, match: str = "") -> list[Mutation]:
    """All of a target that are tried and have `match` in their text, in the order of the code."""
    found = []
    for file in target.files:
        source = (ROOT / file).read_text()
        spans = PythonMutations(source).found if file.endswith(".py") else c_mutations(source)
        found += [Mutation(file, *span) for span in sorted(set(spans))]
    found = [
        m
        for m in found
        if match in str(m) and str(m) not in NO_CHANGE and str(m).split(" -> ")[0] not in NO_CHANGE
    ]
    if target.most and len(found) > target.most:
        found = [found[k * len(found) // target.most] for k in range(target.most)]
    return found


# ---------------------------------------------------------------- trying them


def copy_tree(folder: Path) -> Path:
    """The code in a folder of its own, so that yours stays as it is."""
    leave = shutil.ignore_patterns("__pycache__", "recordings", "*.safetensors", "*.mp4")
    for name in COPIED:
        if (ROOT / name).is_dir():
            leave_out = leave if name == "tests" else shutil.ignore_patterns("__pycache__")
            shutil.copytree(ROOT / name, folder / name, ignore=leave_out)
        else:
            shutil.copy2(ROOT / name, folder / name)
    return folder


def begin(tree: Path, tests: tuple[str, ...]) -> int:
    """A process that runs tests in a tree; returns its id. It ends with pytest's exit code."""
    sys.stdout.flush()
    process = os.fork()
    if process:
        return process
    os.setsid()
    os.chdir(tree)
    log = os.open(tree / "log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(log, 1)
    os.dup2(log, 2)
    paths = [str(tree / p) for p in (".", "sim", "robots", "datasets")]
    sys.path[:0] = paths
    os.environ["PYTHONPATH"] = os.pathsep.join(paths)
    os.environ["TMPDIR"] = tempfile.tempdir = str(tree / "tmp")
    (tree / "tmp").mkdir(exist_ok=True)
    import pytest

    options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", f"--basetemp={tree / 'tmp/pytest'}"]
    code = pytest.main([*options, *tests])
    os._exit(int(code))


def end(process: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process, signal.SIGKILL)
    os.waitpid(process, 0)


def seconds(trees: list[Path], tests: tuple[str, ...]) -> float:
    """How long the tests take on the code as it is, in all trees at once.

    Raises:
        SystemExit: they fail.
    """
    began = time.monotonic()
    for process, tree in [(begin(tree, tests), tree) for tree in trees]:
        if os.waitpid(process, 0)[1] != 0:
            raise SystemExit(f"The tests fail on the code as it is:\n{(tree / 'log').read_text()[-3000:]}")
    return time.monotonic() - began


def outcomes(target: Target, trees: list[Path], match: str) -> Iterator[tuple[Mutation, bool]]:
    """Yields each mutation and whether it survives; those that do not compile are none."""
    longest = 60 + 5 * seconds(trees, target.tests)
    waiting, free, running = mutations(target, match)[::-1], list(trees), {}
    while waiting or running:
        while waiting and free:
            tree, mutation = free.pop(), waiting.pop()
            (tree / mutation.file).write_bytes(mutation.apply((ROOT / mutation.file).read_bytes()))
            running[begin(tree, target.tests)] = tree, mutation, time.monotonic()
        time.sleep(0.05)
        for process, (tree, mutation, began) in list(running.items()):
            done, status = os.waitpid(process, os.WNOHANG)
            if not done and time.monotonic() - began < longest:
                continue
            if not done:
                end(process)
            del running[process]
            shutil.copy2(ROOT / mutation.file, tree / mutation.file)
            free.append(tree)
            if "error: " not in (tree / "log").read_text() or not mutation.file.endswith(".cpp"):
                yield mutation, bool(done) and status == 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", choices=TARGETS, help="this target alone")
    parser.add_argument("--match", default="", help="only mutations whose text contains this")
    parser.add_argument("--list", action="store_true", help="print the mutations and try none")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes at once")
    args = parser.parse_args()
    targets = {args.only: TARGETS[args.only]} if args.only else TARGETS
    if args.list:
        for target in targets.values():
            print(*mutations(target, args.match), sep="\n")
        return 0
    os.environ |= {"OMP_NUM_THREADS": "1", "HF_HUB_OFFLINE": "1", "NUMBA_BOUNDSCHECK": "1"}
    sys.dont_write_bytecode = True
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    warnings.filterwarnings("ignore", "This process .* is multi-threaded", DeprecationWarning)
    bad = 0
    with tempfile.TemporaryDirectory(prefix="pneutac_mutation_") as folder:
        os.environ["HF_HOME"] = folder  # LeRobot reads it when it is imported
        for name in PRELOADED:
            __import__(name)
        trees = [copy_tree(Path(folder) / str(i)) for i in range(args.jobs)]
        for name, target in targets.items():
            tried, left = 0, []
            for mutation, survived in outcomes(target, trees, args.match):
                tried += 1
                if survived:
                    left.append(mutation)
                    print(f"survives: {mutation}", flush=True)
            print(f"{name}: {tried} mutations, {len(left)} survive, {target.may_survive} may.", flush=True)
            bad += len(left) > target.may_survive
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
