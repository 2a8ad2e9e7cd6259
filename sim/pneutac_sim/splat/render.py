"""Renders Gaussians on the CPU or on CUDA."""

from collections.abc import Callable

from pneutac_sim.errors import InputError
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.cuda import CudaSplats, missing
from pneutac_sim.splat.gaussians import Gaussians
from pneutac_sim.splat.rasteriser import Rendering, Splats


def rasterise(
    gaussians: Gaussians, camera: Camera, background=(0.0, 0.0, 0.0), device: str = "cpu"
) -> Rendering:
    """Renders Gaussians as one camera sees them.

    Args:
        gaussians: what to render.
        camera: from where.
        background: (3,) 0 to 1.
        device: `cpu`, `cuda`, or `auto` for CUDA where gsplat and a device are there.

    Raises:
        InputError: an input is malformed or not finite, or CUDA or gsplat is missing.
    """
    splats = on(device)(camera, gaussians.means, gaussians.covariances(), gaussians.opacities)
    return splats.render(gaussians.colours, background)


def on(device: str) -> Callable[..., Splats | CudaSplats]:
    """`Splats` or `CudaSplats` for a device, `cpu`, `cuda`, or `auto` for CUDA where that can be used.

    Raises InputError where there is no such device, or CUDA or gsplat is missing.
    """
    if device == "cpu":
        return Splats
    if device not in ("auto", "cuda"):
        raise InputError(f"A rasteriser's device is 'auto', 'cpu' or 'cuda', not {device!r}.")
    lacks = missing()
    if not lacks:
        return CudaSplats
    if device == "auto":
        return Splats
    raise InputError(lacks)
