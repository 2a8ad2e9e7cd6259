"""The page that finds what is missing: compare, diagnose, try, keep, go back, the next experiment."""

import tempfile
from collections.abc import Callable
from pathlib import Path

from lerobot_pneutac.cli.options import check_report
from lerobot_pneutac.reports.diagnosis import ladder, reductions, rival_rows
from lerobot_pneutac.reports.page import save_table
from lerobot_pneutac.reports.sentences import alternatives, meaning
from lerobot_pneutac.studio.plots import Background, show_text, table
from lerobot_pneutac.verbs.add import add
from lerobot_pneutac.verbs.benches import program_columns
from lerobot_pneutac.verbs.compare import compare
from lerobot_pneutac.verbs.design import Design, design
from lerobot_pneutac.verbs.diagnose import diagnose
from lerobot_pneutac.verbs.history import report
from pneutac_datasets.recording.noise import noise_text
from pneutac_datasets.recording.recording import joined
from pneutac_sim.errors import InputError


class ExperimentPanel:
    """A button that chooses, one that downloads and, where there is a bench, one that drives."""

    def __init__(self, studio, work: Callable):
        self._studio, self._work, gui = studio, work, studio.server.gui
        self._design: Design | None = None
        choose = gui.add_button("Which test is most informative?", hint="pneutac design")
        choose.on_click(studio.safely(self.design))
        self.summary = gui.add_markdown("", visible=False)
        self._download = gui.add_button("Download program.csv", visible=False, icon="download")
        self._download.on_click(self._send)
        self._out = gui.add_text("folder", "outputs/studio/experiment", visible=False)
        hidden = {"visible": False, "hint": "pneutac measure --program=program.csv"}
        name = "Drive it at the bench, and write its recording there"
        self._drive = gui.add_button(name, color="orange", **hidden)
        self._drive.on_click(studio.safely(self.drive))

    def design(self) -> None:
        session = self._studio.session
        recording = session.needs_recording()
        if session.diagnosis is None:
            raise InputError("Diagnose first; the next experiment follows from what is in the running.")

        def work(show) -> None:
            show("choosing among programs", 0, 1)
            self._design = found = design(session.twin, recording, session.diagnosis)
            show_text(self.summary, f"{found.sentence}\n\n{table(found.rows())}")
            self._download.visible = True
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
            save_table(out / "program.csv", program_columns(best))
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
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "program.csv"
            save_table(file, program_columns(self._design.best))
            event.client.send_file_download(file.name, file.read_bytes())


FOUND = "all that was found"
NEWEST = "the newest"
SHOWN = 10  # of the candidates


class FindPage(Background):
    """The loop, by buttons; each does what the command of its name does."""

    title = "Find it"

    def __init__(self, studio):
        self._studio, self._gui = studio, studio.server.gui
        self._scored: dict[str, float] = {}
        self._unit = ""  # of what was scored
        self._figures: list = []
        gui, safely = self._gui, studio.safely
        self.error = gui.add_markdown("")
        gui.add_button("1. Compare", hint="pneutac compare").on_click(safely(self.compare))
        look = gui.add_button("2. Diagnose: what is missing?", hint="pneutac diagnose")
        look.on_click(safely(self.diagnose))
        self._bar = gui.add_progress_bar(0.0, animated=True, visible=False)
        self.progress = gui.add_markdown("", visible=False)
        self.sentence = gui.add_markdown("")
        self._evidence = gui.add_folder("Evidence", visible=False, expand_by_default=False)
        self._choice = gui.add_dropdown("effect", (FOUND,), visible=False)
        hint = "pneutac add, not yet written"
        self._try = gui.add_button("3. Try it: the error before and after", visible=False, hint=hint)
        self._try.on_click(safely(self.try_it))
        self.before_after = gui.add_markdown("", visible=False)
        self._keep_button = gui.add_button("4. Keep it", visible=False, color="green")
        self._keep_button.on_click(safely(self.keep))
        with gui.add_folder("Next experiment", expand_by_default=False):
            self.experiment = ExperimentPanel(studio, self._work)
        with gui.add_folder("History of the twin", expand_by_default=False):
            self.history = gui.add_markdown("")
            self._version = gui.add_dropdown("look at version", (NEWEST,))
            self._version.on_update(safely(self._look))
            self._back = gui.add_button("Go back to it", visible=False, color="orange")
            self._back.on_click(safely(self.back))
        with gui.add_folder("Report on disk", expand_by_default=False):
            self._out = gui.add_text("folder", "outputs/studio")
            write = gui.add_button("Write the diagnosis there", hint="as pneutac diagnose --out=FOLDER does")
            write.on_click(safely(self.write))
        studio.session.when_changed(self._changed)
        self._changed()

    # ---------------------------------------------------------------- the loop

    def _work(self, what: str, work) -> None:
        self._scored = {}

        def run(show) -> None:
            try:
                work(show)
            finally:
                self._bar.visible = self.progress.visible = False

        self._studio.session.begin(what, run, self._show, self._studio.say)
        self._bar.value, self._bar.visible = 2.0, True
        show_text(self.progress, f"{what} ...")

    def _show(self, text: str, done: int, total: int) -> None:
        name, found, error = text.rpartition(": error ")
        if found:
            value, _, unit = error.partition(" ")
            if unit != self._unit:  # air is searched before the body
                self._scored, self._unit = {}, unit
            self._scored[name.partition(" ")[2]] = float(value)
        best = sorted(self._scored.items(), key=lambda item: item[1])[:SHOWN]
        rows = "".join(f"\n| {k} | {v:.3g} |" for k, v in best)
        table = f"\n\n| tried | error, {self._unit} |\n|---|---|{rows}" if rows else ""
        self.progress.content = f"{self._studio.session.working}: {name or text}{table}"
        self._bar.value = 100.0 * max(0.02, done / max(total, 1))

    def compare(self) -> None:
        session = self._studio.session
        session.comparison = compare(session.twin, session.needs_recording())
        self._show_error()
        self.sentence.content = session.comparison.sentence

    def diagnose(self) -> None:
        session = self._studio.session
        recording = session.needs_recording()

        def work(show) -> None:
            session.diagnosis = diagnose(session.twin, recording, progress=show)
            self._show_diagnosis()

        self._work("diagnosing", work)

    def try_it(self) -> None:
        """What the chosen effect does to the error; nothing is written."""
        session = self._studio.session
        recording, chosen = session.needs_recording(), self._choice.value
        if session.diagnosis is None:
            raise InputError("Diagnose first; then what was found can be tried.")

        def work(show) -> None:
            what = session.diagnosis if chosen == FOUND else chosen
            session.addition = a = add(session.twin, recording, what, progress=show)
            show_text(self.before_after, f"{a.sentence}\n\n{table(a.rows())}")
            writes = f"writes version {len(session.twin.history)} of {session.folder.name}"
            self._keep_button.label, self._keep_button.visible = f"4. Keep it: {writes}", a.accepted

        self._work(f"trying {chosen}", work)

    def keep(self) -> None:
        session = self._studio.session
        if session.addition is None or not session.addition.accepted:
            raise InputError("There is nothing to keep; try an effect first.")
        if session.version is not None:
            raise InputError("An earlier version is looked at; choose the newest, or go back to this one.")
        session.addition = added = session.addition.save(session.folder)
        session.look_at()
        session.comparison = compare(session.twin, session.needs_recording())
        self._show_error()
        version = added.twin.history[-1]["version"]
        show_text(self.before_after, f"Stored as version {version}. {added.sentence}")

    def back(self) -> None:
        number = self._studio.session.keep()
        self._studio.say(f"Version {number} is as the one that you went back to; none was lost.")

    def write(self) -> None:
        diagnosis, out = self._studio.session.diagnosis, Path(self._out.value)
        if diagnosis is None:
            raise InputError("Diagnose first; there is nothing to write yet.")
        if out.is_file():
            raise InputError(f"folder={out} is a file; give a folder.")
        check_report(out, name="folder")
        self._studio.say(f"Wrote {diagnosis.stored_in(out).report(out)}.")

    # ---------------------------------------------------------------- what is shown

    def _show_error(self) -> None:
        c = self._studio.session.comparison
        if c is None:
            self.error.content = "How far is the twin from the recording?"
            return
        name, value = ("Test error", c.heldout) if c.heldout is not None else ("Error", c.train)
        self.error.content = f"**{name} {value:.3g} {c.unit}** (noise {noise_text(c.noise_floor)} {c.unit})"

    def _show_diagnosis(self) -> None:
        d = self._studio.session.diagnosis
        warned = "\n".join(f"- {w}" for w in d.warnings)
        parts = f"**{d.sentence}**", meaning(d.state), "**Warnings.**", warned or "None."
        self.sentence.content = "\n\n".join([*parts, f"**Do next.** {d.do_next}"])
        self._clear()
        rivals = rival_rows(d.outcome)
        with self._evidence:
            for figure, height in ((ladder(d.study, d.outcome), 260), (reductions(d.outcome), 300)):
                figure.update_layout(template="plotly_white", height=height, font={"size": 10},
                                     margin={"l": 90, "r": 10, "t": 20, "b": 40})  # fmt: skip
                self._figures.append(self._gui.add_plotly(figure, aspect=440 / height))
            text = table(rivals) or alternatives(d.state)
            self._figures.append(self._gui.add_markdown(f"**Alternatives.** \n\n{text}"))
        self._evidence.visible = True
        tested = [t.name for t in d.outcome.tested if t.name not in d.selected]
        self._choice.options = (FOUND, *d.selected, *tested)[: 1 + SHOWN]
        self._choice.value = FOUND
        self._choice.visible = self._try.visible = bool(d.outcome.tested)

    def _changed(self) -> None:
        session = self._studio.session
        newest = session.twin if session.version is None else None
        if newest is not None:
            self.history.content = table(report(newest).rows()) or "Nothing was changed yet."
            self._version.options = (NEWEST, *(f"{e['version']}: {e['change']}" for e in newest.history[:-1]))
            self._version.value = NEWEST
        self._back.visible = session.version is not None
        self._back.label = f"Go back: writes version {session.version} of the twin as its newest"
        self._clear()
        self.sentence.content = ""
        self._evidence.visible = self._choice.visible = self._try.visible = self._keep_button.visible = False
        show_text(self.before_after, "")
        self._show_error()

    def _look(self) -> None:
        chosen = self._version.value
        number = None if chosen == NEWEST else int(chosen.partition(":")[0])
        if number != self._studio.session.version:
            self._studio.session.look_at(number)

    def _clear(self) -> None:
        for figure in self._figures:
            figure.remove()
        self._figures = []
