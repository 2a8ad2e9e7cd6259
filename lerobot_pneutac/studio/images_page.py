"""The measurement page of a gel: each recorded image and the twin's prediction."""

import threading

import cv2
import numpy as np

from lerobot_pneutac.studio.plots import table
from lerobot_pneutac.verbs.compare import compare
from pneutac_sim.errors import InputError

WIDTH_PX = 150  # of each picture
TIMES = 4.0  # by which the difference is exaggerated


class ImagesPage:
    """Recorded, modelled, and the difference.

    Args:
        studio: that it is a page of; its session has a recording of a gel.
    """

    title = "Measurement"

    def __init__(self, studio):
        self._studio, self._gui, self._c = studio, studio.server.gui, None
        self.readout = self._gui.add_markdown("The twin is run on the recording ...")
        self._number = self._gui.add_slider("image", 1, 2, 1, 1)
        self._picture = self._gui.add_image(
            np.zeros((2, 2, 3), np.uint8), label=f"recorded, model, {TIMES:g} times the difference"
        )
        self._worst = self._gui.add_button("The worst image")
        self._about = self._gui.add_markdown("")
        self._number.on_update(lambda _: self._draw())
        self._worst.on_click(lambda _: self.jump())
        studio.session.when_changed(self._load)
        self._thread = threading.Thread(target=self._load, daemon=True, name="images page")
        self._thread.start()

    def _load(self) -> None:
        session = self._studio.session
        try:
            session.comparison = self._c = compare(session.twin, session.needs_recording())
        except InputError as e:
            self.readout.content = f"> {e}"
            return
        self._number.max = max(2, len(self._c.predicted))
        self._about.content = "\n\n".join(table(rows) for rows in self._c.by.values())
        self._draw()

    def jump(self) -> None:
        """Shows the image with the largest error in the contact."""
        if self._c is not None:
            names = [s.name for s in self._c.data.samples]
            self._number.value = 1 + names.index(self._c.worst[0]["image"])
            self._draw()

    def _draw(self) -> None:
        c = self._c
        if c is None:
            return
        i = min(int(self._number.value), len(c.predicted)) - 1
        sample, score = c.data.samples[i], c.scores[i]
        difference = np.clip(128 + TIMES * (c.predicted[i].astype(float) - sample.image), 0, 255)
        size = (WIDTH_PX, round(WIDTH_PX * sample.image.shape[0] / sample.image.shape[1]))
        three = (sample.image, c.predicted[i], difference.astype(np.uint8))
        small = [cv2.resize(v, size, interpolation=cv2.INTER_AREA) for v in three]
        gap = np.full((size[1], 6, 3), 255, np.uint8)
        self._picture.image = np.concatenate([small[0], gap, small[1], gap, small[2]], axis=1)
        p = sample.press
        self.readout.content = (
            f"**Off by {score.rmse:.2f} levels**, in the contact {score.contact_rmse:.2f}: {sample.name}, "
            f"{p.indenter} of {p.size_mm:g} mm at {p.x_mm:.1f}, {p.y_mm:.1f} mm, {p.depth_mm:.2f} mm deep"
            f"{f' ({sample.role})' if sample.role else ''}"
        )

    def close(self) -> None:
        """Nothing of it goes on by itself."""
