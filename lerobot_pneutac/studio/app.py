"""The studio: a viewer in the browser with its pages, and the session that all browsers share."""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import re
import socket
import threading
from collections.abc import Callable
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING

import viser
import websockets.asyncio.server as websocket_server

from lerobot_pneutac.studio.plots import BRAND, show_text
from lerobot_pneutac.verbs.history import restore
from pneutac_sim.errors import InputError
from pneutac_sim.executor import Progress
from pneutac_sim.features import CHAMBERS
from pneutac_sim.twin import Twin

if TYPE_CHECKING:
    from lerobot_pneutac.studio.app import Session

PANEL_PX = 500
# Who may open a connection: programs and pages of this machine, by whatever port an SSH tunnel has there.
ORIGINS = (None, re.compile(r"http://(localhost|127\.0\.0\.1)(:\d+)?"))


class Studio:
    """One open studio; it answers at once, and `show` fills it while the browser still loads the page.

    `pages` are by their titles, and `driver` is the title of the one that moves the body in the picture.
    """

    session: Session

    def __init__(self, port: int = 8080):
        self.driver = ""
        self.server = _viewer(port)
        self.address = f"http://127.0.0.1:{self.server.get_port()}/"
        gui = self.server.gui
        gui.set_panel_label("PneuTac studio")
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=BRAND)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL_PX)
        self.title = gui.add_markdown("The twin is opened ...")
        self.message = gui.add_markdown("", visible=False)
        self.pages: dict = {}

    def show(self, session: Session) -> None:
        """Makes the pages that twin and recording have something to show on."""
        self.session = session
        self._name()
        session.when_changed(self._name)
        tabs, twin, recording = self.server.gui.add_tab_group(), session.twin, session.recording
        body, touch = twin.device in CHAMBERS, twin.device == "gel" or bool(twin.gel)
        of = None if recording is None else "body" if recording.device in CHAMBERS else "gel"
        icon = viser.Icon
        for shown, title, module, name, picture in (
            (body, "Device", "device_page", "DevicePage", icon.HAND_FINGER),
            (touch, "Touch", "gel_page", "GelPage", icon.FINGERPRINT),
            (of == "body", "Measurement", "measurement_page", "MeasurementPage", icon.CHART_LINE),
            (of == "gel", "Measurement", "measurement_page", "ImagesPage", icon.PHOTO),
            (of is not None, "Find it", "find_page", "FindPage", icon.SEARCH),
            (body, "World", "world_page", "WorldPage", icon.WORLD),
        ):
            if shown:  # its module is loaded once the page before it is there
                made = getattr(importlib.import_module(f"lerobot_pneutac.studio.{module}"), name)
                with tabs.add_tab(title, picture):
                    self.pages[title] = made(self)

    def _name(self) -> None:
        s = self.session
        last = s.twin.history[-1] if s.twin.history else None
        version = f"version {last['version']} ({last['change']})" if last else "as it was made"
        looked = "" if s.version is None else ", **an earlier version; nothing is written**"
        more = f" and {s.measured} measured here" if s.measured else ""
        recording = f"  \nRecording `{Path(s.recording.folder).name}`{more}" if s.recording else ""
        self.title.content = f"Twin `{s.folder.name}`: {s.twin.device}, {version}{looked}{recording}"

    def say(self, text: str) -> None:
        """Shows a sentence above the pages, in every browser; empty for none."""
        show_text(self.message, f"> {text}" if text else "")

    def safely(self, work: Callable) -> Callable:
        """The same as a callback of the viewer: bad input ends in the sentence above the pages."""

        @wraps(work)
        def run(*_) -> None:
            try:
                self.say("")
                work()
            except InputError as e:
                self.say(str(e))

        return run

    def close(self) -> None:
        for page in self.pages.values():
            page.close()
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()


def _viewer(port: int) -> viser.ViserServer:
    """The viewer on this machine alone, refusing connections from pages of other sites.

    viser takes the next port where one is in use, and has no setting for the `origins` of websockets.
    """
    try:
        with socket.create_server(("127.0.0.1", port)) as free:
            port = free.getsockname()[1]
    except (OSError, OverflowError) as e:
        why = os.strerror(e.errno) if getattr(e, "errno", None) else e
        remedy = "another studio may be open there: close it, or give another port; --port=0 takes any"
        raise InputError(f"port={port} cannot be had ({why}); {remedy}.") from e
    serve = websocket_server.serve
    websocket_server.serve = partial(serve, origins=ORIGINS)
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # it prints an address of its own
            return viser.ViserServer("127.0.0.1", port, verbose=False)
    finally:
        websocket_server.serve = serve


if TYPE_CHECKING:
    from lerobot_pneutac.verbs.add import Addition
    from lerobot_pneutac.verbs.benches import Bench
    from lerobot_pneutac.verbs.diagnose import Diagnosis
    from lerobot_pneutac.verbs.result import Comparison
    from pneutac_datasets.recording.recording import Recording


class Session:
    """One twin at work; raises InputError where twin and recording do not go together.

    `twin` is as it lies on the disk, or the earlier `version` that is looked at (None for the newest);
    `working` is what is being done, and `measured` counts the programs that were driven at the bench.
    """

    def __init__(
        self,
        twin: Path,
        recording: Path | None,
        policy: str | Path = "",
        demonstrations: str | Path = "",
        bench: Bench | None = None,
    ):
        self.bench, self.measured = bench, 0
        self.policy, self.demonstrations = str(policy), str(demonstrations)
        self.folder, self.twin, self.version = twin, Twin.load(twin), None
        self.recording = None
        if recording is not None:
            # pandas and what fits recordings; without one the picture does not wait for them
            from lerobot_pneutac.study.pair import same_body
            from pneutac_datasets.recording.recording import Recording

            if (recording / "meta" / "info.json").is_file():
                remedy = "give it by --demonstrations=, and a bench recording here"
                raise InputError(f"recording={recording} is a LeRobotDataset; {remedy}.")
            self.recording = Recording.load(recording)
            same_body(self.twin, self.recording, "open")
        self.comparison: Comparison | None = None
        self.diagnosis: Diagnosis | None = None
        self.addition: Addition | None = None
        self.working = ""
        self._lock = threading.Lock()
        self._listeners: list[Callable[[], None]] = []

    def when_changed(self, listener: Callable[[], None]) -> None:
        self._listeners.append(listener)

    def needs_recording(self) -> Recording:
        """The recording; raises InputError where there is none."""
        if self.recording is None:
            start = f"start `pneutac studio --twin={self.folder} --recording=DIR`"
            raise InputError(f"There is no recording to weigh the twin against; {start}.")
        return self.recording

    def look_at(self, version: int | None = None) -> None:
        """Shows the twin as it lies on the disk, or an earlier version of it; nothing is written."""
        self.twin, self.version = Twin.load(self.folder, version), version
        self.comparison = self.diagnosis = None
        for listener in self._listeners:
            listener()

    def measure(self, recording: Recording) -> None:
        """From now on the twin is weighed against this recording, of which a bench measured the last part."""
        self.recording, self.measured = recording, self.measured + 1
        self.look_at(self.version)

    def keep(self) -> int:
        """Writes the version that is looked at as the newest; returns its number."""
        if self.version is None:
            raise InputError("The newest version is shown; choose an earlier one to go back to it.")
        twin = restore(self.folder, self.version)
        self.look_at()
        return len(twin.history) - 1

    def begin(
        self, what: str, work: Callable[[Progress], None], show: Progress, failed: Callable[[str], None]
    ) -> None:
        """Does a work, called with `show`, in a thread of its own; InputError where another is under way.

        `what` is such as `diagnosing`; `failed` is called with the sentence of an InputError.
        """
        with self._lock:
            if self.working:
                raise InputError(f"Still {self.working}; wait until that is done.")
            self.working = what

        def run() -> None:
            try:
                work(show)
            except InputError as e:
                failed(str(e))
            finally:
                self.working = ""

        threading.Thread(target=run, daemon=True, name=what).start()
