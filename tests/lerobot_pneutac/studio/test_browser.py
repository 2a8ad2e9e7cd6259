"""The studio in a real browser; what takes long, and the pictures of the docs, run nightly.

PNEUTAC_SCREENSHOTS=docs/pictures writes the pictures and the film there.
"""

import io
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import expect, sync_playwright

from lerobot_pneutac.studio.app import Session, Studio
from pneutac_sim.twin import Twin

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
GOLDEN = Path(__file__).parents[2] / "golden" / "recordings"
WEBGL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
expect.set_options(timeout=30_000)  # a busy machine draws without a graphics card
pytestmark = pytest.mark.skipif(BROWSER is None, reason="there is no Chromium; `apt-get install chromium`")


@pytest.fixture(scope="module")
def browser():
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=BROWSER, args=WEBGL)
        yield browser
        browser.close()


@pytest.fixture(autouse=True)
def closed(browser):
    """A page that a failed test left open would draw on, without a graphics card, beside all that follow."""
    yield
    for context in browser.contexts:
        context.close()


class Page:
    """A page, with what it complained of, whom it asked and how many messages came."""

    def __init__(self, browser, address, width=1280, height=720):
        self.page = browser.new_page(viewport={"width": width, "height": height})
        self.errors, self.foreign, self.messages = [], [], 0
        self.frames = []  # of the film, and how long each is shown, ms
        self.page.on("pageerror", lambda e: self.errors.append(str(e)))
        self.page.on("console", lambda m: m.type == "error" and self.errors.append(m.text))
        self.page.on("request", self._asked)
        self.page.on("websocket", lambda ws: ws.on("framereceived", self._came))
        self.page.goto(address)

    def _asked(self, request):
        if re.match(r"https?://(?!127\.0\.0\.1)", request.url):
            self.foreign.append(request.url)

    def _came(self, _):
        self.messages += 1

    def bend_deg(self) -> float:
        return float(re.search(r"Bend (-?[0-9.]+)°", self.page.get_by_text("Bend ").first.inner_text())[1])

    def press(self, kpa: float):
        box = self.page.get_by_role("textbox").first
        box.fill(str(kpa))
        box.press("Enter")

    def frame(self, ms: int, times: int = 1, wait_ms: int = 100):
        if os.environ.get("PNEUTAC_SCREENSHOTS"):
            for _ in range(times):
                self.page.wait_for_timeout(wait_ms)
                image = Image.open(io.BytesIO(self.page.screenshot())).convert("RGB")
                self.frames.append((image.resize((960, 540), Image.Resampling.LANCZOS), ms))

    def film(self, name: str):
        folder = os.environ.get("PNEUTAC_SCREENSHOTS")
        if folder:
            file, (images, ms) = Path(folder) / f"{name}.webp", zip(*self.frames, strict=True)
            more = {"append_images": images[1:], "duration": list(ms), "loop": 0, "method": 6}
            images[0].save(file, save_all=True, quality=55, **more)
            assert file.stat().st_size < 1_000_000

    def open(self, tab: str):
        self.page.get_by_role("tab", name=tab).click()

    def button(self, name: str):
        return self.page.get_by_role("button", name=name)

    def heldout_mm(self) -> float:
        shown = self.page.locator("strong", has_text="Test error")
        expect(shown).to_be_visible(timeout=60_000)
        return float(re.search(r"error ([0-9.]+) mm", shown.inner_text())[1])

    def tidy(self):
        """That this machine has no graphics card is of no interest in a picture."""
        for close in self.page.locator(".mantine-Notification-closeButton").all():
            close.click()

    def picture(self, name: str, colours: int = 128):
        folder = os.environ.get("PNEUTAC_SCREENSHOTS")
        if folder:
            file = Path(folder) / f"studio_{name}.png"
            self.tidy()
            self.page.wait_for_timeout(600)
            self.page.screenshot(path=file)
            whole = Image.open(file).convert("RGB")
            small = whole.quantize(colours)
            if colours > 128:  # with photographs, which would be seen in steps
                small = whole.quantize(palette=small, dither=Image.Dither.FLOYDSTEINBERG)
            small.save(file, optimize=True)
            assert file.stat().st_size < 150_000


def opened(twin: Path, recording: Path | None = None) -> Studio:
    studio = Studio(port=0)
    studio.show(Session(twin, recording))
    return studio


def twin_of(recording: Path, folder: Path) -> Path:
    """A calibrated twin of it, which lacks what the recording hides."""
    for verb in ("new", "calibrate"):
        command = [sys.executable, "-m", "lerobot_pneutac.cli", verb]
        subprocess.run(
            [*command, f"--twin={folder}", f"--recording={recording}"], check=True, capture_output=True
        )
    return folder


@pytest.mark.nightly
@pytest.mark.slow
def test_the_slider_bends_the_finger_for_all_who_look(browser, tmp_path):
    twin = Twin.builtin().save(tmp_path / "finger")
    untouched = {f: f.read_bytes() for f in twin.rglob("*") if f.is_file()}
    studio = opened(twin)
    try:
        one = Page(browser, studio.address, 800, 400)  # drawn without a graphics card
        expect(one.page.get_by_text("Bend ").first).to_be_visible()
        still = one.bend_deg()
        one.press(12)
        expect(one.page.get_by_text("pressure 12.0 kPa").first).to_be_visible()
        assert one.bend_deg() > still + 15
        two = Page(browser, studio.address, 800, 400)
        expect(two.page.get_by_text("pressure 12.0 kPa").first).to_be_visible()
        two.press(3)
        expect(one.page.get_by_text("pressure 3.0 kPa").first).to_be_visible()
        came, device = one.messages, studio.pages["Device"]
        for kpa in np.linspace(3, 12, 30):
            device._pressures[0].value = float(kpa)
            one.page.wait_for_timeout(33)
        assert one.messages - came > 20
        assert not one.errors + two.errors and not one.foreign + two.foreign
        assert {f: f.read_bytes() for f in twin.rglob("*") if f.is_file()} == untouched
        one.page.close(), two.page.close()
    finally:
        studio.close()


@pytest.mark.nightly
def test_a_newcomer_finds_and_adds_what_is_missing(browser, tmp_path):
    recording = shutil.copytree(GOLDEN / "finger_creep", tmp_path / "bench")
    studio = opened(twin_of(recording, tmp_path / "finger"), recording)
    try:
        seen = Page(browser, studio.address)
        page = seen.page
        expect(page.get_by_text("Bend ").first).to_be_visible()
        seen.tidy()
        for kpa in (0, 3, 6, 9, 12, 9, 10):
            seen.press(kpa)
            seen.frame(250, wait_ms=250)
        page.get_by_text("Effects of the twin").wait_for()
        seen.picture("device")
        seen.open("Measurement")
        expect(page.get_by_text("Off by ").first).to_be_visible()
        page.locator("button", has_text="mm: trial").first.click()
        page.get_by_text("Off by ").first.scroll_into_view_if_needed()
        seen.picture("measurement")
        page.get_by_label("Play").first.check()
        seen.frame(300, times=8, wait_ms=250)
        page.get_by_label("Play").first.uncheck()
        seen.open("Find it")
        seen.button("1. Compare").click()
        before = seen.heldout_mm()
        seen.frame(1500)
        seen.button("2. Diagnose").click()
        expect(page.get_by_text("tried", exact=True)).to_be_visible(timeout=120_000)
        seen.frame(400, times=4, wait_ms=300)
        page.reload()  # in the middle of the work, which goes on
        seen.open("Find it")
        expect(page.get_by_text("behaves like creep").first).to_be_visible(timeout=300_000)
        seen.picture("found")
        seen.frame(3500)
        seen.button("3. Try it").click()
        expect(seen.button("4. Keep it")).to_be_visible(timeout=120_000)
        assert "creep" not in str(Twin.load(tmp_path / "finger").history)
        seen.button("4. Keep it").scroll_into_view_if_needed()
        seen.frame(2500)
        seen.button("4. Keep it").click()
        expect(page.get_by_text("Stored as version 1").first).to_be_visible(timeout=60_000)
        assert seen.heldout_mm() < 0.5 * before
        assert Twin.load(tmp_path / "finger").history[-1]["change"].startswith("added ")
        page.locator("strong", has_text="Test error").scroll_into_view_if_needed()
        page.get_by_text("History of the twin").click()
        seen.frame(3500, wait_ms=1000)
        seen.film("studio")
        assert not seen.errors and not seen.foreign
        page.close()
    finally:
        studio.close()


@pytest.mark.nightly
def test_a_world_is_moved_by_keys_and_an_episode_replayed(browser, tmp_path):
    studio = Studio(port=0)
    studio.show(Session(Twin.builtin().save(tmp_path / "finger"), None, "", GOLDEN / "demos"))
    try:
        seen, world = Page(browser, studio.address), studio.pages["World"]
        expect(seen.page.get_by_text("Bend ").first).to_be_visible(timeout=60_000)
        seen.open("World")
        world._player.value, world._task.value = "by hand", "switch"
        seen.button("Begin again").click()
        expect(seen.page.get_by_text(" s of the task").first).to_be_visible(timeout=60_000)
        seen.page.keyboard.press("l")
        seen.page.keyboard.down("i")
        seen.page.wait_for_timeout(100)
        assert world.action()[2] > 0 and world.action()[3] == pytest.approx(0.3)
        seen.page.keyboard.up("i")
        world.close()
        world.episodes._task.value = "switch"
        seen.button("Replay it").click()
        expect(seen.page.get_by_text("Off by ").first).to_be_visible(timeout=120_000)
        world.episodes._player.now_s = 2.5
        world._player.value, world.episodes._name.value = "the scripted expert", "demonstrations"
        seen.page.get_by_label("Play").last.scroll_into_view_if_needed()
        seen.picture("world", 256)
        assert not seen.errors and not seen.foreign
        seen.page.close()
    finally:
        studio.close()


@pytest.mark.nightly
def test_a_server_that_was_killed_is_found_again(browser, tmp_path):
    twin = Twin.builtin().save(tmp_path / "finger")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "lerobot_pneutac.cli", "studio", f"--twin={twin}", f"--port={port}"]

    def start():
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert f"http://127.0.0.1:{port}/" in server.stdout.readline()
        return server

    server = start()
    try:
        seen = Page(browser, f"http://127.0.0.1:{port}/")
        expect(seen.page.get_by_text("Bend ").first).to_be_visible()
        seen.press(5)  # what the next server does not know: the page shows 0 again once it has found it
        expect(seen.page.get_by_text("pressure 5.0 kPa").first).to_be_visible()
        server.send_signal(signal.SIGKILL)
        server.wait()
        server = start()
        expect(seen.page.get_by_text("pressure 0.0 kPa").first).to_be_visible(timeout=60_000)
        seen.press(12)
        expect(seen.page.get_by_text("pressure 12.0 kPa").first).to_be_visible()
    finally:
        server.kill()
