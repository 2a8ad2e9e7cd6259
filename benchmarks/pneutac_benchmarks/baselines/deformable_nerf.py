"""Baseline: a radiance field of the straight body, whose rays are bent back by the particles' motion."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from pneutac_benchmarks.baselines.particle_splat import draw_disks
from pneutac_sim.mpm.body import Body
from pneutac_sim.splat.body import Carrier, check_photograph
from pneutac_sim.splat.camera import Camera
from pneutac_sim.splat.rasteriser import Rendering

SAMPLES = 32  # of a ray between the nearest and the farthest particle
REACH = 1.0  # over the particles' spacing: beyond it from every particle there is nothing
UNIT_M = 0.01  # of the encoding
WAVES = 2.0 ** np.arange(-2, 5)  # angular frequencies of the encoding, 1/unit; the shortest wave is 4 mm
WIDTH = 64
BATCH = 1024
RATE = 5e-3


class Field(torch.nn.Module):
    """Density and colour of the straight body: a perceptron on sines and cosines of the place."""

    def __init__(self, generator: torch.Generator):
        super().__init__()
        sizes = (3 + 6 * len(WAVES), WIDTH, WIDTH, WIDTH, 4)
        self.layers = torch.nn.ModuleList(
            torch.nn.Linear(a, b) for a, b in zip(sizes[:-1], sizes[1:], strict=True)
        )
        for layer in self.layers:  # He initialisation, from a generator of its own
            with torch.no_grad():
                layer.weight.normal_(0, float(np.sqrt(2 / layer.in_features)), generator=generator)
                layer.bias.zero_()

    def forward(self, places: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Densities (n,), 1/unit, and colours (n, 3) at places (n, 3) in m."""
        x = places / UNIT_M
        angles = (x[:, None] * torch.as_tensor(WAVES, dtype=x.dtype)[:, None]).flatten(1)
        x = torch.cat([x, angles.sin(), angles.cos()], 1)
        for layer in self.layers[:-1]:
            x = torch.relu(layer(x))
        x = self.layers[-1](x)
        return 10 * torch.nn.functional.softplus(x[:, 0]), torch.sigmoid(x[:, 1:])


@dataclass(frozen=True)
class DeformableNerf:
    """A body as a field in the space where it is straight.

    Attributes:
        body: its particles, straight.
        field: trained.
    """

    body: Body
    field: Field

    @classmethod
    def fit(
        cls,
        body: Body,
        positions: np.ndarray,
        gradients: np.ndarray,
        image: np.ndarray,
        mask: np.ndarray,
        camera: Camera,
        iterations: int = 1000,
        seed: int = 0,
    ) -> "DeformableNerf":
        """From one photograph: colours and coverage of rays chosen at random, by Adam.

        Args:
            body: its particles, straight.
            positions: (P, 3) when the photograph was taken, m.
            gradients: (P, 3, 3) deformation gradients then.
            image: RGB uint8 (H, W, 3).
            mask: bool (H, W).
            camera: from where.
            iterations: of Adam.
            seed: of the field's start and of the rays' order.
        """
        check_photograph(positions, image, mask, camera)
        generator = torch.Generator().manual_seed(seed)
        self = cls(body, Field(generator))
        rows, columns, places, inside, step = self._rays(positions, gradients, camera)
        wanted = np.concatenate([image / 255 * mask[..., None], mask[..., None]], -1)[rows, columns]
        places, inside = torch.as_tensor(places), torch.as_tensor(inside)
        wanted = torch.as_tensor(wanted, dtype=torch.float32)
        adam = torch.optim.Adam(self.field.parameters(), RATE)
        rates = torch.optim.lr_scheduler.CosineAnnealingLR(adam, iterations)
        for _ in range(iterations):
            some = torch.randint(len(rows), (BATCH,), generator=generator)
            loss = (self._march(places[some], inside[some], step) - wanted[some]).square().mean()
            adam.zero_grad()
            loss.backward()
            adam.step()
            rates.step()
        return self

    def image(self, positions: np.ndarray, gradients: np.ndarray, camera: Camera) -> Rendering:
        """The body in another state."""
        rows, columns, places, inside, step = self._rays(positions, gradients, camera)
        out = np.zeros((camera.height, camera.width, 4), np.float32)
        with torch.no_grad():
            for part in np.array_split(np.arange(len(rows)), max(1, len(rows) // 4096)):
                seen = self._march(torch.as_tensor(places[part]), torch.as_tensor(inside[part]), step)
                out[rows[part], columns[part]] = seen.numpy()
        return Rendering(out[..., :3], out[..., 3])

    def _march(self, places: torch.Tensor, inside: torch.Tensor, step: float) -> torch.Tensor:
        """Colour and coverage (R, 4) of rays with samples at (R, S, 3), front to back."""
        density, colour = torch.zeros(inside.shape), torch.zeros(*inside.shape, 3)
        some_density, some_colour = self.field(places[inside])
        density = density.masked_scatter(inside, some_density)
        colour = colour.masked_scatter(inside[..., None], some_colour)
        depth = density * step / UNIT_M
        through = torch.exp(-(depth.cumsum(1) - depth))
        weight = through * (1 - torch.exp(-depth))
        return torch.cat([(weight[..., None] * colour).sum(1), weight.sum(1, keepdim=True)], 1)

    def _rays(self, positions: np.ndarray, gradients: np.ndarray, camera: Camera):
        """Rays that may meet the body.

        Returns:
            Rows and columns of their pixels (R,), samples brought back to where the body is straight
            (R, S, 3), which of these can hold matter (R, S), and the step between them, m.
        """
        h = self.body.spacing_m
        rows, columns = np.nonzero(draw_disks(camera, positions, 1.5 * h, np.zeros_like(positions)).alpha)
        pixels = np.stack([columns, rows], 1) + 0.5
        flat = cv2.undistortPoints(pixels[:, None], camera.intrinsics, camera.lens)[:, 0]
        depth = camera.project(positions)[1]
        edges = np.linspace(depth.min() - h, depth.max() + h, SAMPLES + 1)
        middle = (edges[:-1] + edges[1:]) / 2
        seen = np.concatenate([flat, np.ones((len(flat), 1))], 1)[:, None] * middle[:, None]
        world = (seen - camera.extrinsics[:3, 3]) @ camera.extrinsics[:3, :3]
        places = self._straighten(world.reshape(-1, 3), positions, gradients)
        low = self.body.origin_m - 1.5 * h
        nodes = _lattice(self.body.cells.max(0) + 5)
        distance = cKDTree(self.body.positions).query(low + h * nodes.reshape(-1, 3))[0]
        near = _interpolate(distance.reshape(nodes.shape[:3]), (places - low) / h)
        shape = len(rows), SAMPLES
        inside = (near < REACH * h).reshape(shape)
        step = float(middle[1] - middle[0])
        return rows, columns, places.reshape(*shape, 3).astype(np.float32), inside, step

    def _straighten(self, points: np.ndarray, positions: np.ndarray, gradients: np.ndarray) -> np.ndarray:
        """(K, 3) where points of the bent body's space lie in that of the straight one."""
        h = self.body.spacing_m
        low = np.minimum(positions.min(0), points.min(0)) - h
        shape = np.ceil((np.maximum(positions.max(0), points.max(0)) + h - low) / h).astype(int) + 1
        nodes = low + h * _lattice(shape).reshape(-1, 3)
        back = Carrier(nodes, positions)(self.body.positions, np.linalg.inv(gradients)) - nodes
        at = (points - low) / h
        return points + np.stack([_interpolate(back[:, k].reshape(shape), at) for k in range(3)], 1)


def _lattice(shape) -> np.ndarray:
    return np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), -1)


def _interpolate(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    return map_coordinates(values, at.T, order=1, mode="nearest")
