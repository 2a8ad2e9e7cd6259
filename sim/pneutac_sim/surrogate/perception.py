"""Perception network f_m: probe grid to the displacement that the gel's material points would show.

A three-level UNet (paper, Sec. "Action and Perception Networks") learns what the gel adds to the grid d,

    f_m(d) = d + g(d) - g(0),

so that where nothing touches within the network's sight the surface rests exactly. Biases and the zeros that
pad the window tell g where the gel ends. The first level works on blocks of 2 x 2 cells, as four channels,
which costs a quarter and loses nothing.
"""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import nn
from torch.nn import functional as F

from pneutac_sim.errors import InputError
from pneutac_sim.files import whole
from pneutac_sim.gel.probe import COLS, ROWS

FORMAT = "pneutac-gel-surrogate/1"
CHANNELS = (16, 24, 32)
BLOCK = 2


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
        channels: of the three levels.
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


class GelSurrogate:
    """A trained perception network.

    Args:
        network: g.
        fingerprint: of the gel that it was trained for.
        deepest_mm: largest probe grid value that it was trained with.
        largest_share: largest share of the window in contact that it was trained with.
        heldout: indenters that it was not trained with.
        errors: what `evaluate_gel` found, kept with the weights.
    """

    def __init__(
        self,
        network: UNet,
        fingerprint: str,
        deepest_mm: float,
        largest_share: float,
        heldout: Sequence[str] = (),
        errors: dict | None = None,
    ):
        self.network = network.cpu().eval().to(memory_format=torch.channels_last)
        self.fingerprint, self.heldout, self.errors = fingerprint, tuple(heldout), errors or {}
        self.deepest_mm, self.largest_share = deepest_mm, largest_share
        with torch.inference_mode():
            self._rest = self.network(torch.zeros(1, 1, ROWS, COLS))

    def displacement(self, depth_mm: np.ndarray) -> np.ndarray:
        """Displacement of the gel's face under probe grids.

        Args:
            depth_mm: (80, 59), or (B, 80, 59) of many environments at once.

        Returns:
            Displacement in mm, float32, same shape; zero where a whole grid is. Beyond `deepest_mm` the gel
            adds what it adds there.

        Raises:
            ValueError: another shape, or a depth that is no finite number.
        """
        depth = np.asarray(depth_mm, np.float32)
        if depth.ndim not in (2, 3) or depth.shape[-2:] != (ROWS, COLS):
            raise ValueError(f"probe grids have shape ([B,] {ROWS}, {COLS}); got {depth.shape}")
        grids = depth.reshape(-1, ROWS, COLS)
        peak = grids.max((1, 2), initial=0.0)
        if not np.isfinite(peak).all():
            raise ValueError("a probe grid holds a depth that is no finite number")
        out = grids.copy()
        touched = np.flatnonzero(peak > 0)
        if len(touched):
            known = np.minimum(grids[touched], np.float32(self.deepest_mm))
            with torch.inference_mode():
                added = self.network(torch.from_numpy(known)[:, None]) - self._rest
            out[touched] += added[:, 0].numpy()
        return out.reshape(depth.shape)

    def out_of_range(self, depth_mm: np.ndarray) -> np.ndarray:
        """Whether probe grids (..., 80, 59) lie deeper, or cover more of the window, than in training."""
        depth = np.asarray(depth_mm)
        share = np.count_nonzero(depth, (-2, -1)) / (ROWS * COLS)
        return (depth.max((-2, -1)) > self.deepest_mm) | (share > self.largest_share)

    def save(self, path: str | Path) -> None:
        """Writes weights and what is known about them as safetensors."""
        metadata = {
            "format": FORMAT,
            "fingerprint": self.fingerprint,
            "deepest_mm": repr(float(self.deepest_mm)),
            "largest_share": repr(float(self.largest_share)),
            "heldout": json.dumps(self.heldout),
            "errors": json.dumps(self.errors),
        }
        weights = {k: v.contiguous() for k, v in self.network.state_dict().items()}
        with whole(Path(path)) as part:
            save_file(weights, part, metadata)

    @classmethod
    def load(cls, path: str | Path) -> "GelSurrogate":
        """Reads what `save` wrote.

        Raises:
            InputError: there is no such file, or it is damaged or of another kind.
        """
        if not Path(path).is_file():
            raise InputError(f"There is no perception network '{path}'; train one with `pneutac surrogate`.")
        try:
            with safe_open(path, "pt") as f:
                about, weights = f.metadata() or {}, {k: f.get_tensor(k) for k in f.keys()}  # noqa: SIM118
            if about["format"] != FORMAT or not all(torch.isfinite(w).all() for w in weights.values()):
                raise ValueError
            network = UNet(tuple(len(weights[f"down{level}.0.bias"]) for level in (1, 2, 3)))
            network.load_state_dict(weights)
            limits = (float(about["deepest_mm"]), float(about["largest_share"]))
            if not all(0 < v < np.inf for v in limits):
                raise ValueError
            return cls(
                network, about["fingerprint"], *limits, *(json.loads(about[k]) for k in ("heldout", "errors"))
            )
        except (SafetensorError, OSError, KeyError, ValueError, RuntimeError) as e:
            raise InputError(
                f"'{path}' is no perception network, or is damaged; train one with `pneutac surrogate`."
            ) from e
