"""The perception network as a PyTorch module, to train it and for batches; see `perception`."""

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from pneutac_sim.surrogate.perception_kernels import BLOCK

CHANNELS = (16, 24, 32)


def _twice(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1),
        nn.ReLU(),
        nn.Conv2d(outputs, outputs, 3, padding=1),
        nn.ReLU(),
    )


def _onto(coarse: torch.Tensor, skip: torch.Tensor) -> torch.Tensor:
    """A coarse level enlarged and laid onto the finer one's channels."""
    return torch.cat([F.interpolate(coarse, size=skip.shape[-2:]), skip], 1)


class UNet(nn.Module):
    """g, from grids (B, 1, 80, 59) to grids of the same shape, mm.

    Args:
        channels: of the three levels, even numbers.
    """

    def __init__(self, channels: tuple[int, int, int] = CHANNELS):
        super().__init__()
        a, b, c = channels
        self.down1, self.down2, self.down3 = _twice(BLOCK**2, a), _twice(a, b), _twice(b, c)
        self.up2, self.up1 = _twice(c + b, b), _twice(b + a, a)
        self.out = nn.Conv2d(a, BLOCK**2, 1)

    def forward(self, depth: torch.Tensor) -> torch.Tensor:
        """Maps (B, 1, rows, columns); a missing last row or column is filled with zeros and cut off again."""
        rows, cols = depth.shape[-2:]
        x = F.pixel_unshuffle(F.pad(depth, (0, cols % BLOCK, 0, rows % BLOCK)), BLOCK)
        first = self.down1(x)
        second = self.down2(F.max_pool2d(first, 2, ceil_mode=True))
        third = self.down3(F.max_pool2d(second, 2, ceil_mode=True))
        y = self.out(self.up1(_onto(self.up2(_onto(third, second)), first)))
        return F.pixel_shuffle(y, BLOCK)[..., :rows, :cols]

    def weights(self) -> dict[str, np.ndarray]:
        """Copies of all weights, float32, as `GelSurrogate` takes them."""
        return {name: w.detach().cpu().numpy().copy() for name, w in self.state_dict().items()}
