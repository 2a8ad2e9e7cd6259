"""The measurement page of a finger or an arm: the recording over time, and the twin's prediction.

The measurement page of a gel: each recorded image and the twin's prediction.
"""

import re
import threading

import cv2
import numpy as np

from lerobot_pneutac.reports.compare import by_condition
from lerobot_pneutac.reports.figures import session_clock
from lerobot_pneutac.reports.page import difference, side_by_side
from lerobot_pneutac.studio import plots as P
from lerobot_pneutac.studio.live import Shape, Skin, measured_tips, shape_of
from lerobot_pneutac.studio.plots import Background, Lines, Player, rgb, table
from lerobot_pneutac.verbs.compare import compare
from pneutac_datasets.recording.photographs import read_camera
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.finger import Pipeline
from pneutac_sim.splat.camera import Camera
from pneutac_sim.twin import Twin

WIDTH_PX = 440


class PhotographPanel:
    """Photographs of one camera."""

    def __init__(self, gui, recording: Recording, twin: Twin):
        self._recording, self._skin = recording, Skin.of(twin)
        self._joints = np.array(twin.spine_joint_positions_mm)
        self._columns = [str(c) for c in recording.samples if re.fullmatch(r"image(_\w+)?", str(c))]
        self._cameras = {c: self._camera_of(c) for c in self._columns}
        names = tuple(self._columns) or ("",)
        self._chosen = gui.add_dropdown("photograph", names, visible=len(names) > 1)
        self._picture = gui.add_image(np.zeros((2, 2, 3), np.uint8), label="photographed", visible=False)

    def _camera_of(self, column: str) -> Camera | None:
        described = self._recording.meta.get("cameras")
        names = list(described) if isinstance(described, dict) else []
        name = column.removeprefix("image_") if column != "image" else next(iter(names), "")
        try:
            return read_camera(self._recording, name) if name in names else None
        except InputError:
            return None  # `pneutac check` lists what is wrong with it; the photograph is shown all the same

    def show(self, sample: int, shape: Shape) -> None:
        """The photograph of a sample, if it has one, and the outline of the model's body on it."""
        if not self._columns or sample >= len(self._recording):  # what a bench measured since is not there
            return
        column = self._chosen.value
        file = self._recording.samples[column].iloc[sample]
        if not (isinstance(file, str) and file):
            return
        image, camera = self._recording.image(file).copy(), self._cameras[column]
        if camera is not None:
            mask = silhouette(self._skin.carried_mm(shape, self._joints), self._skin.faces, camera)
            lines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            cv2.drawContours(image, lines, -1, rgb(P.MODEL), max(2, image.shape[1] // 200))
            self._picture.label = "photographed; the line is the model's outline"
        self._picture.image = side_by_side([image], width=WIDTH_PX)
        self._picture.visible = True


def silhouette(vertices_mm: np.ndarray, faces: np.ndarray, camera: Camera) -> np.ndarray:
    """Bool (H, W): where a camera sees a mesh; vertices (V, 3) in mm of the base frame, faces (F, 3)."""
    mask = np.zeros((camera.height, camera.width), np.uint8)
    pixels, depth = camera.project(1e-3 * vertices_mm)
    seen = (depth[faces] > 0).all(1)
    for triangle in np.round(pixels[faces[seen]]).astype(np.int32):
        cv2.fillConvexPoly(mask, triangle, 1)
    return mask > 0


MOST_POINTS = 500  # of a line: more cannot be distinguished in the panel
WINDOWS = {"10 s": 10.0, "30 s": 30.0, "2 min": 120.0, "all": np.inf}


class MeasurementPage(Background):
    """Play, scrub, jump."""

    title = "Measurement"

    def __init__(self, studio):
        self._studio, self._gui, self._scene = studio, studio.server.gui, studio.pages["Device"].scene
        gui = self._gui
        self.readout = gui.add_markdown("The twin is run on the recording ...")
        self.player = Player(gui, self._scrubbed)
        self._window = gui.add_dropdown("shown about it", tuple(WINDOWS), initial_value="30 s")
        session = studio.session
        self._photograph = PhotographPanel(gui, session.needs_recording(), session.twin)
        self._charts, self._charts_folder = [], gui.add_folder("In time")
        self._places = gui.add_folder("Worst passages")
        self._conditions = gui.add_folder("Error against conditions", expand_by_default=False)
        self._rows, self._lock = [], threading.RLock()
        self._window.on_update(lambda _: self._draw())
        session.when_changed(self._load)
        self.start(self._load, "measurement page")

    # ---------------------------------------------------------------- what is shown

    def _load(self) -> None:
        session = self._studio.session
        try:
            comparison = compare(session.twin, session.needs_recording())
        except InputError as e:
            self.readout.content = f"> {e}"
            return
        session.comparison = comparison
        with self._lock:  # the twin may be another before the first one is laid out
            self._lay_out(comparison)
        self._draw()

    def _lay_out(self, c) -> None:
        """Keeps what is drawn of a comparison, trials laid end to end, and makes what shows it."""
        pipeline, gui = Pipeline.of(c.twin, c.bench.inputs), self._gui
        self._run_of = pipeline.run(c.bench.inputs, pipeline.theta(c.twin, c.bench.inputs.pressure_range_kpa))
        self._t, self._shift = session_clock(c.recording)
        self._c, self._error = c, np.sqrt(c.squared)
        self._main = int(np.argmax(np.var(c.measured[:, : c.counted], axis=0)))
        self._pressure, self._tip = c.recording.commands, measured_tips(c)
        self.player.reaches(float(self._t[-1]))
        if not self._charts:
            name, _, unit = c.columns[self._main].rpartition("_")
            with self._charts_folder:
                title = f"{name.replace('_', ' ')}, {unit}"
                names = c.recording.pressure_columns
                chambers = [n.removeprefix("pressure_cmd_").removesuffix("kpa").strip("_") for n in names]
                commands = [f"command {n}".strip() + ", kPa" for n in chambers]
                colours = (P.PRESSURE, P.FLOOR, P.MODEL)[: len(commands)]
                both, error = ("measured", P.MEASURED), ("error", P.MODEL)
                self._charts = [
                    Lines(gui, "time, s", (both, ("model", P.MODEL)), 170, title, P.FLOOR),
                    Lines(gui, "time, s", (error, ("noise", P.FLOOR)), 140, f"error, {c.unit}"),
                    Lines(gui, "time, s", tuple(zip(commands, colours, strict=True)), 150, "command, kPa"),
                ]
        for handle in self._rows:
            handle.remove()
        self._rows = []
        with self._places:
            for p in c.worst:
                when = f"trial {p['trial']}, {p['from_s']:.1f} s to {p['to_s']:.1f} s"
                b = gui.add_button(f"{p['error']:.3g} {c.unit}: {when}")
                b.on_click(lambda _, p=p: self.jump(p))
                self._rows.append(b)
        with self._conditions:
            shown = {n: r for n, r in c.by.items() if len(r) > 1}
            figure = by_condition(shown, c).update_layout(
                template="plotly_white", height=160 + 200 * ((len(shown) + 1) // 2), font={"size": 9},
                margin={"l": 40, "r": 10, "t": 30, "b": 30}, legend={"orientation": "h", "y": -0.08},
            )  # fmt: skip
            self._rows.append(gui.add_plotly(figure, aspect=min(1.5, 3.0 / max(1, (len(shown) + 1) // 2))))

    def jump(self, passage: dict) -> None:
        self._scene.forget_path()
        self.player.now_s = float(passage["from_s"] + self._shift[passage["trial"]])

    # ---------------------------------------------------------------- in time

    def _scrubbed(self) -> None:
        if self._studio.driver != self.title:
            self._studio.driver = self.title
            self._scene.forget_path()
        self._draw()

    def _draw(self) -> None:
        with self._lock:
            if not hasattr(self, "_c"):
                return
            c, t = self._c, self._t
            i = int(np.clip(np.searchsorted(t, self.player.now_s), 0, len(t) - 1))
            shape = shape_of(self._run_of.joints[i], self._run_of.markers[i], c.twin)
            if self._studio.driver == self.title:
                self._scene.show(shape, None if self._tip is None else self._tip[i])
            half = WINDOWS[self._window.value] / 2
            at = np.flatnonzero(np.abs(t - t[i]) <= half) if np.isfinite(half) else np.arange(len(t))
            every = max(1, len(at) // MOST_POINTS)
            at = at[::every]
            x = t[at]
            main = c.measured[:, self._main], c.model[:, self._main]
            self._charts[0].show(x, *(values[at] for values in main), now=t[i])
            self._charts[1].show(x, self._error[at], np.full(len(at), c.noise_floor or np.nan))
            self._charts[2].show(x, *self._pressure[at].T)
            drawn = f"  \nDrawn: one sample of {every}." if every > 1 else ""
            trial, own = int(c.recording.column("trial")[i]), float(c.recording.column("time_s")[i])
            heldout = "" if c.heldout is None else f"; test error {c.heldout:.3g} {c.unit} in all"
            off = f"**Off by {self._error[i]:.2f} {c.unit}** in trial {trial} at {own:.2f} s{heldout}."
            both = f"measured {main[0][i]:.2f}, model {main[1][i]:.2f}"
            kpa = " / ".join(f"{p:.1f}" for p in self._pressure[i])
            said = f"{off}  \n{c.columns[self._main]}: {both}; command {kpa} kPa"
            self.readout.content = said + drawn
            self._photograph.show(i, shape)

    def close(self) -> None:
        self.player.close()
        super().close()


THUMBNAIL_PX = 150  # of each picture
TIMES = 4.0  # by which the difference is exaggerated


class ImagesPage(Background):
    """Recorded, modelled, and the difference."""

    title = "Measurement"

    def __init__(self, studio):
        self._studio, self._gui, self._c = studio, studio.server.gui, None
        self.readout = self._gui.add_markdown("The twin is run on the recording ...")
        self._number = self._gui.add_slider("image", 1, 2, 1, 1)
        label = f"recorded, model, {TIMES:g} times the difference"
        self._picture = self._gui.add_image(np.zeros((2, 2, 3), np.uint8), label=label)
        self._worst = self._gui.add_button("The worst image")
        self._about = self._gui.add_markdown("")
        self._number.on_update(lambda _: self._draw())
        self._worst.on_click(lambda _: self.jump())
        studio.session.when_changed(self._load)
        self.start(self._load, "images page")

    def _load(self) -> None:
        session = self._studio.session
        try:
            session.comparison = self._c = compare(session.twin, session.needs_recording())
        except InputError as e:
            self.readout.content = f"> {e}"
            return
        self._number.max = max(2, len(self._c.drawn.images))
        self._about.content = "\n\n".join(table(rows) for rows in self._c.by.values())
        self._draw()

    def jump(self) -> None:
        if self._c is not None:
            names = [s.name for s in self._c.data.samples]
            self._number.value = 1 + names.index(self._c.worst[0]["image"])
            self._draw()

    def _draw(self) -> None:
        c = self._c
        if c is None:
            return
        i = min(int(self._number.value), len(c.drawn.images)) - 1
        sample, score, model = c.data.samples[i], c.drawn.scores[i], c.drawn.images[i]
        three = (sample.image, model, difference(model, sample.image, TIMES))
        self._picture.image = side_by_side(three, width=THUMBNAIL_PX)
        p, role = sample.press, f" ({sample.role})" if sample.role else ""
        off = f"**Off by {score.rmse:.2f} levels**, in the contact {score.contact_rmse:.2f}"
        press = f"{p.indenter} of {p.size_mm:g} mm at {p.x_mm:.1f}, {p.y_mm:.1f} mm, {p.depth_mm:.2f} mm deep"
        self.readout.content = f"{off}: {sample.name}, {press}{role}"
