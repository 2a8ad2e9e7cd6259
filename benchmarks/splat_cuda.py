"""Times a picture of Gaussians on a GPU through gsplat, by device events: needs CUDA and the extra `cuda`."""

import numpy as np
import torch

from pneutac_benchmarks.speed.device_time import device_ms
from pneutac_benchmarks.speed.splats import OPACITY, finger, gel
from pneutac_sim.splat.render import rasterise_tensors


def main() -> None:
    for name, scene in (("finger, 480 x 640", finger), ("gel, 320 x 240", gel)):
        camera, means, scale = scene()
        n = len(means)
        rng = np.random.default_rng(0)
        arrays = (means, np.tile(scale**2 * np.eye(3), (n, 1, 1)), rng.random((n, 3)), np.full(n, OPACITY))
        means, covariances, colours, opacities = (
            torch.tensor(np.asarray(a), dtype=torch.float32, device="cuda") for a in arrays
        )

        def forward(c=colours, o=opacities, camera=camera, means=means, covariances=covariances):
            return rasterise_tensors(means, covariances, c, o, camera, torch.zeros(3, device="cuda"))

        def both(c=colours, o=opacities, forward=forward):
            c, o = c.clone().requires_grad_(), o.clone().requires_grad_()
            image, alpha = forward(c, o)
            image.square().sum().backward()

        for what, work in (("forward", forward), ("forward and backward", both)):
            print(f"{name}, {n:,} Gaussians, {what}: {device_ms(work):.3f} ms")


if __name__ == "__main__":
    main()
