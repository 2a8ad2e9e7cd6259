"""The photograph of a moment of a recording, with the outline of the model as its camera would see it."""

import re

import cv2
import numpy as np

from lerobot_pneutac.studio.colours import MODEL, rgb
from lerobot_pneutac.studio.live import Shape, Skin
from pneutac_datasets.recording.photographs import read_camera
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.splat.camera import Camera
from pneutac_sim.twin import Twin

WIDTH_PX = 440


class PhotographPanel:
    """Photographs of one camera.

    Args:
        gui: of the viewer.
        recording: of a finger or an arm, perhaps without photographs.
        twin: gives the skin.
    """

    def __init__(self, gui, recording: Recording, twin: Twin):
        self._recording, self._skin = recording, Skin.of(twin)
        self._joints = np.array(twin.spine_joint_positions_mm)
        self._columns = [str(c) for c in recording.samples if re.fullmatch(r"image(_\w+)?", str(c))]
        self._cameras = {c: self._camera_of(c) for c in self._columns}
        self._chosen = gui.add_dropdown(
            "photograph", tuple(self._columns) or ("",), visible=len(self._columns) > 1
        )
        self._picture = gui.add_image(np.zeros((2, 2, 3), np.uint8), label="photographed", visible=False)

    def _camera_of(self, column: str) -> Camera | None:
        """Of a column, where `recording.json` describes it."""
        described = self._recording.meta.get("cameras")
        names = list(described) if isinstance(described, dict) else []
        name = column.removeprefix("image_") if column != "image" else next(iter(names), "")
        try:
            return read_camera(self._recording, name) if name in names else None
        except InputError:
            return None  # `pneutac check` tells what is wrong with it; the photograph is shown all the same

    def show(self, sample: int, shape: Shape) -> None:
        """The photograph of a sample, if it has one, and the outline of the model's body on it."""
        if not self._columns or sample >= len(self._recording):  # what a bench measured since is not there
            return
        column = self._chosen.value
        file = self._recording.samples[column].iloc[sample]
        if not (isinstance(file, str) and file):
            return
        image, camera = self._recording.image(file).copy(), self._cameras[column]
        if camera is not None:
            mask = silhouette(self._skin.carried_mm(shape, self._joints), self._skin.faces, camera)
            lines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            cv2.drawContours(image, lines, -1, rgb(MODEL), max(2, image.shape[1] // 200))
            self._picture.label = "photographed; the line is the model's outline"
        size = (WIDTH_PX, round(WIDTH_PX * image.shape[0] / image.shape[1]))
        self._picture.image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        self._picture.visible = True


def silhouette(vertices_mm: np.ndarray, faces: np.ndarray, camera: Camera) -> np.ndarray:
    """Bool (H, W): where a camera sees a mesh; vertices (V, 3) in mm of the base frame, faces (F, 3)."""
    mask = np.zeros((camera.height, camera.width), np.uint8)
    pixels, depth = camera.project(1e-3 * vertices_mm)
    seen = (depth[faces] > 0).all(1)
    for triangle in np.round(pixels[faces[seen]]).astype(np.int32):
        cv2.fillConvexPoly(mask, triangle, 1)
    return mask > 0
