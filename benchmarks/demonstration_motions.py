"""Which motion of the arm, with the finger against a bar, shows what is hidden in the stand-in.

    python benchmarks/demonstration_motions.py

Each motion is carried out on the stand-in as it is and with one change, three times, and once more at other
places of the bar. Told is by how much the force over the motion differs from the plain one once its own level
is taken out, as a share of it; the level; and the turn of the bar in the gel's frame. Then, of every task,
the force in its holds where a demonstration's commands are played with heavier objects, and with less
friction.
"""

import numpy as np
from scipy.ndimage import uniform_filter1d

from lerobot_robot_pneutac.standin.world import OBJECT_MASS, Physics, StandinWorld
from pneutac_benchmarks.tables import markdown
from pneutac_sim.features import CONTROL_HZ, task_names
from pneutac_sim.world.expert import ScriptedExpert
from pneutac_sim.world.tasks.button import HIGH_M

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
SEARCH_KPA, PRESS_KPA, TOUCH_MM, LONGEST = 2.0, 9.0, 0.3, 400
CHATTER = 3  # frames of a rigid contact, over which forces are averaged


def held(seconds: float, kpa: float = PRESS_KPA, velocity=(0.0, 0.0, 0.0)) -> list[np.ndarray]:
    """Actions of a part of a motion."""
    return [np.array([*velocity, kpa])] * round(seconds * CONTROL_HZ)


MOTIONS = {
    "press and hold": held(6),
    "three steps of pressure, each held": held(2, 6.0) + held(2, 9.0) + held(2, 12.0),
    "three steps of the arm, each held": held(2) + 3 * (held(0.5, velocity=(0.01, 0, 0)) + held(2)),
    "drag along the finger": held(2)
    + held(1, velocity=(0, 0, 0.004))
    + held(2, velocity=(0, 0, -0.004))
    + held(2, velocity=(0, 0, 0.004)),
    "drag sideways": held(2)
    + held(1.2, velocity=(0, 0.01, 0))
    + held(2.4, velocity=(0, -0.01, 0))
    + held(2.4, velocity=(0, 0.01, 0)),
}


def carried_out(world: StandinWorld, seed: int, motion: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Force (T,) N and turn of the bar (T,) degrees, from a second after the touch on."""
    world.reset(seed)
    for _ in range(LONGEST):
        if world.press_mm > TOUCH_MM:
            break
        world.step(np.array([0.04, 0, np.clip(1.5 * (HIGH_M - world.gel_m[2]), -0.04, 0.04), SEARCH_KPA]))
    force, turn = [], []
    for action in motion:
        world.step(action)
        bar = world.data.site("gel").xmat.reshape(3, 3)[1]
        force.append(world.press_n)
        turn.append((np.degrees(np.arctan2(bar[1], bar[0])) + 90) % 180 - 90)
    return uniform_filter1d(force, CHATTER)[CONTROL_HZ:], np.array(turn)[CONTROL_HZ:]


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
    for name, motion in MOTIONS.items():
        plain = [carried_out(StandinWorld(touch="none", task="button"), s, motion) for s in PLACES]
        cells = []
        for hidden, physics in HIDDEN.items():
            world = StandinWorld("button", touch="none", physics=physics)
            places = ELSEWHERE if hidden == "nothing" else PLACES
            shape, level, turned = [], [], []
            for (f0, t0), (f, t) in zip(plain, (carried_out(world, s, motion) for s in places), strict=True):
                shape.append(np.sqrt(np.mean((f * (f @ f0) / (f @ f) - f0) ** 2)) / f0.mean())
                level.append(f.mean() / f0.mean() - 1)
                turned.append(np.sqrt(np.mean((t - t0) ** 2)))
            cells.append(
                f"{100 * np.mean(shape):.1f} %, {100 * np.mean(level):+.0f} %, {np.mean(turned):.1f}°"
            )
        rows.append((name, *cells))
    heads = ("motion: shape, level, turn", "nothing, elsewhere", *list(HIDDEN)[1:])
    print("\n".join(markdown(heads, rows)), "\n")
    print("\n".join(markdown(("task: force of a hold", *CHANGES), list(map(holds, task_names())))))


if __name__ == "__main__":
    main()
