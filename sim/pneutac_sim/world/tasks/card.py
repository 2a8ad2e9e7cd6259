"""Pull one card out of a deck that stands in a leaning holder."""

from dataclasses import dataclass
from typing import override

import numpy as np

from pneutac_sim.world.tasks.base import Goal, Task, contact_force, place, share

POSITION_M = (0.56, 0.0, 0.0)
STAND_M = 0.09  # height of the holder's floor
CARD_M = (0.063, 0.088, 0.0006)  # width, height, thickness


@dataclass
class CardTask(Task):
    """A reduced deck: each card slides on the next one behind it, the last one in the holder.

    Cards are a chain of slide joints, card 1 the front one. The joint of card i holds by the dry friction
    `mu_i N + i edge_n`: N presses on the front card and is the same at every interface, `edge_n` is the drag
    of the holder on one card. So the next card follows where (mu_1 - mu_2) N exceeds the drag: who presses
    too hard draws two. The friction follows N once a control step.
    """

    name = "card"
    description = "Pull the front card out of the deck."
    home_m = (0.385, 0.0, 0.315)
    wider = {"spread_x_m": 0.012, "spread_y_m": 0.008}
    # the front face, below the upper edge: what the second card gives is lost
    goal = Goal(
        lambda t: share(t.drawn_m(1) / t.draw_m) - share(t.drawn_m(2) / t.second_m),
        "card_1",
        (-1, 0, 0.85),
        depth_mm=0.5,
    )

    cards: int = 10  # number of loose cards; fewer are quicker and do for planning
    friction: tuple[float, float] = (0.2, 0.4)  # lowest and highest friction coefficient between two cards
    edge_n: float = 0.18  # drag of the holder's edges on one card, N
    lean_rad: float = 0.40  # lean of the holder towards the robot
    # draw_m, second_m: how far the front card must come out, and the next one must not
    draw_m: float = 0.030
    second_m: float = 0.010
    # spread_x_m, spread_y_m: half widths of the random start
    spread_x_m: float = 0.040
    spread_y_m: float = 0.020

    @override
    def mjcf(self) -> str:
        w, h, t = CARD_M
        deck = ""
        for i in range(1, self.cards + 1):  # card 1 is the front one, the innermost body
            faces = "".join(
                f'<geom class="decor" type="box" pos="{-t * 0.6} {y} {z}" size="{t * 0.5} .004 .004"'
                ' euler=".785 0 0" material="accent"/>'
                for y, z in ((0, 0), (0.02, 0.03), (-0.02, -0.03))
            )
            deck = (
                f'<body name="card_{i}" pos="{-t} 0 0">'
                f'<joint name="card_{i}" type="slide" axis="0 0 1" range="0 .2" limited="true"'
                f' frictionloss="{self.edge_n}" damping=".2" armature=".02"'
                ' solreffriction=".004 1" solimpfriction=".99 .99 .001" solreflimit=".004 1"/>'
                f'<geom name="card_{i}" class="object" type="box" size="{t / 2} {w / 2} {h / 2}"'
                f' mass=".0018" material="card" friction=".8"/>{faces if i == 1 else ""}{deck}</body>'
            )
        return f"""
        <body name="card">
          <geom class="object" type="box" pos=".02 0 {STAND_M / 2}" size=".03 .05 {STAND_M / 2}"
                material="console_dark"/>
          <body pos="0 0 {STAND_M}" euler="0 {-self.lean_rad} 0">
            <geom class="object" type="box" pos=".012 0 .040" size=".010 .038 .040" material="console"/>
            <geom class="object" type="box" pos="-.002 0 .004" size=".012 .038 .004" material="console"/>
            <body pos="0 0 {0.010 + h / 2}">{deck}</body>
          </body>
        </body>"""

    @override
    def reset(self, model, data, rng):
        x, y = rng.uniform(-1, 1, 2) * (self.spread_x_m, self.spread_y_m)
        self._mu = rng.uniform(*self.friction, self.cards)
        place(model, "card", np.add(POSITION_M, (x, y, 0)), 0.0)
        self._joints = [data.joint(f"card_{i + 1}") for i in range(self.cards)]
        self._dofs = [model.joint(f"card_{i + 1}").dofadr[0] for i in range(self.cards)]
        self._set_friction(model, 0.0)

    @override
    def update(self, model, data, dt):
        self._set_friction(model, contact_force(model, data, "card_1"))

    def _set_friction(self, model, normal_n: float) -> None:
        model.dof_frictionloss[self._dofs] = self._mu * normal_n + self.edge_n * np.arange(1, self.cards + 1)

    @override
    def success(self):
        return self.drawn_m(1) > self.draw_m

    @override
    def failure(self):
        if self.drawn_m(2) > self.second_m:
            return f"a second card came out more than {self.second_m * 1e3:g} mm"
        return None

    @property
    def middle_m(self) -> float:
        """Height at which to touch the front card, just below its upper edge, metres above the table."""
        return STAND_M + (0.006 + CARD_M[1]) * np.cos(self.lean_rad)

    def drawn_m(self, card: int) -> float:
        """How far a card has come out of the holder, metres; card 1 is the front one."""
        return float(sum(j.qpos[0] for j in self._joints[card - 1 :]))
