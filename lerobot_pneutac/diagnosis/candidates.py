"""Which effects a recording can test, and which column the others need."""

from dataclasses import dataclass

import numpy as np

from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.laws import is_law, law, law_names
from pneutac_sim.effects.registry import body_effects
from pneutac_sim.finger.inputs import conditions_of
from pneutac_sim.twin import Twin

LEAST_CHANGE = {"temperature_c": 1.0, "payload_g": 1e-3}  # below this a condition is as good as constant


@dataclass
class Untested:
    """An effect that this recording cannot test.

    Attributes:
        name: the effect.
        reason: what is missing, a sentence with the remedy.
    """

    name: str
    reason: str


def sort_candidates(recording: Recording, twin: Twin) -> tuple[list[str], list[Untested]]:
    """Effects to try and those that cannot be tried; what the twin has already is in neither."""
    names, untested = [], []
    known = conditions_of(recording.samples, recording.device)
    marked = any(recording.has(f"tip_{a}_mm") for a in "xyz")
    for name, effect in (body_effects() | {n: law(n) for n in law_names()}).items():
        if name in twin.effects and not is_law(name):
            continue
        if is_law(name) and not can_act(name, recording, marked, known):
            continue
        missing = [c for c in effect.columns if c not in known]
        if any(c.startswith("other_") for c in missing):
            continue  # there is no other chamber on record, so none whose effect could be missing
        constant = [
            c
            for c in effect.columns
            if c in LEAST_CHANGE and recording.has(c) and np.ptp(recording.column(c)) < LEAST_CHANGE[c]
        ]
        if missing:
            untested.append(Untested(name, f"cannot be tested, record column {', '.join(missing)}"))
        elif constant:
            untested.append(Untested(name, f"cannot be tested, column {constant[0]} hardly changes: vary it"))
        elif effect.of_markers and not marked:
            untested.append(Untested(name, "cannot be tested on angles, record tip_x_mm, tip_y_mm, tip_z_mm"))
        else:
            names.append(name)
    return names, untested


def can_act(name: str, recording: Recording, marked: bool, known: set[str]) -> bool:
    """Whether a law can show in a recording; one that cannot is not worth a word."""
    effect = law(name)
    if any(c not in known for c in effect.columns):
        return False
    if any(
        np.ptp(recording.column(c)) < LEAST_CHANGE.get(c, 0.1) for c in effect.columns if recording.has(c)
    ):
        return False
    if name.startswith("bend"):
        return not marked
    return marked or not effect.of_markers or name == "tracker_lag"
