"""A gel that a camera looks into: contact by theory, picture by rays; nothing of the twin's gel is in it."""

from pneutac_truths.light.gel import Gel

__all__ = ["Gel"]
