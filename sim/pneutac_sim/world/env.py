"""The simulated robot's environment, registered as `pneutac_sim/TASK`."""

import warnings
from pathlib import Path

from pneutac_sim.twin import NETWORKS, Twin
from pneutac_sim.world.checks import Conditions
from pneutac_sim.world.station import Station
from pneutac_sim.world.task_env import TaskEnv
from pneutac_sim.world.world import World


class PneutacEnv(TaskEnv):
    """A task on the simulated robot, see `TaskEnv`."""

    def __init__(
        self,
        task: str = "switch",
        touch: str = "image",
        twin: Twin | str | Path | None = None,
        fidelity: str | None = None,
        conditions: Conditions | None = None,
        render: str = "mesh",
        pressure_range_kpa: tuple[float, float] | None = None,
        station: Station | None = None,
        **options,
    ):
        """An environment with a task.

        Args:
            task: a task's name, see `features.task_names`.
            touch: `image`, `area` or `none`, see `World`.
            twin: the finger, or an arm of several chambers, with its gel, or its folder; default the built-in
                one.
            fidelity: `surrogate`, `mpm` or `probe`, see `World`; all have the same spaces. None for
                `surrogate`, or, with a warning, `probe` where no networks were trained for the twin; an arm
                has `probe` alone.
            conditions: what the twin's effects ask for, such as `{"temperature_c": [20, 30]}`, see `World`.
            render: `mesh` or `splats`, what draws touch and finger, see `World`.
            pressure_range_kpa: of the action; default what the twin was measured over.
            station: workspace and mount; default the paper's.
            options: `render_mode`, `render_width`, `render_height`, `cameras`, `randomise_look`,
                `points` of `TaskEnv`.
        """
        twin = Twin.load(twin) if isinstance(twin, str | Path) else twin or Twin.builtin()
        more = {"pressure_range_kpa": pressure_range_kpa, "station": station}
        world = World(task, twin, touch, fidelity or _best_fidelity(twin), conditions, render, **more)
        super().__init__(world, touch, **options)


def _best_fidelity(twin: Twin) -> str:
    from pneutac_sim.surrogate.finger import builtin, fits  # its modules take a second to start

    if twin.device == "arm":
        return "probe"  # it has no other
    if twin.device != "finger" or twin.networks or all(fits(builtin(name), name, twin) for name in NETWORKS):
        return "surrogate"
    warnings.warn(
        "The twin has no networks of its own, so finger and gel deform by formulas (fidelity `probe`); "
        "`pneutac surrogate` trains networks.",
        stacklevel=3,
    )
    return "probe"
