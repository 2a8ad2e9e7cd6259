"""Colours of the pages and of the studio, told apart by the colour-blind."""

MEASURED, MODEL, TRAIN, HELDOUT, FLOOR = "#1b2430", "#d1495b", "#9bb1c4", "#0b6e99", "#e0a100"
CHAMBERS = (HELDOUT, FLOOR, MODEL)  # of one chamber the first
