"""The page of a gel: an indenter by sliders and by the mouse, and what the sensor sees of it."""

import threading
import time
from dataclasses import replace

import numpy as np

from lerobot_pneutac.reports.page import side_by_side
from lerobot_pneutac.studio.plots import SKIN, Background, EffectsPanel
from pneutac_sim.effects.registry import sensor_effects
from pneutac_sim.gel.indenter import INDENTERS, Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.photograph import press_depth, registered
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.splat.body import stretch_colours

FRAMES_A_S = 30
UNIT = 0.1  # of the scene, in mm^-1
DEPTH_DRAWN = 3.0  # an imprint is drawn so many times as deep as it is
PICTURE_PX = 300  # height of each of the two pictures
DEEPEST_MM = 2.0


class GelPage(Background):
    """An indenter on a gel."""

    title = "Touch"

    def __init__(self, studio):
        self._studio, self._gui = studio, studio.server.gui
        self.readout = self._gui.add_markdown("")
        blank = np.zeros((PICTURE_PX, PICTURE_PX, 3), np.uint8)
        label = f"what the sensor sees; how deep its surface moves, 0 to {DEEPEST_MM:g} mm"
        self._picture = self._gui.add_image(blank, label=label)
        self._sensor = TactileSensor(GelModel.from_twin(studio.session.twin))
        width, height = self._sensor.model.window_mm
        self._shape = self._gui.add_dropdown("indenter", INDENTERS)
        self._size = self._gui.add_slider("radius or side, mm", 0.5, 8.0, 0.1, 3.0)
        self._x = self._gui.add_slider("x, mm", -width / 2, width / 2, 0.05, 0.0)
        self._y = self._gui.add_slider("y, mm", -height / 2, height / 2, 0.05, 0.0)
        self._depth = self._gui.add_slider("depth, mm", 0.0, DEEPEST_MM, 0.02, 0.6)
        self._yaw = self._gui.add_slider("turn, °", -90.0, 90.0, 1.0, 0.0)
        self._panel = EffectsPanel(self._gui, "Effects of the sensor")
        self._draw_scene()
        self._due = threading.Event()
        for control in (self._shape, self._size, self._x, self._y, self._depth, self._yaw):
            control.on_update(self._moved)
        self._changed()
        studio.driver = studio.driver or self.title
        studio.session.when_changed(studio.safely(self._changed))
        self.start(self._run, "gel page")

    def _draw_scene(self) -> None:
        scene, (width, height) = self._studio.server.scene, self._sensor.model.window_mm
        self._grid = rows, cols = 80, 59
        x, y = ((np.arange(n) + 0.5) * s / n - s / 2 for n, s in ((cols, width), (rows, height)))
        self._flat = np.stack([*np.meshgrid(UNIT * x, -UNIT * y), np.zeros(self._grid)], -1).reshape(-1, 3)
        at = np.arange(rows * cols).reshape(self._grid)
        a, b, c, d = at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]
        self._faces = np.concatenate([np.stack([a, c, b], -1), np.stack([b, c, d], -1)]).reshape(-1, 3)
        if self._studio.session.twin.device != "gel":
            return  # the picture is the finger's
        server = self._studio.server
        server.initial_camera.position = (0.0, -0.9 * UNIT * height, 1.0 * UNIT * height)
        server.initial_camera.fov = np.radians(50)
        server.initial_camera.look_at = (0.0, 0.0, 0.0)
        scene.set_up_direction("+z")
        self._handle = scene.add_transform_controls(
            "/indenter", scale=0.3, disable_rotations=True, depth_test=False
        )
        self._handle.on_update(self._pulled)

    def _pulled(self, _) -> None:
        x, y, z = np.array(self._handle.position) / UNIT
        for slider, value in ((self._x, x), (self._y, -y), (self._depth, -z / DEPTH_DRAWN)):
            value = float(np.clip(value, slider.min, slider.max))
            if abs(slider.value - value) > 1e-6:
                slider.value = value
        self._due.set()

    def _moved(self, _=None) -> None:
        self._studio.driver = self.title
        self._due.set()

    def _changed(self) -> None:
        twin = self._studio.session.twin
        effects, present = sensor_effects(), twin.effects if twin.gel else GelModel.builtin().effects
        present = {n: p for n, p in present.items() if n in effects}
        self._panel.fill(effects, present, 1.0, self._studio.safely(self._rebuild))
        self._rebuild()

    def _rebuild(self) -> None:
        gel = GelModel.from_twin(self._studio.session.twin)
        on = {n: {k: v.value for k, v in values.items()} for n, values in self._panel.values().items()}
        self._sensor = TactileSensor(replace(gel, effects=on))
        self._due.set()

    def state(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Tactile image (H, W, 3), the imprint and the surface's displacement (80, 59) in mm."""
        sensor = self._sensor
        if self._depth.value <= 0:
            nothing = np.zeros(self._grid, np.float32)
            return sensor.rest_image, nothing, nothing
        place = (s.value for s in (self._shape, self._size, self._x, self._y, self._depth))
        press = Press(*place, np.radians(self._yaw.value))
        depth = press_depth(registered(press, sensor.model), sensor.model)
        moved = sensor.displacement(depth)
        return sensor.draw(moved) if moved.any() else sensor.rest_image, depth, moved

    def _run(self) -> None:
        while not self._stop.is_set():
            if not self._due.wait(0.2):
                continue
            self._due.clear()
            start = time.monotonic()
            self._show(*self.state())
            self._stop.wait(max(0.0, 1 / FRAMES_A_S - (time.monotonic() - start)))

    def _show(self, image: np.ndarray, depth: np.ndarray, moved: np.ndarray) -> None:
        sensor = self._sensor
        area = sensor.contact(image)
        width, height = sensor.model.window_mm
        contact, under = (width * height * share for share in (area.area, (depth > 0).mean()))
        shown = f"**Contact {contact:.1f} mm²** ({area.pixels} pixels)"
        self.readout.content = f"{shown}, deepest {depth.max():.2f} mm, under its shape {under:.1f} mm²"
        colours = stretch_colours(moved, DEEPEST_MM).astype(np.uint8)
        self._picture.image = side_by_side([image, colours], height=PICTURE_PX)
        if self._studio.session.twin.device != "gel":
            return
        drawn = self._flat.copy()
        drawn[:, 2] = -UNIT * DEPTH_DRAWN * moved.ravel()
        server, place = self._studio.server, (self._x.value, -self._y.value, -DEPTH_DRAWN * self._depth.value)
        with server.atomic():
            looks = {"color": SKIN, "side": "double"}
            server.scene.add_mesh_simple("/gel", drawn.astype(np.float32), self._faces, **looks)
            self._handle.position = UNIT * np.array(place)
