"""Draws triangles, the nearest on top, without lights or blending."""

import cv2
import numpy as np
from numba import njit

from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.rasteriser import Rendering

FINE = 2  # pixels drawn a pixel of the picture, each way; their mean smooths edges


def draw_triangles(camera: Camera, vertices: np.ndarray, faces: np.ndarray, colours: np.ndarray) -> Rendering:
    """Triangles (F, 3) of vertices (V, 3) m, their colours (V, 3), 0 to 1, blended between, on black."""
    pixels, depth = camera.project(vertices)
    seen = faces[(depth[faces] > 0).all(1)]
    image, nearest = canvas_of(camera)
    _triangles(FINE * pixels, 1 / depth, seen, np.asarray(colours, float), image, nearest)
    return picture_of(camera, image, nearest)


def canvas_of(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Black picture and nothing near, both `FINE` times as fine as the camera's."""
    size = FINE * camera.height, FINE * camera.width
    return np.zeros((*size, 3), np.float32), np.zeros(size)


def picture_of(camera: Camera, image: np.ndarray, nearest: np.ndarray) -> Rendering:
    """What was drawn on a canvas, at the camera's size."""
    size = camera.width, camera.height
    return Rendering(
        cv2.resize(image, size, interpolation=cv2.INTER_AREA),
        cv2.resize((nearest > 0).astype(np.float32), size, interpolation=cv2.INTER_AREA),
    )


@njit(cache=True)
def _triangles(pixels, nearness, faces, colours, image, nearest):
    """Pixel (i, j) is sampled at its centre (j + 0.5, i + 0.5); colours are linear in space (1/z)."""
    height, width = nearest.shape
    for f in range(len(faces)):
        a, b, c = faces[f]
        ax, ay = pixels[a]
        bx, by = pixels[b]
        cx, cy = pixels[c]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0:
            continue
        left, right = max(0, int(min(ax, bx, cx))), min(width - 1, int(max(ax, bx, cx)))
        top, bottom = max(0, int(min(ay, by, cy))), min(height - 1, int(max(ay, by, cy)))
        for i in range(top, bottom + 1):
            for j in range(left, right + 1):
                x, y = j + 0.5, i + 0.5
                u = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
                v = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
                if u < 0 or v < 0 or u + v > 1:
                    continue
                wa, wb, wc = (1 - u - v) * nearness[a], u * nearness[b], v * nearness[c]
                total = wa + wb + wc
                if total > nearest[i, j]:
                    nearest[i, j] = total
                    for k in range(3):
                        image[i, j, k] = (
                            wa * colours[a, k] + wb * colours[b, k] + wc * colours[c, k]
                        ) / total
