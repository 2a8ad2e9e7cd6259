"""Which motion of the arm, with the finger against a bar, shows what is hidden in the stand-in.

    python benchmarks/demonstration_motions.py

Each motion is carried out on the stand-in as it is and with one change, three times, and once more at other
places of the bar. Told is by how much the force over the motion differs from the plain one once its own level
is taken out, as a share of it; the level; and the turn of the bar in the gel's frame. Then, of every task,
the force in its holds where a demonstration's commands are played with heavier objects, and with less
friction.
"""

import numpy as np

from lerobot_pneutac.verbs.design_motion import MOTIONS, TASK, carried_out, sideways
from lerobot_robot_pneutac.standin.world import OBJECT_MASS, Physics, StandinWorld
from pneutac_benchmarks.tables import markdown
from pneutac_sim.features import task_names
from pneutac_sim.world.expert import ScriptedExpert

HIDDEN = {
    "nothing": Physics(),
    "creep 3.5 times": Physics(creep=0.50),
    "half the friction": Physics(friction=0.5),
    "70 % of the stiffness": Physics(stiffness=0.7),
}
CHANGES = {
    "twice the weight": Physics(object_mass=2 * OBJECT_MASS),
    "half the friction": Physics(friction=0.5),
}
PLACES, ELSEWHERE = (3, 4, 5), (13, 14, 15)
LONGEST = 400  # frames of a demonstration


def holds(task: str) -> tuple[str, ...]:
    """Least and most by which the force of a task's holds changes, for each of `CHANGES`."""
    plain, begun = StandinWorld(task, touch="none"), []
    for seed in range(500, 520):
        plain.reset(seed)
        expert, actions, force = ScriptedExpert(plain, np.random.default_rng(seed)), [], []
        while len(actions) < LONGEST and not (plain.success or plain.failure):
            actions.append(expert.action())
            plain.step(actions[-1])
            force.append(plain.press_n)
        if plain.success:
            begun.append((seed, actions, np.array(force)))
        if len(begun) == len(PLACES):
            break
    cells = []
    for physics in CHANGES.values():
        world, changes = StandinWorld(task, touch="none", physics=physics), []
        for seed, actions, force in begun:
            world.reset(seed)
            played = []
            for action in actions:
                world.step(action)
                played.append(world.press_n)
            strong = force > 0.5 * force.max()
            changes.append(100 * (np.median(np.array(played)[strong]) / np.median(force[strong]) - 1))
        cells.append(f"{min(changes):+.0f} to {max(changes):+.0f} %")
    return (task, *cells)


def main() -> None:
    """Prints a row a motion: shape, level and turn of each change; then a row a task."""
    rows = []
    for motion in (*MOTIONS, sideways(12.0)):
        plain = [carried_out(StandinWorld(touch="none", task=TASK), s, motion) for s in PLACES]
        cells = []
        for hidden, physics in HIDDEN.items():
            world = StandinWorld(TASK, touch="none", physics=physics)
            places = ELSEWHERE if hidden == "nothing" else PLACES
            shape, level, turned = [], [], []
            for a, b in zip(plain, (carried_out(world, s, motion) for s in places), strict=True):
                f0, f = a.force_n, b.force_n
                shape.append(np.sqrt(np.mean((f * (f @ f0) / (f @ f) - f0) ** 2)) / f0.mean())
                level.append(f.mean() / f0.mean() - 1)
                turned.append(np.sqrt(np.mean((b.turn_deg - a.turn_deg) ** 2)))
            cells.append(
                f"{100 * np.mean(shape):.1f} %, {100 * np.mean(level):+.0f} %, {np.mean(turned):.1f}°"
            )
        rows.append((motion.name, *cells))
    heads = ("motion: shape, level, turn", "nothing, elsewhere", *list(HIDDEN)[1:])
    print("\n".join(markdown(heads, rows)), "\n")
    print("\n".join(markdown(("task: force of a hold", *CHANGES), list(map(holds, task_names())))))


if __name__ == "__main__":
    main()
