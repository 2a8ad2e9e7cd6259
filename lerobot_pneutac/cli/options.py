"""Command line options as dataclasses: a bad one ends in one sentence, as all bad input does.

Help texts are the comments of the dataclass' fields, so that they stand in one place.
"""

import dataclasses
import difflib
import functools
import inspect
import json
import math
import os
import re
import shlex
import shutil
import sys
import textwrap
import types
import typing
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import yaml

from pneutac_sim.errors import InputError, check_choice, refuse_given, shown
from pneutac_sim.executor import MOST_WORKERS, check_device
from pneutac_sim.files import LOCK, YamlLoader, check_writable, fits, inside, read_json, read_yaml

COLUMN = 28  # where help texts begin
MOST = 2**32 - 1  # of an option's number, and the largest seed that NumPy and PyTorch both take
MOST_COUNT = 10**6  # of any other whole number: files, trials or rows, of which more would fill the memory
# What an option's number may be at most, by the last word of its name.
MOST_OF = {"seed": MOST, "steps": 10**9, "updates": 10**9, "jobs": MOST_WORKERS}
MOST_OF |= {"batch": 2**14, "size": 2**14, "rgb": 255}  # samples that are held at once; a colour's levels
# Options of which no number may be 0 or below, whatever else a verb asks of them.
POSITIVE = "hz evaluations particles chambers image_size marker_mm dots_mm size_mm depth_mm".split()
OUTPUTS = ("out", "output.root", "student.root")  # options that name a folder to be written
# Endings that a file has and hardly a folder.
FILES = ".csv .gif .htm .html .jpg .json .mat .md .mp4 .parquet .pdf .png .py .rrd .txt .xlsx .yaml .yml .zip"


@dataclass(frozen=True)
class Option:
    """One option of a command."""

    name: str  # with the groups that it is in, such as `planner.horizon`
    kind: type  # type of its value, without None; a dataclass for a group of options
    default: object  # None where there is none
    text_of: type | str  # the class whose comments or docstring say what it means, or that text itself
    optional: bool = False  # whether its value may be None
    choices: tuple[str, ...] = ()  # of its values, where it chooses a class

    @property
    def text(self) -> str:
        """What it says in `--help`."""
        if isinstance(self.text_of, str):
            return self.text_of
        return attribute_texts(self.text_of).get(self.name.rpartition(".")[2], "")

    @property
    def shown(self) -> str:
        """The default as one writes it; empty where there is none."""
        listed = isinstance(self.default, tuple | list)
        value = ",".join(map(str, self.default)) if listed else self.default
        return "" if value is None or dataclasses.is_dataclass(self.kind) else str(value)


def keywords(config, function) -> dict:
    """Those options of a verb that its function takes as keyword arguments alone, by their names."""
    parameters = inspect.signature(function).parameters.values()
    names = [p.name for p in parameters if p.kind is p.KEYWORD_ONLY and hasattr(config, p.name)]
    return {name: getattr(config, name) for name in names}


@dataclass(kw_only=True)
class TableOptions:
    """Options of a verb that takes a lab's own table as a recording."""

    yes: bool = False  # take a table as it is understood, without asking
    mapping: Path | None = None  # `mapping.yaml` of another table with such columns, which says what they are


@dataclass(kw_only=True)
class PairOptions(TableOptions):
    """Options of a verb that takes a twin and a recording."""

    twin: Path  # folder of the twin
    # folder of a bench recording, or tables as `pneutac convert` reads them of the same finger, arm or gel;
    # or of a LeRobotDataset of demonstrations, or its name on the Hub
    recording: Path
    task: str = ""  # of demonstrations: the task in front of the robot, if their instruction does not name it
    # of demonstrations: `station.yaml` of the arm and its place; if omitted, the one that their robot left in
    # them, or the paper's
    station: Path | None = None
    out: Path | None = None  # folder for `result.json` and `report.html`; nothing is written without it


def parse_options(config_class: type, argv: list[str], what: str | None = None):
    """Reads `--name=value` options into a dataclass that validates itself; raises InputError for bad ones.

    `a,b` is the list `[a,b]`, a flag may stand without its `=true`, and `--help` prints all and exits, after
    the sentence `what`, else that of the class' module. The class may name the option that the `first`
    argument is without its name, and `aliases` of options.
    """
    options = {o.name: o for o in list_options(config_class)}
    if "-h" in argv or "--help" in argv:
        print(help_text(config_class, what))
        raise SystemExit(0)
    given, first = argv, getattr(config_class, "first", "")
    if first and argv and not argv[0].startswith("-"):
        argv = [f"--{first}={argv[0]}", *argv[1:]]
    argv = _completed(options, argv, getattr(config_class, "aliases", {}))
    for path in (a.partition("=")[2] for a in argv if a.startswith("--config_path=")):
        _check_file(Path(path), options)
    import draccus  # which the library does without

    try:
        config = draccus.parse(config_class, args=argv)
    except draccus.ParsingError as e:  # draccus hides what the dataclass itself raised
        cause = e
        while cause.__cause__ is not None and not isinstance(cause, InputError):
            cause = cause.__cause__
        raise cause if isinstance(cause, InputError) else InputError(_in_words(str(e), options)) from e
    _check_numbers(config)
    _check_outputs(config, given)
    _convert_tables(config)
    return config


def _check_numbers(config, group: str = "") -> None:
    """Raises InputError for a number that no option takes, and a dataset's name that the Hub does not.

    That is what is not finite or above the most of its kind, a whole number below 0 (a seed, a count, a
    port), and 0 or less where something must be there.
    """
    for name in (field.name for field in dataclasses.fields(config)):
        value, option = getattr(config, name), f"--{group}{name}"
        if dataclasses.is_dataclass(value):
            _check_numbers(value, f"{group}{name}.")
        for number in _numbers(value):
            if not math.isfinite(number):
                raise InputError(f"{option} is {value}; give a finite number.")
            usual = MOST_COUNT if isinstance(number, int) else MOST
            if abs(number) > (most := MOST_OF.get(name.rpartition("_")[2], usual)):
                raise InputError(f"{option} is {value}; give at most {most}.")
            if isinstance(number, int) and number < 0:
                raise InputError(f"{option} is {value}; it must be 0 or more.")
            if name in POSITIVE and number <= 0:
                raise InputError(f"{option} is {value}; it must be above 0.")
        if name == "device" and isinstance(value, str) and getattr(config, "executor", "local") == "local":
            check_device(value)
        if name == "repo_id" and not re.fullmatch(r"([\w.-]+/)?[\w.-]+", value):
            raise InputError(f"{option} is '{value}'; give a name such as local/demos.")


def _numbers(value: object) -> Iterator[int | float]:
    """Those that an option's value is made of."""
    if isinstance(value, dict | list | tuple):
        for each in value.values() if isinstance(value, dict) else value:
            yield from _numbers(each)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield value


def _check_outputs(config, argv: list[str]) -> None:
    """Raises InputError where a folder to write cannot be, is one that is read, or holds something else.

    A class of options says `names_a_file` where `out` is a file, by `outputs` which others are written, and
    by `resumed_by` of what file or folder in `out` a command knows what an earlier run left there.
    """
    paths = list(_paths(config))
    outputs = {*OUTPUTS, *getattr(config, "outputs", ())}
    for name, path in paths:
        if name not in outputs:
            continue
        if getattr(config, "names_a_file", False):
            check_writable(path.parent, f"{path.parent}, the folder of --{name}={path},")
            continue
        check_folder(name, path)
        check_writable(path, f"--{name}={path}")
        for source, folder in paths:
            if name == "out" and source in OUTPUTS[1:] and inside(folder, path):
                raise InputError(f"--out={path} is or lies in --{source}={folder}; give another folder.")
            if source not in outputs and folder.is_dir() and inside(folder, path):
                raise InputError(
                    f"--{name}={path} lies in --{source}={folder}, which is read; give another folder."
                )
        if name == "out" and not getattr(config, "replace", False):
            check_report(path, config, argv)
        mark = getattr(config, "resumed_by", "") if name == "out" else ""
        there = {p.name for p in path.iterdir()} - {LOCK} if path.is_dir() else ()
        if mark and there and mark not in there:
            raise InputError(
                f"--{name}={path} is not empty and holds no earlier run of this; give a new folder."
            )


def check_folder(name: str, path: Path) -> None:
    """Raises InputError where an option that takes a folder is given what is, or looks like, a file."""
    if os.path.isfile(path):  # unlike Path.is_file, False for a name that is too long
        raise InputError(f"--{name}={path} is a file; give a folder.")
    if path.suffix.lower() in FILES.split() and not os.path.isdir(path):
        raise InputError(
            f"--{name}={path} names a file; give a folder, in which files get names of their own."
        )


HELD = {"recording.json": "a recording", "twin.yaml": "a twin", "meta/info.json": "a dataset"}


def check_report(out: Path, config=None, argv: Sequence[str] = (), name: str = "--out") -> None:
    """Raises InputError where a report in folder `out` would be mixed with or replace what is there.

    What this very command wrote, `argv` of a class of options, is replaced; an earlier run goes on.
    """
    found = next((what for file, what in HELD.items() if (out / file).is_file()), "")
    result = out / "result.json"
    command = str(read_json(result).get("command", "")) if not found and result.is_file() else ""
    verb = " ".join(command.split()[:2])
    same = f"`{verb}`" in (type(config).__doc__ or "")
    again = same and (hasattr(config, "resumed_by") or command == f"{verb} {shlex.join(argv)}")
    if verb and not again:
        found = f"the report of {'another ' if same else ''}`{verb}`"
    if found:
        raise InputError(f"{name}={out} holds {found}; give another folder.")


def _paths(config, group: str = "") -> Iterator[tuple[str, Path]]:
    """All paths that options give, by the option's name."""
    for field in dataclasses.fields(config):
        value, name = getattr(config, field.name), group + field.name
        if dataclasses.is_dataclass(value):
            yield from _paths(value, f"{name}.")
        for path in value if isinstance(value, list | tuple) else [value]:
            if isinstance(path, Path):
                yield name, path


def _convert_tables(config) -> None:
    """Puts the folders of recordings where tables are given."""
    recording, later = getattr(config, "recording", None), getattr(config, "later", [])
    tables = any(isinstance(p, Path) and not p.is_dir() for p in (recording, *later))
    if isinstance(config, TableOptions) and not tables:
        refuse_given(config, ("mapping",), "is of a table, and none is given as a recording")
    if all(isinstance(p, Path) and p.is_dir() for p in (recording, *later) if p is not None):
        return
    from lerobot_pneutac.cli.tables import recording_folder  # pandas, which many commands do not need

    table_options = getattr(config, "yes", False), getattr(config, "mapping", None)
    length_mm = getattr(config, "length_mm", None)
    if isinstance(recording, Path):
        config.recording = recording_folder(recording, *table_options, length_mm)
    if later:
        config.later = [recording_folder(p, *table_options, length_mm) for p in later]


def name_option(sentence: str, config_class: type, argv: Iterable[str] = ()) -> str:
    """A library's sentence about a parameter, `jobs=-1 must be ...`, as one about the option `--jobs`.

    A folder that has the name of an option, and is given in `argv`, remains what it is.
    """
    values = {word.rpartition("=")[2] for word in argv}
    options = [o.name for o in list_options(config_class)]

    def named(found: re.Match) -> str:
        name = found[0]
        if name in values and not found.start():
            return name
        same = [o for o in options if o == name] or [o for o in options if re.search(rf"[._]{name}$", o)]
        return f"--{same[0]}" if len(same) == 1 else name

    verbs = "is|has|and|must|are|chooses|simulates"  # after a word that may begin another sentence, too
    first = rf"^[\w.]+_\w+(?=[ =])|^[\w.]+(?==| (?:{verbs}) )"
    return re.sub(rf"{first}|(?<![\w.=/'`-])[a-z][\w.]*(?==[\w'])", named, sentence)


def _check_file(path: Path, options: dict[str, Option]) -> None:
    if not path.is_file():
        raise InputError(f"--config_path={path} is no file; give a YAML file of options.")
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise InputError(f"--config_path={path} must hold options, one `name: value` in each line.")
    for name, value in _given(content, options):
        if name not in options:
            raise InputError(f"{path}: {_unknown(name, options)}")
        _check_value(options[name], value, f"{path}: {name} is {shown(value)}")


def _given(content: dict, options: dict[str, Option], group: str = "") -> Iterator[tuple[str, object]]:
    """The options that a file gives, those of a group with its name, and their values."""
    for name, value in content.items():
        own = options.get(f"{group}{name}")
        if isinstance(value, dict) and own and dataclasses.is_dataclass(own.kind):
            yield from _given(value, options, f"{group}{name}.")
        else:
            yield f"{group}{name}", value


def _check_value(option: Option, value: object, said: str) -> None:
    """Raises InputError, which begins with `said`, where a value of YAML is not of the option's kind."""
    if not (value is None and option.optional or fits(option.kind, value)):
        raise InputError(f"{said}; it must be {_wanted(option.name, option.kind)}.")


def _in_words(text: str, options: dict[str, Option]) -> str:
    text = " ".join(text.split())
    text = re.sub(r": Could not decode the value into any of the given types: (\w+): ", ": ", text, count=1)
    if missing := re.match(r"(?:`(\w+)`: )?Missing required field\(s\) (.+) for \w+", text):
        group = f"{missing[1]}." if missing[1] else ""
        names = re.findall(r"`(\w+)`", missing[2])
        wanted = [o for o in options.values() if o.name.removeprefix(group).split(".")[0] in names]
        shown = [f"--{o.name}{_placeholder(o.kind)}" for o in wanted if not dataclasses.is_dataclass(o.kind)]
        shown = [", ".join(shown[:-1]), shown[-1]] if shown[1:] else shown
        return f"Give {' and '.join(shown)}; --help lists all options."
    return text


_KINDS = {int: "a whole number", float: "a number", bool: "true or false", Path: "a path", str: "a text"}


def _wanted(name: str, kind: type) -> str:
    """What an option takes, and how that is written."""
    kinds, (always, sometimes) = typing.get_args(kind), _lists(kind)
    if typing.get_origin(kind) is tuple and Ellipsis not in kinds:
        whole = "whole " * (kinds[0] is int)
        return f"{len(kinds)} {whole}numbers with commas, as in --{name}={','.join('ABCDEF'[: len(kinds)])}"
    if typing.get_origin(kind) is dict:
        return f"names and their values, as in --{name}='{{temperature_c: 22}}'"
    if always:
        return f"{_KINDS.get(kinds[0], 'one')}, or several with commas, as in --{name}=A,B"
    if sometimes:
        return "a number, or several with commas, such as 15,20,15"
    return _KINDS.get(kind, "of another kind")


def list_options(config_class: type, group: str = "") -> Iterator[Option]:
    """The options of a dataclass, in its order; those of a nested one follow it as `group.name`."""
    if hasattr(config_class, "get_known_choices"):  # one class a type, as LeRobot's cameras
        choices = config_class.get_known_choices()
        names = tuple(sorted(choices))
        yield Option(f"{group}type", str, None, f"one of {', '.join(names)}.", choices=names)
        found = (option for choice in choices.values() for option in _fields(choice, group))
        yield from {o.name: dataclasses.replace(o, default=None) for o in found}.values()
    else:
        yield from _fields(config_class, group)


def _fields(config_class: type, group: str) -> Iterator[Option]:
    hints = typing.get_type_hints(config_class)
    for field in dataclasses.fields(config_class):
        kind = hints[field.name]
        kinds = [k for k in typing.get_args(kind) if k is not type(None)]
        kind = kinds[0] if len(kinds) == 1 and type(None) in typing.get_args(kind) else kind
        default = None if field.default is dataclasses.MISSING else field.default
        optional = types.NoneType in typing.get_args(hints[field.name])
        yield Option(group + field.name, kind, default, config_class, optional)
        if dataclasses.is_dataclass(kind):
            yield from list_options(kind, f"{group}{field.name}.")


@functools.cache
def attribute_texts(config_class: type) -> dict[str, str]:
    """What the options of a class mean, and those of the classes that it extends.

    It is said by a comment behind a field or above it, by `Attributes:` in the docstring, or by the arguments
    of the verb's function, where the class names it as `described_by`.
    """
    function = getattr(config_class, "described_by", None)
    texts = {} if function is None else _entries(function.__doc__, "Args:")
    for base in filter(dataclasses.is_dataclass, reversed(config_class.__mro__)):
        texts |= _entries(base.__doc__, "Attributes:") | _comments(base)
    return texts


def _comments(config_class: type) -> dict[str, str]:
    try:
        lines = inspect.getsource(config_class).partition("\nclass ")[2].splitlines()
    except OSError:  # a class that was made at run time
        return {}
    texts, above = {}, []
    for line in lines:
        code, found, comment = line.strip().partition("# ")
        if code.startswith(("def ", "@")):
            break
        comments = above + ([comment] if found and not comment.startswith("pyright:") else [])
        above = comments if found and not code else []
        if (field := re.match(r"(\w+): ", code)) and comments:
            texts[field[1]] = " ".join(comments)
    return texts


def _entries(doc: str | None, section: str) -> dict[str, str]:
    entries = textwrap.dedent(inspect.cleandoc(doc or "").partition(f"{section}\n")[2].split("\n\n")[0])
    parts = (entry.partition(":") for entry in re.split(r"\n(?=\S)", entries))
    return {name.strip(): " ".join(text.split()) for name, found, text in parts if found}


def help_text(config_class: type, what: str | None = None) -> str:
    """What `--help` prints: what the command does, and every option; see `parse_options`."""
    sentence = inspect.cleandoc(what or sys.modules[config_class.__module__].__doc__ or "").split("\n\n")[0]
    sentence = re.sub(r"^`pneutac [^`]*`: ", "", " ".join(sentence.split()))
    width = min(110, shutil.get_terminal_size((100, 24)).columns)
    lines = [f"usage: {sys.argv[0].rpartition('/')[2]} [--option=value ...]", ""]
    lines += [*textwrap.wrap(sentence[:1].upper() + sentence[1:], width), "", "options:"]
    extra = (
        Option("config_path", Path, None, "YAML file of options; those of the command line win over it."),
        Option("help", bool, None, "this text."),
    )
    for option in (*list_options(config_class), *extra):
        lines += _help_lines(option, width)
    return "\n".join(lines)


def _help_lines(option: Option, width: int) -> list[str]:
    left = f"  --{option.name}{_placeholder(option.kind)}"
    text = option.text.rstrip(".")
    if option.shown and option.default is not False:
        text = f"{text} (default {option.shown})"
    right = textwrap.wrap(f"{text}." if text else "", max(40, width - COLUMN)) or [""]
    first = [left + " " * (COLUMN - len(left)) + right.pop(0)] if len(left) < COLUMN - 1 else [left]
    return first + [" " * COLUMN + line for line in right]


def _lists(kind: type) -> tuple[bool, bool]:
    """Whether a value is a list, and whether it may be one, as one of several kinds."""
    several = typing.get_origin(kind) in (types.UnionType, typing.Union)
    kinds = [typing.get_origin(k) in (tuple, list) for k in (typing.get_args(kind) if several else (kind,))]
    return all(kinds), any(kinds)


def _placeholder(kind: type) -> str:
    if kind is bool:
        return ""
    if dataclasses.is_dataclass(kind):
        return ".*"
    always, sometimes = _lists(kind)
    if always:
        return "=A,B"
    if float in typing.get_args(kind) and sometimes:
        return "=NUMBER"
    return "=" + {str: "TEXT", int: "INT", float: "NUMBER", Path: "PATH"}.get(kind, "VALUE")


def _completed(options: dict[str, Option], argv: list[str], aliases: dict[str, str]) -> list[str]:
    """The same arguments as draccus wants them: with lists in brackets, which it would else take apart."""
    out, rest = [], list(argv)
    while rest:
        name, given, value = rest.pop(0).partition("=")
        if not name.startswith("--"):
            raise InputError(f"'{name}' is not an option; they are written --name=value.")
        name = aliases.get(name.removeprefix("--"), name.removeprefix("--"))
        if name != "config_path" and name not in options:
            raise InputError(_unknown(name, options))
        kind = options[name].kind if name in options else Path
        if not given:
            stands = rest and not rest[0].startswith("--")
            if not stands and kind is not bool:
                raise InputError(f"--{name} has no value; write --{name}=VALUE.")
            value = rest.pop(0) if stands else "true"
        if dataclasses.is_dataclass(kind) and not value.startswith("{"):
            inside = [f"--{o}" for o in options if o.startswith(f"{name}.")]
            inside = inside[:1] if inside[0].endswith(".type") else inside  # what others there are follows it
            raise InputError(f"--{name}={value} names none of its options; give {' or '.join(inside)}.")
        if not value and kind is not str:
            raise InputError(f"--{name} has no value; write --{name}=VALUE.")
        if choices := getattr(options.get(name), "choices", ()):
            check_choice(name, value, choices)
        out.append(f"--{name}={_of_yaml(options[name], value) if name in options else value}")
    return out


def _of_yaml(option: Option, text: str) -> str:
    """A value as draccus reads it; raises InputError where it is not of the option's kind."""
    if option.kind in (str, Path) and text != "null":
        plain = False
        with suppress(ValueError):  # of a date that cannot be, such as 2026-13-40
            plain = re.fullmatch(r"[\w./~+-]*", text) and yaml.safe_load(text) == text
        # else brackets, stars, colons and numbers would be YAML; a plain one may be a choice of argparse
        return text if plain else json.dumps(text, ensure_ascii=False)
    value, (always, sometimes) = text, _lists(option.kind)
    if sometimes and text[0] not in "[{" and ("," in text or always):
        quoted = always and typing.get_args(option.kind)[0] in (str, Path)
        value = json.dumps([v.strip() for v in text.split(",")]) if quoted else f"[{text}]"
    if not dataclasses.is_dataclass(option.kind):
        try:
            found = yaml.load(value, YamlLoader)
        except yaml.YAMLError:
            found = object()
        _check_value(option, found, f"--{option.name} is {shown(text)}")
    return value


def _unknown(name: str, options: dict[str, Option]) -> str:
    close = difflib.get_close_matches(name, options, n=3, cutoff=0.5)
    close += [o for o in options if o.rpartition(".")[2] == name and o not in close]
    if close:
        return f"There is no option --{name}; did you mean {' or '.join('--' + o for o in close)}?"
    known = (o.name for o in options.values() if not dataclasses.is_dataclass(o.kind))
    return f"There is no option --{name}; the options are {', '.join('--' + o for o in known)}."
