"""Demonstrations of a robot with the finger: each replayed in the twin's world; the gel's light at rest."""

import time
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lerobot_pneutac.diagnosis.search import Structure
from lerobot_pneutac.reports.page import COMMAND, MEASURED, MODEL, OTHER, Report, difference, side_by_side
from lerobot_pneutac.study.demonstration_fit import ARM, LATE, TOUCH
from lerobot_pneutac.study.demonstrations import UNIT, DemonstrationStudy
from lerobot_pneutac.verbs.result import Calibration, Comparison, rms_of
from pneutac_datasets.demonstrations.episodes import Episode
from pneutac_datasets.demonstrations.imprint import Dragging, LightDrift, light_drift, rest_image
from pneutac_datasets.demonstrations.reading import Demonstrations
from pneutac_datasets.demonstrations.replaying import Replayed, replay
from pneutac_sim.errors import InputError
from pneutac_sim.executor import Progress, no_progress
from pneutac_sim.features import AREA, CONTROL_HZ, PRESSURE
from pneutac_sim.gel.contact import without_specks
from pneutac_sim.gel.model import GelModel
from pneutac_sim.twin import Twin
from pneutac_sim.world.world import World

CHANNELS = {"arm": slice(0, 3), "gauge": slice(3, 4), "touch": TOUCH}  # of a residual
PHASES = ("free", "onset", "pressed", "release")
NEAR = 4  # frames about the first and after the last touch that are its onset and release
DEPTHS_MM = (0.0, 0.3, 0.6, 0.9, 1.2)
TOUCHED_MM = 0.03  # by which a replay's gel is pressed in where it touches; its images show it later
LATE_S = 0.02  # from the twin's own latency: more is reported


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class DemonstrationComparison(Comparison):
    """A twin against demonstrations."""

    heading = "Twin against demonstrations: {0.demonstrations.folder.name}"

    study: DemonstrationStudy  # the episodes as measured and replayed for the errors
    findings: tuple[str, ...]
    replayed: list[Replayed]  # each episode in the twin's world, with images
    latency_s: float  # by which the commands acted late, from the arm; including the twin's
    clock_s: float  # by which touch is shown late, from the camera's clock against the robot's
    drift_s: float | None  # change of that from an episode's first half to its second; None if it is unknown
    light: LightDrift  # how the light of the gel has changed since the twin was made

    unit = UNIT
    keys = (
        "unit", "error", "noise_floor", "by", "worst", "history", ("task", "demonstrations.task"),
        "latency_s", "clock_s", ("clock_drift_s", "drift_s"),
    )  # fmt: skip

    @property
    def twin(self) -> Twin:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.study.twin

    @property
    def demonstrations(self) -> Demonstrations:
        return self.study.recording

    @property
    def noise_floor(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.study.noise.floor

    def subject(self) -> tuple[Twin, str]:
        return self.twin, str(self.demonstrations.folder)

    @cached_property
    def residual(self) -> np.ndarray:
        """(N, 5) measured minus predicted of all frames, mm at the tip: flange x, y, z, pressure, touch."""
        return self.study.residual(self.twin)

    @property
    def _squared(self) -> np.ndarray:
        return (self.residual**2).sum(1)

    @property
    def error(self) -> dict[str, float | None]:
        """Of the episodes that a fit would see, and of those that it would not; and of each channel."""
        parts = self.study.parts
        out = {"train": rms_of(self._squared[parts.train]), "heldout": rms_of(self._squared[parts.test])}
        return out | {k: rms_of((self.residual[:, c] ** 2).sum(1)) for k, c in CHANNELS.items()}

    @cached_property
    def phase(self) -> np.ndarray:
        return np.concatenate([phases(e) for e in self.demonstrations.episodes])

    @cached_property
    def by(self) -> dict[str, list[dict]]:
        owner = self.study.owner
        episodes = [
            {"bin": str(i), **self._row(owner == i)} | self._touches(i)
            for i in range(len(self.demonstrations.episodes))
        ]
        depth = np.concatenate([r.press_mm for r in self.replayed])
        bands = zip(DEPTHS_MM, (*DEPTHS_MM[1:], np.inf), strict=True)
        depths = [(f"{a:g} mm and more", (depth >= a) & (depth < b) & (self.phase > 0)) for a, b in bands]
        return {
            "phase": [{"bin": n, **self._row(self.phase == k)} for k, n in enumerate(PHASES)],
            "episode": episodes,
            "depth": [{"bin": name, **self._row(rows)} for name, rows in depths if rows.any()],
        }

    def _row(self, rows: np.ndarray) -> dict:
        r = self.residual[rows]
        row = {k: rms_of((r[:, c] ** 2).sum(1)) for k, c in ({"error": slice(None)} | CHANNELS).items()}
        pairs = zip(self.demonstrations.episodes, self.replayed, strict=True)
        area_error = np.concatenate([e.state[:, AREA] - r.area for e, r in pairs])[rows]
        return row | {"area": rms_of(area_error**2), "frames": int(rows.sum())}

    def _touches(self, i: int) -> dict:
        """When an episode first touches, as recorded and as replayed, and how far its images differ."""
        e, r = self.demonstrations.episodes[i], self.replayed[i]
        touched = np.flatnonzero(r.press_mm > TOUCHED_MM)
        first = (e.contact() or (0, 0))[0]
        pressed, rmse = phases(e) == 2, None
        if r.images is not None and pressed.any():
            residual = r.images[pressed].astype(np.float32) - e.images[pressed]
            rmse = float(np.sqrt(np.mean(residual**2)))
        onset_s = float(touched[0]) / CONTROL_HZ if len(touched) else None
        row = {"onset_s": first / CONTROL_HZ, "onset_replayed_s": onset_s}
        return row | {"image_rmse_levels": rmse, "does_the_task": r.success}

    @property
    def worst(self) -> list[dict]:
        rows = sorted(self.by["episode"], key=lambda r: -r["error"])[:3]
        length = [len(e) / CONTROL_HZ for e in self.demonstrations.episodes]
        return [
            {"trial": int(r["bin"]), "from_s": 0.0, "to_s": length[int(r["bin"])], "error": r["error"]}
            for r in rows
        ]

    @property
    def sentence(self) -> str:
        channel = max(("arm", "gauge", "touch"), key=lambda k: self.error[k] or 0.0)
        phase = max(self.by["phase"], key=lambda r: r["error"] or 0.0)["bin"]
        most = {"arm": "where the arm goes", "gauge": "its pressure", "touch": "its touch"}[channel]
        misses = f"the twin misses the demonstrations by {self.error['heldout']:.3g} {UNIT}"
        where = f"most in {most} and in the phase '{phase}'"
        return f"Replayed in its world, {misses} on test episodes, {where}."

    def rows(self) -> list[dict]:
        shown = {f"{UNIT} (noise {self.noise_floor:.3g})": "bin"}
        shown |= {k: k for k in ("error", "arm", "gauge", "touch", "area")}
        return [{name: row[k] for name, k in shown.items()} for row in self.by["phase"]]

    def remarks(self) -> list[str]:
        own, out = self.study.fitter.known_s, []
        if self.latency_s - own > LATE_S:
            late = f"Commands acted {self.latency_s:.2g} s late and the twin has {own:.2g} s"
            out.append(f"{late}; `pneutac diagnose` finds whether arm and air are equally late.")
        out.append(f"Touch is shown {self.clock_s:.2g} s after the robot's joints and gauge.")
        if self.drift_s is not None and abs(self.drift_s) > 1 / CONTROL_HZ:
            later = f"touch is {self.drift_s:+.2g} s later in the second half of an episode than in the first"
            out.append(
                f"[yellow]The clocks of camera and robot drift:[/] {later}, which the twin is charged with."
            )
        out.append(self.light.sentence)
        stronger = self.study.stronger_by(self.twin) if self.residual.size else 0.0
        if stronger:
            times = f"Imprints are {np.exp(stronger):.2g} times as strong as in what the twin was fitted to"
            out.append(f"{times}, which counts as an error of its touch; `pneutac diagnose` finds why.")
        return out

    def content(self) -> dict:
        placed = (e.place for e in self.study.fitter.episodes)
        places = [{"seed": p.seed, "shift_m": list(p.shift_m)} for p in placed]
        return super().content() | {"light": self.light.to_dict(), "places": places}

    def film(self, number: int) -> tuple[list[np.ndarray], int]:
        """An episode's gel as recorded and as replayed, uint8 (H, W, 3) each, and the frame touched most."""
        e, r = self.demonstrations.episodes[number], self.replayed[number]
        frames = [comparison_picture(a, b) for a, b in zip(e.images, r.images, strict=True)]
        return frames, int(np.argmax(e.state[:, AREA]))

    def page(self) -> Report:
        page = Comparison.page(self)
        worst = self.worst[0]["trial"]
        frames, most = self.film(worst)
        caption = f"the gel as recorded, as replayed, and their difference, {GAIN} times as large."
        page.image(frames[most], f"Episode {worst}: {caption}", 3 * WIDTH)
        caption = f"The same as a film, {len(frames) / CONTROL_HZ:.0f} s."
        page.film(frames[::EVERY], EVERY / CONTROL_HZ, caption, 3 * WIDTH)
        page.heading("Pressure, contact area and path")
        from lerobot_pneutac.reports.figures import stacked  # plotly

        ends = self.study.fitter.ends
        for i in (row["trial"] for row in self.worst):
            e, r = self.demonstrations.episodes[i], self.replayed[i]
            t = np.arange(len(e)) / CONTROL_HZ
            figure = stacked(("pressure (kPa)", "contact area (%)", "arm (mm)"), (1, 1, 1), 0.05)
            off = np.linalg.norm(self.residual[ends[i] : ends[i + 1], :3], axis=1)
            lines = (
                (1, "commanded", t, e.action[:, 3], COMMAND),
                (1, "recorded", t, e.state[:, PRESSURE], MEASURED),
                (1, "replayed", t, r.pressure_kpa, MODEL),
                (2, "recorded", t, 100 * e.state[:, AREA], MEASURED),
                (2, "replayed", t, 100 * r.area, MODEL),
                (3, "arm off its commands", t, off, OTHER),
            )
            for row, name, x, y, colour in lines:
                figure.add_scatter(
                    x=x, y=y, name=name, line_color=colour, showlegend=row != 2, row=row, col=1
                )
            page.figure(figure, f"Episode {i}: recorded, and replayed by the twin.", 520)
        page.heading("Errors")
        for axis in ("episode", "depth"):  # the table above has the phases
            page.table([{axis: r.pop("bin"), **r} for r in map(dict, self.by[axis])])
        page.text(
            f"Error in {self.unit}: root mean square over frames; errors of gauge and touch are converted to"
            " the bend that would cause them. Area is the share of the image that is in contact."
        )
        return page

    def pictures(self) -> dict[str, np.ndarray]:
        frames, most = self.film(self.worst[0]["trial"])
        return {"touch.png": frames[most]}


def phases(episode: Episode) -> np.ndarray:
    """(T,) phase of each frame of an episode, an index of `PHASES`."""
    first, last = episode.contact() or (len(episode), len(episode))
    frames = np.arange(len(episode))
    out = np.where(without_specks(episode.state[:, AREA]) > 0, 2, 0)
    out[np.abs(frames - first) <= NEAR] = 1
    out[(frames > last - NEAR) & (frames <= last + NEAR) & (frames > first + NEAR)] = 3
    return out


def compare_demonstrations(
    twin: Twin, given: Demonstrations, seed: int = 0, progress: Progress = no_progress
) -> DemonstrationComparison:
    """Replays demonstrations in the twin's world; raises InputError where objects cannot be placed."""
    study = DemonstrationStudy(twin, given, seed, (), progress)
    world, f = World(given.task, twin, "image", "probe", station=given.station), study.fitter
    replayed = [
        replay(world, e, data.place, keep=True) for e, data in zip(given.episodes, f.episodes, strict=True)
    ]
    late = f.fit((Structure((LATE,)), f.start(LATE)), ARM, 40).values[f"{LATE}.latency_s"]
    touch = f.base(TOUCH).values["touch_late"] / CONTROL_HZ
    halves = [np.cumsum(e.contact) > e.contact.sum() // 2 for e in f.episodes]  # of an episode's touch
    masks = [[e.contact & (h == later) for e, h in zip(f.episodes, halves, strict=True)] for later in (0, 1)]
    drift_s = None
    if min(int(m.sum()) for m in sum(masks, [])) >= 2 * CONTROL_HZ:
        first, second = map(f.lateness, masks)
        drift_s = (second - first) / CONTROL_HZ
    return DemonstrationComparison(
        study=study,
        findings=tuple(study.findings),
        replayed=replayed,
        latency_s=late,
        clock_s=touch,
        drift_s=drift_s,
        light=light_drift(given.episodes, GelModel.from_twin(twin).rest_image),
    )


WIDTH = 180  # of a picture of the gel, px
GAIN = 3  # by which a change is shown larger
EVERY = 2  # frames of an episode that are shown in the film


def comparison_picture(recorded: np.ndarray, replayed: np.ndarray) -> np.ndarray:
    """Two images of the gel and their difference, `GAIN` times as large, side by side: uint8 (H, W, 3)."""
    return side_by_side((recorded, replayed, difference(recorded, replayed, GAIN)), width=WIDTH, gap=0)


COLOURS = ("red", "green", "blue")
LEAST = 2  # episodes: one to take the light from, one to test it


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class LightCalibration(Calibration):
    """A twin whose gel is lit at rest as in demonstrations."""

    light: LightDrift  # how the light had changed since the twin was made
    before: float  # error of the twin's own rest image on the test episodes, levels
    task: str
    dragging: Dragging | None = None  # how imprints turned where the finger was dragged sideways; None if not
    dragged_before: Dragging | None = None  # the same as the twin knew it

    heading = "The gel's light at rest"

    @property
    def sentence(self) -> str:
        if self.error["heldout"] == self.before:
            return f"{self.light.sentence} The rest image is unchanged: it is {self.before:.2f} levels off."
        light, now = self.light.sentence.split(";")[0].rstrip("."), f"{self.error['heldout']:.2f}"
        off = f"the twin's own rest image is {self.before:.2f} levels off, the new one {now}"
        return f"{light}. On rest frames of test episodes {off}."

    def rows(self) -> list[dict]:
        parts = zip(COLOURS, self.light.gain, self.light.levels, strict=True)
        return [{"colour": name, "factor": gain, "levels": level} for name, gain, level in parts]

    def remarks(self) -> list[str]:
        stays = "How the light changes under a press stays as it was calibrated"
        out = [f"{stays}; presses of known objects on the bench calibrate that{self._now()}."]
        return out + ([self.dragging.sentence(self.dragged_before)] if self.dragging else [])

    def _noted(self) -> dict:
        return {"dragging": self.dragging.to_history(self.task)} if self.dragging else {}

    def content(self) -> dict:
        return super().content() | {"light": self.light.to_dict(), "before": self.before}


def calibrate_demonstrations(twin: Twin, given: Demonstrations, seed: int = 0) -> LightCalibration:
    """Takes the gel's rest image from the frames before the first touches, of two episodes at least."""
    began = time.perf_counter()
    if len(given.episodes) < LEAST:
        raise InputError(f"{given.folder} has {len(given.episodes)} episode; a rest image takes {LEAST}.")
    model = GelModel.from_twin(twin)
    rests = np.stack([rest_image(e) for e in given.episodes]).astype(float)
    if rests.shape[1:] != model.rest_image.shape:
        sizes = f"the images are {rests.shape[1:]} and the gel's {model.rest_image.shape}"
        raise InputError(f"{given.folder}: {sizes}; calibrate the gel on its own camera first.")
    order = np.random.default_rng([seed, 6]).permutation(len(rests))
    heldout, used = np.split(order, [max(1, len(rests) // 3)])
    new = np.median(rests[used], axis=0).round().astype(np.uint8)
    out = twin.copy()
    if not out.gel:
        raise InputError("The twin has no gel of its own yet; calibrate one with a bench recording first.")

    def off(image: np.ndarray, which: np.ndarray) -> float:
        return float(np.sqrt(np.mean((rests[which] - image.astype(float)) ** 2)))

    light, before = light_drift(given.episodes, model.rest_image), off(model.rest_image, heldout)
    if off(new, heldout) >= before:  # nothing has changed by more than the camera wanders
        new = model.rest_image
    out.arrays = out.arrays | {"rest_image": new}
    return LightCalibration(
        twin=out,
        parameters={
            f"{c}_factor": {"value": g, "unit": ""} for c, g in zip(COLOURS, light.gain, strict=True)
        },
        error={"train": off(new, used), "heldout": off(new, heldout)},
        unit="levels",
        evaluations=1,
        seconds=time.perf_counter() - began,
        recording=str(given.folder),
        change="light at rest",
        seed=seed,
        light=light,
        before=before,
        task=given.task,
        dragging=Dragging.of(given.episodes),
        dragged_before=Dragging.known(twin.history, given.task),
    )
