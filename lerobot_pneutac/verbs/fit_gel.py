"""Calibrates the gel of a twin to presses of a recording, and compares one with it, image by image."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from lerobot_pneutac.reports.page import Report, difference, side_by_side
from lerobot_pneutac.study.gel import (
    UNHELD,
    Modulus,
    Pasted,
    at_bound,
    keep_modulus,
    late_effects,
    modulus_sentence,
    predict,
    seen_by,
)
from lerobot_pneutac.verbs.result import Calibration, Comparison, rms_of
from pneutac_datasets.recording.gel import GelRecording, GelSample
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import get_effect, of_sensor, sensor_effects
from pneutac_sim.errors import InputError
from pneutac_sim.executor import Progress, no_progress
from pneutac_sim.gel.fit import ERROR_LEVELS, GelFit, fit_presses, slope_light
from pneutac_sim.gel.identifiability import Identified, identify, library, save
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.inverse import TouchReader
from pneutac_sim.gel.layout import LIKE, Layout, Orientation, recognise
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import ImageScores, disc, rest_changed, score
from pneutac_sim.twin import Twin

EFFECTS, STANDARD = "effects", "standard"  # in the history of a twin whose effects nobody chose
OURS, BASELINE, REST = "this model", "difference pasted", "rest image"
# A press is poor above this share of the rest image's error, and this many times the median share.
LEAST_PRESSES, POOR_SHARE, POOR_TIMES = 4, 0.8, 1.6
ENOUGH_LEVELS = ERROR_LEVELS / 4  # uncertainty besides the model's own error, which no press removes
PICTURES, PICTURE_PX = 6, 213  # held-out images in the picture grid, and the height of each
MPM = "this model, material points"  # light and all predictions on their surfaces


@dataclass(frozen=True, eq=False)
class Drawn:
    """A recording's photographs as a gel draws them, uint8 (H, W, 3); `images` are by the closed form."""

    gel: GelModel
    data: GelRecording
    given: list[np.ndarray] | None = None  # in place of these

    @cached_property
    def images(self) -> list[np.ndarray]:
        return predict(self.gel, self.data) if self.given is None else self.given

    @cached_property
    def scores(self) -> list[ImageScores]:
        return scores_of(self.data, self.images)

    @cached_property
    def rest_scores(self) -> list[ImageScores]:
        """Of the rest image alone."""
        return scores_of(self.data, [s.rest for s in self.data.samples])

    @cached_property
    def pasted_scores(self) -> list[ImageScores]:
        """Of the first calibration image's difference to its rest image, moved to each contact."""
        pasted = Pasted(self.data.presses[0], self.data.px_per_mm)
        return scores_of(self.data, [pasted.image(s.press) for s in self.data.samples])


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GelCalibration(Calibration):
    """A gel calibrated to one pair of images or several."""

    gel: GelModel  # as the twin keeps it
    fit: GelFit
    drawn: Drawn  # by the fit
    notes: str = ""
    standard: bool = False  # whether nobody chose the effects
    modulus: Modulus | None = None  # of the gel, by the presses with a force; None if there is none
    by_points: Drawn | None = None  # by material points, if the light was fitted to them
    material: str = ""  # of these; empty for the closed form

    @property
    def data(self) -> GelRecording:
        return self.drawn.data

    @cached_property
    def identified(self) -> Identified:
        """What the presses identify."""
        return identify(self.fit.gel, self.fit.channels, self.data.presses)

    @property
    def scores(self) -> dict[str, list[ImageScores]]:
        """Method to the score of every image."""
        out = {OURS: self.drawn.scores, BASELINE: self.drawn.pasted_scores, REST: self.drawn.rest_scores}
        return out | ({MPM: self.by_points.scores} if self.by_points else {})

    def _noted(self) -> dict:
        """That the effects were no one's choice, so that the next calibration need not keep them."""
        return {EFFECTS: STANDARD} if self.standard else {}

    @property
    def title(self) -> str:
        n = len(self.data.presses)
        return "A tactile sensor from two images" if n == 1 else f"A tactile sensor from {n} presses"

    def mean(self, method: str) -> ImageScores | None:
        picked = [self.scores[method][i] for i in self.data.heldout]
        return ImageScores.mean(picked) if picked else None

    @property
    def sentence(self) -> str:
        if not self.data.heldout:
            return ""
        ours, rest = (f"{self.mean(m).rmse:.2f}" for m in (OURS, REST))
        error = f"the error is {ours} levels; the rest image alone has {rest}"
        return f"On {len(self.data.heldout)} images that the fit has not seen, {error}."

    def rows(self) -> list[dict]:
        rows, samples = [], self.data.samples
        for role in sorted({s.role for s in samples}, key=lambda r: (r == "calibration", r)):
            picked = [i for i, s in enumerate(samples) if s.role == role]
            for name, each in self.scores.items():
                if name == BASELINE and role == "calibration":
                    continue  # it equals the very difference that is pasted
                m = ImageScores.mean([each[i] for i in picked])
                row = {"images": f"{role or 'others'} ({len(picked)})", "method": name}
                row |= {"RMSE": m.rmse, "PSNR": m.psnr, "NCC": m.ncc}
                rows.append(row | {"contact": m.contact_rmse, "dNCC": m.contact_dncc})
        return rows

    def _identified_of(self) -> list[str]:
        out = [make_sentence(self.fit)]
        if self.material:
            confirm = "confirm that" if self.fit.refined else "do not confirm that, so it was not taken"
            out.append(
                f"The light was fitted to surfaces of material points ({self.material}) and refined through "
                f"the splat renderer; held-out parts of the presses {confirm}. The twin draws by the closed "
                f"form nearest to them, of decay {self.gel.decay_mm:.2f} mm; '{MPM}' by theirs."
            )
        rows, columns = self.gel.rest_image.shape[:2]
        if (rows, columns) != self.data.rest.shape[:2]:
            out.append(f"The twin's images are {columns} x {rows} px, made of the photographs'.")
        out.append(modulus_sentence(self.modulus, self.twin))
        for k, (p, found) in enumerate(zip(self.data.presses, self.fit.presses, strict=True), 1):
            moves = (f"{n} {getattr(found, n):.3g} (stated {getattr(p.press, n):.3g})" for n in p.sd)
            if p.sd:
                out.append(f"Within what its row leaves open, calibration press {k} has {', '.join(moves)}.")
        out.append(residual_sentence(self.fit))
        return [*filter(None, out), *identified_sentences(self.identified, self.fit.make)]

    def save_prior(self, name: str) -> Path:
        """Stores the sensor's lights as the prior of its model, for later calibrations; returns the file."""
        source = f"{self.recording}, {len(self.data.presses)} of its presses"
        return save(name, self.fit.gel, self.fit.channels, source, self.fit.leftovers)

    @property
    def reference(self) -> tuple[str, float | None]:
        return "the rest image alone", errors_of(self.scores[REST], self.data)["heldout"]

    def remarks(self) -> list[str]:
        out = self._identified_of()
        n = len(self.data.presses)
        what = "one rest and one indentation image" if n == 1 else f"{n} indentation images"
        out.append(f"Fitted to {what} in {self.seconds:.1f} s{self._now()}.")
        out += [f"[yellow]note:[/] {sentence}" for sentence in poor_presses(self.scores, self.data)]
        names = at_bound(self.gel, list(self.gel.effects))
        out += [f"[yellow]note:[/] {name} lies at its bound." for name in names]
        unknown = "[yellow]note:[/] there is no held-out image, so how well this generalises is unknown."
        return out + [unknown] * (not self.data.heldout)

    def content(self) -> dict:
        n, methods = len(self.data.heldout), {}
        for name in self.scores if n else ():  # the PSNR of equal images is infinite
            scores = vars(self.mean(name))
            methods[name] = {k: v if np.isfinite(v) else None for k, v in scores.items()}
        image = methods[OURS] | {"rest_rmse": methods[REST]["rmse"], "n": n} if n else None
        fit, found = self.fit, self.identified
        return super().content() | {
            "make": fit.make,
            "orientation": str(fit.orientation) if fit.make else "",
            "make_likeness": fit.likeness,
            "make_by": ("rest image" if fit.by_rest else "light") if fit.make else "",
            "refined": fit.refined,
            "untold": list(found.unidentified),
            "next_press": _described(found.add) | {"where": found.where, "deeper": found.deeper},
            "presses": [_described(press) for press in fit.presses],
            "open_levels": {"now": found.open_levels, "with_next_press": found.then_levels},
            "image": image,
            "methods": methods,
            "notes": self.notes,
        }

    def pictures(self) -> dict[str, np.ndarray]:
        return {"tactile.png": picture_grid(self.data, self.drawn.images, self.data.presses[0])}

    def page(self) -> Report:
        page = self.lead_page()
        page.text(f"Recording: `{self.recording}`. {self.notes}")
        rows = "Above the recording, in the middle the model, below four times model minus recording"
        columns = "Columns: rest, the calibration image, held-out images"
        page.image(self.pictures()["tactile.png"], f"{rows} (grey is no error). {columns}.")
        what = "Mean over images; contact: a disc of twice the contact radius"
        page.table(self.rows(), f"{what}; dNCC: correlation of (image - rest) there.")
        page.heading("What was fitted")
        page.text(" ".join(self._identified_of()))
        page.table(
            [{"parameter": k, **v} for k, v in self.parameters.items()],
            "Light per unit slope along x (columns) and y (rows) and per millimetre of depth",
        )
        return page


def make_sentence(fit: GelFit) -> str:
    """The sensor model that was recognised, and by what; empty if none was looked for."""
    which, none = f"that of a {fit.make}, {fit.orientation}", "The sensor is of no known model"
    if fit.make and fit.by_rest:
        return f"The light is {which}: the rest images correlate by {fit.likeness:.2f} (at least {LIKE:g})."
    if fit.make:
        agree = "its directions in the first press agree, its rest image does not"
        return f"The light may be {which}: {agree}."
    if fit.likeness is None:
        return ""
    if not fit.likeness:
        return f"{none}: the images of all known ones have other proportions."
    like = f"{fit.likeness:.2f}, less than {LIKE:g}"
    return f"{none}: its rest image correlates with the most similar by {like}."


def identified_sentences(found: Identified, make: str) -> list[str]:
    """Parameters that the presses do not identify, and the press to add."""
    out = []
    if found.unidentified:
        colours: dict[str, list[str]] = {}  # of each parameter, from one entry a colour
        for name, colour in (entry.split(" ", 1) for entry in found.unidentified):
            colours.setdefault(name, []).append(colour.strip("()"))
        shown = ", ".join(f"{name} ({', '.join(c)})" for name, c in colours.items())
        source = f"its value on other sensors of the model {make}" if make else "its default"
        out.append(f"The presses do not identify {shown}: each stays near {source}.")
    if found.open_levels < ENOUGH_LEVELS:
        out.append("Another press of this indenter would add little information.")
        return out
    p = found.add
    press = f"add a {'deeper ' * found.deeper}press at the {found.where}"
    place = f"{p.depth_mm:.2g} mm deep, x {p.x_mm:.1f}, y {p.y_mm:.1f} mm"
    gain = f"from {found.open_levels:.1f} to {found.then_levels:.1f} grey levels"
    cuts = f"this press would cut the calibration's uncertainty {gain}"
    out.append(f"To know more, {press} ({place}): {cuts}.")
    if found.deeper:
        out.append("Contacts deeper than the presses are extrapolated.")
    return out


def residual_sentence(fit: GelFit) -> str:
    """What was added to the light of other sensors' and of the presses' residual fields; empty if nothing."""
    out = []
    if fit.prior_share:
        share = {0.25: "A quarter", 0.5: "Half"}.get(fit.prior_share, f"{fit.prior_share:.0%}")
        what = f"{share} of the mean residual field of other sensors of the model {fit.make}"
        out.append(f"{what} is added: the share that fits the presses best.")
    if fit.gel.residual is not None:
        far = "as far as cross-validation over them confirms it"
        out.append(f"A residual field is fitted to the presses too, {far}.")
    return " ".join(out)


def picture_grid(data: GelRecording, ours: list[np.ndarray], first: GelSample) -> np.ndarray:
    """Rows recorded, ours, error (grey is none, four times exaggerated); columns rest, first, held-out."""
    heldout = data.heldout
    spaced = np.linspace(0, len(heldout) - 1, PICTURES).astype(int)
    picks = [data.samples.index(first), *(heldout[i] for i in np.unique(spaced) if heldout)]
    recorded = [data.rest, *(data.samples[i].image for i in picks)]
    model = [data.rest, *(ours[i] for i in picks)]
    errors = [difference(a, b, 4.0) for a, b in zip(model, recorded, strict=True)]
    rows = [side_by_side(row, height=PICTURE_PX) for row in (recorded, model, errors)]
    gap = ((0, 4), (0, 0), (0, 0))  # below each row
    return np.concatenate([np.pad(row, gap, constant_values=255) for row in rows])


def calibrate_gel(
    twin: Twin,
    recording: Recording,
    effects: Sequence[str] | None = None,
    image_size: Sequence[int] | None = None,
    through_points: bool = False,
    progress: Progress = no_progress,
) -> GelCalibration:
    """Fits light and optics to all images of role `calibration`; see `calibrate`.

    Through points the surfaces are those that material points have, and the light is refined through the
    splat renderer.
    """
    names = wanted(effects, twin)
    moving = [name for name in names or () if get_effect(name).press is not None]
    if through_points and moving:
        but = f"the effect '{moving[0]}' moves the presses; choose other effects, or omit through"
        raise InputError(f"through=mpm presses where the recording says, but {but}.")
    known = late_effects(
        {n: {k: v.value for k, v in twin.effects[n].items()} for n in of_sensor(twin.effects)}
    )
    data = GelRecording.load(recording, to_fit=True)
    earlier = twin.arrays.get("rest_image") if twin.gel else None
    data.warnings += rest_changed(earlier, data.rest, data.px_per_mm)
    unseen = [n for n in late_effects(dict.fromkeys(names or (), {})) if n not in known]
    if unseen and not any(p.earlier for p in data.presses):
        remedy = "give role 'calibration' to a press that came after another"
        raise InputError(f"effects={','.join(names or ())}: '{unseen[0]}' {UNHELD}, and {remedy}.")
    start, points = time.monotonic(), None
    if through_points:
        from pneutac_sim.mpm.devices import PressedGel

        progress("material points under the presses of the calibration", 0, 1)
        points = PressedGel(GelModel(data.rest, np.zeros((3, 2)), np.zeros(3), data.px_per_mm), twin)
    args = data.presses, data.px_per_mm, names, data.thickness_mm, library()
    fit = fit_presses(*args, *([points.between] if points else []), known=known)
    if points:
        from pneutac_sim.splat.gel import refine_fit  # numba takes a second to start

        progress("the light refined through the splat renderer", 0, 1)
        refine_fit(fit, data.presses, points.between)
    new = twin.copy()
    gel = fit.gel if image_size is None else fit.gel.resized(*image_size[::-1])
    seconds, drawn = time.monotonic() - start, Drawn(fit.gel, data)
    gel.into_twin(new)
    modulus = keep_modulus(new, data)
    found = GelCalibration(
        twin=new,
        parameters=_parameters(gel) | (modulus.parameter() if modulus else {}),
        error=errors_of(drawn.scores, data),
        unit="levels",
        evaluations=fit.evaluations,
        seconds=seconds,
        recording=str(recording.folder),
        change="calibrated gel" + " through material points" * through_points,
        seed=None,
        findings=tuple(data.warnings),
        gel=gel,
        fit=fit,
        drawn=drawn,
        notes=recording.meta.get("notes", ""),
        standard=names is None,
        modulus=modulus,
    )
    if not points:
        return found
    from pneutac_sim.mpm.solid import parameter

    progress(f"material points under all {len(data.samples)} presses", 0, 1)
    by_points = Drawn(fit.gel, data, predict(fit.gel, data, points.surface))
    name = "gel_poissons_ratio"
    assumed = "" if name in twin.parameters else ", assumed"
    return replace(found, by_points=by_points, material=f"Poisson's ratio {parameter(twin, name):g}{assumed}")


def scores_of(data: GelRecording, predicted: list[np.ndarray]) -> list[ImageScores]:
    return [
        score(p, s.image, s.rest, s.x_px, s.y_px, s.radius_px)
        for p, s in zip(predicted, data.samples, strict=True)
    ]


def poor_presses(scores: dict[str, list[ImageScores]], data: GelRecording) -> list[str]:
    """A sentence for each press that the model misses far more than the others, as shares of REST's error."""
    pairs = zip(scores[OURS], scores[REST], strict=True)
    share = np.array([ours.rmse / max(rest.rmse, 1e-9) for ours, rest in pairs])
    if len(share) < LEAST_PRESSES:
        return []
    typical = float(np.median(share))
    remedy = "Check its image, x_mm, y_mm, depth_mm and indenter, or leave the row out"
    others = f"the rest image alone misses it by; the others by {typical:.2f} times. {remedy}."
    return [
        f"Row {i + 1} ('{data.samples[i].name}') is missed by {scores[OURS][i].rmse:.1f} levels, "
        f"{share[i]:.2f} times what {others}"
        for i in np.flatnonzero(share > max(POOR_SHARE, POOR_TIMES * typical))
    ]


def errors_of(scores: list[ImageScores], data: GelRecording) -> dict[str, float | None]:
    """Root mean square error over the calibration's images and over all others."""
    squared = np.array([s.rmse**2 for s in scores])
    unseen = np.isin(np.arange(len(squared)), data.heldout)
    return {"train": rms_of(squared[~unseen]), "heldout": rms_of(squared[unseen])}


def _described(press: Press) -> dict:
    return {k: v for k, v in vars(press).items() if k != "figure"}


def _parameters(gel: GelModel) -> dict[str, dict]:
    out = {}
    for k, channel in enumerate("rgb"):
        for axis in range(2):
            out[f"light_{channel}_{'xy'[axis]}"] = {"value": gel.light[k, axis], "unit": "levels"}
        out[f"depth_light_{channel}"] = {"value": gel.depth_light[k], "unit": "levels/mm"}
    out["decay_mm"] = {"value": gel.decay_mm, "unit": "mm"}
    out["depth_scale"] = {"value": gel.depth_scale, "unit": ""}
    for effect, values in gel.effects.items():
        units = {p.name: p.unit for p in get_effect(effect).parameters}
        out |= {f"{effect}.{k}": {"value": round(v, 6), "unit": units[k]} for k, v in values.items()}
    out["threshold_levels"] = {"value": gel.threshold_levels, "unit": "levels"}
    return out


def wanted(effects: Sequence[str] | None, twin: Twin) -> list[str] | None:
    """Optics effects to fit: those asked for, else those once chosen for the twin, else None (standard ones).

    An effect is chosen by `calibrate --effects` or `add`. What `pneutac new` writes are defaults, and what a
    calibration without `--effects` fits depends on its presses: neither binds the next one.
    """
    if effects is None:
        fits = [version for version in twin.history if version.get("unit") == "levels"]
        chosen = any(version.get(EFFECTS) != STANDARD for version in fits)
        return of_sensor(twin.effects) if twin.gel and chosen else None
    of_one_pair = [name for name, effect in sensor_effects().items() if not effect.of_session]
    for name in effects:
        if name not in of_one_pair:
            why = "needs more than one pair of images" if of_sensor([name]) else "is no optics effect"
            remedy = f"give some of {','.join(of_one_pair)}, or none for the paper's linear model"
            raise InputError(f"effects={','.join(effects)}: '{name}' {why}; {remedy}.")
    return list(dict.fromkeys(effects))


# ---------------------------------------------------------------- comparison

QUIET_RADII = 3.0  # beyond so many contact radii the image should equal the rest image
WORST = 5


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GelComparison(Comparison):
    """A gel against photographs."""

    heading = "Gel twin against recording: {0.folder.name}"

    drawn: Drawn
    touch: list[dict]  # of each, what `TouchReader` reads from the photograph, and what its row states
    folder: Path
    twin: Twin

    unit = "levels"
    keys = (
        "unit", "error", "noise_floor", "image", "by", "worst", ("touch", "touch_error"), "history",
        ("checks", "findings"), "sentence",
    )  # fmt: skip

    def subject(self) -> tuple[Twin, Path]:
        return self.twin, self.folder

    @property
    def data(self) -> GelRecording:
        return self.drawn.data

    @property
    def findings(self) -> tuple[str, ...]:
        return tuple(self.data.warnings)

    @property
    def error(self) -> dict[str, float | None]:
        return errors_of(self.drawn.scores, self.data)

    @property
    def image(self) -> dict | None:
        """Mean scores over images whose role is not calibration."""
        if not self.data.heldout:
            return None
        mean = ImageScores.mean([self.drawn.scores[i] for i in self.data.heldout])
        rest = ImageScores.mean([self.drawn.rest_scores[i] for i in self.data.heldout])
        # two equal pictures have an infinite PSNR, which JSON cannot hold; 8-bit rounding ends at 59 dB
        psnr = {"psnr": min(mean.psnr, 99.0)}
        return vars(mean) | psnr | {"rest_rmse": rest.rmse, "n": len(self.data.heldout)}

    @cached_property
    def noise_floor(self) -> float:
        """What the picture changes where nothing touches, levels: light, noise and compression."""
        squares = []
        for s in self.data.samples:
            quiet = ~disc(s.rest.shape, s.x_px, s.y_px, QUIET_RADII * s.radius_px)
            if quiet.any():
                squares.append(np.mean((s.image[quiet].astype(float) - s.rest[quiet]) ** 2))
        return float(np.sqrt(np.mean(squares))) if squares else 0.0

    @property
    def by(self) -> dict[str, list[dict]]:
        samples, unseen, scores = self.data.samples, self.data.heldout, self.drawn.scores
        return {
            "role": _by(scores, [s.role or "others" for s in samples]),
            "indenter": _by([scores[i] for i in unseen], [samples[i].press.indenter for i in unseen]),
        }

    @property
    def worst(self) -> list[dict]:
        pairs = zip(self.data.samples, self.drawn.scores, strict=True)
        rows = [{"image": p.name, "error": s.rmse, "contact_rmse": s.contact_rmse} for p, s in pairs]
        return sorted(rows, key=lambda row: -row["contact_rmse"])[:WORST]

    @property
    def touch_error(self) -> dict | None:
        """Root mean square error of depth and median distance of place, read from test images, mm."""
        rows = [self.touch[i] for i in self.data.heldout if self.touch[i]["depth_mm"] > 0]
        if not rows:
            return None
        depth = [row["depth_mm"] - row["stated_mm"] for row in rows]
        off = float(np.median([row["off_mm"] for row in rows]))
        return {"depth_mm": float(np.sqrt(np.mean(np.square(depth)))), "place_mm": off, "n": len(rows)}

    @property
    def sentence(self) -> str:
        image = self.image
        if image is None:
            return f"The twin misses its calibration image, the only one, by {self.train:.3g} levels."
        off = f"{image['rmse']:.3g} levels off (the rest image alone {image['rest_rmse']:.3g})"
        where = f"On {image['n']} images that the twin was not fitted to"
        return f"{where} it is {off}, in the contact {image['contact_rmse']:.3g}."

    def rows(self) -> list[dict]:
        return self.by["role"]

    def content(self) -> dict:
        how = f"change of the picture further than {QUIET_RADII:g} contact radii from the contact"
        return super().content() | {"noise": {"how": how}}

    def pictures(self) -> dict[str, np.ndarray]:
        first = next(iter(self.data.presses), self.data.samples[0])
        return {"tactile.png": picture_grid(self.data, self.drawn.images, first)}

    def page(self) -> Report:
        page = self.lead_page()
        page.image(
            self.pictures()["tactile.png"],
            "Above the recording, in the middle the twin, below four times the difference.",
        )
        if self.image:
            page.table([self.image], "Means over the images whose role is not calibration.")
        for name, rows in self.by.items():
            page.table(rows, f"By {name}.")
        page.table(self.worst, "Worst images.")
        if self.touch_error:
            depth, place, n = self.touch_error.values()
            page.heading("Touch read back from the images")
            off = f"off by {depth:.2f} mm and the contact's centre by {place:.2f} mm"
            page.text(f"On {n} test images the depth is {off} (root mean square, median).")
            page.table(self.touch, "By image; 0 mm deep where no contact was found.")
        return page


def compare_gel(twin: Twin, recording: Recording) -> GelComparison:
    """Renders every image's indentation with the twin and scores it.

    The recording's own rest images, scale and, if it has a row of role `calibration`, half of the drift of
    light seen there are used: illumination changes between sessions, and that is no fault of the gel's model.
    """
    data = GelRecording.load(recording)
    if not twin.gel:
        raise InputError("The twin has no gel; `pneutac calibrate` it on a recording of a gel.")
    gel = seen_by(GelModel.from_twin(twin), data)
    data.warnings += turned(gel, data)
    return GelComparison(
        drawn=Drawn(gel, data),
        touch=read_back(gel, data),
        folder=Path(recording.folder),
        twin=twin,
    )


def read_back(gel: GelModel, data: GelRecording) -> list[dict]:
    """Depth, area and place read from each photograph, and the stated depth and place."""
    reader, out = TouchReader(gel), []
    for s in data.samples:
        touch = reader.read(s.image, s.rest)
        row = {"image": s.name, "stated_mm": s.press.depth_mm, "depth_mm": touch.depth_mm}
        off = float(np.linalg.norm(touch.centre_mm - (s.press.x_mm, s.press.y_mm)))
        out.append(row | {"off_mm": off if touch.depth_mm else None, "area_mm2": touch.area_mm2})
    return out


def turned(gel: GelModel, data: GelRecording) -> list[str]:
    """A note where the recording's images are mirrored, or have their channels in another order."""
    if not data.presses:
        return []
    far = -1e3 * gel.light / np.maximum(np.linalg.norm(gel.light, axis=1), 1e-9)[:, None]
    height, width = data.rest.shape[:2]
    own = Layout("twin", tuple(map(tuple, far)), (0.0, 0.0, 0.0), width / height)
    first = data.presses[0]
    light = slope_light(replace(gel, effects={}), first)
    orientation = recognise(light, first.press.x_mm, first.press.y_mm, (width, height), own)
    if orientation is None or orientation == Orientation():
        return []
    remedy = "turn them, or calibrate a twin of their own"
    return [f"against the twin the recording's images are {orientation}; {remedy}."]


def _by(scores: list[ImageScores], labels: list[str]) -> list[dict]:
    rows = []
    for label in sorted(set(labels)):
        mean = ImageScores.mean([s for s, x in zip(scores, labels, strict=True) if x == label])
        row = {"value": label, "error": mean.rmse, "n": labels.count(label)}
        rows.append(row | {"contact_rmse": mean.contact_rmse, "contact_dncc": mean.contact_dncc})
    return rows
