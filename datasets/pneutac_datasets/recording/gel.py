"""A gel's bench recording, ready to fit and to score: checked images and what pressed each of them.

Indenters of any form, as the rows of a gel's recording describe them.
"""

import math
from dataclasses import dataclass, field

import cv2
import numpy as np
import pandas as pd

from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.wording import collected, grouped
from pneutac_sim.errors import InputError, shown
from pneutac_sim.gel.indenter import FIGURES, INDENTERS, AnyFigure, Figure, Outline, Press
from pneutac_sim.gel.pair import (
    Earlier,
    PressPhotograph,
    RestDifference,
    cell_px,
    cells,
    check_pair,
    saturated,
    shows_contact,
)
from pneutac_sim.gel.probe import THICKNESS_MM

MIRROR_SAMPLES = 4  # photographs from which a mirrored axis can be detected
AGREE_MM = 0.5  # by which a contact's place in pixels and in millimetres may differ
MOST_HELD_S = 1e5  # a day
MOST_N = 100.0  # on a gel of a fingertip
WINDOW_MM = (3.0, 200.0)  # smallest and largest width of a gel's image
KNOWN = "known_depth"  # role of rows whose presses hold
UNCERTAIN = {
    "place_sd_mm": ("x_mm", "y_mm"),
    "depth_sd_mm": ("depth_mm",),
    "yaw_sd_rad": ("yaw_rad",),
    "tilt_sd_rad": ("tilt_x_rad", "tilt_y_rad"),
}
# How places (n, 2) of presses may be turned, as matrices; `_misplaced` looks at mirrored axes by themselves.
QUARTERS = {
    "turned by a quarter": np.array([[0, 1], [-1, 0]]),
    "turned by a quarter the other way": np.array([[0, -1], [1, 0]]),
    "with x and y exchanged": np.array([[0, 1], [1, 0]]),
    "with x and y exchanged and mirrored": np.array([[0, -1], [-1, 0]]),
}
LIKE = 0.8  # correlation of shown and stated places; four real and generated sensors have 0.98 and more
# The same sensors: places 0.97 to 1.05 times as far, contacts 1.1 to 1.7 times as wide as stated, rest images
# within 3 % of the presses' median.
FARTHER, WIDTHS = 1.25, (0.6, 2.4)
REST_SAMPLES, REST_GAIN = 5, 0.05
BLACK_LEVEL, WHITE_LEVEL = 8, 247  # an image below or above all over shows nothing
ASSUMED_RADIUS_MM = 3.0  # of a ball that the recording does not state: the scale of the light absorbs it
NO_PRESS = (
    "The recording has no row with role 'calibration'; add a column 'role' and mark one indentation with it."
)
# Of numbers in a row: what must hold, and the remedy where it does not.
NUMBERS = {"force_n": (lambda n: 0 < n < MOST_N, f"give newton, above 0 and below {MOST_N:g}")}
NUMBERS |= dict.fromkeys(
    UNCERTAIN, (lambda sd: 0 <= sd < math.inf, "give a standard deviation, or leave it empty")
)


@dataclass(eq=False, kw_only=True)
class GelSample(PressPhotograph):
    """A photograph as a row of the recording describes it."""

    name: str  # the image's path as the recording names it
    role: str  # `calibration`, `heldout`, `known_depth` or another label
    x_px: float  # column of the contact centre
    y_px: float  # row of the contact centre
    radius_px: float  # contact radius
    force_n: float | None = None  # on the indenter, along the gel's view; None if the row has none


@dataclass
class GelRecording:
    """Photographs of one gel at one size."""

    rest: np.ndarray  # image without contact, uint8 (H, W, 3)
    px_per_mm: float  # scale of the images
    thickness_mm: float  # gel thickness
    samples: list[GelSample]  # one photograph each
    warnings: list[str] = field(default_factory=list)  # one sentence for each thing that had to be assumed
    faults: list[str] = field(default_factory=list)  # one sentence for each row that is wrong
    # one sentence for each photograph of role `calibration` that `check_pair` refuses
    unfit: list[str] = field(default_factory=list)

    @classmethod
    def load(cls, recording: Recording, to_fit: bool = False) -> "GelRecording":
        """Reads and checks every image and indenter of a gel's recording, one that is `to_fit` for that too.

        Raises InputError: one sentence naming the file, the row (the first is row 1) or field, and the
        remedy.
        """
        out = _read(recording)
        for fault in [*out.faults, *(out.unfit if to_fit else ())]:
            raise InputError(fault)
        if to_fit and not out.presses:
            raise InputError(NO_PRESS)
        return out

    @property
    def presses(self) -> list[GelSample]:
        """The samples of role `calibration`."""
        return [s for s in self.samples if s.role == "calibration"]

    @property
    def heldout(self) -> list[int]:
        """Numbers of the samples of other roles, which no fit of a calibration sees."""
        return [i for i, s in enumerate(self.samples) if s.role != "calibration"]


def gel_faults(recording: Recording) -> tuple[list[str], list[str]]:
    """A sentence for each fault of a gel's recording that `calibrate` refuses; else one for each note."""
    try:
        data = _read(recording)
    except InputError as e:
        return [str(e)], []
    faults = data.faults or data.unfit or [NO_PRESS] * (not data.presses)
    notes = [f"{recording.folder}: {note}" for note in data.warnings[len(recording.warnings) :]]
    return list(dict.fromkeys(faults)), [] if faults else notes


def _read(recording: Recording) -> GelRecording:
    """All photographs; their checks wait until no row is wrong."""
    out, named = _begun(recording), recording.meta["rest_image"]
    rows = _Rows(recording, out, {named: out.rest})
    clock = np.arange(len(recording)) / max(len(recording) - 1, 1)
    for name in ("trial", "time_s"):  # where they run on
        time = recording.column(name).astype(float)
        if np.ptp(time) > 0 and (np.diff(time) >= 0).all():
            clock = (time - time[0]) / np.ptp(time)
    for i, (_, row) in enumerate(recording.samples.iterrows()):
        with collected(out.faults):
            out.samples.append(rows.sample(i, row, float(clock[i])))
    if out.faults:
        out.faults = grouped(out.faults)
        return out
    _fill_earlier(recording, out.samples)
    misplaced, empty, bright, scale = _misplaced(out), [], [], out.px_per_mm
    for i, s in enumerate(out.samples, 1):
        if s.role != "calibration":
            empty += [str(i)] * (not shows_contact(s.rest, s.image, s.press, scale))
            bright += [str(i)] * saturated(s.image, s.near(scale, 1.2))
            continue
        try:
            check_pair(s.rest, s.image, s.press, scale)
        except InputError as e:
            where = f"rest image '{named}', indentation '{s.name}'"
            out.unfit.append(f"{recording.folder} ({where}): {e}")
    out.unfit = grouped(out.unfit)
    out.warnings += misplaced
    if empty and not misplaced:
        where = f"no contact shows where rows {', '.join(empty)} put it"
        out.warnings.append(f"{where}; check their x_mm and y_mm.")
    if bright and not misplaced:
        where = f"most of the contact is saturated in rows {', '.join(bright)}"
        out.warnings.append(f"{where}, which stay in the fit; lower the exposure.")
    of_rest = {id(s.rest): [r for r in out.samples if r.rest is s.rest] for s in out.samples}
    for samples in of_rest.values():
        out.warnings += _rest_doubts(samples, scale) if len(samples) >= REST_SAMPLES else []
    return out


def _begun(recording: Recording) -> GelRecording:
    """A recording without its samples yet."""
    file, meta = recording.folder / "recording.json", recording.meta
    scale, field = meta.get("px_per_mm"), f"{file}: field"
    if isinstance(scale, bool) or not isinstance(scale, int | float) or not 0 < scale < math.inf:
        raise InputError(f"{field} 'px_per_mm' is {shown(scale)}; give the images' pixels per millimetre.")
    if not meta.get("rest_image"):
        raise InputError(
            f"{field} 'rest_image' is missing; name the image without contact. Where none was taken, the"
            " median of five or more presses at different places serves."
        )
    size = meta.get("gel_size_mm")
    sizes = size if isinstance(size, list) and len(size) == 3 else [None]
    if size is not None and not all(isinstance(x, int | float) and 0 < x < 1000 for x in sizes):
        raise InputError(f"{field} 'gel_size_mm' is {shown(size)}; give width, height and thickness.")
    thickness = float(size[2]) if size is not None else THICKNESS_MM
    rest = _image(recording, meta["rest_image"], f"{file}: rest image {shown(meta['rest_image'])}")
    width_mm = rest.shape[1] / scale
    if not WINDOW_MM[0] <= width_mm <= WINDOW_MM[1]:
        raise InputError(
            f"{file}: px_per_mm is {scale:g}, so that the image would be {width_mm:.3g} mm wide; "
            f"a gel's is {WINDOW_MM[0]:g} to {WINDOW_MM[1]:g} mm."
        )
    return GelRecording(rest, float(scale), thickness, [], list(recording.warnings))


def _image(recording: Recording, value, what: str, like: np.ndarray | None = None) -> np.ndarray:
    """An image; raises InputError where it is of another size than `like`, or black or white all over."""
    if not isinstance(value, dict | str):
        raise InputError(f"{what} is no file's name; name the image.")
    image = recording.image(value, plain=True)
    if like is not None and image.shape != like.shape:
        raise InputError(
            f"{what} is {image.shape[1]} x {image.shape[0]} pixels but the rest image is "
            f"{like.shape[1]} x {like.shape[0]}; give images of one size."
        )
    dark, bright = np.percentile(image, (1, 99))
    if bright < BLACK_LEVEL or dark > WHITE_LEVEL:
        colour = "black" if bright < BLACK_LEVEL else "white"
        raise InputError(f"{what} is {colour} all over; take it again with the light on and not too bright.")
    return image


def _fill_earlier(recording: Recording, samples: list[GelSample]) -> None:
    """Fills in what came before each photograph, by `time_s` and `hold_s`; a new rest image starts again."""
    if not recording.has("hold_s"):
        return
    held, time = (recording.samples[c].to_numpy(float) for c in ("hold_s", "time_s"))
    first = 0
    for i, (s, t, hold) in enumerate(zip(samples, time, held, strict=True)):
        row = f"{recording.folder}, row {i + 1}:"
        if not 0 < hold < MOST_HELD_S:
            raise InputError(
                f"{row} hold_s is {hold:g}; give the seconds that the indenter was in the gel, above 0 and"
                f" below {MOST_HELD_S:g}, in every row, or leave the column out."
            )
        if i and t - hold < time[i - 1]:
            raise InputError(
                f"{row} with time_s {t:g} and hold_s {hold:g} it was pressed before the row above it was"
                f" photographed, at {time[i - 1]:g} s; correct them, or leave hold_s out."
            )
        first = i if s.rest is not samples[first].rest else first
        before = range(first, i)
        s.earlier = tuple(Earlier(samples[k].press, float(held[k]), float(time[i] - time[k])) for k in before)


def _misplaced(data: GelRecording) -> list[str]:
    """A note where the images show contacts at other places, or of another size, than the rows say."""
    shown_px, stated_px, widths = [], [], []
    for s in data.samples:
        if np.array_equal(s.image, s.rest):
            continue
        change = cv2.GaussianBlur(s.image.astype(np.float32) - s.rest, (0, 0), s.radius_px / 3)
        squared = np.square(change).sum(2)
        squared[squared < 0.25 * squared.max()] = 0
        y, x = np.indices(squared.shape)
        shown_px.append([(x * squared).sum() / squared.sum(), (y * squared).sum() / squared.sum()])
        stated_px.append([s.x_px, s.y_px])
        widths.append(np.sqrt((squared > 0).sum() / np.pi) / s.radius_px)
    if len(shown_px) < MIRROR_SAMPLES:
        return []
    seen, stated = (np.array(a) - np.mean(a, 0) for a in (shown_px, stated_px))
    mirrored = [name for i, name in enumerate("xy") if _correlation(seen[:, i], stated[:, i]) < -0.8]
    if mirrored:
        return [f"the images show contacts opposite to {m}_mm: it, or they, are mirrored." for m in mirrored]
    like = {how: _correlation(seen, stated @ turn) for how, turn in QUARTERS.items()}
    best, as_stated = max(like, key=like.__getitem__), _correlation(seen, stated)
    if like[best] > max(LIKE, as_stated + 0.2):
        return [f"the images show contacts {best} against x_mm and y_mm; turn them, or correct the two."]
    if as_stated < LIKE:
        return []
    farther, wider = (seen * stated).sum() / np.square(stated).sum(), float(np.median(widths))
    if not 1 / FARTHER < farther < FARTHER:
        return [
            f"the contacts lie {farther:.2g} times as far from each other as x_mm, y_mm and px_per_mm"
            f" {data.px_per_mm:g} say; is px_per_mm {data.px_per_mm * farther:.3g}?"
        ]
    if not WIDTHS[0] < wider < WIDTHS[1]:
        return [
            f"the contacts are {wider:.2g} times as wide as depth_mm and the indenter's size say; are both in"
            " millimetres?"
        ]
    return []


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Of two arrays without their means; 0 where one does not vary."""
    norm = np.sqrt(np.square(a).sum() * np.square(b).sum())
    return float((a * b).sum() / norm) if norm > 0 else 0.0


def _rest_doubts(samples: list[GelSample], px_per_mm: float) -> list[str]:
    """Notes where a rest image differs from the median of its presses away from their contacts."""
    stack = np.stack([cells(s.image, px_per_mm) for s in samples])
    y, x = np.indices(stack.shape[1:3])
    cell = cell_px(px_per_mm)
    for image, s in zip(stack, samples, strict=True):
        near = max(2 * s.radius_px, 1.5 * px_per_mm) / cell
        image[np.hypot(x - s.x_px / cell, y - s.y_px / cell) < near] = np.nan
    free = np.isfinite(stack[..., 0]).sum(0) >= MIRROR_SAMPLES - 1
    if free.mean() < 0.3:
        return []
    median = np.nanmedian(np.where(free[..., None], stack, 0), 0)
    mine = cells(samples[0].rest, px_per_mm)

    def likeness(image: np.ndarray) -> float:
        return _correlation(*(v[free] - v[free].mean(0) for v in (image, median)))

    turned = {"mirrored left to right": mine[:, ::-1], "mirrored top to bottom": mine[::-1]}
    turned["turned by half"] = mine[::-1, ::-1]
    best = max(turned, key=lambda how: likeness(turned[how]))
    if likeness(turned[best]) > max(LIKE, likeness(mine) + 0.05):
        return [f"the rest image is {best} against the presses; turn it as they are."]
    found, out = RestDifference.of(mine, median, px_per_mm, free), []
    if abs(found.gain - 1) > REST_GAIN:
        how = "darker" if found.gain > 1 else "brighter"
        out.append(
            f"the rest image is {abs(1 - 1 / found.gain):.0%} {how} than the presses away from their"
            " contacts; take one in the same session and light."
        )
    if found.shows:
        out.append(
            f"the rest image shows something at ({found.x_mm:.1f}, {found.y_mm:.1f}) mm that the presses do"
            f" not, {found.levels:.0f} levels strong; take one while nothing touches the gel."
        )
    return out


@dataclass
class _Rows:
    """Reads the rows of a recording; `rests` and `figures` hold, by name, what was read."""

    recording: Recording
    gel: GelRecording
    rests: dict[str, np.ndarray]
    figures: dict[str, Figure] = field(default_factory=dict)

    def sample(self, i: int, row: pd.Series, clock: float) -> GelSample:
        """Row `i` from 0; raises InputError where it is wrong."""
        recording, scale = self.recording, self.gel.px_per_mm
        where, own = f"{recording.folder}, row {i + 1}", row.get("rest_image")
        own = own if own and isinstance(own, dict | str) else recording.meta["rest_image"]
        name = own if isinstance(own, str) else where
        if name not in self.rests:
            self.rests[name] = _image(recording, own, f"{where}: rest image {shown(name)}", self.gel.rest)
        rest = self.rests[name]
        image = _image(recording, row["image"], f"{where}: image {shown(str(row['image']))}", rest)
        try:
            kind = str(row["indenter"])
            if kind not in INDENTERS + FIGURES:
                every = ", ".join(INDENTERS + FIGURES)
                raise InputError(f"indenter is {shown(kind)}; it must be one of {every}.")
            x_px, x_mm = _place(row, scale, "x", image.shape[1])
            y_px, y_mm = _place(row, scale, "y", image.shape[0])
            figure = self._figure(row, kind)
            size_mm, depth_mm = self._size_and_depth(row, kind, figure)
            press = Press(kind, size_mm, x_mm, y_mm, depth_mm, _number(row, "yaw_rad") or 0.0, figure)
            radius_px, sd = _number(row, "contact_radius_px"), {}  # what no deviation is stated of holds
            radius_px = press.contact_radius_mm * scale if radius_px is None else radius_px
            role = str(row.get("role", ""))
            for column, attributes in UNCERTAIN.items() if role != KNOWN else ():
                if deviation := _number(row, column):
                    sd |= dict.fromkeys(attributes, deviation)
            force_n = _number(row, "force_n")
        except InputError as e:
            raise InputError(f"{where}: {e}") from e
        return GelSample(
            press=press,
            image=image,
            rest=rest,
            clock=clock,
            sd=sd,
            name=str(row["image"]),
            role=role,
            x_px=x_px,
            y_px=y_px,
            radius_px=radius_px,
            force_n=force_n,
        )

    def _figure(self, row: pd.Series, indenter: str) -> AnyFigure | None:
        """Of a row's indenter: its `outline_mm`, or the `indenter_file` in the recording's folder.

        None where it is one of the plain shapes; raises InputError where the column is empty, or names no
        indenter.
        """
        columns = {
            "outline": ("outline_mm", "give its corners in mm, x y; x y; x y"),
            "mesh": ("indenter_file", "name the STL inside the recording's folder"),
        }
        if indenter not in columns:
            return None
        column, remedy = columns[indenter]
        text, folder = row.get(column), self.recording.folder
        if not isinstance(text, str) or not text.strip():
            raise InputError(f"{column} is empty; {remedy}.")
        if indenter == "outline":
            return Outline.of_text(text)
        if "\0" in text:
            raise InputError(f"indenter_file {shown(text)} is no file's name; give its file.")
        if text not in self.figures:
            self.figures[text] = Figure.read(folder / text, within=folder)
        return self.figures[text]

    def _size_and_depth(self, row: pd.Series, kind: str, figure: AnyFigure | None) -> tuple[float, float]:
        """Indenter size and depth, mm; of a ball the depth may follow from the contact radius (Hertz)."""
        names, gel = ("indenter_radius_mm", "indenter_size_mm"), self.gel
        names = names[::-1] if kind in ("cube", "edge") else names
        size = figure.reach_mm if figure else _number(row, *names)
        radius_px = _number(row, "contact_radius_px") if kind == "sphere" else None
        if size is None and radius_px is not None:
            size, ball = ASSUMED_RADIUS_MM, f"a ball of {ASSUMED_RADIUS_MM:g} mm is assumed"
            note = f"indenter_radius_mm is empty; {ball}, which scales the light alone."
            gel.warnings += [note] * (note not in gel.warnings)
        if size is None:
            raise InputError(f"indenter_radius_mm or indenter_size_mm is empty; give the {kind}'s size.")
        depth = _number(row, "depth_mm")
        if depth is None and radius_px is not None:
            depth = (radius_px / gel.px_per_mm) ** 2 / size  # Hertz: a^2 = R d
        if depth is None:
            raise InputError("depth_mm is empty; give it, or contact_radius_px of a sphere.")
        if depth > gel.thickness_mm:
            raise InputError(
                f"depth_mm is {depth:g} but the gel is {gel.thickness_mm:g} mm thick; give millimetres, or"
                " gel_size_mm in recording.json."
            )
        return size, depth


def _number(row: pd.Series, *names: str) -> float | None:
    """The first of these columns that is there and filled; raises InputError where it breaks its rule."""
    for name in (n for n in names if n in row and pd.notna(row[n])):
        value, (holds, remedy) = float(row[name]), NUMBERS.get(name, (bool, ""))
        if remedy and not holds(value):
            raise InputError(f"{name} is {value:g}; {remedy}.")
        return value
    return None


def _place(row: pd.Series, px_per_mm: float, axis: str, size_px: int) -> tuple[float, float]:
    """Contact centre along one axis: pixel, and mm from the image's centre."""
    px, mm = _number(row, f"contact_{axis}_px"), _number(row, f"{axis}_mm")
    if px is None:
        if mm is None:
            raise InputError("the contact's place is empty; fill x_mm, y_mm, or contact_x_px, contact_y_px.")
        px = size_px / 2 + mm * px_per_mm
    centred_mm = (px - size_px / 2) / px_per_mm
    if not 0 <= px < size_px:
        raise InputError(
            f"the contact's centre, {centred_mm:.3g} mm along {axis}, lies outside the image, which goes to"
            f" {size_px / px_per_mm / 2:.3g} mm; correct {axis}_mm, contact_{axis}_px or px_per_mm, or leave"
            " the row out."
        )
    if mm is not None and abs(centred_mm - mm) > AGREE_MM:
        raise InputError(
            f"{axis}_mm is {mm:g} but contact_{axis}_px, {px:g}, lies at {centred_mm:.3g} mm from the image's"
            " centre; correct one of them."
        )
    return px, centred_mm
