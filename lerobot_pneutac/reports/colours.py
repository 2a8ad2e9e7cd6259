"""Colours of all pages and of the studio, one for each meaning, distinct for the colour-blind."""

MEASURED = "#1b2430"
MODEL = BEFORE = "#d1495b"  # the twin as it is
KNOWN = "#8a6fb3"  # with known causes
AFTER = "#0b6e99"  # with all that was found
TRAIN, HELDOUT = "#9bb1c4", "#2a9d8f"
FLOOR = "#e0a100"  # the noise
COMMAND = OTHER = "#9aa5b1"
SHADE = "rgba(155, 177, 196, 0.35)"  # behind the worst passages
CHAMBERS = (AFTER, FLOOR, MODEL)  # of one chamber the first
BAND = "rgba(42, 157, 143, 0.3)"  # of held-out samples
WHISKER = INK = "#333333"  # of intervals, and of text in pictures
PAPER, PALE = "#ffffff", "#cccccc"
SERIES = (AFTER, "#c2410c", "#15803d", "#7e22ce")  # of things without a meaning of their own
