"""Files that are read with one sentence where they are bad, and written whole or not at all."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import yaml

from pneutac_sim.errors import InputError


def read_yaml(file: Path):
    """Content of a YAML file; raises InputError, one line, where it is none."""
    try:
        return yaml.safe_load(file.read_text())
    except (yaml.YAMLError, UnicodeDecodeError) as e:
        mark = getattr(e, "problem_mark", None)
        where, what = (f", line {mark.line + 1},", e.problem) if mark else ("", e)
        raise InputError(f"{file}{where} is not valid YAML: {what}; correct it in a text editor.") from e


@contextmanager
def whole(file: Path) -> Iterator[Path]:
    """Gives a path to write to, which takes the place of `file` at the end: a stop leaves no half of it."""
    part = file.with_name(f"{file.name}.{os.getpid()}.part")
    part.parent.mkdir(parents=True, exist_ok=True)
    try:
        yield part
        part.replace(file)
    finally:
        part.unlink(missing_ok=True)


def write_json(file: Path, content) -> None:
    """Writes JSON, whole or not at all; raises ValueError where a number is NaN or infinite."""
    with whole(file) as part:
        part.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")
