"""The device page of a finger or an arm: knobs of what acts on it, and how it bends, in real time."""

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import viser

from lerobot_pneutac.studio import plots as P
from lerobot_pneutac.studio.live import LiveBody, Shape, Skin
from lerobot_pneutac.studio.plots import Background, EffectsPanel, Lines, rgb, show_text
from pneutac_sim.effects.registry import body_effects, get_effect, of_body, of_sensor
from pneutac_sim.errors import InputError
from pneutac_sim.executor import Progress, no_progress
from pneutac_sim.features import CHAMBERS
from pneutac_sim.finger.online import COMPUTED, OTHERS
from pneutac_sim.splat.body import MOST_STRAIN, strain, stretch_colours
from pneutac_sim.splat.render import Gaussians
from pneutac_sim.twin import Twin

PARTICLES = 3000


@dataclass(frozen=True)
class Solid:
    """Material points at rest."""

    points_mm: np.ndarray  # (P, 3)
    colours: np.ndarray  # (P, 3) uint8, by how far each is stretched
    splats: Gaussians  # the body's Gaussians, in the twin's own looks where it has any
    most_strain: float  # largest principal strain, a share
    tip_mm: np.ndarray  # (3,) where the spine ends


def solve(
    twin: Twin, pressure_kpa: np.ndarray, conditions: Mapping[str, float], progress: Progress = no_progress
) -> Solid:
    """Brings the body to rest at pressures (chambers,) held for long.

    Raises InputError where an effect moves the tip alone, which material points do not follow.
    """
    from lerobot_pneutac.rendering.body import body_looks
    from pneutac_sim.mpm import devices  # brings the compiler of kernels, which takes a second
    from pneutac_sim.mpm.solve import solve_equilibrium
    from pneutac_sim.mpm.total_lagrangian import Loads

    q = devices.joint_targets(twin, pressure_kpa[None], conditions=conditions)
    solver = devices.BODIES[twin.device](twin, particles=PARTICLES, device="cpu")
    rest = solve_equilibrium(solver, Loads(q_cmd=q), progress=progress)
    stretched = strain(rest.gradients[0])
    return Solid(
        points_mm=1e3 * rest.positions[0],
        colours=stretch_colours(stretched, MOST_STRAIN).astype(np.uint8),
        splats=body_looks(twin, solver.body)(rest.positions[0], rest.gradients[0]),
        most_strain=float(stretched.max()),
        tip_mm=1e3 * devices.spine_points(solver, rest.q)[0, -1],
    )


UNIT = 0.01  # of the scene, in mm^-1: a decimetre
CIRCLES = {"point_shape": "circle", "precision": "float32"}
TRAIL_POINTS = 200
NARROW = 0.6  # width over height of a picture into which the body fits


class BodyScene:
    """What is drawn of a body."""

    def __init__(self, server: viser.ViserServer, twin: Twin):
        self._server, self._length = server, twin.length_mm
        self._joints = np.array(twin.spine_joint_positions_mm)
        scene, skin = server.scene, Skin.of(twin)
        scene.set_up_direction("-x")  # it hangs
        size = UNIT * twin.length_mm
        server.initial_camera.position = (0.45 * size, -2.1 * size, 0.9 * size)
        server.initial_camera.look_at = (0.5 * size, 0.0, 0.25 * size)
        server.initial_camera.up = (-1.0, 0.0, 0.0)
        server.initial_camera.fov = np.radians(45)
        server.on_client_connect(_keep_in_view)
        width = UNIT * float(np.ptp(skin.vertices_mm[:, 2]))
        scene.add_box("/base", color=P.BASE, dimensions=(0.4 * width, 1.5 * width, 1.5 * width),
                      position=(-0.2 * width, 0.0, 0.0))  # fmt: skip
        # sent again as it moves: a skinned mesh of viser 1.1.1 breaks the page when the server restarts
        self._carried = skin
        vertices, looks = (UNIT * skin.vertices_mm).astype(np.float32), {"color": P.SKIN, "opacity": 0.55}
        self._skin = scene.add_mesh_simple("/skin", vertices, skin.faces, side="double", **looks)
        straight = np.zeros((len(self._joints) + 2, 3))
        straight[1:-1, 0], straight[-1, 0] = self._joints, self._length
        spine = _segments(UNIT * straight)
        self._spine = scene.add_line_segments("/spine", spine, P.SPINE, thickness=0.08 * width)
        joints = (UNIT * straight[1:-1]).astype(np.float32)
        self._dots = scene.add_point_cloud("/joints", joints, P.JOINTS, point_size=0.14 * width, **CIRCLES)
        size = 0.13 * width
        self._tip = scene.add_icosphere("/tip", radius=size, color=P.TRAIL)
        self._measured = scene.add_icosphere("/measured tip", size, rgb(P.MEASURED), visible=False)
        look = {"thickness": 2.0, "thickness_units": "screen"}
        nothing = np.zeros((1, 2, 3), np.float32)
        self._trail = scene.add_line_segments("/tip's path", nothing, P.TRAIL, **look)
        self._path: list[np.ndarray] = []
        self._solid = None

    def show(self, shape: Shape, measured_mm: np.ndarray | None = None) -> None:
        """Draws a shape, and the measured tip (3,), if there is one."""
        with self._server.atomic():
            self._skin.vertices = (UNIT * self._carried.carried_mm(shape, self._joints)).astype(np.float32)
            spine = UNIT * shape.spine_mm(self._length, self._joints)
            self._spine.points = _segments(spine)
            self._dots.points = spine[1:-1].astype(np.float32)
            self._tip.position = UNIT * shape.markers[:3]
            self._measured.visible = measured_mm is not None
            if measured_mm is not None:
                self._measured.position = UNIT * measured_mm
            self._path = [*self._path[1 - TRAIL_POINTS :], UNIT * shape.markers[:3]]
            if len(self._path) > 1:
                self._trail.points = _segments(np.array(self._path))

    def show_solid(self, solid: Solid, splats: bool) -> None:
        """A body of material points, or of its Gaussians, in place of the skin, until `hide_solid`."""
        self.hide_solid()
        self._skin.visible = False
        name, scene = "/material points", self._server.scene
        if splats:
            g, metre = solid.splats, 1e3 * UNIT
            shape = metre * g.means, metre**2 * g.covariances()
            self._solid = scene.add_gaussian_splats(name, *shape, g.colours, g.opacities[:, None])
            return
        points = (UNIT * solid.points_mm).astype(np.float32)
        self._solid = scene.add_point_cloud(name, points, solid.colours, point_size=0.02, **CIRCLES)

    def hide_solid(self) -> None:
        if self._solid is not None:
            self._solid.remove()
            self._solid, self._skin.visible = None, True

    def forget_path(self) -> None:
        self._path = []
        self._trail.points = np.zeros((1, 2, 3), np.float32)


def _keep_in_view(client: viser.ClientHandle) -> None:
    """Moves the camera of a browser away where its picture is narrower than the body with its arrows."""
    farther = 1.0

    def changed(camera: viser.CameraHandle) -> None:
        nonlocal farther
        by, farther = max(1.0, NARROW / camera.aspect) / farther, max(1.0, NARROW / camera.aspect)
        if abs(by - 1) > 0.02:
            camera.position = camera.look_at + (camera.position - camera.look_at) * by

    client.camera.on_update(changed)


def _segments(points: np.ndarray) -> np.ndarray:
    """(n - 1, 2, 3) of the line through (n, 3)."""
    return np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)


DRAWN = POINTS, SPLATS = "points, coloured by stretch", "splats, in its own looks where it has any"


class SolidPanel:
    """A button that solves, and what came of it until something moves.

    `now` gives what `solve` takes; `begin` is called before.
    """

    def __init__(self, studio, scene: BodyScene, begin: Callable[[], None], now: Callable[[], tuple]):
        self._studio, self._scene, self._begin, self._now = studio, scene, begin, now
        self._solid: Solid | None = None
        gui = studio.server.gui
        button = gui.add_button("Solve by material points", icon="grid-dots")
        button.on_click(studio.safely(self.solve))
        self._drawn = gui.add_dropdown("drawn as", DRAWN)
        self._drawn.on_update(lambda _: self._draw())
        self.summary = gui.add_markdown("", visible=False)

    def solve(self) -> None:
        """The free body at rest at this pressure, without the poke."""

        def show(text: str, done: int, total: int) -> None:
            self.summary.content = f"Solving by material points: {done} of {total} ({text})"

        def work(progress: Progress) -> None:
            self._solid = found = solve(*self._now(), progress)
            self._draw()
            tip = "x {:.1f}, y {:.1f}, z {:.1f} mm".format(*found.tip_mm)
            stretch = f"stretched by {100 * found.most_strain:.1f} % at most"
            self.summary.content = f"{len(found.points_mm)} material points: tip at {tip}, {stretch}"

        def failed(why: str) -> None:
            self.summary.visible = False
            self._studio.say(why)

        self._begin()
        self._studio.session.begin("solving by material points", work, show, failed)
        show_text(self.summary, "Solving by material points ...")

    def _draw(self) -> None:
        if self._solid is not None:
            self._scene.show_solid(self._solid, splats=self._drawn.value == SPLATS)

    def hide(self) -> None:
        self._solid, self.summary.visible = None, False
        self._scene.hide_solid()


FRAMES_A_S = 30
CHART_S, CHART_A_S, CHART_HZ = 20.0, 10, 5
LONGEST_S = 0.25  # a frame that came late is no jump in time
STILL_MM = 1e-3
TWO_BENDS_RAD = 0.5  # of a joint, by the largest poke
GRAVITY_M_S2 = 9.81
SPEEDS = {"1 x": 1.0, "10 x": 10.0, "100 x": 100.0}


class DevicePage(Background):
    """Knobs, switches, and a body that follows them."""

    title = "Device"

    def __init__(self, studio):
        self._studio, self._gui = studio, studio.server.gui
        twin = studio.session.twin
        self.scene = BodyScene(studio.server, twin)
        self._arm = CHAMBERS[twin.device] > 1
        self.readout = self._gui.add_markdown("")
        self._chart = Lines(self._gui, "time, s", (("bend, °", P.MODEL), ("pressure, kPa", P.PRESSURE)), 190)
        low, high = map(float, twin.pressure_range_kpa)
        numbers = [f" {i + 1}" for i in range(CHAMBERS[twin.device])] if self._arm else [""]
        names = (f"pressure{n}, kPa" for n in numbers)
        self._pressures = [self._gui.add_slider(name, low, high, 0.1, 0.0) for name in names]
        for s in self._pressures:
            s.on_update(self._drive)
        self._loads(twin)
        with self._gui.add_folder("Time and material", expand_by_default=False):
            self._speed = self._gui.add_dropdown("speed of time", tuple(SPEEDS))
            rested = self._gui.add_button("Let it rest at this pressure", icon="bed")
            self.solid = SolidPanel(studio, self.scene, self._drive, self._state)
        rested.on_click(studio.safely(self._rest))
        self._series: deque = deque(maxlen=int(CHART_S * CHART_A_S))
        self._lock = threading.Lock()
        self._panel = EffectsPanel(self._gui, "Effects of the twin")
        self._changed()
        studio.driver = self.title
        studio.session.when_changed(studio.safely(self._changed))
        self.start(self._run, "device page")

    # ---------------------------------------------------------------- knobs

    def _drive(self, _=None) -> None:
        self.solid.hide()
        if self._studio.driver != self.title:
            self._studio.driver, self._poke.visible = self.title, True
            self.scene.forget_path()

    def _loads(self, twin: Twin) -> None:
        gui, recording = self._gui, self._studio.session.recording

        def typical(column: str, otherwise: float) -> float:
            if recording is None or not recording.has(column):
                return otherwise
            return round(float(np.median(recording.column(column))), 1)

        with gui.add_folder("Surroundings"):
            warm = typical("temperature_c", 22.0)
            self._temperature = gui.add_slider("temperature, °C", min(0.0, warm), max(60.0, warm), 0.5, warm)
            load = typical("payload_g", 0.0)
            self._payload = gui.add_slider("payload at the tip, g", 0.0, max(200.0, load), 1.0, load)
            self._down = gui.add_slider("gravity, ° from the finger", -180.0, 180.0, 1.0, 0.0,
                                        hint="0: it hangs; 90: it lies and bends downwards")  # fmt: skip
            self._aside = gui.add_slider("gravity, ° out of the plane", -90.0, 90.0, 1.0, 0.0)
            stiffness = twin.parameter("joint_stiffness_nm_per_rad")
            most = float(f"{TWO_BENDS_RAD * stiffness / (5e-4 * twin.length_mm):.1g}")
            axes, ends = "xyz" if self._arm else "xz", (-most, most, most / 100, 0.0)
            self._force = [gui.add_slider(f"poke along {axis}, N", *ends) for axis in axes]
        self._began = {"temperature_c": warm, "payload_g": load, "gravity_x": 0.0}
        for s in (self._temperature, self._payload, self._down, self._aside):
            s.on_update(self._studio.safely(self._surroundings))
        for s in self._force:
            s.on_update(self._drive)
        self._poke = self._studio.server.scene.add_transform_controls(
            "/poke", scale=0.25, disable_rotations=True, depth_test=False, opacity=0.8
        )
        self._most_n, self._dragged = most, False
        self._poke.on_update(self._pull)

    def _pull(self, event) -> None:
        """A pull at the tip's arrows; by half the finger's length it is the largest force."""
        if event.phase == "start":
            self._dragged, self._from = True, self.shape.markers[:3] * UNIT
        if event.phase == "end":
            self._dragged = False
            for slider in self._force:
                slider.value = 0.0
            return
        half = 0.5 * UNIT * self._studio.session.twin.length_mm
        pulled = (np.array(self._poke.position) - self._from) / half
        parts = pulled if self._arm else pulled[[0, 2]]
        for slider, part in zip(self._force, np.clip(parts, -1, 1), strict=True):
            slider.value = float(self._most_n * part)
        self._drive()

    @property
    def pressure_kpa(self) -> np.ndarray:
        return np.array([s.value for s in self._pressures], float)

    @property
    def force_n(self) -> np.ndarray:
        f = [s.value for s in self._force]
        return np.array(f if self._arm else [f[0], 0.0, f[1]], float)

    def conditions(self) -> dict[str, float]:
        """What the sliders say of the surroundings; further conditions as the recording has them, else 0."""
        down, aside = np.radians(self._down.value), np.radians(self._aside.value)
        x, y, z = np.cos(down) * np.cos(aside), np.sin(aside), np.sin(down) * np.cos(aside)
        given = {f"gravity_{a}": GRAVITY_M_S2 * v for a, v in zip("xyz", (x, y, z), strict=True)}
        given |= {"temperature_c": self._temperature.value, "payload_g": self._payload.value}
        recording, effects = self._studio.session.recording, self._twin.effects
        for name in {c for e in of_body(effects) for c in get_effect(e).columns} - {*COMPUTED, *given}:
            known = recording is not None and recording.has(name)
            given[name] = float(np.median(recording.column(name))) if known else 0.0
        return given

    # ---------------------------------------------------------------- the body

    def _changed(self) -> None:
        twin = self._studio.session.twin
        names = [*body_effects(), *(e for e in of_body(twin.effects) if e not in body_effects())]
        names = [n for n in names if n in twin.effects or not set(get_effect(n).columns) & set(OTHERS)]
        top = max(abs(x) for x in twin.pressure_range_kpa)
        self._panel.fill(names, twin.effects, top, self._studio.safely(self._rebuild))
        self._rebuild()

    def _rebuild(self) -> None:
        """The body with the effects that are switched on, long at rest under the present pressure."""
        twin = self._studio.session.twin
        sensor_effects = {n: twin.effects[n] for n in of_sensor(twin.effects)}
        self._twin = replace(twin, effects=sensor_effects | self._panel.values())
        body = LiveBody(self._twin, self.conditions())
        body.rest(self.pressure_kpa)
        with self._lock:
            self._body, self._moved = body, True
        self._drive()

    def _surroundings(self) -> None:
        with self._lock:
            self._body.set_conditions(self.conditions())
        acting = {c for e in of_body(self._twin.effects) for c in get_effect(e).columns}
        for column, slider, effect in (
            ("temperature_c", self._temperature, "thermal"),
            ("payload_g", self._payload, "payload"),
            ("gravity_x", self._down, "gravity"),
        ):
            if column not in acting and slider.value != self._began[column]:
                off = f"This bends the body by its effect `{effect}`, which is off"
                raise InputError(f"{off}; switch it on below.")
        self._drive()

    def _rest(self) -> None:
        with self._lock:
            self._body.rest(self.pressure_kpa)
        self.scene.forget_path()
        self._drive()

    def _state(self) -> tuple[Twin, np.ndarray, dict[str, float]]:
        return self._twin, self.pressed_kpa, self.conditions()

    def step(self, dt_s: float) -> Shape:
        with self._lock:
            self.pressed_kpa = self.pressure_kpa
            self.shape = self._body.step(self.pressed_kpa, self.force_n, dt_s)
        return self.shape

    def _run(self) -> None:
        last, shown, drawn = time.monotonic(), None, 0
        while not self._stop.wait(1 / FRAMES_A_S):
            now = time.monotonic()
            dt, last = min(now - last, LONGEST_S), now
            if self._studio.driver != self.title:
                self._poke.visible, shown = False, None
                continue
            shape = self.step(dt * SPEEDS[self._speed.value])
            moved = shown is None or np.abs(shape.markers[:3] - shown).max() > STILL_MM
            if moved:
                self._show(shape)
                shown = shape.markers[:3]
            self._series.append((now, shape.bend_deg, float(self.pressure_kpa.mean())))
            drawn += 1
            if drawn % (FRAMES_A_S // CHART_HZ) == 0 and np.ptp(np.array(self._series)[:, 1]) > 1e-3:
                t, *lines = np.array(self._series).T
                self._chart.show(t - t[-1], *lines)

    def _show(self, shape: Shape) -> None:
        self.scene.show(shape)
        if not self._dragged:
            self._poke.position = UNIT * shape.markers[:3]
        tip = "x {:.1f}, y {:.1f}, z {:.1f} mm".format(*shape.markers[:3])
        kpa = " / ".join(f"{p:.1f}" for p in self.pressed_kpa)
        self.readout.content = f"**Bend {shape.bend_deg:.1f}°**, tip at {tip}, pressure {kpa} kPa"
