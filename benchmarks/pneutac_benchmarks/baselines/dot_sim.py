"""DOT-Sim (You et al. 2026, arXiv 2604.27367): a network learns the image's residual to the idle image.

What its abstract and summaries tell: the gel is deformed by a calibrated material point method; depth and
surface normals are rendered from the deformed surface; a neural network turns them into a residual image,
which is added to the sensor's real idle image. What they leave open, and is assumed here: the network is a
U-Net (Ronneberger et al. 2015) of three levels, trained by AdamW on the absolute error.

`displacement` stands in for the particles. The one pair is augmented by random crops, but not by flips or
turns, which would move the lights. Neither position nor the idle image is given to the network: one contact
cannot tell how light depends on them, so that a network could only learn that contact by heart. It works on
images 120 pixels wide, whose residuals are smooth at that scale, and takes about half a minute on one core.
"""

import cv2
import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from pneutac_benchmarks.baselines.displacement import Displacement
from pneutac_benchmarks.baselines.pair import Pair
from pneutac_sim.gel.indenter import Press

WIDTH_PX = 120
CHANNELS = 16  # of the finest level, doubled at each coarser one
CROP_PX, BATCH = 64, 8
STEPS, LEARNING_RATE, WEIGHT_DECAY = 300, 3e-3, 1e-2
SEED = 0
# Bring slopes, displacement in mm and residuals in levels near 1.
FIELD_SCALE = np.array([2.0, 2.0, 1.5], np.float32)[:, None, None]
LEVELS = 30.0


class DotSim:
    """A network from depth and slopes to the change of the image."""

    def __init__(self, rest: np.ndarray, displacement: Displacement, network: nn.Module):
        self._rest, self._displacement, self._network = rest, displacement, network

    @classmethod
    def fit(cls, pair: Pair) -> "DotSim":
        """Trains the network; always from the same seed."""
        displacement = Displacement.fit(pair)
        residual = _small((pair.image.astype(np.float32) - pair.rest).transpose(2, 0, 1)) / LEVELS
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(SEED)
            network = _UNet()
        _train(network, _network_input(displacement, pair.press), torch.from_numpy(residual))
        return cls(pair.rest, displacement, network)

    @torch.no_grad()
    def image(self, press: Press) -> np.ndarray:
        """Tactile image, uint8 (H, W, 3)."""
        residual = LEVELS * self._network(_network_input(self._displacement, press)[None])[0]
        h, w = self._rest.shape[:2]
        residual = cv2.resize(residual.numpy().transpose(1, 2, 0), (w, h), interpolation=cv2.INTER_LINEAR)
        return np.clip(self._rest + residual, 0, 255).round().astype(np.uint8)


def _network_input(displacement: Displacement, press: Press) -> torch.Tensor:
    return torch.from_numpy(FIELD_SCALE * _small(displacement.fields(press)))


def _small(planes: np.ndarray) -> np.ndarray:
    """Planes (n, H, W) at the network's width, and a height that two poolings divide."""
    height = 4 * round(planes.shape[1] / planes.shape[2] * WIDTH_PX / 4)
    return np.stack(
        [
            cv2.resize(np.ascontiguousarray(p), (WIDTH_PX, height), interpolation=cv2.INTER_AREA)
            for p in planes
        ]
    )


def _train(network: nn.Module, fields: torch.Tensor, residual: torch.Tensor) -> None:
    """Minimises the absolute error over random crops of one image (3, H, W)."""
    rng = np.random.default_rng(SEED)
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=WEIGHT_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, LEARNING_RATE, total_steps=STEPS)
    h, w = fields.shape[1:]
    size = min(CROP_PX, h, w)
    for _ in range(STEPS):
        rows, columns = rng.integers(0, h - size + 1, BATCH), rng.integers(0, w - size + 1, BATCH)
        inputs, target = (
            torch.stack([a[:, i : i + size, j : j + size] for i, j in zip(rows, columns, strict=True)])
            for a in (fields, residual)
        )
        loss = (network(inputs) - target).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()


class _UNet(nn.Module):
    """Three levels with skip connections; predicts no change before it is trained."""

    def __init__(self):
        super().__init__()
        c = CHANNELS
        self.fine, self.middle, self.coarse = _block(3, c), _block(c, 2 * c), _block(2 * c, 4 * c)
        self.up_middle, self.up_fine = _block(6 * c, 2 * c), _block(3 * c, c)
        self.out = nn.Conv2d(c, 3, 1)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        fine = self.fine(x)
        middle = self.middle(F.max_pool2d(fine, 2))
        coarse = self.coarse(F.max_pool2d(middle, 2))
        middle = self.up_middle(torch.cat([_enlarged(coarse), middle], 1))
        return self.out(self.up_fine(torch.cat([_enlarged(middle), fine], 1)))


def _block(inputs: int, outputs: int) -> nn.Sequential:
    # padding by repetition: zeros would tell the network where the image ends, hence where the contact is
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1, padding_mode="replicate"),
        nn.ReLU(),
        nn.Conv2d(outputs, outputs, 3, padding=1, padding_mode="replicate"),
        nn.ReLU(),
    )


def _enlarged(x: torch.Tensor) -> torch.Tensor:
    return F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)
