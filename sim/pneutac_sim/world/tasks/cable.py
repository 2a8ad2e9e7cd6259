"""Follow a cable by touch to its plug."""

from dataclasses import dataclass
from typing import override

import numpy as np

from pneutac_sim.world.tasks.base import Goal, Task, contact_force, lately, place

POSITION_M = (0.53, 0.0, 0.0)
START_M = (-0.045, 0.125)  # y and height of the clip at the near end
PARTS, PART_M = 4, 0.024
REACHED_S = 0.2
TOUCH_N, PRESS_N = 0.15, 0.5  # forces: the least that the expert feels, and the one that it keeps


@dataclass
class CableTask(Task):
    """A cable on the front of a board, from a clip that is known to a plug that is not.

    The cable turns by a random angle at each of its joints, so that nothing but following it leads there.
    """

    name = "cable"
    description = "Follow the cable to its plug."
    home_m = (0.405, START_M[0], 0.262)
    goal = Goal(lambda task: task.followed, "plug", (0, 0, 1), depth_mm=0.6)

    turn_rad: float = 0.45  # largest turn of the first part, and of each to the one before
    too_hard = "pressed the cable"
    limit_n = 3.0  # pressing harder than this damages the cable
    # spread_x_m, spread_z_m: half widths of the random place of the board and of the clip's height
    spread_x_m: float = 0.020
    spread_z_m: float = 0.004

    @override
    def mjcf(self) -> str:
        capsule = f'class="object" type="capsule" fromto="0 0 0 0 {PART_M} 0" size=".004" material="accent"'
        chain = (
            f'<body name="plug" pos="0 {PART_M} 0"><geom name="plug" class="object" type="capsule"'
            ' fromto="0 .006 0 0 .02 0" size=".0055" material="steel"/></body>'
        )
        for n in reversed(range(PARTS)):
            at = f"0 {PART_M} 0" if n else f"0 {START_M[0]} {START_M[1]}"
            part = f'<geom name="cable_{n}" {capsule} friction=".3"/>'
            chain = f'<body name="cable_{n}" pos="{at}">{part}{chain}</body>'
        return f"""
        <body name="cable">
          <geom class="object" type="box" pos=".021 .02 .11" size=".008 .12 .11" material="console"/>
          <geom class="object" type="box" pos=".03 .02 .01" size=".03 .12 .01" material="console_dark"/>
          <geom class="decor" type="box" pos=".004 {START_M[0]} {START_M[1]}" size=".008 .004 .007"
                material="steel"/>
          {chain}
        </body>"""

    @override
    def reset(self, model, data, rng):
        x, z = rng.uniform(-1, 1, 2) * (self.spread_x_m, self.spread_z_m)
        place(model, "cable", np.add(POSITION_M, (x, 0.0, z)), 0.0)
        for n, turn in enumerate(rng.uniform(-1, 1, PARTS) * self.turn_rad):
            model.body(f"cable_{n}").quat[:] = np.cos(turn / 2), np.sin(turn / 2), 0.0, 0.0
        self._model, self._data = model, data
        self._reached_s, self.followed, self._force = 0.0, 0.0, (0.0, 0.0)

    @override
    def update(self, model, data, dt):
        self._force = lately(self._force, contact_force(model, data, ("cable", "plug")), dt)
        parts = [contact_force(model, data, f"cable_{n}") > 0 for n in range(PARTS)]
        if any(parts):
            self.followed = max(self.followed, (1 + int(np.flatnonzero(parts)[-1])) / (PARTS + 1))
        self._reached_s = self._reached_s + dt if contact_force(model, data, "plug") > 0 else 0.0

    @override
    def success(self):
        return self._reached_s >= REACHED_S - 1e-9

    @override
    def expert(self, world, habits, pressure_kpa):
        at = world.imprint_m
        if world.press_n < TOUCH_N or at is None:
            up = np.clip(30 * (START_M[1] + habits.offset_m - world.gel_m[2]), -1, 1)
            lost = world.flange_m[1] > START_M[0] + 0.012  # it has followed, and now gropes ahead
            return habits.speed * np.array([0.03, 0.0, 0.0 if lost else 0.03 * up]), habits.low_kpa
        ahead = np.clip(0.1 * (PRESS_N - world.press_n), -0.02, 0.02)
        # The imprint of a cable above the middle asks for the hand to rise, at once.
        return habits.speed * np.array([ahead, 0.022, -5.0 * at[1]]), habits.low_kpa
