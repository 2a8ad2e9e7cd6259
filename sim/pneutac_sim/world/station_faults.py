"""Everything that is wrong with a station at once, where loading it stops at the first fault."""

import dataclasses
from pathlib import Path
from typing import Any

from pneutac_sim.errors import InputError
from pneutac_sim.files import read_yaml
from pneutac_sim.world.arms import read_arm
from pneutac_sim.world.station import FORMAT, Station, check_corner, unknown_field

CORNERS = ("workspace_low_m", "workspace_high_m", "home_m")  # each is judged by the others too


def station_faults(file: str | Path) -> list[str]:
    """One sentence for each fault of a `station.yaml`.

    Raises:
        InputError: it cannot be read at all.
    """
    file = Path(file)
    content = read_yaml(file)
    if not isinstance(content, dict):
        return [f"{file}: field 'format' must be '{FORMAT}'."]
    found, good = [], {}
    if content.pop("format", None) != FORMAT:
        found.append(f"{file}: field 'format' must be '{FORMAT}'.")
    names = [f.name for f in dataclasses.fields(Station)]
    for name, value in content.items():
        try:
            if name not in names:
                raise InputError(unknown_field(name, names))
            good[name] = _alone(name, value, file.parent)
        except InputError as e:
            found.append(f"{file}: {e}")
    try:
        Station(**good).make_arm()
    except InputError as e:
        found.append(f"{file}: {e}")
    return found


def _alone(name: str, value: Any, folder: Path) -> Any:
    """A field as a station takes it; raises InputError where it is wrong whatever the others are."""
    if name in CORNERS:
        return None if value is None and name == "home_m" else check_corner(value, name)
    value = read_arm(value, folder) if name == "arm" else value
    Station(**{name: value})
    return value
