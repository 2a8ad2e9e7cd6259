"""Renders Gaussians on the CPU: many colours of one geometry."""

import gc
from threading import Thread
from typing import NamedTuple

import numpy as np
from numba import config

from pneutac_sim.errors import InputError
from pneutac_sim.splat import compositing, kernels
from pneutac_sim.splat.camera import Camera

MOST_THREADS = 8  # starting more costs longer than they save on a picture of a few milliseconds


class Rendering(NamedTuple):
    """A picture of Gaussians.

    Attributes:
        image: (H, W, 3) float32, 0 to 1 where colours and background are.
        alpha: coverage, (H, W) float32, 0 to 1: one minus the share of the background in a pixel.
    """

    image: np.ndarray
    alpha: np.ndarray


class Splats:
    """Gaussians projected, ordered by depth and listed by image tile, ready for any colours.

    The image is linear in colours: image = W colours + (1 - alpha) background.

    Args:
        camera: from where.
        means: (n, 3) m.
        covariances: (n, 3, 3) m^2, symmetric.
        opacities: (n,) 0 to 1.

    Attributes:
        camera: as given.
        means, covariances, opacities: as given, float32.

    Raises:
        InputError: a shape is wrong, a number not finite or an opacity outside 0 to 1.
    """

    def __init__(self, camera: Camera, means, covariances, opacities):
        means = numbers("means", means, (-1, 3))
        n = len(means)
        covariances = numbers("covariances", covariances, (n, 3, 3))
        opacities = numbers("opacities", opacities, (n,))
        if n and not (opacities.min() >= 0 and opacities.max() <= 1):
            raise InputError("Opacities of Gaussians must lie between 0 and 1.")
        self.camera, self.means = camera, means
        self.covariances, self.opacities = covariances, opacities
        visible = opacities >= kernels.LEAST_ALPHA
        reach = np.sqrt(2 * np.log(255 * opacities, where=visible, out=np.zeros_like(opacities)).clip(0))
        reach[~visible] = -1
        splats, boxes = np.empty((n, 8), np.float32), np.empty((n, 4), np.int16)
        depth = np.empty(n, np.float32)
        size = (camera.width, camera.height)
        view = (camera.intrinsics, camera.extrinsics, camera.lens, camera.largest_r2, size)
        _share(kernels.project, means, covariances, opacities, reach, *view, splats, boxes, depth)
        self._tiles_x, tiles_y = -(-camera.width // kernels.TILE), -(-camera.height // kernels.TILE)
        tiles = self._tiles_x * tiles_y
        self._lists = (*kernels.bin_tiles(boxes, depth.view(np.uint32), self._tiles_x, tiles), splats)

    def __len__(self):
        return len(self._lists[2])

    def with_opacities(self, opacities: np.ndarray) -> "Splats":
        """The same Gaussians with other opacities (n,)."""
        return Splats(self.camera, self.means, self.covariances, opacities)

    def render(self, colours, background=(0.0, 0.0, 0.0)) -> Rendering:
        """The picture with colours (n, 3) on a background (3,).

        Raises:
            InputError: a shape is wrong or a number not finite.
        """
        colours = numbers("colours", colours, (len(self), 3))
        background = numbers("background", background, (3,))
        h, w = self.camera.height, self.camera.width
        out = Rendering(np.empty((h, w, 3), np.float32), np.empty((h, w), np.float32))
        _share(compositing.composite, *self._lists, colours, background, self._tiles_x, *out)
        return out

    def transpose(self, image) -> np.ndarray:
        """W^T times an image (H, W, 3): the gradient by colours alone, (n, 3) float32.

        Raises:
            InputError: a shape is wrong or a number not finite.
        """
        image = numbers("image", image, (self.camera.height, self.camera.width, 3))
        return self._gather(compositing.pull_back, 3, image)

    def gradients(
        self, colours, background, grad_image, grad_alpha=None, rendering: Rendering | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gradients of a loss by colours and opacities.

        Args:
            colours: (n, 3).
            background: (3,).
            grad_image: gradient by the image, (H, W, 3).
            grad_alpha: gradient by the coverage, (H, W); none where None.
            rendering: what `render` gave for these colours and background; rendered anew where None.

        Returns:
            Gradients by colours (n, 3) and by opacities (n,), float32. Geometry, and which Gaussians a pixel
            takes, are held fixed.

        Raises:
            InputError: a shape is wrong or a number not finite.
        """
        h, w = self.camera.height, self.camera.width
        colours = numbers("colours", colours, (len(self), 3))
        grad_image = numbers("grad_image", grad_image, (h, w, 3))
        image, alpha = rendering or self.render(colours, background)
        if grad_alpha is None:
            grad_alpha = np.zeros((h, w), np.float32)
        grad_alpha = numbers("grad_alpha", grad_alpha, (h, w))
        out = self._gather(compositing.replay, 4, colours, image, alpha, grad_image, grad_alpha)
        return out[:, :3], out[:, 3]

    def _gather(self, kernel, columns: int, *inputs) -> np.ndarray:
        """Sum over threads of what `kernel` adds to each Gaussian, (n, columns)."""
        out = np.zeros((_shares(), len(self), columns), np.float32)
        _share(lambda k, n, *rest: kernel(k, n, *rest, out[k]), *self._lists, *inputs, self._tiles_x)
        return out.sum(0)


def numbers(name: str, values, shape: tuple[int, ...]) -> np.ndarray:
    """`values` as contiguous float32 of `shape`, where -1 stands for any length.

    Raises:
        InputError: the shape differs or a number is not finite.
    """
    try:
        array = np.ascontiguousarray(values, np.float32)
    except (TypeError, ValueError):
        array = np.full(1, np.nan, np.float32)
    fits = array.ndim == len(shape) and all(s in (-1, t) for s, t in zip(shape, array.shape, strict=True))
    if not fits or not np.isfinite(array).all():
        wanted = ", ".join("n" if s == -1 else str(s) for s in shape)
        raise InputError(f"The rasteriser's {name} must be finite numbers of shape ({wanted}).")
    return array


def _shares() -> int:
    """Threads to use: NUMBA_NUM_THREADS, at most `MOST_THREADS`."""
    return min(config.NUMBA_NUM_THREADS, MOST_THREADS)


def _share(kernel, *inputs) -> None:
    """Runs kernel(share, shares, *inputs) for every share at once.

    Threads live for one call: no pool to break when a process forks or when two threads render. Garbage is
    not collected meanwhile: what a material point solver left on a GPU only the thread that made it may free.
    """
    n = _shares()
    others = [Thread(target=kernel, args=(k, n, *inputs)) for k in range(1, n)]
    collects = gc.isenabled()
    gc.disable()
    try:
        for thread in others:
            thread.start()
        kernel(0, n, *inputs)
        for thread in others:
            thread.join()
    finally:
        if collects:
            gc.enable()
