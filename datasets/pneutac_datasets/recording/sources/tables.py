"""Numbers over time from MATLAB's `.mat` files."""

from pathlib import Path

import numpy as np
import pandas as pd

from pneutac_datasets.recording.sources.columns import read_name
from pneutac_datasets.recording.text_table import TextTable
from pneutac_datasets.recording.wording import cut, listed, shown
from pneutac_sim.errors import InputError
from pneutac_sim.files import refuse_pointer

TIME = "time_s"
MAX_CELLS = 200_000_000


def mat_table(file: Path, time: str = "") -> TextTable:
    """Every numeric vector of a `.mat` file that is as long as its times.

    Fields of a struct are called `struct.field`. A matrix of as many rows (or columns) as there are times
    becomes one column each: `tip_1`, `tip_2` ...

    Args:
        file: of MATLAB's version 7 or earlier.
        time: name of the variable that holds the times; if omitted, the one whose name says so.

    Raises:
        InputError: the file is none of these, or has no such variable.
    """
    from scipy.io import loadmat

    refuse_pointer(file)
    try:
        content = loadmat(file, squeeze_me=True, struct_as_record=False)
    except NotImplementedError as e:
        raise InputError(f"{file} is of version 7.3; save it with MATLAB's option '-v7'.") from e
    except Exception as e:  # what SciPy's reader raises on damaged bytes has no common class
        reason = cut(" ".join(str(e).split()) or type(e).__name__)
        raise InputError(f"{file} is no .mat file, or is damaged ({reason}); save it again.") from e
    flat: dict[str, np.ndarray] = {}
    for name, value in content.items():
        if not name.startswith("__"):
            _flatten(name, value, flat)
    vectors = [n for n, v in flat.items() if v.ndim == 1 and len(v) > 1]
    if not time:
        clocks = [n for n in vectors if n == TIME] or [n for n in vectors if _is_time(n)]
        time = clocks[0] if len(clocks) == 1 else TIME
    if time not in vectors or flat[time].dtype.kind not in "fiub":
        has = listed(f"{shown(n)} {'x'.join(map(str, v.shape))}" for n, v in flat.items()) or "no arrays"
        raise InputError(f"{file} has no vector '{time}' of times; it has {has}. Give its name by --time.")
    count = len(flat[time])
    columns, notes = {time: flat.pop(time).astype(float)}, []
    for name, value in flat.items():
        if value.size > MAX_CELLS:
            raise InputError(f"{file}: '{name}' has {value.size} entries; keep every n-th.")
        if value.ndim == 2 and value.shape[0] != count == value.shape[1]:
            value = value.T
        if value.shape[:1] != (count,) or value.dtype.kind not in "fiub":
            if value.size > 1:
                what = "complex" if value.dtype.kind == "c" else "x".join(map(str, value.shape))
                notes.append(f"{file}: {shown(name)} ({what}) is left out; '{time}' has {count} entries.")
            continue
        if value.ndim == 1:
            columns[name] = value.astype(float)
        elif value.ndim == 2:
            columns |= {f"{name}_{i + 1}": column.astype(float) for i, column in enumerate(value.T)}
    return TextTable(file, pd.DataFrame(columns), {}, np.arange(count) + 1, "MATLAB", notes)


def _is_time(name: str) -> bool:
    return read_name(name.rpartition(".")[2]).kind == "time"


def _flatten(name: str, value, into: dict[str, np.ndarray]) -> None:
    """Numeric arrays of a value by name; other kinds are left out."""
    if hasattr(value, "_fieldnames"):
        for entry in value._fieldnames:
            _flatten(f"{name}.{entry}", getattr(value, entry), into)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiubc" and value.ndim in (1, 2):
        into[name] = value
