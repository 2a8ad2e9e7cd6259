"""A gel by finite elements, seen by ray tracing: bench recordings with known surface and light."""

from pneutac_truths.gel.faults import GEL_EFFECTS
from pneutac_truths.gel.session import write_gel

__all__ = ["GEL_EFFECTS", "write_gel"]
