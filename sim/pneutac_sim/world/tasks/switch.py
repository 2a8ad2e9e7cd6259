"""Flip a toggle switch: a bistable lever on a console, pushed away from the robot."""

from dataclasses import dataclass
from typing import override

import numpy as np

from pneutac_sim.world.tasks.base import Goal, Task, contact_force, lately, place, share

LEVER_M = 0.045  # hinge to bar
HINGE_M = 0.085  # hinge above the table
POSITION_M = (0.54, 0.0, 0.0)  # console, middle of the random poses
REST_S = 0.5  # how long the lever must rest in the other well


@dataclass
class SwitchTask(Task):
    """A lever with two wells at -+ `well_rad` and a ridge between them.

    The hinge's torque is `-k q (q^2 / well^2 - 1)`, whose peak between well and ridge is
    `2 k well / (3 sqrt 3)`; k follows from `ridge_torque_nm`.

    The lever has some play sideways: pushed off its middle it gives way and the finger slips off. The
    random start is that of the bar, about which the console is turned.
    """

    name = "switch"
    description = "Flip the toggle switch."
    home_m = (0.40, 0.0, 0.255)
    starts_m = (-0.020, 0.0, 0.020)
    wider = {"spread_yaw_rad": np.radians(8)}
    goal = Goal(
        lambda t: share((t.lever_rad + t.well_rad) / (2 * t.well_rad)),
        "bar",
        (-1, 0, 0),
        depth_mm=1.0,
    )

    ridge_torque_nm: float = 0.058  # torque that passes the ridge, N m
    # lever angle in a well; the task starts at -well (towards the robot) and ends at +well
    well_rad: float = 0.4
    tilt_rad: float = 0.3  # how far the console leans towards the robot
    bar_half_m: float = 0.012  # half the length of the barrel-shaped bar on the lever
    play_nm_per_rad: float = 0.12  # stiffness of the lever sideways
    too_hard = "pressed the switch"
    limit_n = 8.0  # pressing the switch harder than this breaks it
    # spread_x_m, spread_y_m, spread_yaw_rad: half widths of the random start
    spread_x_m: float = 0.040
    spread_y_m: float = 0.032
    spread_yaw_rad: float = np.radians(15)

    @override
    def mjcf(self) -> str:
        k = self.ridge_torque_nm * 3 * np.sqrt(3) / (2 * self.well_rad)
        b, top = self.bar_half_m, LEVER_M
        return f"""
        <body name="switch">
          <geom name="switch_base" class="object" type="box" pos=".018 0 .012" size=".075 .06 .012"
                material="console_dark"/>
          <body pos="0 0 {HINGE_M}" euler="0 {-self.tilt_rad} 0">
            <geom name="switch_console" class="object" type="box" pos="0 0 -.043" size=".040 .045 .035"
                  material="console"/>
            <geom class="decor" type="cylinder" pos="0 0 -.008" size=".016 .003" material="steel"/>
            <geom class="decor" type="box" pos=".034 0 -.0078" size=".003 .020 .0006" material="accent"/>
            <body name="lever">
              <joint name="lever" axis="0 1 0" stiffness="{-k} 0 {k / self.well_rad**2}" damping=".0015"/>
              <joint name="lever_play" axis="1 0 0" stiffness="{self.play_nm_per_rad}" damping=".002"/>
              <geom name="switch_lever" class="object" type="capsule" fromto="0 0 0 0 0 {top}" size=".0035"
                    mass=".004" material="steel"/>
              <geom name="bar" class="object" type="ellipsoid" pos="0 0 {top}" size=".0065 {b} .0065"
                    mass=".006" material="accent"/>
            </body>
          </body>
        </body>"""

    @override
    def reset(self, model, data, rng):
        x, y, yaw = rng.uniform(-1, 1, 3) * (self.spread_x_m, self.spread_y_m, self.spread_yaw_rad)
        bar = -LEVER_M * np.sin(self.well_rad + self.tilt_rad)
        place(model, "switch", np.add(POSITION_M, (x, y, 0)), yaw, pivot_m=bar)
        self._lever = data.joint("lever")
        self._lever.qpos = -self.well_rad
        self._rested_s = 0.0
        self._force = (0.0, 0.0)

    @override
    def update(self, model, data, dt):
        force = contact_force(model, data, ("switch", "bar"))
        self._force = lately(self._force, force, dt)
        resting = self.lever_rad > 0.75 * self.well_rad and abs(self._lever.qvel[0]) < 0.5
        self._rested_s = self._rested_s + dt if resting else 0.0

    @override
    def success(self):
        return self._rested_s >= REST_S - 1e-9

    @property
    def lever_rad(self) -> float:
        """Angle of the lever, rad: -well at the start, +well when flipped."""
        return float(self._lever.qpos[0])
