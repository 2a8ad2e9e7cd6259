"""Press a call bar twice and hold it each time: while it is held, the touch shows how the finger bends."""

from dataclasses import dataclass
from typing import override

import numpy as np

from pneutac_sim.world.tasks.base import Goal, Task, contact_force, lately, place

POSITION_M = (0.53, 0.0, 0.0)
HIGH_M = 0.12  # of its middle above the table
BAR_M, HALF_M = 0.007, 0.016  # its radius and half its length
TOUCH_MM = 0.3  # imprint at which the expert has found it
DRAGS, DRAG_M_S = 2, 0.010  # how often it drags to both sides, and how fast


@dataclass
class ButtonTask(Task):
    """A round bar that does not give way, on a post."""

    name = "button"
    description = "Press the call button twice and hold it."
    home_m = (0.40, 0.0, 0.255)
    goal = Goal(lambda task: task.pressed / task.presses, "button", (-1, 0, 0), depth_mm=0.9)

    presses: int = 2  # how often it is to be pressed
    press_n: float = 0.5  # force that counts as a press
    hold_s: float = 3.0  # for how long
    too_hard = "pressed the button"
    limit_n = 6.0  # pressing it harder than this breaks it
    # how far the expert drags the finger sideways along the bar, to and fro, before it lets go
    drag_m: float = 0.0
    # spread_x_m, spread_y_m, spread_z_m: half widths of the random start
    spread_x_m: float = 0.020
    spread_y_m: float = 0.002
    spread_z_m: float = 0.002

    @override
    def mjcf(self) -> str:
        return f"""
        <body name="button">
          <geom name="button" class="object" type="capsule" size="{BAR_M}"
                fromto="0 {-HALF_M} {HIGH_M} 0 {HALF_M} {HIGH_M}"
                material="accent"/>
          <geom class="object" type="box" pos=".045 0 {HIGH_M / 2}" size=".020 .03 {HIGH_M / 2 + 0.03}"
                material="console"/>
          <geom class="decor" type="capsule" fromto="0 0 {HIGH_M} .03 0 {HIGH_M}" size=".004"
                material="steel"/>
        </body>"""

    @override
    def reset(self, model, data, rng):
        x, y, z = rng.uniform(-1, 1, 3) * (self.spread_x_m, self.spread_y_m, self.spread_z_m)
        place(model, "button", np.add(POSITION_M, (x, y, z)), 0.0)
        self.pressed, self._held_s, self._force = 0, 0.0, (0.0, 0.0)

    @override
    def update(self, model, data, dt):
        self._force = lately(self._force, contact_force(model, data, "button"), dt)
        # While it is dragged along, a gel that slips and sticks lets go for a moment.
        if (max(self._force) if self.drag_m else self._force[-1]) >= self.press_n:
            self._held_s += dt
        else:
            self.pressed += self.held
            self._held_s = 0.0

    @property
    def _drag_s(self) -> float:
        return 4 * DRAGS * self.drag_m / DRAG_M_S

    @property
    def held(self) -> bool:
        """Whether this press lasted long enough."""
        return self._held_s >= self.hold_s - 1e-9

    @override
    def success(self):
        return self.pressed >= self.presses

    @override
    def expert(self, world, habits, pressure_kpa):
        held_for = self._held_s - self.hold_s
        if self.drag_m and self.pressed == self.presses - 1 and self.held and held_for < self._drag_s:
            share = max(held_for, 0.0) / self._drag_s  # of a way to one side, the other, and back
            way = 1.0 if int(4 * DRAGS * share + 1) // 2 % 2 == 0 else -1.0
            return np.array([0.0, way * DRAG_M_S, 0.0]), habits.high_kpa
        if self.held or self.pressed >= self.presses:  # it lets go
            return np.zeros(3), 0.0
        if self.pressed or pressure_kpa > habits.low_kpa or world.press_mm > TOUCH_MM:
            return np.zeros(3), habits.high_kpa * (1.0 if self.pressed else 0.75)
        up = HIGH_M + habits.offset_m - world.gel_m[2]
        return 0.05 * habits.speed * np.array([1.0, 0.0, np.clip(30 * up, -1, 1)]), habits.low_kpa
