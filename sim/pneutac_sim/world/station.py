"""Where a simulated finger works: a file `station.yaml` of a lab, the paper's station where there is none."""

import dataclasses
import difflib
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pneutac_sim.errors import InputError, shown
from pneutac_sim.files import read_yaml

FORMAT = "pneutac-station/1"


@dataclass(frozen=True)
class Station:
    """A station, in the arm's base frame.

    Attributes:
        workspace_low_m: corner (x, y, z) of the box to which the flange is held with a finger of 110 mm on a
            mount of 20 mm; with what is longer its floor is as much higher.
        workspace_high_m: the opposite corner.
        mount_mm: from the flange to the finger's base.
    """

    workspace_low_m: tuple[float, float, float] = (0.30, -0.20, 0.18)
    workspace_high_m: tuple[float, float, float] = (0.66, 0.20, 0.55)
    mount_mm: float = 20.0

    def __post_init__(self):
        for name in ("workspace_low_m", "workspace_high_m"):
            object.__setattr__(self, name, _corner(getattr(self, name), name))
        if not np.less(self.workspace_low_m, self.workspace_high_m).all():
            raise InputError(
                f"workspace_low_m is {self.workspace_low_m} and workspace_high_m {self.workspace_high_m};"
                " each number of the first must be below that of the second."
            )
        right = isinstance(self.mount_mm, int | float) and not isinstance(self.mount_mm, bool)
        if not (right and 1 <= self.mount_mm <= 200):
            raise InputError(f"mount_mm is {shown(self.mount_mm)}; give 1 to 200 mm.")

    @classmethod
    def load(cls, file: str | Path) -> "Station":
        """Reads a `station.yaml`; fields that are left out are the paper's.

        Raises:
            InputError: one sentence with file, field and what to do.
        """
        file = Path(file)
        if not file.is_file():
            raise InputError(f"There is no file '{file}'; give a station.yaml.")
        content = read_yaml(file)
        if not isinstance(content, dict) or content.pop("format", None) != FORMAT:
            raise InputError(f"{file}: field 'format' must be '{FORMAT}'.")
        names = [f.name for f in dataclasses.fields(cls)]
        for name in content:
            if name not in names:
                near = difflib.get_close_matches(str(name), names, n=1)
                hint = f"is '{near[0]}' meant?" if near else f"the fields are {', '.join(names)}."
                raise InputError(f"{file}: there is no field '{name}'; {hint}")
        try:
            return cls(**content)
        except InputError as e:
            raise InputError(f"{file}: {e}") from e


def _corner(value, name: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(v) for v in value)
        right = all(math.isfinite(v) for v in (x, y, z))
    except (TypeError, ValueError):
        right = False
    if not right:
        raise InputError(f"{name} is {shown(value)}; give three finite numbers of metres, x, y and z.")
    return x, y, z
