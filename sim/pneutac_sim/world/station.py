"""Where a simulated finger works: a file `station.yaml` of a lab, the paper's station where there is none."""

import dataclasses
import math
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from pneutac_sim.errors import InputError, as_numbers, check_between, shown, unknown_names
from pneutac_sim.features import CONTROL_HZ, PAPER_LENGTH_MM, RATES_HZ
from pneutac_sim.files import read_fields, read_yaml, whole
from pneutac_sim.world.arms import ARMS, ArmFile, Chain, joints_of, make_arm, read_arm
from pneutac_sim.world.panda import Panda

MOST_LATE_S = 1.0
FARTHEST_M = 10.0  # no arm on a table works farther from its origin
MISSING_M = 0.003  # by which a place that is out of the arm's reach is missed
FORMAT = "pneutac-station/1"
FILE = "station.yaml"


@dataclass(frozen=True)
class Station:
    """A station. Its origin lies on the table, x forwards and z up; the tasks are laid out in its frame."""

    # corner (x, y, z) of the box to which the flange is held with a finger of 110 mm on a mount of 20 mm;
    # with what is longer its floor is as much higher
    workspace_low_m: tuple[float, float, float] = (0.30, -0.20, 0.18)
    workspace_high_m: tuple[float, float, float] = (0.66, 0.20, 0.55)  # the opposite corner
    mount_mm: float = 20.0  # from the flange to the finger's base
    arm: ArmFile | str = "panda"  # `panda`, `ur5`, `so101`, or an arm's own description
    # where the arm's base stands (x, y, z), so that the table is at -z in the arm's own frame; if omitted,
    # the origin, and for `so101` where it reaches the tasks
    base_m: tuple[float, float, float] | None = None
    # where the flange starts (x, y, z) in place of the task's own start
    home_m: tuple[float, float, float] | None = None
    latency_s: float = 0.0  # by which commands act late, in whole control steps
    control_hz: int = CONTROL_HZ  # control rate, a whole number of Hz; demonstrations are recorded at it

    def __post_init__(self):
        if self.base_m is None:
            base_m = ARMS[self.arm][1] if isinstance(self.arm, str) else (0.0, 0.0, 0.0)
            object.__setattr__(self, "base_m", base_m)
        for name in (
            "workspace_low_m",
            "workspace_high_m",
            "base_m",
            *["home_m"] * (self.home_m is not None),
        ):
            object.__setattr__(self, name, check_corner(getattr(self, name), name))
        if not np.less(self.workspace_low_m, self.workspace_high_m).all():
            raise InputError(
                f"workspace_low_m is {self.workspace_low_m} and workspace_high_m {self.workspace_high_m};"
                " each number of the first must be below that of the second."
            )
        for name, low, high, unit in (("mount_mm", 1, 200, "mm"), ("latency_s", 0, MOST_LATE_S, "s")):
            check_between(low, high, unit, **{name: getattr(self, name)})
        low, high = RATES_HZ
        whole = isinstance(self.control_hz, int) and not isinstance(self.control_hz, bool)
        if not (whole and low <= self.control_hz <= high):
            raise InputError(
                f"control_hz is {shown(self.control_hz)}; give a whole number from {low} to {high} Hz."
            )
        inside = np.clip(self.home_m or self.workspace_low_m, self.workspace_low_m, self.workspace_high_m)
        if self.home_m is not None and (inside != self.home_m).any():
            raise InputError(
                f"home_m is {self.home_m}, outside the workspace, {self.workspace_low_m} to"
                f" {self.workspace_high_m}."
            )

    @property
    def late_commands(self) -> int:
        return self.steps(self.latency_s)

    @property
    def dt_s(self) -> float:
        return 1 / self.control_hz

    def steps(self, seconds: float) -> int:
        """Control steps that come nearest to a duration."""
        return round(seconds * self.control_hz)

    def box_m(self, length_mm: float) -> tuple[np.ndarray, np.ndarray]:
        """Corners (3,) of the flange's box with a finger of that length."""
        longer_mm = length_mm - PAPER_LENGTH_MM + self.mount_mm - Station.mount_mm
        lift_m = np.array([0.0, 0.0, 1e-3 * longer_mm])
        return self.workspace_low_m + lift_m, np.array(self.workspace_high_m)

    @property
    def joints(self) -> int:
        return joints_of(self.arm)

    def make_arm(self) -> Chain | Panda:
        """The arm; raises InputError where its file is missing or damaged, or it cannot carry a finger."""
        return make_arm(self.arm, self.base_m)

    @classmethod
    def load(cls, file: str | Path) -> "Station":
        """Reads a `station.yaml`; fields that are left out are the paper's.

        Raises InputError: one sentence with file, field and what to do.
        """
        file = Path(file)
        if not file.is_file():
            raise InputError(f"There is no file '{file}'; give a station.yaml.")
        content = read_fields(file, ("format", *(f.name for f in dataclasses.fields(cls))))
        if content.pop("format", None) != FORMAT:
            raise InputError(f"{file}: field 'format' must be '{FORMAT}'.")
        try:
            if "arm" in content:
                content["arm"] = read_arm(content["arm"], file.parent)
            return cls(**content)
        except InputError as e:
            raise InputError(f"{file}: {e}") from e

    def save(self, folder: str | Path) -> None:
        """Writes `station.yaml` into a folder, and a copy of the arm's own file."""
        content = {name: value for name, value in dataclasses.asdict(self).items() if value is not None}
        if isinstance(self.arm, ArmFile):
            file = Path(folder) / f"arm{Path(self.arm.urdf).suffix}"
            shutil.copyfile(self.arm.urdf, file)
            content["arm"]["urdf"] = file.name
        with whole(Path(folder) / FILE) as part:
            part.write_text(yaml.safe_dump({"format": FORMAT} | content, sort_keys=False))


def station_of(dataset: str | Path, given: Path | None = None) -> Station | None:
    """The station of a dataset's folder: of the file that is given, or that its robot left in its `meta`.

    None where there is neither: it was the paper's. Raises InputError where the file is damaged.
    """
    left = Path(dataset) / "meta" / FILE
    file = given or (left if left.exists() or left.is_symlink() else None)
    return Station.load(file) if file else None


def check_corner(value, name: str) -> tuple[float, float, float]:
    """Three numbers of metres; raises InputError where they are none."""
    try:
        x, y, z = as_numbers(value)
        right = all(math.isfinite(v) for v in (x, y, z))
    except (TypeError, ValueError):
        right = False
    if not right:
        raise InputError(f"{name} is {shown(value)}; give three finite numbers of metres, x, y and z.")
    if max(map(abs, (x, y, z))) > FARTHEST_M:
        raise InputError(f"{name} is {shown(value)}, which can only be millimetres; divide it by 1000.")
    return x, y, z


CORNERS = ("workspace_low_m", "workspace_high_m", "home_m")  # each is judged by the others too


def station_faults(file: str | Path) -> list[str]:
    """One sentence for each fault of a `station.yaml`; raises InputError where it cannot be read at all."""
    file = Path(file)
    content = read_yaml(file)
    if file.name == "twin.yaml":
        return [f"{file} is a twin's; give its folder, {file.parent}."]
    if not content or not isinstance(content, dict):
        what = "is empty" if not content else "holds no fields"
        return [f"{file} {what}; its first line is `format: {FORMAT}`."]
    found, good = [], {}
    if content.pop("format", None) != FORMAT:
        found.append(f"{file}: field 'format' must be '{FORMAT}'.")
    names = [f.name for f in dataclasses.fields(Station)]
    found += [f"{file}: {fault}" for fault in unknown_names(content, names)]
    for name, value in ((k, v) for k, v in content.items() if k in names):
        try:
            good[name] = _alone(name, value, file.parent)
        except InputError as e:
            found.append(f"{file}: {e}")
    try:
        Station(**good).make_arm()
    except InputError as e:
        found.append(f"{file}: {e}")
    return found


def _alone(name: str, value: Any, folder: Path) -> Any:
    if name in CORNERS:
        return None if value is None and name == "home_m" else check_corner(value, name)
    value = read_arm(value, folder) if name == "arm" else value
    Station(**{name: value})
    return value
