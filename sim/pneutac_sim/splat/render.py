"""3D Gaussians that follow a body, drawn on the CPU, or on CUDA by gsplat's kernels (Ye et al. 2024)."""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from pneutac_sim.errors import InputError, finite_array
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.rasteriser import BLUR_PX2, LEAST_ALPHA, NEAR_M, TILE, Rendering, Splats, numbers


@dataclass
class Gaussians:
    """n Gaussians."""

    means: np.ndarray  # (n, 3) m
    scales: np.ndarray  # (n, 3) m, standard deviations along the Gaussian's own axes
    rotations: np.ndarray  # (n, 3, 3), own axes to world, as columns
    colours: np.ndarray  # (n, 3) red, green, blue, 0 to 1
    opacities: np.ndarray  # (n,) 0 to 1

    def __post_init__(self):
        n = len(self.means)
        names = "means", "scales", "rotations", "colours", "opacities"
        for name, shape in zip(names, [(n, 3), (n, 3), (n, 3, 3), (n, 3), (n,)], strict=True):
            value = finite_array(f"The {name} of {n} Gaussians", getattr(self, name), shape, np.float32)
            setattr(self, name, value)
        if n and self.scales.min() < 0:
            raise InputError("The scales of Gaussians must not be negative.")
        for name in ("colours", "opacities"):
            if n and not (getattr(self, name).min() >= 0 and getattr(self, name).max() <= 1):
                raise InputError(f"The {name} of Gaussians must lie between 0 and 1.")

    def __len__(self):
        return len(self.means)

    def covariances(self) -> np.ndarray:
        """R diag(s^2) R^T, float32 (n, 3, 3) m^2."""
        axes = self.rotations * self.scales[:, None, :]
        return axes @ axes.transpose(0, 2, 1)

    def moved(self, means, deformation_gradients=None) -> "Gaussians":
        """The same Gaussians carried along by their body to means (n, 3) in m, of unchanged scales.

        With deformation gradients F (n, 3, 3) each turns by the rotation U of F = U P, P symmetric positive
        definite.

        Raises InputError: a shape is wrong, a number not finite, or a determinant of F not positive.
        """
        if deformation_gradients is None:
            return replace(self, means=means)
        F = np.ascontiguousarray(deformation_gradients, np.float64)
        if F.shape != (len(self), 3, 3) or not np.isfinite(F).all():
            raise InputError(
                f"Deformation gradients of {len(self)} Gaussians must be finite numbers of shape (n, 3, 3)."
            )
        turn = np.empty(F.shape)
        if not _polar(F, turn):
            raise InputError(
                "A deformation gradient turns its particle inside out; its determinant must be > 0."
            )
        return replace(self, means=means, rotations=turn @ self.rotations)


@njit(cache=True)
def _polar(F, turn):
    """Writes the rotation of each F by Newton's iteration X <- (X + X^-T) / 2 (Higham 1986).

    Returns whether every determinant is positive.
    """
    for i in range(len(F)):
        X = F[i].copy()
        for _ in range(20):
            # rows of the cofactor matrix, det X^-T
            c0 = np.cross(X[1], X[2])
            c1 = np.cross(X[2], X[0])
            c2 = np.cross(X[0], X[1])
            det = X[0, 0] * c0[0] + X[0, 1] * c0[1] + X[0, 2] * c0[2]
            if det <= 0:
                return False
            change = 0.0
            for j in range(3):
                for k, c in enumerate((c0[j], c1[j], c2[j])):
                    new = 0.5 * (X[k, j] + c / det)
                    change = max(change, abs(new - X[k, j]))
                    X[k, j] = new
            if change < 1e-9:
                break
        turn[i] = X
    return True


class CudaSplats:
    """As `Splats`, on a CUDA device; gsplat compiles its kernels first (minutes)."""

    def __init__(self, camera: Camera, means, covariances, opacities):
        self.camera, self.means = camera, numbers("means", means, (-1, 3))
        n = len(self.means)
        self._means = _sent(self.means)
        self._covariances = _sent(numbers("covariances", covariances, (n, 3, 3)))
        self._opacities = _sent(numbers("opacities", opacities, (n,)))

    def render(self, colours, background=(0.0, 0.0, 0.0)) -> Rendering:
        """As `Splats.render`."""
        import torch

        colours = _sent(numbers("colours", colours, self.means.shape))
        behind = _sent(numbers("background", background, (3,)))
        gaussians = self._means, self._covariances, colours, self._opacities
        with torch.no_grad():
            image, alpha = rasterise_tensors(*gaussians, self.camera, behind)
        return Rendering(image.cpu().numpy(), alpha.cpu().numpy())


def rasterise(
    gaussians: Gaussians, camera: Camera, background=(0.0, 0.0, 0.0), device: str = "cpu"
) -> Rendering:
    """Renders Gaussians as one camera sees them.

    Args:
        gaussians: what to render.
        camera: from where.
        background: (3,) 0 to 1.
        device: `cpu`, `cuda`, or `auto` for CUDA where gsplat and a device are there.

    Raises InputError: an input is malformed or not finite, or CUDA or gsplat is missing.
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


def _sent(array: np.ndarray):
    import torch

    return torch.from_numpy(array).cuda()


def missing() -> str:
    """What to do where gsplat or a CUDA device is missing; empty where both are there."""
    install = "uv pip install -e '.[cuda]' in PneuTac's folder"
    if importlib.util.find_spec("gsplat") is None:
        return f"Rendering on CUDA needs the package gsplat; install it with: {install}"
    import torch

    if not torch.cuda.is_available():
        return f"Rendering on CUDA needs a CUDA device, which PyTorch does not find; see: {install}"
    return ""


def rasterise_tensors(means, covariances, colours, opacities, camera: Camera, background):
    """The same on float32 CUDA tensors; differentiable, by gsplat, by all tensors.

    Of means (n, 3) m, covariances (n, 3, 3) m^2, colours (n, 3), opacities (n,) and a background (3,).
    Returns the image (H, W, 3) and coverage (H, W).
    """
    import torch
    from gsplat import isect_offset_encode, isect_tiles, rasterization, rasterize_to_pixels

    size = (camera.width, camera.height)
    sent = {"dtype": torch.float32, "device": means.device}
    view, K = (torch.tensor(m, **sent) for m in (camera.extrinsics, camera.intrinsics))
    behind = background[None]
    if not camera.distortion:
        inputs = means, None, None, opacities, colours, view[None], K[None], *size
        how = {"near_plane": NEAR_M, "eps2d": BLUR_PX2, "packed": False}
        image, alpha, _ = rasterization(*inputs, backgrounds=behind, covars=covariances, **how)
        return image[0], alpha[0, ..., 0]
    pixels, conics, depth, radii = _project(means, covariances, opacities, camera, view)
    across, down = -(-camera.width // TILE), -(-camera.height // TILE)
    with torch.no_grad():
        _, lists, ids = isect_tiles(pixels[None], radii[None], depth[None], TILE, across, down)
        starts = isect_offset_encode(lists, 1, across, down)
    splats = pixels[None], conics[None], colours[None], opacities[None]
    image, alpha = rasterize_to_pixels(*splats, *size, TILE, starts, ids, behind)
    return image[0], alpha[0, ..., 0]


def _project(means, covariances, opacities, camera: Camera, view):
    """`rasteriser.project` in torch: pixels (n, 2), conics (n, 3), depth (n,), radii (n, 2), 0 where unseen.

    gsplat's own projection knows no lens.
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
