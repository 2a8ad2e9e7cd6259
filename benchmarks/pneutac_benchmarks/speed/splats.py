"""What a picture of Gaussians costs here, beside a tiled rasteriser in plain PyTorch."""

import time

import numpy as np
import torch

from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.photograph import press_depth
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.gel import SplatSensor
from pneutac_sim.splat.rasteriser import BLUR_PX2, Splats

OPACITY = 0.5
REPEATS, PEER_REPEATS = 25, 2
PEER_TILE = 16


def finger() -> tuple[Camera, np.ndarray, float]:
    """4,050 particles of a finger of 99 x 20 x 22 mm at 480 x 640: camera, means (n, 3) m, scale m."""
    grid = np.stack(np.meshgrid(*(np.arange(k) for k in (45, 9, 10)), indexing="ij"), -1).reshape(-1, 3)
    camera = Camera.look_at([0.07, -0.2, 0.031], [0.05, 0.01, 0.011], [0, 0, 1], 35, 640, 480)
    return camera, 2.2e-3 * grid, 1.3e-3


def gel() -> tuple[Camera, np.ndarray, float]:
    """A slab of 59 x 80 x 13 particles of about a pixel at 320 x 240, as of a DIGIT's gel."""
    grid = np.stack(np.meshgrid(*(np.arange(k) for k in (59, 80, 13)), indexing="ij"), -1).reshape(-1, 3)
    view = np.eye(4)
    view[:3, 3] = -6e-3, -8e-3, 20e-3
    camera = Camera(np.array([[400.0, 0, 120], [0, 400.0, 160], [0, 0, 1]]), view, 240, 320)
    return camera, grid * [12e-3 / 59, 16e-3 / 80, 2.5e-3 / 13], 5e-5


def torch_image(camera: Camera, means, covariances, colours, opacities) -> torch.Tensor:
    """The same picture by tiles of tensor operations, differentiable: (H, W, 3)."""
    K, E = (torch.tensor(m, dtype=torch.float32) for m in (camera.intrinsics, camera.extrinsics))
    p = means @ E[:3, :3].T + E[:3, 3]
    order = torch.argsort(p[:, 2], stable=True)
    p, S, colours, opacities = p[order], covariances[order], colours[order], opacities[order]
    x, y, z = p.unbind(-1)
    zero = torch.zeros_like(z)
    J = torch.stack([K[0, 0] / z, zero, -K[0, 0] * x / z**2, zero, K[1, 1] / z, -K[1, 1] * y / z**2], -1)
    J = J.reshape(-1, 2, 3) @ E[:3, :3]
    S = J @ S @ J.transpose(1, 2) + BLUR_PX2 * torch.eye(2)
    xx, xy, yy = S[:, 0, 0], S[:, 0, 1], S[:, 1, 1]
    det = xx * yy - xy**2
    px, py = K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]
    reach = (2 * torch.log(255 * opacities.detach())).clamp(min=0).sqrt()
    rx, ry = reach * xx.sqrt(), reach * yy.sqrt()
    rows = []
    for top in range(0, camera.height, PEER_TILE):
        in_row = torch.nonzero((py + ry > top) & (py - ry < top + PEER_TILE))[:, 0]
        tiles = []
        for left in range(0, camera.width, PEER_TILE):
            i = in_row[(px[in_row] + rx[in_row] > left) & (px[in_row] - rx[in_row] < left + PEER_TILE)]
            v, u = torch.meshgrid(
                torch.arange(top, min(top + PEER_TILE, camera.height)) + 0.5,
                torch.arange(left, min(left + PEER_TILE, camera.width)) + 0.5,
                indexing="ij",
            )
            dx, dy = u[..., None] - px[i], v[..., None] - py[i]
            sigma = (0.5 * (yy[i] * dx**2 + xx[i] * dy**2) - xy[i] * dx * dy) / det[i]
            alpha = (opacities[i] * torch.exp(-sigma)).clamp(max=0.999)
            alpha = torch.where(alpha >= 1 / 255, alpha, 0.0)
            left_over = torch.cumprod(1 - alpha, -1)
            before = torch.cat([torch.ones_like(left_over[..., :1]), left_over[..., :-1]], -1)
            weight = torch.where(left_over > 1e-4, before * alpha, 0.0)
            tiles.append(weight @ colours[i])
        rows.append(torch.cat(tiles, 1))
    return torch.cat(rows, 0)


def best_ms(work, repeats: int) -> float:
    """Least milliseconds of `work()`: others on this machine only ever add."""
    found = np.inf
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        found = min(found, time.perf_counter() - began)
    return 1e3 * found


def peer_ms(work) -> float:
    """Least milliseconds of PyTorch, on one thread or on all: busy cores slow its many small steps."""
    threads = torch.get_num_threads()
    try:
        found = best_ms(work, PEER_REPEATS)
        torch.set_num_threads(1)
        return min(found, best_ms(work, PEER_REPEATS))
    finally:
        torch.set_num_threads(threads)


def measure(camera: Camera, means: np.ndarray, scale: float) -> dict[str, float]:
    """Milliseconds of a picture and of its gradients, ours and PyTorch's, and the pictures' difference."""
    n = len(means)
    rng = np.random.default_rng(0)
    arrays = (
        means,
        np.tile(scale**2 * np.eye(3), (n, 1, 1)),
        rng.random((n, 3)),
        np.full(n, OPACITY),
    )
    means, covariances, colours, opacities = (np.asarray(a, np.float32) for a in arrays)
    tensors = [torch.from_numpy(a) for a in (means, covariances, colours, opacities)]
    grad = rng.random((camera.height, camera.width, 3)).astype(np.float32)

    def forward():
        return Splats(camera, means, covariances, opacities).render(colours)

    def both():
        splats = Splats(camera, means, covariances, opacities)
        return splats.gradients(colours, (0, 0, 0), grad, rendering=splats.render(colours))

    def peer_forward():
        with torch.no_grad():
            return torch_image(camera, *tensors)

    def peer_both():
        leaves = [t.clone().requires_grad_() for t in tensors[2:]]
        torch_image(camera, *tensors[:2], *leaves).backward(torch.from_numpy(grad))

    both()  # compiles
    return {
        "gaussians": n,
        "forward_ms": best_ms(forward, REPEATS),
        "forward_backward_ms": best_ms(both, REPEATS),
        "torch_forward_ms": peer_ms(peer_forward),
        "torch_forward_backward_ms": peer_ms(peer_both),
        "rms_difference": float(np.sqrt(np.mean((forward().image - peer_forward().numpy()) ** 2))),
    }


def measure_touch() -> dict[str, float]:
    """Seconds to fit the built-in DIGIT's rest image, milliseconds from a displacement to a tactile image."""
    began = time.perf_counter()
    sensor = SplatSensor(GelModel.builtin())
    fitted = time.perf_counter() - began
    touch = TactileSensor(sensor.model)
    depth = press_depth(Press("sphere", 3.0, 0.5, 1.0, 0.9), sensor.model)
    u = touch.displacement(depth)
    sensor.image(u)  # compiles
    return {
        "rest_fit_s": fitted,
        "rest_error_levels": sensor.rest_error_levels,
        "image_ms": best_ms(lambda: sensor.image(u), REPEATS),
        "in_the_image_plane_ms": best_ms(lambda: touch.image(depth), REPEATS),
    }


def time_splats(console) -> dict:
    """Measures both scenes and a tactile image, and prints tables on a rich console.

    Returns:
        By scene, what `measure` found; under `touch` what `measure_touch` did.
    """
    from rich.table import Table

    table = Table("picture", "forward", "forward + backward", title="Gaussian splats on the CPU")
    results = {}
    for name, scene in (("finger, 480 x 640", finger), ("gel, 320 x 240", gel)):
        with console.status(name):
            r = results[name] = measure(*scene())
        cells = [
            f"{r[k + '_ms']:.1f} ms; PyTorch {r['torch_' + k + '_ms']:.0f} ms, "
            f"{r['torch_' + k + '_ms'] / r[k + '_ms']:.0f} times"
            for k in ("forward", "forward_backward")
        ]
        table.add_row(f"{r['gaussians']:,} Gaussians, {name}", *cells)
    console.print(table)
    with console.status("tactile image"):
        r = results["touch"] = measure_touch()
    console.print(
        f"Tactile image from the gel's displacement: {r['image_ms']:.1f} ms by splats, "
        f"{r['in_the_image_plane_ms']:.2f} ms in the image plane; the rest image is fitted in "
        f"{r['rest_fit_s']:.1f} s, compiling included, and {r['rest_error_levels']:.2f} levels off.",
        highlight=False,
    )
    return results
