"""The face of a gel of material points under the presses of a bench recording.

A press at a share of its depth is what `GelModel.depth_scale` means: the camera sees the indenter as if it
had gone in by that share.
"""

from dataclasses import replace

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.mpm import devices
from pneutac_sim.mpm.figure import SAMPLES, distances_m
from pneutac_sim.mpm.solve import MpmDiverged, solve_equilibrium
from pneutac_sim.twin import Twin

STEP_MM = 0.35  # that an indenter goes in by at a time, since friction makes the gel remember its way
SHARES = np.linspace(0.5, 1.0, 6)  # of a press's depth, between which `between` interpolates


class PressedGel:
    """One gel, pressed again and again, each time from rest.

    Args:
        gel: gives the window; the lattice is that of `devices.gel`.
        twin: gives elasticity, Poisson's ratio and density, where it has them.
        device: see `runtime.start`.
    """

    def __init__(self, gel: GelModel, twin: Twin, device: str = "auto"):
        own = twin.copy()
        gel.into_twin(own)
        self._window = gel.window_mm
        self._solver = devices.gel(own, device=device, table=np.zeros((SAMPLES,) * 3))
        self._seen: list[tuple[Press, np.ndarray]] = []

    def surface(self, press: Press, share: float = 1.0) -> np.ndarray:
        """Displacement in mm, float32 (80, 59), under a press at a share of its depth.

        Raises:
            InputError: the gel finds no rest.
        """
        return self._surfaces(press, np.array([share]))[0]

    def between(self, press: Press, share: float) -> np.ndarray:
        """The same for a share from 0.5 to 1, interpolated between six that are stored for each press."""
        found = [kept for seen, kept in self._seen if seen is press]
        if not found:
            found = [self._surfaces(press, SHARES)]
            self._seen.append((press, found[0]))
        k = int(np.clip(np.searchsorted(SHARES, share) - 1, 0, len(SHARES) - 2))
        part = np.float32((share - SHARES[k]) / (SHARES[k + 1] - SHARES[k]))
        return (1 - part) * found[0][k] + part * found[0][k + 1]

    def _surfaces(self, press: Press, shares: np.ndarray) -> np.ndarray:
        """(K, 80, 59) on the way in; the explicit steps are halved once where they are too long."""
        if press.figure is not None:
            self._solver.set_table(distances_m(press.figure))
        longest = self._solver.stable_dt
        try:
            return self._driven(press, shares)
        except MpmDiverged:
            self._solver.stable_dt = 0.5 * longest
        try:
            return self._driven(press, shares)
        except MpmDiverged as e:
            raise InputError(
                f"{e.finding}, under the {press.indenter} pressed {press.depth_mm:.3g} mm deep; correct its "
                "depth, or calibrate without through=mpm."
            ) from e
        finally:
            self._solver.stable_dt = longest

    def _driven(self, press: Press, shares: np.ndarray) -> np.ndarray:
        out, at = [], 0.0
        for depth in shares * press.depth_mm:
            for d in np.linspace(at, depth, int(np.ceil((depth - at) / STEP_MM)) + 1)[1:]:
                part = devices.press_loads(replace(press, depth_mm=float(d)))
                solve_equilibrium(self._solver, part, warm=at > 0)
                at = float(d)
            out.append(devices.surface_displacement(self._solver, self._window)[0].astype(np.float32))
        return np.stack(out)
