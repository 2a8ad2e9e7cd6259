"""Gives Gaussians the looks of a picture: colours by one linear solve, then colours and opacities by Adam."""

import numpy as np

from pneutac_sim.splat.rasteriser import Rendering, Splats, numbers

RIDGE = 1e-3  # weight of one colour's prior against one fully covered pixel
LEARNING_RATE = 0.01  # of the paper


class Adam:
    """Adam (Kingma and Ba 2015) on one array of float32 or float64, changed in place."""

    def __init__(self, values: np.ndarray, rate: float = LEARNING_RATE):
        self.values, self._rate, self._steps = values, rate, 0
        self._mean, self._square = np.zeros_like(values), np.zeros_like(values)

    def step(self, gradient: np.ndarray) -> None:
        """One step down a gradient of the values' shape."""
        self._steps += 1
        # m <- b1 m + (1 - b1) g, v <- b2 v + (1 - b2) g^2, b1 = 0.9, b2 = 0.999; their bias is in the rate
        self._mean += 0.1 * (gradient - self._mean)
        self._square += 1e-3 * (gradient**2 - self._square)
        rate = self._rate * np.sqrt(1 - 0.999**self._steps) / (1 - 0.9**self._steps)
        self.values -= rate * self._mean / (np.sqrt(self._square) + 1e-8)


def solve_colours(
    splats: Splats, target: np.ndarray, background=(0.0, 0.0, 0.0), iterations: int = 30, ridge: float = RIDGE
) -> np.ndarray:
    """Colours (n, 3), float32, 0 to 1, that render best as a picture (H, W, 3), 0 to 1, opacities fixed.

    Minimises |W c + (1 - alpha) background - target|^2 + ridge |c - prior|^2 by conjugate gradients on the
    normal equations, scaled by the weight that each Gaussian has in the picture; 5 iterations get most of the
    way. The prior is the picture's colour at each Gaussian's centre, so that Gaussians hidden behind others
    get a likely colour.

    Raises InputError where a shape is wrong or a number not finite.
    """
    camera = splats.camera
    target = numbers("target", target, (camera.height, camera.width, 3))
    pixels = (
        np.floor(camera.project(splats.means)[0]).clip(0, (camera.width - 1, camera.height - 1)).astype(int)
    )
    colours = target[pixels[:, 1], pixels[:, 0]]

    def normal(c):
        return splats.transpose(splats.render(c).image) + ridge * c

    # (W^T W + ridge) c = W^T (target - (1 - alpha) background) + ridge prior; Jacobi's preconditioner
    scale = 1 / (splats.transpose(splats.render(np.ones_like(colours)).image) + ridge)
    residual = splats.transpose(target - splats.render(colours, background).image)
    direction = step = scale * residual
    energy = np.sum(residual * step, 0, np.float64)
    for _ in range(iterations):
        if not energy.any():
            break
        bent = normal(direction)
        length = energy / np.maximum(np.sum(direction * bent, 0, np.float64), 1e-30)
        colours = colours + length.astype(np.float32) * direction
        residual = residual - length.astype(np.float32) * bent
        step = scale * residual
        energy, before = np.sum(residual * step, 0, np.float64), energy
        direction = step + (energy / np.maximum(before, 1e-30)).astype(np.float32) * direction
    return np.clip(colours, 0, 1)


def fit_looks(
    splats: Splats,
    target: np.ndarray,
    background=(0.0, 0.0, 0.0),
    iterations: int = 100,
    coverage: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Colours (n, 3) and opacities (n,), float32, that render best as a picture (H, W, 3), 0 to 1.

    `solve_colours`, then Adam on colours and on logits of opacities, at the paper's rate; those to start from
    are clipped to 0.01 to 0.99, and the best iteration is taken. `coverage` (H, W), 0 to 1, is what is
    wanted, such as a silhouette; free where None.

    Raises InputError: a shape is wrong or a number not finite.
    """
    camera = splats.camera
    target = numbers("target", target, (camera.height, camera.width, 3))
    if coverage is not None:
        coverage = numbers("coverage", coverage, (camera.height, camera.width))
    opacities = np.clip(splats.opacities, 0.01, 0.99)
    splats = splats.with_opacities(opacities)
    colours = Adam(solve_colours(splats, target, background))
    logits = Adam(np.log(opacities / (1 - opacities)))
    best = (np.inf, colours.values.copy(), opacities)
    for iteration in range(iterations + 1):
        rendering = splats.render(colours.values, background)
        loss, grad_image, grad_alpha = _difference(rendering, target, coverage)
        if loss < best[0]:
            best = (loss, colours.values.copy(), opacities)
        if iteration == iterations:
            break
        by_colours, by_opacities = splats.gradients(
            colours.values, background, grad_image, grad_alpha, rendering
        )
        colours.step(by_colours)
        np.clip(colours.values, 0, 1, out=colours.values)
        logits.step(by_opacities * opacities * (1 - opacities))  # d sigmoid(x) / dx = s (1 - s)
        opacities = np.clip(1 / (1 + np.exp(-logits.values)), 0.01, 0.99)
        splats = splats.with_opacities(opacities)
    return best[1:]


def _difference(rendering: Rendering, target, coverage):
    """L = sum |I - target|^2 + (alpha - coverage)^2, and half its gradients by I and alpha."""
    grad_image = rendering.image - target
    loss = float(np.vdot(grad_image, grad_image))
    if coverage is None:
        return loss, grad_image, None
    grad_alpha = rendering.alpha - coverage
    return loss + float(np.vdot(grad_alpha, grad_alpha)), grad_image, grad_alpha
