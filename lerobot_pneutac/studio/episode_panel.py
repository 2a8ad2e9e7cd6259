"""Episodes of a LeRobotDataset carried out once more in the twin's world, its touch beside the recorded."""

import numpy as np

from lerobot_pneutac.studio.colours import FLOOR, MEASURED, MODEL
from lerobot_pneutac.studio.player import Player
from lerobot_pneutac.studio.plots import Lines
from pneutac_sim.errors import InputError
from pneutac_sim.features import AREA, PRESSURE, task_names

TOLD = "as its instruction says"


class EpisodePanel:
    """One episode: recorded, replayed, and the difference.

    Args:
        studio: that it is a part of; its twin is a finger's.
    """

    def __init__(self, studio):
        self._studio, gui = studio, studio.server.gui
        self._episode, self._replayed = None, None
        with gui.add_folder("Episodes of a dataset", expand_by_default=bool(studio.session.demonstrations)):
            self._name = gui.add_text("dataset", studio.session.demonstrations,
                                      hint="folder of a LeRobotDataset, or its name on the Hub")  # fmt: skip
            self._task = gui.add_dropdown("its task", (TOLD, *task_names()))
            self._number = gui.add_number("episode", 0, min=0, step=1)
            replay = gui.add_button("Replay it in the twin's world", icon="repeat")
            self.readout = gui.add_markdown("The arm goes as recorded; pressure and touch are the twin's.")
            self._picture = gui.add_image(
                np.zeros((2, 2, 3), np.uint8),
                label="touch: recorded, the twin's, the difference",
                visible=False,
            )
            self._beside = gui.add_folder("In time", visible=False)
            lines = (("recorded", MEASURED), ("twin", MODEL))
            commanded = (*lines, ("commanded", FLOOR))
            with self._beside:
                self._player = Player(gui, self._show)
                self._charts = [
                    Lines(gui, "time, s", lines, 160, "contact area, %", FLOOR),
                    Lines(gui, "time, s", commanded, 160, "pressure, kPa"),
                ]
        replay.on_click(studio.safely(self.replay))
        studio.session.when_changed(self._forget)

    def replay(self) -> None:
        """Carries the chosen episode out with the twin that is looked at."""
        name, number = self._name.value.strip(), int(self._number.value)
        if not name:
            raise InputError("Which dataset? Give its folder, such as outputs/demo/demonstrations.")
        twin, task = self._studio.session.twin, "" if self._task.value == TOLD else self._task.value

        def work(_) -> None:
            from pneutac_datasets.demonstrations.replay.placing import find_place
            from pneutac_datasets.demonstrations.replay.reading import load_demonstrations
            from pneutac_datasets.demonstrations.replay.replaying import ReplayWorld

            try:
                given = load_demonstrations(name, task, twin, only=[number])
                episode = given.episodes[0]
                seen = ReplayWorld(given.task, twin, "image", given.station)
                place = find_place(ReplayWorld(given.task, twin, station=given.station), episode)
                replayed = seen.replay(episode, place, keep=True)
            except InputError as e:
                self.readout.content = f"> {e}"
                return
            self._episode, self._replayed = episode, replayed
            t = np.arange(len(episode)) / episode.fps
            self._player.reaches(float(t[-1]))
            pressure = episode.state[:, PRESSURE], replayed.pressure_kpa, episode.action[:, 3]
            self._charts[1].show(t, *pressure)
            self._show()

        self._studio.session.begin("replaying an episode", work, lambda *_: None)
        self.readout.content = "The episode is replayed ..."

    def _show(self) -> None:
        from lerobot_pneutac.reports.compare_demonstrations import beside

        e, r = self._episode, self._replayed
        if e is None or r is None:
            return
        i = min(round(self._player.now_s * e.fps), len(e) - 1)
        self._picture.image, self._picture.visible = beside(e.images[i], r.images[i]), True
        self._beside.visible = True
        t, areas = np.arange(len(e)) / e.fps, (100 * e.state[:, AREA], 100 * r.area)
        self._charts[0].show(t, *areas, now=t[i])
        off = float(np.sqrt(np.mean((r.images[i].astype(np.float32) - e.images[i]) ** 2)))
        end = "does the task too" if r.success else "does not do the task"
        self.readout.content = (
            f"**Off by {off:.1f} levels** at {t[i]:.2f} s: contact recorded {areas[0][i]:.2f} %, the twin's "
            f"{areas[1][i]:.2f} %; pressure {e.state[i, PRESSURE]:.2f} and {r.pressure_kpa[i]:.2f} kPa. "
            f"Replayed, the twin {end}."
        )

    def _forget(self) -> None:
        if self._episode is not None:
            self._episode = None
            self._picture.visible = self._beside.visible = False
            self.readout.content = "Another version of the twin is looked at; replay it anew."

    def close(self) -> None:
        self._player.close()
