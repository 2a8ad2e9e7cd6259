"""Parquet files whose writer was killed: complete row groups are read again by a footer made again.

A Parquet file lists at its end where its columns lie. LeRobot keeps one file open for many episodes, one row
group each, and so writes that end when the recording ends. Each column is a row of pages, however, and each
page begins with a header with its length, so that a file without an end can be walked from its start.
Numbers of fields are those of the format's `parquet.thrift`; the encoding is Thrift's compact protocol.
"""

import io
import shutil
import struct
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from pneutac_sim.errors import InputError
from pneutac_sim.files import whole

MAGIC = b"PAR1"
BOOLS = BOOL_TRUE, BOOL_FALSE = 1, 2
BYTE, I16, I32, I64, DOUBLE, BINARY, LIST, SET, _, STRUCT = range(3, 13)
PAGE_BYTES = 2**31  # a page states its length in 31 bits
HEADER_BYTES = 2**16  # far more than a page's header has; statistics of long texts are cut by the writer


@dataclass(frozen=True)
class Page:
    """One page: where it begins and ends in the file, whether it is a dictionary, how many values it has."""

    begin: int
    end: int
    dictionary: bool
    values: int
    uncompressed: int  # bytes with its header, as the footer counts them


def is_whole(file: Path) -> bool:
    """Whether a Parquet file has its end and can be opened."""
    try:
        pq.read_metadata(file)
    except (pa.ArrowInvalid, OSError):
        return False
    return True


def fix_footer(file: Path, schema: pa.Schema, out: Path) -> tuple[int, int]:
    """Writes the complete row groups of a file without a footer to `out`, with a footer.

    The file is as `pyarrow.parquet.ParquetWriter` wrote it with dictionaries, one row group a call; `schema`
    is of the tables that were written. Returns the number of row groups, and how many bytes follow them;
    where none is complete `out` is not written. Raises InputError where a column is written without a
    dictionary.
    """
    footer = _template(schema)
    chunks = footer[4][1][1][0][1][1][1]  # row_groups -> the only one -> columns
    groups = _row_groups(_pages(file), len(chunks))
    if not groups:
        return 0, max(0, file.stat().st_size - len(MAGIC))
    footer[3] = (I64, sum(map(_rows, groups)))
    footer[4] = (LIST, (STRUCT, [_row_group(chunks, group) for group in groups]))
    tail = _struct(footer)
    end = groups[-1][-1][-1].end
    with whole(out) as part, file.open("rb") as old, part.open("wb") as new:
        shutil.copyfileobj(old, new)
        new.truncate(end)
        new.seek(end)
        new.write(tail + struct.pack("<I", len(tail)) + MAGIC)
    return len(groups), file.stat().st_size - end


def _template(schema: pa.Schema) -> dict:
    """The footer of a file with one row of this schema."""
    if any(pa.types.is_boolean(f.type) for f in schema):
        raise InputError("A dataset with features of true and false cannot be repaired.")
    sink = io.BytesIO()
    with pq.ParquetWriter(sink, schema, compression="snappy", use_dictionary=True) as writer:
        writer.write_table(pa.table([pa.nulls(1, f.type) for f in schema], schema=schema))
    data = sink.getvalue()
    (length,) = struct.unpack("<I", data[-8:-4])
    return _read_struct(io.BytesIO(data[-8 - length : -8]))


def _pages(file: Path) -> list[Page]:
    """All pages that are in the file to their last byte."""
    size, pages = file.stat().st_size, []
    with file.open("rb") as f:
        if f.read(4) != MAGIC:
            return []
        while True:
            begin = f.tell()
            try:
                head = io.BytesIO(f.read(HEADER_BYTES))
                fields = _read_struct(head)
                length, uncompressed = fields[3][1], fields[2][1]
                dictionary = 7 in fields
                values = fields[7 if dictionary else 5][1][1][1]
            except (EOFError, KeyError, IndexError, TypeError, struct.error):
                return pages
            end = begin + head.tell() + length
            if not 0 <= length < PAGE_BYTES or end > size:
                return pages
            pages.append(Page(begin, end, dictionary, values, head.tell() + uncompressed))
            f.seek(end)


def _row_groups(pages: list[Page], columns: int) -> list[list[list[Page]]]:
    """Complete row groups as row group, column, page: each column begins with its dictionary."""
    chunks: list[list[Page]] = []
    for page in pages:
        if page.dictionary:
            chunks.append([])
        if not chunks:
            return []
        chunks[-1].append(page)
    groups = [chunks[i : i + columns] for i in range(0, len(chunks), columns)]
    return [g for g in groups if len(g) == columns and _values(g[-1]) == _rows(g) > 0]


def _values(chunk: list[Page]) -> int:
    return sum(p.values for p in chunk if not p.dictionary)


def _rows(group: list[list[Page]]) -> int:
    """Rows of a row group: a scalar has as many values, a vector more."""
    return min(_values(chunk) for chunk in group)


def _row_group(template: list[dict], group: list[list[Page]]) -> dict:
    """A footer's `RowGroup` by the template's columns and the pages that were found."""
    columns, total = [], 0
    for column, pages in zip(template, group, strict=True):
        meta = {k: v for k, v in column[3][1].items() if k in (1, 2, 3, 4)}  # type, encodings, path, codec
        uncompressed = sum(p.uncompressed for p in pages)
        meta |= {5: (I64, _values(pages)), 6: (I64, uncompressed), 7: (I64, pages[-1].end - pages[0].begin)}
        meta |= {9: (I64, pages[1].begin), 11: (I64, pages[0].begin)}  # first data page, dictionary
        columns.append({2: (I64, pages[0].begin), 3: (STRUCT, meta)})
        total += uncompressed
    return {1: (LIST, (STRUCT, columns)), 2: (I64, total), 3: (I64, _rows(group))}


# ---------------------------------------------------------------- Thrift's compact protocol
# A struct is {field: (type, value)}, a list (type of its elements, values); numbers are zigzag varints. Of a
# field the type alone says true or false; a double stays as its bytes.


def _read_struct(data: io.BytesIO) -> dict:
    fields, number = {}, 0
    while head := _exactly(data, 1)[0]:
        number = number + (head >> 4) if head >> 4 else _read(data, I64)
        kind = head & 15
        fields[number] = (kind, kind == BOOL_TRUE if kind in BOOLS else _read(data, kind))
    return fields


def _read(data: io.BytesIO, kind: int):
    if kind in (*BOOLS, BYTE):  # as elements of lists
        return _exactly(data, 1)[0]
    if kind in (I16, I32, I64):
        value = _read_varint(data)
        return (value >> 1) ^ -(value & 1)
    if kind in (DOUBLE, BINARY):
        return _exactly(data, 8 if kind == DOUBLE else _read_varint(data))
    if kind in (LIST, SET):
        head = _exactly(data, 1)[0]
        length = head >> 4 if head >> 4 < 15 else _read_varint(data)
        return head & 15, [_read(data, head & 15) for _ in range(length)]
    if kind == STRUCT:
        return _read_struct(data)
    raise EOFError(f"no page begins here: Thrift has no type {kind} in Parquet")


def _exactly(data: io.BytesIO, n: int) -> bytes:
    found = data.read(n)
    if len(found) != n:
        raise EOFError("the file ends here")
    return found


def _read_varint(data: io.BytesIO) -> int:
    value = shift = 0
    while True:
        byte = _exactly(data, 1)[0]
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            return value


def _struct(fields: dict) -> bytes:
    out, last = b"", 0
    for number, (kind, value) in sorted(fields.items()):
        kind = (BOOL_FALSE, BOOL_TRUE)[bool(value)] if kind in BOOLS else kind
        step = number - last
        out += bytes([step << 4 | kind]) if step < 16 else bytes([kind]) + _bytes(I64, number)
        out += b"" if kind in BOOLS else _bytes(kind, value)
        last = number
    return out + b"\0"


def _bytes(kind: int, value) -> bytes:
    if kind in (*BOOLS, BYTE):
        return bytes([value])
    if kind in (I16, I32, I64):
        return _varint(value << 1 if value >= 0 else (-value << 1) - 1)
    if kind in (LIST, SET):
        element, values = value
        long = _varint(len(values)) if len(values) >= 15 else b""
        head = bytes([min(len(values), 15) << 4 | element]) + long
        return head + b"".join(_bytes(element, v) for v in values)
    if kind == STRUCT:
        return _struct(value)
    return _varint(len(value)) + value if kind == BINARY else value


def _varint(value: int) -> bytes:
    return bytes([value]) if value < 128 else bytes([value & 127 | 128]) + _varint(value >> 7)
