"""Files that are read with one sentence where they are bad, and written whole or not at all."""

import difflib
import errno
import io
import json
import math
import os
import re
import shutil
import struct
import sys
import tempfile
import types
import typing
import warnings
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import yaml
from filelock import FileLock, Timeout
from PIL import Image, ImageFile

from pneutac_sim.errors import CONTROL, InputError, shown, unknown_names

MOST_YAML_BYTES, MOST_JSON_BYTES = 2**20, 2**22
MOST_WHOLE = 10**19
LOCK = ".lock"  # file that stays in a folder into which one process at a time may write
LOCK_S = 60.0  # how long another process's writing is waited for
# How the small text files begin that stand for files which Git has not fetched, and the command that does.
POINTERS = {b"version https://git-lfs": "git lfs pull", b"/annex/objects/": "git annex get ."}


def _text(file: Path, most_bytes: int) -> str:
    try:
        if file.stat().st_size > most_bytes:
            raise InputError(f"{file} is larger than {most_bytes} bytes; it is no file of this product.")
        refuse_pointer(file)
        return file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as e:
        raise InputError(f"{file} is no text in UTF-8; give another file, or save it as UTF-8.") from e
    except OSError as e:
        raise InputError(f"{file} cannot be read ({e.strerror}); give another file.") from e


def read_json[T: (dict, list)](file: Path, kind: type[T] = dict) -> T:
    """Content of a JSON file: names and values, or a list.

    Raises InputError: one line: it is none, far too large, or holds something else, a name twice or control
    characters.
    """
    text = _text(file, MOST_JSON_BYTES)
    try:
        content = json.loads(text, parse_int=_whole, object_pairs_hook=_once)
    except RecursionError as e:
        raise InputError(f"{file} is not valid JSON: it is nested too deeply.") from e
    except ValueError as e:
        raise InputError(f"{file} is not valid JSON: {e}; correct it in a text editor.") from e
    if not isinstance(content, kind):
        what = "object" if kind is dict else "list"
        raise InputError(f"{file} must hold a JSON {what}, not {shown(content)}.")
    return content


def _whole(digits: str) -> int | float:
    """A whole number of JSON; one that no quantity has is infinite, which every field refuses."""
    return int(digits) if len(digits) < 20 else float(digits)


def _once(pairs: list[tuple[str, object]]) -> dict:
    """An object of JSON; of a name that is given twice one value would be ignored."""
    out: dict = {}
    for name, value in pairs:
        if name in out:
            raise ValueError(f"'{name}' is given twice")
        texts = (name, *(value if isinstance(value, list) else [value]))
        if any(isinstance(text, str) and CONTROL.search(text) for text in texts):
            raise ValueError(f"'{name}' holds control characters")
        out[name] = value
    return out


def read_made(file: Path) -> dict:
    """Content of a JSON file that an earlier run made; raises InputError where it is damaged."""
    try:
        return read_json(file)
    except InputError as e:
        raise InputError(f"'{file}' is damaged; delete it, and the same command makes it again.") from e


def claim(file: Path, run: dict, **words: str) -> None:
    """Begins a run that fills the folder of `file`, or goes on with the same one.

    `words` say in the sentence what options are called.

    Raises InputError: the file there is damaged, or of a run of other options.
    """
    run = json.loads(json.dumps(run))
    if not file.exists():
        write_json(file, run)
    elif (old := read_made(file)) != run:
        changed = (words.get(k, k) for k in sorted(run.keys() | old.keys()) if run.get(k) != old.get(k))
        raise InputError(
            f"'{file.parent}' holds a run with another {', '.join(changed)}; give another folder, delete this"
            " one, or repeat the command that began it."
        )


def read_yaml(file: Path):
    """Content of a YAML file; raises InputError, one line, where it is none or far too large."""
    text = _text(file, MOST_YAML_BYTES)
    try:
        return yaml.load(text, YamlLoader)
    except RecursionError as e:
        raise InputError(f"{file} is nested too deeply; correct it in a text editor.") from e
    except (yaml.YAMLError, ValueError) as e:
        mark = getattr(e, "problem_mark", None)
        where, what = (f", line {mark.line + 1},", e.problem) if mark else ("", getattr(e, "reason", e))
        raise InputError(f"{file}{where} is not valid YAML: {what}; correct it in a text editor.") from e


def read_fields(file: Path, known: Iterable[str], required: Iterable[str] = (), kind: str = "field") -> dict:
    """The fields of a YAML file that a user writes, `name: value` in each line.

    It may have `known` names, each perhaps with a type, and must have those that are `required`; `kind` is
    what a name is, in a sentence.

    Raises InputError: one line: it is none, or empty, lacks a name, or has another one or a value of another
    type.
    """
    content, types_of = read_yaml(file), known if isinstance(known, dict) else {}
    if not isinstance(content, dict):
        what = "is empty" if content is None else f"is {shown(content)}"
        raise InputError(f"{file} {what}; write `name: value` lines, of {', '.join(known)}.")
    for fault in unknown_names(content, known, kind):
        raise InputError(f"{file}: {fault}")
    for name in required:
        if name not in content:
            raise InputError(f"{file}: {kind} '{name}' is missing.")
    for name, value in content.items():
        if name in types_of and not fits(types_of[name], value):
            wanted = getattr(types_of[name], "__name__", types_of[name])
            raise InputError(f"{file}: {kind} '{name}' is {shown(value)}; it must be of the type {wanted}.")
    return content


def fits(kind: type, value: object) -> bool:
    """Whether a value of YAML is of a kind, such as `list[float]`; of one not known here anything is."""
    origin, kinds = typing.get_origin(kind) or kind, typing.get_args(kind)
    if origin in (types.UnionType, typing.Union):
        return any(fits(k, value) for k in kinds)
    if origin in (list, tuple):
        each = isinstance(value, list) and all(fits(k, v) for v in value for k in kinds[:1])
        return each and (origin is list or Ellipsis in kinds or len(value) == len(kinds))
    if origin is dict:
        return isinstance(value, dict) and all(fits(k, v) for v in value.values() for k in kinds[1:])
    if origin in (int, float):
        return isinstance(value, int if origin is int else int | float) and not isinstance(value, bool)
    kinds = {bool: bool, Path: str, str: str | int | float, types.NoneType: types.NoneType}
    switch = origin is str and isinstance(value, bool)  # YAML's `no` and `off`, of which a text is not made
    return not switch and isinstance(value, kinds.get(origin, object))


class YamlLoader(yaml.SafeLoader):
    """Safe YAML without aliases, with which a small file could stand for a huge one; dates are texts.

    Numbers are those of YAML 1.2: 1e3 is one, while 1:30 is no 90, and 020 no 16.
    """

    yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in found if not re.search(":(timestamp|int|float)$", tag)]
        for first, found in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def compose_node(self, parent, index):
        if self.check_event(yaml.AliasEvent):
            raise yaml.constructor.ConstructorError(
                None, None, "aliases are not read", self.peek_event().start_mark
            )
        return super().compose_node(parent, index)

    def construct_yaml_int(self, node):
        """A whole number; one that no quantity has is infinite, which every field refuses."""
        value = super().construct_yaml_int(node)
        if abs(value) < MOST_WHOLE:
            return value
        return math.inf if value > 0 else -math.inf

    def construct_mapping(self, node, deep=False):
        """Names and what they are; of a name that is given twice one value would be ignored."""
        seen = set()
        for key in (k for k, _ in node.value if isinstance(k, yaml.ScalarNode)):
            if key.value in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"'{key.value}' is given twice", key.start_mark
                )
            seen.add(key.value)
        return super().construct_mapping(node, deep)

    def construct_scalar(self, node):
        value = super().construct_scalar(node)
        if CONTROL.search(value):
            raise yaml.constructor.ConstructorError(
                None, None, "control characters are not read", node.start_mark
            )
        return value


def refuse_pointer(file: Path) -> None:
    """Raises InputError where a file stands for another one that Git LFS or git-annex has not fetched."""
    with file.open("rb") as f:
        begin = f.read(32)
    for mark, command in POINTERS.items():
        if begin.startswith(mark):
            raise InputError(
                f"{file} is a {'Git LFS' if b'lfs' in mark else 'git-annex'} pointer and not the file itself;"
                f" run `{command}` in its repository."
            )


YamlLoader.add_constructor("tag:yaml.org,2002:int", YamlLoader.construct_yaml_int)
_NUMBERS = {
    "int": r"[-+]?(0|[1-9]\d*)$",
    "float": r"[-+]?((\d+\.\d*|\.\d+)([eE][-+]?\d+)?|\d+[eE][-+]?\d+|\.(inf|Inf|INF))$|\.(nan|NaN|NAN)$",
}
for _kind, _pattern in _NUMBERS.items():
    _first = list("-+.0123456789")
    YamlLoader.add_implicit_resolver(f"tag:yaml.org,2002:{_kind}", re.compile(_pattern), _first)


def inside(folder: Path, file: Path) -> bool:
    """Whether a file's content lies in `folder`, symbolic links followed.

    A snapshot in the Hub's cache holds links to the `blobs` next to it, which count as inside.

    Raises InputError: a link leads to itself.
    """
    try:
        real, target = folder.resolve(), file.resolve()
    except RuntimeError as e:  # before Python 3.13
        raise InputError(f"{file} is a link that leads to itself; put there what it should lead to.") from e
    caches = [p.parent / "blobs" for p in real.parents if p.name == "snapshots"]
    return any(target.is_relative_to(p) for p in (real, *caches[:1]))


@contextmanager
def whole(file: Path) -> Iterator[Path]:
    """Gives a path to write a file or a new folder to, which takes the place of `file` at the end.

    A stop, at any moment, or a power cut leaves the old file or the new one, whole.

    Raises InputError where it cannot be written, or no space is left; the old file is untouched.
    """
    part = file.with_name(f"{file.name}.{os.getpid()}.part")
    made = [p for p in file.parents if not p.exists()]
    with _space(file):
        try:
            part.parent.mkdir(parents=True, exist_ok=True)
            yield part
            flush(part)
            part.replace(file)
            flush(file.parent)
        except BaseException:
            with suppress(OSError):
                shutil.rmtree(part) if part.is_dir() else part.unlink(missing_ok=True)
            _remove_empty(made)
            raise


def meant(folder: Path, mark: str) -> str:
    """The folder next to it with such a name that holds a file `mark`, as a question; empty for none."""
    there = {file.parent.name for file in folder.parent.glob(f"*/{mark}")} - {folder.name}
    near = difflib.get_close_matches(folder.name, there, n=1)
    return f"did you mean '{folder.with_name(near[0])}'?" if near else ""


def flush(path: Path) -> None:
    """Has the disk itself hold a file, or the names in a folder, before anything else is written."""
    if sys.platform == "win32" and path.is_dir():
        return  # folders cannot be opened there
    handle = os.open(path, os.O_RDWR if sys.platform == "win32" else os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def check_writable(folder: Path, what: str) -> None:
    """Raises InputError, which says `what`, where a folder cannot be written into; changes nothing."""
    made: list[Path] = []
    try:
        made = [p for p in (folder, *folder.parents) if not p.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"tried")
    except FileExistsError as e:
        kind = "a link that leads nowhere" if folder.is_symlink() and not folder.exists() else "a file"
        raise InputError(f"{what} is {kind}; give a folder.") from e
    except OSError as e:
        remedy = "free some" if e.errno in (errno.ENOSPC, errno.EDQUOT) else "choose another folder"
        raise InputError(f"{what} cannot be written ({e.strerror}); {remedy}.") from e
    finally:
        _remove_empty(made)


def _remove_empty(folders: Iterable[Path]) -> None:
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()


def check_new(folder: Path, what: str) -> None:
    """Raises InputError, which says `what`, where a folder holds something or cannot be written into."""
    check_writable(folder, what)
    if folder.is_dir() and any(folder.iterdir()):
        raise InputError(f"{what} is not empty; give a new folder.")


def check_new_file(file: Path, what: str) -> None:
    """Raises InputError, which says `what`, where a file is there already."""
    if file.exists():
        raise InputError(f"{what} is there already; give a new name, or delete it.")


@contextmanager
def _space(file: Path) -> Iterator[None]:
    try:
        yield
    except (BrokenPipeError, Timeout):
        raise
    except OSError as e:
        if e.errno in (errno.ENOSPC, errno.EDQUOT):
            raise InputError(f"No space is left to write {file}; free some and repeat.") from e
        raise InputError(f"{file} cannot be written ({e.strerror or e}); choose another folder.") from e


@contextmanager
def locked(folder: Path, wait_s: float = LOCK_S) -> Iterator[None]:
    """One process at a time writes into a folder; others wait. It may be nested.

    Raises InputError where another process still writes after `wait_s` seconds.
    """
    with _space(folder):
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder.absolute() / LOCK, is_singleton=True)  # one in a process counts how often
    try:
        with _space(folder), lock.acquire(wait_s):
            yield
    except Timeout as e:
        raise InputError(
            f"Another process has been writing into '{folder}' for {wait_s:.0f} s; wait for it and repeat."
            if wait_s
            else f"Another command is writing into '{folder}'; wait for it and repeat."
        ) from e


@contextmanager
def together(folder: Path, names: Iterable[str] = ()) -> Iterator[Path]:
    """Gives an empty folder, whose files and folders take their places in `folder` together at the end.

    A stop leaves all that was there before, or all that is new. Of `names` those go that are not written
    anew, so that nothing of an earlier run lies next to what it does not belong to. Raises as `whole`.
    """
    made = [p for p in (folder, *folder.parents) if not p.exists()]
    with _space(folder):
        folder.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(prefix=".unfinished-", dir=folder))
    try:
        yield part
        fresh = [p.name for p in part.iterdir()]
        (old := part / ".old").mkdir()

        def settle() -> None:
            for name in {*names, *fresh}:
                new, there = part / name, folder / name
                if name in fresh and not new.exists():
                    continue  # it is in its place
                if there.is_dir() or (name not in fresh and there.exists()):
                    there.rename(old / name)
                if name in fresh:
                    new.replace(there)

        with locked(folder):
            try:
                settle()
            except KeyboardInterrupt:
                settle()
                raise
    finally:
        shutil.rmtree(part, ignore_errors=True)
        _remove_empty(made)


def write_text(file: Path, text: str) -> None:
    """Writes UTF-8, whole or not at all."""
    with whole(file) as part:
        part.write_text(text, encoding="utf-8")


def write_json(file: Path, content) -> None:
    """Writes JSON, whole or not at all; raises ValueError where a number is NaN or infinite."""
    write_text(file, json.dumps(content, indent=1, allow_nan=False) + "\n")


# Others take memory before their size is known (WebP), or run programs (EPS).
FORMATS = ("PNG", "JPEG", "BMP", "TIFF")
MOST_BYTES = 80 * 2**20
MOST_PIXELS = 25_000_000  # 6000 x 4000: decoding takes under 400 MB and half a second
ORIENTATION = 0x0112  # field of EXIF; 1 is upright
MOST_SCANS = 60  # of a JPEG; a progressive one has about 10, and each costs a pass over all pixels
# What PIL's decoders of these formats raise on damaged files.
DAMAGED = (OSError, SyntaxError, ValueError, TypeError, KeyError, IndexError, EOFError, OverflowError)
DAMAGED = (*DAMAGED, struct.error, zlib.error, Image.DecompressionBombError, MemoryError)


def read_image(source: str | Path | bytes, name: str = "", plain: bool = False) -> np.ndarray:
    """RGB uint8 (H, W, 3) of an image file or its content: first its size from the header, then its pixels.

    `name` is what the message calls it, if empty the file; a `plain` one must be RGB with 8 bits a channel.
    Raises InputError where it is too large, damaged, of another format than `FORMATS`, or not plain.
    """
    name = name or str(source)
    size = len(source) if isinstance(source, bytes) else Path(source).stat().st_size
    if size > MOST_BYTES:
        raise InputError(f"{name} has {size / 2**20:.0f} MB, above the limit of {MOST_BYTES // 2**20} MB.")
    if not isinstance(source, bytes):
        refuse_pointer(Path(source))
    data = source if isinstance(source, bytes) else Path(source).read_bytes()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about damaged fields that nothing here reads
            with Image.open(io.BytesIO(data), formats=FORMATS) as image:
                _check_image(image, name, plain)
                _refuse_turned(image, name)
                if image.format == "JPEG" and data.count(b"\xff\xda") > MOST_SCANS:
                    raise InputError(f"{name} has more than {MOST_SCANS} scans; save it again.")
                return np.array(image.convert("RGB"))
    except InputError:
        raise
    except DAMAGED as e:
        reason = (" ".join(f"{e}".split()) or type(e).__name__)[:200].rstrip(".")
        if "BytesIO" in reason:  # PIL names the buffer that it was given
            reason = "it is none of these"
        raise InputError(f"{name} cannot be read as an image ({', '.join(FORMATS)}): {reason}.") from e


def _refuse_turned(image: ImageFile.ImageFile, name: str) -> None:
    """Raises InputError where a viewer turns the picture, whose places would be others than in its pixels."""
    turn = 1
    with suppress(*DAMAGED):  # a damaged field turns nothing
        turn = image.getexif().get(ORIENTATION, 1) if image.format in ("JPEG", "PNG") else 1
    if turn in range(2, 9):
        raise InputError(
            f"{name} is stored turned, and viewers turn it back (EXIF orientation {turn}); save it"
            " upright, as `mogrify -auto-orient` does."
        )


def _check_image(image: ImageFile.ImageFile, name: str, plain: bool) -> None:
    width, height = image.size
    if width * height > MOST_PIXELS:
        raise InputError(
            f"{name} states {width} x {height} pixels, above the limit of {MOST_PIXELS / 1e6:.0f} million;"
            " make it smaller."
        )
    if not plain:
        return
    words = {"L": "grey", "1": "black and white", "P": "a palette", "I": "grey with 32 bits"}
    what = words.get(image.mode)
    if "A" in image.mode:
        what = "with an alpha channel, so not opaque"
    if "16" in image.mode or any("16" in str(tile[3]) for tile in image.tile):
        what = "of 16 bits a channel"
    if what or image.mode not in ("RGB", "YCbCr"):
        raise InputError(f"{name} is {what or image.mode}; convert it to plain RGB with 8 bits a channel.")


def write_image(file: Path, pixels: np.ndarray, **options) -> None:
    """Writes a picture, uint8 (H, W) or (H, W, 3), of the kind its name says; `options` are Pillow's."""
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, Image.registered_extensions()[file.suffix.lower()], **options)
    with whole(file) as part:
        part.write_bytes(data.getvalue())
