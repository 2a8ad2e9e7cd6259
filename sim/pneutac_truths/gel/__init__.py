"""A gel by finite elements, seen by ray tracing: bench recordings with known surface and light."""

from pneutac_truths.gel.session import GEL_EFFECTS, write_gel

__all__ = ["GEL_EFFECTS", "write_gel"]
