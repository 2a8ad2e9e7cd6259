"""Plain dense splatting in float64 torch, pixel by Gaussian, for comparison."""

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.render import Gaussians


def scene(seed: int, n: int, size: float = 0.01) -> Gaussians:
    """Gaussians in a box of 0.2 m about the origin."""
    rng = np.random.default_rng(seed)
    return Gaussians(
        means=rng.uniform(-0.1, 0.1, (n, 3)),
        scales=size * rng.uniform(0.1, 2.0, (n, 3)),
        rotations=Rotation.random(n, random_state=seed).as_matrix(),
        colours=rng.random((n, 3)),
        opacities=rng.uniform(0.02, 1.0, n),
    )


def view(distortion=(), width=70, height=51) -> Camera:
    plain = Camera.look_at([0.1, -0.3, 0.12], [0, 0, 0], [0, 0, 1], 40, width, height)
    return Camera(plain.intrinsics, plain.extrinsics, width, height, distortion)


def render(camera, means, covariances, colours, opacities, background=(0.0, 0.0, 0.0)):
    """Image (H, W, 3) and coverage (H, W), differentiable by colours and opacities."""
    means, covariances = (torch.as_tensor(np.asarray(v, np.float64)) for v in (means, covariances))
    K, E = torch.as_tensor(camera.intrinsics.copy()), torch.as_tensor(camera.extrinsics.copy())
    p = means @ E[:3, :3].T + E[:3, 3]
    keep = p[:, 2] >= 1e-3
    order = torch.argsort(p[:, 2], stable=True)
    order = order[keep[order]]
    p, S = p[order], covariances[order]
    colours, opacities = colours[order], opacities[order]
    u, v, z = p[:, 0] / p[:, 2], p[:, 1] / p[:, 2], p[:, 2]
    k1, k2, p1, p2, k3 = (*camera.distortion, *[0.0] * 5)[:5]
    r2 = u**2 + v**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    x = K[0, 0] * (u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u**2)) + K[0, 2]
    y = K[1, 1] * (v * radial + p1 * (r2 + 2 * v**2) + 2 * p2 * u * v) + K[1, 2]
    w, h = camera.width, camera.height
    f, g, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    u = u.clamp(-(cx + 0.15 * w) / f, (1.15 * w - cx) / f)
    v = v.clamp(-(cy + 0.15 * h) / g, (1.15 * h - cy) / g)
    o = torch.zeros_like(z)
    J = torch.stack([f / z, o, -f * u / z, o, g / z, -g * v / z], -1).reshape(-1, 2, 3) @ E[:3, :3]
    S2 = J @ S @ J.transpose(1, 2) + 0.3 * torch.eye(2)
    P = torch.linalg.inv(S2)
    rows, cols = torch.meshgrid(torch.arange(h) + 0.5, torch.arange(w) + 0.5, indexing="ij")
    image, T = torch.zeros(h, w, 3, dtype=torch.float64), torch.ones(h, w, dtype=torch.float64)
    done = torch.zeros(h, w, dtype=torch.bool)
    for i in range(len(z)):
        dx, dy = cols - x[i], rows - y[i]
        sigma = 0.5 * (P[i, 0, 0] * dx**2 + P[i, 1, 1] * dy**2) + P[i, 0, 1] * dx * dy
        alpha = (opacities[i] * torch.exp(-sigma)).clamp(max=0.999)
        takes = (alpha >= 1 / 255) & ~done
        done = done | (takes & (T * (1 - alpha) <= 1e-4))
        alpha = torch.where(takes & ~done, alpha, 0.0)
        image = image + (T * alpha)[..., None] * colours[i]
        T = T * (1 - alpha)
    return image + T[..., None] * torch.as_tensor(background, dtype=torch.float64), 1 - T
