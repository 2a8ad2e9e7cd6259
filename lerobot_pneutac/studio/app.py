"""The studio: a viewer in the browser and its pages."""

from __future__ import annotations

import contextlib
import io
import os
import re
import socket
from collections.abc import Callable
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING

import viser
import websockets.asyncio.server as websocket_server

from lerobot_pneutac.studio.plots import BRAND
from pneutac_sim.errors import InputError
from pneutac_sim.features import CHAMBERS

if TYPE_CHECKING:
    from lerobot_pneutac.studio.session import Session

PANEL_PX = 500
# Who may open a connection: programs and pages of this machine, by whatever port an SSH tunnel has there.
ORIGINS = (None, re.compile(r"http://(localhost|127\.0\.0\.1)(:\d+)?"))


class Studio:
    """One open studio; it answers at once, and `show` fills it while the browser still loads the page.

    Args:
        port: of this machine to listen on; 0 for any that is free.

    Attributes:
        session: what it shows.
        server: the viewer.
        pages: by their titles.
        driver: page that moves the body in the picture.
        address: to open in a browser.

    Raises:
        InputError: the address cannot be had.
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
        self.said = gui.add_markdown("", visible=False)
        self.pages: dict = {}

    def show(self, session: Session) -> None:
        """Makes the pages that twin and recording have something to show on."""
        self.session = session
        self._name()
        session.when_changed(self._name)
        self._add_pages(self.server.gui.add_tab_group(), self.pages)

    def _add_pages(self, tabs, pages: dict) -> None:
        twin = self.session.twin
        if twin.device in CHAMBERS:
            from lerobot_pneutac.studio.device_page import DevicePage

            with tabs.add_tab("Device", viser.Icon.HAND_FINGER):
                pages["Device"] = DevicePage(self)
        if twin.device == "gel" or twin.gel:
            from lerobot_pneutac.studio.gel_page import GelPage

            with tabs.add_tab("Touch", viser.Icon.FINGERPRINT):
                pages["Touch"] = GelPage(self)
        if self.session.recording is not None:
            self._add_recorded(tabs, pages, self.session.recording.device in CHAMBERS)
        if twin.device in CHAMBERS:
            from lerobot_pneutac.studio.world_page import WorldPage

            with tabs.add_tab("World", viser.Icon.WORLD):
                pages["World"] = WorldPage(self)

    def _add_recorded(self, tabs, pages: dict, body: bool) -> None:
        """The pages that weigh the twin against its recording, of a body or of a gel."""
        if body:
            from lerobot_pneutac.studio.measurement_page import MeasurementPage

            with tabs.add_tab("Measurement", viser.Icon.CHART_LINE):
                pages["Measurement"] = MeasurementPage(self, pages["Device"].scene)
        else:
            from lerobot_pneutac.studio.measurement_page import ImagesPage

            with tabs.add_tab("Measurement", viser.Icon.PHOTO):
                pages["Measurement"] = ImagesPage(self)
        from lerobot_pneutac.studio.find_page import FindPage

        with tabs.add_tab("Find it", viser.Icon.SEARCH):
            pages["Find it"] = FindPage(self)

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
        self.said.content, self.said.visible = f"> {text}" if text else "", bool(text)

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
        """Ends it; what was not written is lost."""
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
        raise InputError(
            f"port={port} cannot be had ({why}); another studio may be open there: close it, or"
            " give another with --port=, or --port=0 for any that is free."
        ) from e
    serve = websocket_server.serve
    websocket_server.serve = partial(serve, origins=ORIGINS)
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # it prints an address of its own
            return viser.ViserServer("127.0.0.1", port, verbose=False)
    finally:
        websocket_server.serve = serve
