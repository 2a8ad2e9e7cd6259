"""Numbers over time from MATLAB's `.mat` files and from plain CSV."""

from pathlib import Path

import numpy as np

from pneutac_datasets.recording.reading import MAX_CELLS, read_csv
from pneutac_datasets.recording.sources.tracks import Source
from pneutac_sim.errors import InputError

TIME = "time_s"


def read_mat(file: Path, time: str = TIME) -> Source:
    """Every numeric vector of a `.mat` file; fields of a struct are called `struct.field`.

    A matrix of as many rows (or columns) as there are times becomes one column each: `tip_1`, `tip_2` ...

    Args:
        file: of MATLAB's version 7 or earlier.
        time: name of the variable that holds the times, s.

    Raises:
        InputError: the file is none of these, or has no such variable.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        content = loadmat(file, squeeze_me=True, struct_as_record=False)
    except NotImplementedError as e:
        raise InputError(f"{file} is of version 7.3; save it with MATLAB's option '-v7'.") from e
    except (MatReadError, ValueError, TypeError, OSError) as e:
        raise InputError(f"{file} is no .mat file ({e}); save it anew.") from e
    flat: dict[str, np.ndarray] = {}
    for name, value in content.items():
        if not name.startswith("__"):
            _flatten(name, value, flat)
    if time not in flat or flat[time].ndim != 1:
        raise InputError(f"{file} has no vector '{time}'; it has {', '.join(flat)}. Give its name by --time.")
    times = flat.pop(time).astype(float)
    source = Source(file)
    for name, value in flat.items():
        if value.size > MAX_CELLS:
            raise InputError(f"{file}: '{name}' has {value.size} entries; keep every n-th.")
        if value.ndim == 2 and value.shape[0] != len(times) == value.shape[1]:
            value = value.T
        if value.ndim == 1 and len(value) == len(times):
            source.columns[name] = times, value
        elif value.ndim == 2 and len(value) == len(times):
            source.columns |= {f"{name}_{i + 1}": (times, column) for i, column in enumerate(value.T)}
    return source


def read_log(file: Path, time: str = TIME) -> Source:
    """Every column of a CSV with a header; raises InputError where it has no column of times."""
    table = read_csv(file)
    if time not in table:
        raise InputError(
            f"{file} has no column '{time}'; it has {', '.join(table)}. Give its name by --time."
        )
    times = table[time].to_numpy(float)
    return Source(file, {}, {str(c): (times, table[c].to_numpy()) for c in table if c != time})


def _flatten(name: str, value, into: dict[str, np.ndarray]) -> None:
    """Numeric arrays of a value by name; other kinds are left out."""
    if hasattr(value, "_fieldnames"):
        for entry in value._fieldnames:
            _flatten(f"{name}.{entry}", getattr(value, entry), into)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and value.ndim in (1, 2):
        into[name] = value
