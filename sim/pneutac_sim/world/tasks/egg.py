"""Open an egg carton: find the tab of the lid from below, hook it with the gel and lift."""

from dataclasses import dataclass
from typing import override

import numpy as np

from pneutac_sim.world.tasks.base import Goal, Task, contact_force, lately, place, share

POSITION_M = (0.58, 0.0, 0.0)
TRAY_M = 0.10  # height of the tray under the carton
BASE_M = 0.045  # height of the carton's lower half
DEPTH_M = 0.10  # hinge to front wall


@dataclass
class EggTask(Task):
    """A springy lid on a hinge at the far side, held shut by a small magnet, with a tab at its front.

    Off the magnet the lid opens by itself, as pulp does that was folded shut. Only the tab stands out over
    the front wall, by a few millimetres; the rest of the lid lies behind it. The random start is that of the
    front wall's middle, about which the carton is turned.
    """

    name = "egg"
    description = "Open the egg carton."
    home_m = (0.410, 0.0, 0.265)
    starts_m = (-0.015, 0.0, 0.015)
    wider = {"spread_yaw_rad": np.radians(8)}
    # from below, at the front edge of the tab
    goal = Goal(lambda t: share(t.lid_rad / t.open_rad), "carton_tab", (-1, 0, -1), depth_mm=0.6)

    latch_n: float = 1.0  # pull of the latch at the front edge, N
    # spring_nm_per_rad, spring_rest_rad: stiffness of the hinge, and the lid's angle at which it is slack
    spring_nm_per_rad: float = 0.012
    spring_rest_rad: float = 2.0
    overhang_m: float = 0.004  # how far the tab stands out over the front wall
    tab_half_m: float = 0.008  # half the tab's width
    recess_m: float = 0.010  # how far the rest of the lid lies behind the front wall
    open_rad: float = np.radians(60)  # lid angle that counts as open
    too_hard = "pressed the carton"
    limit_n = 8.0  # pressing the carton harder than this breaks the eggs
    wall_limit_n: float = 1.2  # pressing its front wall harder than this dents it
    # spread_x_m, spread_y_m, spread_yaw_rad: half widths of the random start
    spread_x_m: float = 0.045
    spread_y_m: float = 0.028
    spread_yaw_rad: float = np.radians(15)

    @override
    def mjcf(self) -> str:
        half, front = DEPTH_M / 2, DEPTH_M - self.recess_m
        cups = "".join(
            f'<geom class="decor" type="ellipsoid" pos="{x} {y} {BASE_M}" size=".018 .018 .022"'
            ' material="egg"/>'
            for x in (-0.025, 0.025)
            for y in (-0.048, 0.0, 0.048)
        )
        domes = "".join(
            f'<geom class="decor" type="ellipsoid" pos="{x} {y} .005" size=".021 .021 .018"'
            ' material="carton"/>'
            for x in (-0.077, -0.025)
            for y in (-0.048, 0.0, 0.048)
        )
        return f"""
        <body name="egg">
          <geom class="object" type="box" pos="0 0 {TRAY_M / 2}" size=".045 .06 {TRAY_M / 2}"
                material="console_dark"/>
          <body name="carton" pos="0 0 {TRAY_M}">
            <geom name="carton_base" class="object" type="box" pos="0 0 {BASE_M / 2}"
                  size="{half} .075 {BASE_M / 2}" material="carton_dark" conaffinity="5"/>
            {cups}
            <body name="lid" pos="{half} 0 {BASE_M + 0.003}">
              <joint name="lid" axis="0 1 0" range="0 2" limited="true" damping=".004"
                     stiffness="{self.spring_nm_per_rad}" springref="{self.spring_rest_rad}"/>
              <geom name="carton_lid" class="object" type="box" pos="{-front / 2} 0 .002"
                    size="{front / 2} .075 .002" mass=".025" material="carton"/>
              <geom name="carton_tab" class="object" type="box" pos="{-(front + self.reach_m) / 2} 0 .002"
                    size="{(self.reach_m - front) / 2} {self.tab_half_m} .002" mass=".0005"
                    material="carton"/>
              {domes}
              <body name="latch" pos="{-DEPTH_M + 0.004} 0 0">
                <geom class="decor" type="sphere" size=".0035" mass=".001" material="steel" contype="4"/>
              </body>
            </body>
          </body>
        </body>"""

    @override
    def actuators(self) -> str:
        return f'<adhesion name="latch" body="latch" ctrlrange="0 1" gain="{self.latch_n}"/>'

    @override
    def reset(self, model, data, rng):
        x, y, yaw = rng.uniform(-1, 1, 3) * (self.spread_x_m, self.spread_y_m, self.spread_yaw_rad)
        place(model, "egg", np.add(POSITION_M, (x, y, 0)), yaw, pivot_m=-DEPTH_M / 2)
        self._lid = data.joint("lid")
        data.actuator("latch").ctrl = 1.0
        self._force = self._wall = (0.0, 0.0)

    @override
    def update(self, model, data, dt):
        self._force = lately(self._force, contact_force(model, data, "carton"), dt)
        self._wall = lately(self._wall, contact_force(model, data, "carton_base"), dt)

    @override
    def success(self):
        return self.lid_rad > self.open_rad

    @override
    def failure(self):
        spoilt = super().failure()
        if not spoilt and min(self._wall) > self.wall_limit_n:
            return f"pressed the carton's wall with more than {self.wall_limit_n:g} N"
        return spoilt

    @property
    def reach_m(self) -> float:
        """Hinge to front edge of the tab, metres."""
        return DEPTH_M + self.overhang_m

    @property
    def edge_m(self) -> float:
        """Height of the closed lid's edge above the table, metres."""
        return TRAY_M + BASE_M + 0.005

    @property
    def lid_rad(self) -> float:
        """Angle of the lid, rad: 0 closed."""
        return float(self._lid.qpos[0])
