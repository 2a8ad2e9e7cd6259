"""Lift a soft fruit: held against a wall, firmly enough to bear it and not so firmly that it bursts."""

from dataclasses import dataclass
from typing import override

import numpy as np

from pneutac_sim.world.tasks.base import Goal, Task, contact_force, lately, place

POSITION_M = (0.53, 0.0, 0.0)
STAND_M = 0.10  # height of what it stands on
ROUND_M, BACK_M = 0.013, 0.012  # radius of its front, and from its middle to its flat back
HIGH_M, WIDE_M = 0.018, 0.014  # half its height and half its width
HOLD_S = 0.3
TOUCH_N, HELD_N = 0.1, 0.8  # forces: the least that the expert feels, and the one with which it holds
HELD_MM = 0.2  # the imprint that it makes
BELOW_M = 0.002  # the gel meets the fruit below its middle, for it creeps up on it


@dataclass
class FruitTask(Task):
    """A ripe fruit, round in front, between the rails of a wall that stands for a second finger.

    The gel holds the fruit against the wall and draws it up between the rails; let go, it falls back. It
    gives way where it is touched and bursts beyond `limit_n`.
    """

    name = "fruit"
    description = "Lift the ripe fruit without bursting it."
    home_m = (0.395, 0.0, 0.255)
    goal = Goal(lambda task: task.lifted_m / task.lift_m, "fruit", (0, 0, 0), depth_mm=HELD_MM)

    mass_kg: float = 0.030  # of the fruit
    wall_friction: float = 0.15  # between it and the wall
    too_hard = "squeezed the fruit"
    limit_n = 1.6  # squeezing it harder than this bursts it
    lift_m: float = 0.020  # how far it must be lifted
    # spread_x_m, spread_y_m: half widths of the random start
    spread_x_m: float = 0.040
    spread_y_m: float = 0.005

    @override
    def mjcf(self) -> str:
        soft = 'class="object" material="accent" solref=".012 1.2" solimp=".6 .95 .004" friction=".9"'
        rails = "".join(
            f'<geom class="decor" type="box" pos="{BACK_M} {y} {STAND_M + 0.05}" size=".006 .002 .09"'
            ' material="steel"/>'
            for y in (-WIDE_M - 0.003, WIDE_M + 0.003)
        )
        return f"""
        <body name="fruit">
          <geom class="object" type="box" pos=".03 0 .01" size=".05 .05 .01" material="console_dark"/>
          <geom class="object" type="box" pos=".006 0 {STAND_M / 2}" size=".006 .014 {STAND_M / 2}"
                material="console"/>
          <geom class="object" type="box" pos="{BACK_M + 0.005} 0 {STAND_M + 0.05}" size=".004 .05 .09"
                material="steel"/>
          {rails}
          <body pos="0 0 {STAND_M + HIGH_M}">
            <joint name="fruit" type="slide" axis="0 0 1" range="0 .1" limited="true" damping=".2"
                   solreflimit=".004 1"/>
            <geom name="fruit" type="capsule" fromto="0 -.006 0 0 .006 0" size="{ROUND_M}"
                  mass="{self.mass_kg / 2}" {soft}/>
            <geom name="fruit_back" type="box" pos=".003 0 0" size="{BACK_M - 0.003} {WIDE_M} {HIGH_M}"
                  mass="{self.mass_kg / 2}" {soft}/>
            <geom class="decor" type="capsule" fromto="0 0 {ROUND_M} 0 0 {HIGH_M + 0.006}" size=".0015"
                  material="carton_dark"/>
          </body>
        </body>"""

    @override
    def reset(self, model, data, rng):
        x, y = rng.uniform(-1, 1, 2) * (self.spread_x_m, self.spread_y_m)
        place(model, "fruit", np.add(POSITION_M, (x, y, 0.0)), 0.0)
        self._fruit, self._dof = data.joint("fruit"), model.joint("fruit").dofadr[0]
        model.dof_frictionloss[self._dof] = 0.0
        self._held_s, self._force = 0.0, (0.0, 0.0)

    @override
    def update(self, model, data, dt):
        self._force = lately(self._force, contact_force(model, data, "fruit"), dt)
        model.dof_frictionloss[self._dof] = self.wall_friction * self._force[-1]  # what presses it against it
        self._held_s = self._held_s + dt if self.lifted_m > self.lift_m else 0.0

    @override
    def success(self):
        return self._held_s >= HOLD_S - 1e-9

    @property
    def lifted_m(self) -> float:
        """How far the fruit is above where it stood, m."""
        return float(self._fruit.qpos[0])

    @override
    def expert(self, world, habits, pressure_kpa):
        up = STAND_M + HIGH_M - BELOW_M + habits.offset_m - world.gel_m[2]
        if world.press_n < TOUCH_N:
            return 0.05 * habits.speed * np.array([1.0, 0.0, np.clip(30 * up, -1, 1)]), habits.low_kpa
        ahead = np.clip(0.15 * (HELD_N - world.press_n), -0.02, 0.015)  # holds it by what it feels
        rise = 0.02 if world.press_n > 0.75 * HELD_N else np.clip(3 * up, -0.02, 0.02)
        return habits.speed * np.array([ahead, 0.0, rise]), habits.low_kpa
