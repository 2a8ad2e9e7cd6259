"""Which optics effect a gel lacks, and where in the image it fails, as a result."""

import time
from dataclasses import dataclass

import numpy as np

from lerobot_pneutac.reports.page import Report
from lerobot_pneutac.reports.sentences import percent
from lerobot_pneutac.study.gel import GelFindings, Trial, maps, seen_by, study
from lerobot_pneutac.verbs.diagnosis import Diagnosis
from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import get_effect, of_sensor
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import check_pair
from pneutac_sim.twin import Twin

MAP_GAIN = 4.0  # maps are shown this many times brighter


@dataclass(frozen=True, eq=False)
class GelDiagnosis(Diagnosis):
    """What a gel lacks.

    Attributes:
        found: everything that was found.
        seconds: wall time.
    """

    found: GelFindings
    seconds: float

    verdict = property(lambda self: self.found.verdict)
    selected = property(lambda self: self.found.selected)
    findings = property(lambda self: self.found.data.warnings)

    @property
    def title(self) -> str:
        """Heading of the table."""
        return f"held-out error, levels (noise {self.found.noise:.3g})"

    @property
    def sentence(self) -> str:
        """What was found."""
        return lead(self.found)

    @property
    def next_experiment(self) -> str:
        """What to record next."""
        return advice(self.found)

    def rows(self) -> list[dict]:
        """Each effect."""
        s, result = self.found, self.to_dict()
        base, after = result["baseline"], result["after"]
        heads = ("effect", "whole image", "contact", "avoidable error removed", "")
        rows = [("(as it is)", f"{base['heldout']:.3g}", f"{base['heldout_contact']:.3g}", "", "")]
        for e in sorted(result["effects"], key=lambda e: e["heldout"]):
            added = e["reduction"] is not None
            how = "found" if e["name"] in s.selected else "" if added else "in the twin; error without it"
            share = percent(e["reduction"], e["reduction_ci95"]) if added else ""
            rows.append((e["name"], f"{e['heldout']:.3g}", f"{e['heldout_contact']:.3g}", share, how))
        if s.selected:
            rows.append(("(all found)", f"{after['heldout']:.3g}", f"{after['heldout_contact']:.3g}", "", ""))
        return [dict(zip(heads, row, strict=True)) for row in rows]

    def remarks(self) -> list[str]:
        """What was fitted to what, the next experiment, the verdict."""
        return [
            refitted(self.found, self.to_dict()),
            f"[bold]Next experiment:[/] {self.next_experiment}",
            f"verdict: {self.verdict}   ({self.seconds:.0f} s)",
        ]

    def to_dict(self) -> dict:
        """The content of `result.json`."""
        return _result(self.found, self.seconds)

    def page(self) -> Report:
        """The ladder, and where in the image the twin fails."""
        return gel_page(self.found, self.to_dict())


def load_gel(twin: Twin, recording: Recording) -> tuple[GelModel, GelRecording]:
    """The gel as the recording's images show it, and the recording, whose calibration pair is checked.

    Raises:
        InputError: there is no calibration pair, or it cannot be one.
    """
    data = GelRecording.load(recording)
    sample = data.calibration
    check_pair(sample.rest, sample.image, sample.press, data.px_per_mm)
    return seen_by(GelModel.from_twin(twin), data), data


def own_effects(twin: Twin) -> list[str]:
    """Optics effects that the twin has."""
    return of_sensor(twin.effects)


def diagnose_gel(twin: Twin, recording: Recording, seed: int, tell, done) -> GelDiagnosis:
    """Studies the recording."""
    start = time.monotonic()
    gel, data = load_gel(twin, recording)
    found = study(gel, data, own_effects(twin), seed, tell, done)
    return GelDiagnosis(found, time.monotonic() - start)


def _result(s: GelFindings, seconds: float) -> dict:
    base, final = s.base, s.ladder[-1]

    def errors(trial: Trial) -> dict:
        held = ~s.train
        return {
            "train": float(np.sqrt(trial.squares[s.train].mean())),
            "heldout": s.heldout(trial),
            "heldout_contact": float(np.sqrt(trial.contact[held].mean())),
        }

    share, interval = s.judge.reduction(base.squares, final.squares, s.noise)
    effects = []
    for name, trial in s.alone.items():
        alone, ci95 = s.judge.reduction(base.squares, trial.squares, s.noise)
        effects.append(
            {
                "name": name,
                **errors(trial),
                "reduction": alone,
                "reduction_ci95": list(ci95),
                "parameters": trial.fit.gel.effects[name],
                "tested_by": "added to the twin",
            }
        )
    for name, trial in s.present.items():
        effects.append(
            {"name": name, **errors(trial), "reduction": None, "tested_by": "taken out of the twin"}
        )
    stored = None if s.stored is None else float(np.sqrt(s.judge.value(s.stored)))
    return {
        "verdict": s.verdict,
        "sentence": lead(s),
        "unit": "levels",
        "noise_floor": s.noise,
        "noise_floor_how": "images away from contacts, less each image's own smooth drift of light",
        "stored": stored,
        "baseline": errors(base),
        "selected": s.selected,
        "after": errors(final),
        "reduction": share if s.selected else 0.0,
        "reduction_ci95": list(interval) if s.selected else [0.0, 0.0],
        "parameters": {e: final.fit.gel.effects[e] for e in s.selected},
        "ladder": [
            {"change": "the twin as it is" if i == 0 else f"+ {s.selected[i - 1]}", **errors(t)}
            for i, t in enumerate(s.ladder)
        ],
        "effects": effects,
        "indistinguishable": [list(r) for r in s.rivals],
        "at_bound": s.evidence.at_bound,
        "make": final.fit.make,
        "orientation": str(final.fit.orientation) if final.fit.make else "",
        "trained_on": [x.name for x, t in zip(s.data.samples, s.train, strict=True) if t],
        "next_experiment": advice(s),
        "seconds": seconds,
    }


def lead(s: GelFindings) -> str:
    """What was found, in a sentence or two."""
    before, after = s.heldout(s.base), s.heldout(s.ladder[-1])
    if s.verdict == "ambiguous":
        if s.evidence.poor:
            return f"This recording cannot tell: the images left to judge by are {s.judge.units}; record ten."
        helpful = ", ".join(s.evidence.near_miss)
        return f"This recording cannot tell: {helpful} would help, but perhaps by chance."
    if not s.selected:
        if s.verdict == "adequate":
            return (
                f"Nothing is missing that these images could show: {after:.3g} levels stay, about as many as "
                "where nothing touches."
            )
        if s.verdict == "insufficient_form":
            return (
                f"What the twin has explains {100 * s.explained:.0f} % of what a contact changes, and no "
                f"other effect of the library more: {after:.3g} levels stay where the noise is {s.noise:.3g}."
            )
        return (
            f"Something that no optics effect of the library describes is in these images: {after:.3g} "
            f"levels stay where their noise is {s.noise:.3g}."
        )
    first = s.selected[0]
    text = get_effect(first).describe(s.ladder[-1].fit.gel.effects[first], "gel")
    text += (
        f" Adding {', '.join(s.selected)} takes the held-out error from {before:.3g} to {after:.3g} levels."
    )
    rivals = sorted({r for e, r in s.rivals if e == first})
    if rivals:
        text += f" As far as these images can tell it may be {' or '.join(rivals)} instead."
    if s.verdict in ("insufficient_form", "unknown_effect"):
        text += f" That is not all: the noise is {s.noise:.3g} levels."
    return text


def advice(s: GelFindings) -> str:
    """What to record next."""
    if s.evidence.poor:
        return "Press one ball at ten places all over the window, to several depths; note where and how deep."
    hints = [r for pair in s.rivals for r in pair] or s.selected or s.evidence.near_miss
    if hints:
        return f"To see {hints[0]} alone: {get_effect(hints[0]).experiment}"
    return (
        "Press other shapes, such as an edge or a small cylinder: so far the light is known for these alone."
    )


def refitted(s: GelFindings, result: dict) -> str:
    """What was fitted to what."""
    stored = "" if result["stored"] is None else f"As stored it is {result['stored']:.3g} levels off. "
    return (
        f"{stored}All that follows is re-fitted to {s.train.sum()} of the {len(s.train)} images and judged "
        f"on the other {s.judge.units}."
    )


def gel_page(s: GelFindings, result: dict) -> Report:
    """The sentence, the ladder, and where in the image the twin fails."""
    page = Report("What is missing in the light")
    page.lead(result["sentence"])
    page.text(f"Verdict: {s.verdict}. {refitted(s, result)} The images' noise is {s.noise:.3g} levels.")
    page.text(f"**Next experiment.** {result['next_experiment']}")
    page.heading("How the error falls")
    page.table(result["ladder"], "Levels of 8 bits; train: the images fitted to, heldout: all others.")
    page.heading("Where it fails")
    tries = [s.base, s.ladder[-1]] if s.selected else [s.base]
    pictures = [maps(s, t) for t in tries]
    page.image(
        np.concatenate([_bright(plane) for plane, _ in pictures], 1),
        f"Root mean square error over the held-out images, {MAP_GAIN:g} times brighter; left as it is, right "
        "with all effects found.",
    )
    page.image(
        np.concatenate([np.clip(128 + MAP_GAIN * c, 0, 255).astype(np.uint8) for _, c in pictures], 1),
        "Mean of rendered less photographed around the contact, three contact radii each way; grey is none.",
        width=242 * len(pictures),
    )
    page.heading("Each effect")
    page.table(
        [
            {
                "effect": e["name"],
                "held-out error": e["heldout"],
                "in the contact": e["heldout_contact"],
                "removes": percent(e["reduction"], e["reduction_ci95"])
                if e["reduction"] is not None
                else "-",
                "tested": e["tested_by"],
                "": "found" if e["name"] in s.selected else "",
            }
            for e in sorted(result["effects"], key=lambda e: e["heldout"])
        ]
    )
    page.heading("What was fitted")
    page.table(
        [
            {"effect": e, "parameter": p.name, "value": values[p.name], "unit": p.unit or "(a ratio)"}
            for e, values in result["parameters"].items()
            for p in get_effect(e).parameters
        ]
    )
    return page


def _bright(plane: np.ndarray) -> np.ndarray:
    return np.clip(MAP_GAIN * plane, 0, 255).astype(np.uint8)
