"""Pressure controllers side by side, one a chamber, as one."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

import numpy as np

from lerobot_robot_pneutac.hardware.parts import HardwareFault, PressureController


class Chambers:
    """One controller a chamber; whatever goes wrong with one vents all.

    A command of each is void after `parts.COMMAND_S`, so all are vented also where the caller stops.

    Args:
        controllers: of the chambers, in their order.
        same_limit: whether another highest set-point than the first one's is a fault.
    """

    def __init__(self, controllers: Sequence[PressureController], same_limit: bool = True):
        self.controllers = tuple(controllers)
        self._same_limit = same_limit

    @classmethod
    def of(cls, pressure: "PressureController | Chambers") -> "Chambers":
        """One controller as that of one chamber; several as they are."""
        return pressure if isinstance(pressure, cls) else cls([pressure])

    def __len__(self) -> int:
        return len(self.controllers)

    @property
    def max_kpa(self) -> np.ndarray:
        """(chambers,) highest set-points; raises HardwareFault before `connect`."""
        return np.array([c.max_kpa for c in self.controllers], float)

    @property
    def min_kpa(self) -> np.ndarray:
        """(chambers,) lowest set-points."""
        return np.array([getattr(c, "min_kpa", 0.0) for c in self.controllers], float)

    def connect(self) -> None:
        """Connects all; the chambers stay vented.

        Raises HardwareFault: one cannot be used, or its limit is not that of the others; all are let go
        again.
        """
        try:
            for c in self.controllers:
                c.connect()
            if self._same_limit and len(self) > 1 and len(set(self.max_kpa)) > 1:
                limits = ", ".join(f"{x:g}" for x in self.max_kpa)
                raise HardwareFault(
                    f"The chambers' pressure controllers have different limits, {limits} kPa; give one for"
                    " all in the options, such as {max_kpa: 15}, or each its own, such as"
                    " {max_kpa: [15, 20, 15]}."
                )
        except BaseException:
            with suppress(Exception):
                self.disconnect()
            raise

    def set_pressure(self, kpa: np.ndarray) -> None:
        """Sets the targets (chambers,) in kPa; returns at once.

        Raises:
            InputError: as a controller's own; all are vented.
            HardwareFault: likewise.
        """
        with self._vented_after():
            for c, target in zip(self.controllers, kpa, strict=True):
                c.set_pressure(float(target))

    def pressure(self) -> np.ndarray:
        """The newest measured pressures (chambers,), kPa; raises as `set_pressure`."""
        with self._vented_after():
            return np.array([c.pressure() for c in self.controllers], float)

    def vent(self) -> None:
        """Opens all chambers to the room; what a controller raises, which none should, comes after all."""
        self._each("vent")

    def disconnect(self) -> None:
        """Vents all, and only then lets go of one after the other; raises as `vent`."""
        try:
            if len(self) > 1:
                self.vent()
        finally:
            self._each("disconnect")

    def _each(self, method: str) -> None:
        faults = []
        for c in self.controllers:
            try:
                getattr(c, method)()
            except Exception as e:
                faults.append(e)
        if faults:
            raise faults[0]

    @contextmanager
    def _vented_after(self) -> Iterator[None]:
        """Vents all chambers before an exception goes on."""
        try:
            yield
        except BaseException:
            if len(self) > 1:  # one controller alone does as its maker thinks right
                with suppress(Exception):
                    self.vent()
            raise
