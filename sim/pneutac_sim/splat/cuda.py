"""The rasteriser on CUDA through gsplat's kernels (Ye et al. 2024), agreeing with the one on the CPU."""

import importlib.util

import numpy as np

from pneutac_sim.errors import InputError
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.gaussians import Gaussians
from pneutac_sim.splat.kernels import BLUR_PX2, LEAST_ALPHA, NEAR_M, TILE


def rasterise(gaussians: Gaussians, camera: Camera, background: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Renders Gaussians as one camera sees them; gsplat compiles its kernels at the first call (minutes).

    Args:
        gaussians: what to render.
        camera: from where.
        background: (3,) float32, 0 to 1.

    Returns:
        Image (H, W, 3) and coverage (H, W), float32.

    Raises:
        InputError: gsplat or a CUDA device is missing.
    """
    require()
    import torch

    arrays = (gaussians.means, gaussians.covariances(), gaussians.colours, gaussians.opacities, background)
    means, covariances, colours, opacities, behind = (torch.from_numpy(a).cuda() for a in arrays)
    with torch.no_grad():
        image, alpha = rasterise_tensors(means, covariances, colours, opacities, camera, behind)
    return image.cpu().numpy(), alpha.cpu().numpy()


def require() -> None:
    """Raises InputError where gsplat or a CUDA device is missing."""
    install = "uv pip install -e '.[cuda]' in PneuTac's folder"
    if importlib.util.find_spec("gsplat") is None:
        raise InputError(f"Rendering on CUDA needs the package gsplat; install it with: {install}")
    import torch

    if not torch.cuda.is_available():
        raise InputError(
            f"Rendering on CUDA needs a CUDA device, which PyTorch does not find; see: {install}"
        )


def rasterise_tensors(means, covariances, colours, opacities, camera: Camera, background):
    """The same on float32 CUDA tensors; differentiable, by gsplat, by all tensors.

    Args:
        means: (n, 3) m.
        covariances: (n, 3, 3) m^2.
        colours: (n, 3).
        opacities: (n,).
        camera: from where.
        background: (3,).

    Returns:
        Image (H, W, 3) and coverage (H, W).
    """
    import torch
    from gsplat import isect_offset_encode, isect_tiles, rasterization, rasterize_to_pixels

    size = (camera.width, camera.height)
    view, K = (
        torch.tensor(m, dtype=torch.float32, device=means.device)
        for m in (camera.extrinsics, camera.intrinsics)
    )
    behind = background[None]
    if not camera.distortion:
        image, alpha, _ = rasterization(
            means,
            None,
            None,
            opacities,
            colours,
            view[None],
            K[None],
            *size,
            near_plane=NEAR_M,
            eps2d=BLUR_PX2,
            packed=False,
            backgrounds=behind,
            covars=covariances,
        )
        return image[0], alpha[0, ..., 0]
    pixels, conics, depth, radii = _project(means, covariances, opacities, camera, view)
    across, down = -(-camera.width // TILE), -(-camera.height // TILE)
    with torch.no_grad():
        _, lists, ids = isect_tiles(pixels[None], radii[None], depth[None], TILE, across, down)
        starts = isect_offset_encode(lists, 1, across, down)
    image, alpha = rasterize_to_pixels(
        pixels[None], conics[None], colours[None], opacities[None], *size, TILE, starts, ids, behind
    )
    return image[0], alpha[0, ..., 0]


def _project(means, covariances, opacities, camera: Camera, view):
    """`kernels.project` in torch: pixels (n, 2), conics (n, 3), depth (n,), radii (n, 2), 0 where unseen.

    gsplat's own projection beside these kernels knows no lens.
    """
    import torch

    # Python numbers, so that the lens costs no copies to the device
    (fx, _, cx), (_, fy, cy), _ = camera.intrinsics.tolist()
    k1, k2, p1, p2, k3 = camera.lens.tolist()
    width, height = camera.width, camera.height
    rotation = view[:3, :3]
    x, y, z = (means @ rotation.T + view[:3, 3]).unbind(-1)
    seen = z >= NEAR_M
    near = torch.where(seen, z, 1.0)
    u, v = x / near, y / near
    r2 = u * u + v * v
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    px = fx * (u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)) + cx
    py = fy * (v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v) + cy
    seen = seen & (r2 <= camera.largest_r2)
    u = u.clamp(-(cx + 0.15 * width) / fx, (1.15 * width - cx) / fx)
    v = v.clamp(-(cy + 0.15 * height) / fy, (1.15 * height - cy) / fy)
    # rows of the Jacobian of the pixel by the point, times the world-to-camera rotation
    jx = (fx / near)[:, None] * (rotation[0] - u[:, None] * rotation[2])
    jy = (fy / near)[:, None] * (rotation[1] - v[:, None] * rotation[2])
    J = torch.stack([jx, jy], 1)
    S = J @ covariances @ J.transpose(1, 2)
    xx, xy, yy = S[:, 0, 0] + BLUR_PX2, S[:, 0, 1], S[:, 1, 1] + BLUR_PX2
    det = xx * yy - xy * xy
    conics = torch.stack([yy / det, -xy / det, xx / det], -1)
    with torch.no_grad():
        reach = (2 * torch.log(opacities / float(LEAST_ALPHA))).clamp(min=0).sqrt()
        rx, ry = (reach * xx.sqrt()).ceil(), (reach * yy.sqrt()).ceil()
        seen = seen & (opacities >= float(LEAST_ALPHA))
        seen = seen & (px + rx > 0) & (px - rx < width) & (py + ry > 0) & (py - ry < height)
        radii = (torch.stack([rx, ry], -1) * seen[:, None]).to(torch.int32)
    return torch.stack([px, py], -1), conics, z, radii
