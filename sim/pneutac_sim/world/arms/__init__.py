"""Arms other than the paper's: those of the library, and what says which one carries the finger."""

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pneutac_sim.errors import InputError, shown, unknown_names
from pneutac_sim.features import PANDA_JOINTS
from pneutac_sim.world.arms.chain import Chain
from pneutac_sim.world.panda import Panda

_HERE = Path(__file__).parent


@dataclass(frozen=True)
class ArmFile:
    """An arm described by a URDF or an MJCF.

    Attributes:
        urdf: that file; only its joints count, so its meshes may be missing.
        flange: link of the URDF, or body or site of the MJCF, that carries the finger, z outwards.
        home_rad: joint angles (N,) from the base to there at which the flange points down.
    """

    urdf: str
    flange: str
    home_rad: tuple[float, ...]

    def __post_init__(self):
        for name in ("urdf", "flange"):
            if not isinstance(getattr(self, name), str):
                raise InputError(f"arm.{name} is {shown(getattr(self, name))}; give a text.")
        try:
            angles = tuple(float(q) for q in self.home_rad)
        except (TypeError, ValueError):
            angles = (math.nan,)
        if not all(map(math.isfinite, angles)):
            raise InputError(f"arm.home_rad is {shown(self.home_rad)}; give a finite angle in rad a joint.")
        object.__setattr__(self, "home_rad", angles)

    @property
    def joints(self) -> int:
        return len(self.home_rad)


# The library's arms, and where their bases stand so that they reach what the tasks lay out.
ARMS: dict[str, tuple[ArmFile | None, tuple[float, float, float]]] = {
    "panda": (None, (0.0, 0.0, 0.0)),
    "ur5": (
        ArmFile(str(_HERE / "ur5.urdf"), "tool0", (0.2397, -1.5299, -1.9536, -1.2284, 1.5708, 0.0)),
        (0.0, 0.0, 0.0),
    ),
    "so101": (ArmFile(str(_HERE / "so101.urdf"), "flange", (0.0, 0.48, 0.55, 0.54, 0.0)), (0.29, 0.0, 0.23)),
}


def read_arm(value: Any, folder: Path) -> "ArmFile | str":
    """An arm as a `station.yaml` in `folder` gives it: one of `ARMS`, or the fields of `ArmFile`.

    Raises InputError where it is neither; one sentence.
    """
    if isinstance(value, str) and value in ARMS:
        return value
    names = [f.name for f in dataclasses.fields(ArmFile)]
    for fault in unknown_names(value, names) if isinstance(value, dict) else ():
        raise InputError(f"arm: {fault}")
    if not isinstance(value, dict) or set(value) != set(names):
        raise InputError(
            f"arm is {shown(value)}; give {', '.join(ARMS)}, or a mapping with exactly {', '.join(names)}."
        )
    arm = ArmFile(**value)
    return dataclasses.replace(arm, urdf=str(folder / arm.urdf))


def joints_of(arm: "ArmFile | str") -> int:
    """How many joints an arm has, without its file being read."""
    described = ARMS[arm][0] if isinstance(arm, str) else arm
    return PANDA_JOINTS if described is None else described.joints


def make_arm(arm: "ArmFile | str", base_m: tuple[float, float, float]) -> "Chain | Panda":
    """The arm, its base at `base_m` (3,) of the station.

    Raises InputError where its file is missing or damaged, or it cannot carry a finger; one sentence.
    """
    described = ARMS[arm][0] if isinstance(arm, str) else arm
    if described is None:
        return Panda(base_m)
    return Chain(described.urdf, described.flange, described.home_rad, base_m)
