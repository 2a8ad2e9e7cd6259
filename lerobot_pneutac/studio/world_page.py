"""The world page: a task in simulation with this twin's finger, by an expert or by hand, touch beside."""

import threading
import time

import cv2
import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.features import IMAGE_NAME, task_names

HEIGHT_PX = 280
SPEED_M_S = 0.05  # of a button that is held
HELD_S = 0.25  # after which a button that was held counts as let go
MOVES = {"forward": (0, 1), "back": (0, -1), "left": (1, 1), "right": (1, -1), "up": (2, 1), "down": (2, -1)}
PLAYERS = ("the scripted expert", "by hand")


class WorldPage:
    """A task of the library, one control step after the other.

    Args:
        studio: that it is a page of; its twin is a finger's.
    """

    title = "World"

    def __init__(self, studio):
        self._studio, gui = studio, studio.server.gui
        self.readout = gui.add_markdown("A task in simulation, with this twin's finger; nothing is recorded.")
        self._picture = gui.add_image(np.zeros((2, 2, 3), np.uint8), label="scene and touch", visible=False)
        self._task = gui.add_dropdown("task", tuple(task_names()))
        self._player = gui.add_dropdown("moved by", PLAYERS)
        gui.add_button("Begin anew", icon="player-play").on_click(studio.safely(self.begin))
        low, high = studio.session.twin.pressure_range_kpa
        self._held: dict[str, float] = {}
        hand = gui.add_folder("By hand")
        with hand:
            self._pressure = gui.add_slider("pressure, kPa", float(low), float(high), 0.1, 0.0)
        for name in MOVES:
            with hand:
                button = gui.add_button(f"Hold to move {name}")
            button.on_hold(lambda _, n=name: self._hold(n), callback_hz=10.0)
        self._stop, self._thread = threading.Event(), None

    def _hold(self, name: str) -> None:
        self._held[name] = time.monotonic()

    def begin(self) -> None:
        """Another start of the task; the one before ends."""
        self.close()
        self._stop = threading.Event()
        self.readout.content = f"The world of the task '{self._task.value}' is made ..."
        self._thread = threading.Thread(target=self._run, args=(self._stop,), daemon=True, name="world page")
        self._thread.start()

    def _run(self, stop: threading.Event) -> None:
        from pneutac_sim.world.env import PneutacEnv  # MuJoCo, and networks where the twin has them
        from pneutac_sim.world.expert import ScriptedExpert

        try:
            env = PneutacEnv(self._task.value, twin=self._studio.session.twin)
            observation, info = env.reset(seed=int(time.time()) % 10_000)
            expert = ScriptedExpert(env.world, np.random.default_rng())
            done, shown_s = False, 0.0
            while not (done or stop.is_set()):
                began = time.monotonic()
                action = expert.action() if self._player.value == PLAYERS[0] else self.action()
                observation, _, done, _, info = env.step(action)
                shown_s += env.world.dt_s
                self._show(env.render(), observation["pixels"][IMAGE_NAME], shown_s, info, done)
                stop.wait(max(0.0, env.world.dt_s - (time.monotonic() - began)))
            env.close()
        except InputError as e:
            self.readout.content = f"> {e}"

    def action(self) -> np.ndarray:
        """(4,) of the buttons that are held and of the slider, as `features.ACTION_NAMES`."""
        velocity = np.zeros(3)
        for name, (axis, sign) in MOVES.items():
            if time.monotonic() - self._held.get(name, -np.inf) < HELD_S:
                velocity[axis] += sign * SPEED_M_S
        return np.append(velocity, self._pressure.value)

    def _show(self, scene: np.ndarray, touch: np.ndarray, time_s: float, info: dict, done: bool) -> None:
        small = [
            cv2.resize(
                v, (round(HEIGHT_PX * v.shape[1] / v.shape[0]), HEIGHT_PX), interpolation=cv2.INTER_AREA
            )
            for v in (scene, touch)
        ]
        self._picture.image = np.concatenate(
            [small[0], np.full((HEIGHT_PX, 6, 3), 255, np.uint8), small[1]], 1
        )
        self._picture.visible = True
        end = " **Done.**" if info["is_success"] else f" **{info['failure']}**" if done else ""
        self.readout.content = f"{self._task.value}, {time_s:.1f} s of the task.{end}"

    def close(self) -> None:
        """Ends the task."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(timeout=5.0)
