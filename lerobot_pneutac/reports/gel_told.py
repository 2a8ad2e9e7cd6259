"""In words: the sensor model, what its presses identify, and which press to add."""

from collections.abc import Sequence

import numpy as np
from PIL import Image

from pneutac_datasets.recording.gel import GelRecording, GelSample
from pneutac_sim.gel.channel import ERROR_LEVELS
from pneutac_sim.gel.layout import LIKE
from pneutac_sim.gel.photograph import PressPhotograph
from pneutac_sim.gel.problem import GelFit
from pneutac_sim.gel.told import Told

ENOUGH_LEVELS = ERROR_LEVELS / 4  # uncertainty besides the model's own error, which no press removes


def make_sentence(fit: GelFit) -> str:
    """The sensor model that was recognised, and by what; empty if none was looked for."""
    if fit.make and fit.by_rest:
        return (
            f"The light is that of a {fit.make}, {fit.orientation}: the rest images correlate by "
            f"{fit.likeness:.2f} (at least {LIKE:g})."
        )
    if fit.make:
        return (
            f"The light may be that of a {fit.make}, {fit.orientation}: its directions in the first "
            "press agree, its rest image does not."
        )
    if fit.likeness is None:
        return ""
    if not fit.likeness:
        return "The sensor is of no known model: the images of all known ones have other proportions."
    return (
        f"The sensor is of no known model: its rest image correlates with the most similar by "
        f"{fit.likeness:.2f}, less than {LIKE:g}."
    )


def told_sentences(told: Told, make: str) -> list[str]:
    """Parameters that the presses do not identify, and the press to add."""
    out = []
    if told.untold:
        colours: dict[str, list[str]] = {}  # of each parameter, from one entry a colour
        for name, colour in (entry.split(" ", 1) for entry in told.untold):
            colours.setdefault(name, []).append(colour.strip("()"))
        shown = ", ".join(f"{name} ({', '.join(c)})" for name, c in colours.items())
        source = f"what other sensors of the make {make} have" if make else "its default"
        out.append(f"The presses do not identify {shown}: each stays near {source}.")
    if told.open_levels < ENOUGH_LEVELS:
        out.append("Another press of this indenter would add little information.")
        return out
    p = told.add
    out.append(
        f"To know more, add a {'deeper press' if told.deeper else 'press'} at the {told.where} "
        f"({p.depth_mm:.2g} mm deep, x {p.x_mm:.1f}, y {p.y_mm:.1f} mm): this press would cut the "
        f"calibration's uncertainty from {told.open_levels:.1f} to {told.then_levels:.1f} grey levels."
    )
    if told.deeper:
        out.append("Contacts deeper than the presses are extrapolated.")
    return out


def moved_sentences(stated: Sequence[PressPhotograph], fit: GelFit) -> list[str]:
    """Where the presses whose place was uncertain were found to be."""
    out = []
    for k, (p, found) in enumerate(zip(stated, fit.presses, strict=True), 1):
        if p.sd:
            moves = [f"{n} {getattr(found, n):.3g} (stated {getattr(p.press, n):.3g})" for n in p.sd]
            out.append(f"Within what its row leaves open, calibration press {k} has {', '.join(moves)}.")
    return out


def residual_sentence(fit: GelFit) -> str:
    """What was added to the light of other sensors' and of the presses' residual fields; empty if nothing."""
    out = []
    if fit.lent:
        share = {0.25: "A quarter", 0.5: "Half"}.get(fit.lent, f"{fit.lent:.0%}")
        out.append(
            f"{share} of what the model leaves over on other sensors of the make {fit.make} is added, which "
            "explains the presses best."
        )
    if fit.gel.residual is not None:
        out.append(
            "What the model leaves over of the presses is learnt too, as far as they bear one another out."
        )
    return " ".join(out)


PICTURES = 6  # held-out images in the picture grid


def picture_grid(data: GelRecording, ours: list[np.ndarray], first: GelSample) -> np.ndarray:
    """Rows recorded, ours, error (grey is none, four times exaggerated); columns rest, first, held-out."""
    heldout = data.heldout
    spaced = np.linspace(0, len(heldout) - 1, PICTURES).astype(int)
    picks = [heldout[i] for i in np.unique(spaced)] if heldout else []
    columns = [_column(data.rest, data.rest)]
    columns += [_column(data.samples[i].image, ours[i]) for i in [data.samples.index(first), *picks]]
    return np.concatenate(columns, axis=1)


def _column(recorded: np.ndarray, ours: np.ndarray) -> np.ndarray:
    error = np.clip(128 + 4.0 * (ours.astype(float) - recorded), 0, 255).astype(np.uint8)
    size = (round(160 * recorded.shape[1] / recorded.shape[0] * 4 / 3), round(160 * 4 / 3))
    small = [Image.fromarray(a).resize(size, Image.Resampling.BOX) for a in (recorded, ours, error)]
    gaps = ((0, 4), (0, 4), (0, 0))  # below and to the right
    return np.concatenate([np.pad(a, gaps, constant_values=255) for a in small])
