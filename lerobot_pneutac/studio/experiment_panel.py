"""The next experiment: which program tells most, to download, or to drive at the bench at once."""

import tempfile
from collections.abc import Callable
from pathlib import Path

from lerobot_pneutac.studio.tables import table
from lerobot_pneutac.verbs.benches import save_program
from lerobot_pneutac.verbs.design import Design, design
from pneutac_datasets.recording.joined import joined
from pneutac_sim.errors import InputError


class ExperimentPanel:
    """A button that chooses, one that downloads and, where there is a bench, one that drives.

    Args:
        studio: that it is a part of; its session has a recording.
        work: begins something that takes long: what it is, and what is called with its progress.
    """

    def __init__(self, studio, work: Callable):
        self._studio, self._work, gui = studio, work, studio.server.gui
        self._design: Design | None = None
        gui.add_button("Which program tells most?", hint="pneutac design").on_click(
            studio.safely(self.design)
        )
        self.told = gui.add_markdown("", visible=False)
        self._download = gui.add_button("Download program.csv", visible=False, icon="download")
        self._download.on_click(self._send)
        self._out = gui.add_text("folder", "outputs/studio/experiment", visible=False)
        self._drive = gui.add_button(
            "Drive it at the bench, and write its recording there", visible=False, color="orange",
            hint="pneutac measure --program=program.csv",
        )  # fmt: skip
        self._drive.on_click(studio.safely(self.drive))

    def design(self) -> None:
        """Chooses the program for the bench that tells most."""
        session = self._studio.session
        recording = session.needs_recording()
        if session.diagnosis is None:
            raise InputError("Diagnose first; the next experiment follows from what is in the running.")

        def work(show) -> None:
            show("choosing among programs", 0, 1)
            self._design = found = design(session.twin, recording, session.diagnosis)
            self.told.content = f"{found.sentence}\n\n{table(found.rows())}"
            self.told.visible = self._download.visible = True
            self._out.visible = self._drive.visible = session.bench is not None

        self._work("choosing the next experiment", work)

    def drive(self) -> None:
        """Drives the program at the bench; what was measured is weighed with the recording from then on."""
        session, out = self._studio.session, Path(self._out.value)
        if self._design is None or session.bench is None:
            raise InputError("Choose a program first.")
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise InputError(f"folder={out} is not empty; give a new one.")
        best, bench, before = self._design.best, session.bench, session.needs_recording()

        def work(show) -> None:
            from lerobot_robot_pneutac.hardware.parts import HardwareFault  # LeRobot, which takes seconds

            show(f"{best.name}, {best.seconds:.0f} s", 0, 1)
            out.mkdir(parents=True, exist_ok=True)
            save_program(out / "program.csv", best.time_s, best.pressure_kpa, best.kind, best.conditions)
            try:
                measured = bench.follow(out / "program.csv", out / "recording", session.measured)
            except HardwareFault as e:
                raise InputError(f"{e} What was finished is in {out}.") from e
            session.measure(joined([before, measured], [None, bench.pause_s]))
            self._studio.say(f"Wrote {measured.folder}; it is weighed with the recording from now on.")

        self._work("driving the program", work)

    def _send(self, event) -> None:
        if event.client is None or self._design is None:
            return
        c = self._design.best
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "program.csv"
            save_program(file, c.time_s, c.pressure_kpa, c.kind, c.conditions)
            event.client.send_file_download(file.name, file.read_bytes())
