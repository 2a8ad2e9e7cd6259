"""Training of the perception network on the contacts of `gel_collect`.

Errors of the perception network against full material points, and those of its baselines.

The same table has its baselines: the probe grid itself, and the analytic `gel.surface`.
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from pneutac_sim.errors import InputError, check_choice
from pneutac_sim.executor import check_device
from pneutac_sim.gel.indenter import INDENTERS
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.surrogate.gel_collect import Pairs, read_contacts
from pneutac_sim.surrogate.perception import BLOCK, GelSurrogate
from pneutac_sim.twin import Twin

HELDOUT = ("cylinder", "cone")  # a flat and a pointed indenter
CHECK_EVERY = 6  # of the contacts of trained indenters one in so many is for early stopping
LEAST = 5  # contacts
RATE = 1e-3
BATCH = 32
EPOCHS, PATIENCE = 400, 60
EPOCHS_ON = 40  # from another gel's network: its face is near already
AVERAGE = 0.995  # of the weights over steps: checked and stored; at first over fewer

CHANNELS = (16, 24, 32)


def _twice(inputs: int, outputs: int) -> nn.Sequential:
    first, second = (nn.Conv2d(n, outputs, 3, padding=1) for n in (inputs, outputs))
    return nn.Sequential(first, nn.ReLU(), second, nn.ReLU())


def _onto(coarse: torch.Tensor, skip: torch.Tensor) -> torch.Tensor:
    return torch.cat([F.interpolate(coarse, size=skip.shape[-2:]), skip], 1)


class UNet(nn.Module):
    """g, from grids (B, 1, 80, 59) to grids of that shape, mm; `channels` of the three levels are even."""

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


def split(
    contacts: Sequence[Pairs], heldout: Sequence[str] = HELDOUT
) -> tuple[list[Pairs], list[Pairs], list[Pairs]]:
    """Contacts to train on, those for early stopping, and those of indenters that are never trained on.

    Contacts outside the window, in which nothing touches, are in neither of the first two.

    Raises InputError where an indenter is unknown, or too few contacts are left to train on.
    """
    for name in heldout:
        if name not in INDENTERS:
            raise InputError(f"There is no indenter '{name}' to hold out; there are {', '.join(INDENTERS)}.")
    seen = [p for p in contacts if p.indenter not in heldout and p.depth_mm[-1].any()]
    check = seen[CHECK_EVERY - 1 :: CHECK_EVERY]
    train = [p for i, p in enumerate(seen) if i % CHECK_EVERY != CHECK_EVERY - 1]
    if len(train) < LEAST or not check:
        raise InputError(
            f"{len(seen)} gel contacts of indenters other than {' and '.join(heldout)} are too few to train "
            f"on; collect at least {LEAST + 1} with `pneutac surrogate`."
        )
    return train, check, [p for p in contacts if p.indenter in heldout]


def train_gel(
    folder: str | Path,
    fingerprint: str,
    heldout: Sequence[str] = HELDOUT,
    seed: int = 0,
    epochs: int = EPOCHS,
    device: str = "auto",
    progress: Callable[[int, int], None] = lambda done, total: None,
    start: GelSurrogate | None = None,
) -> GelSurrogate:
    """Trains on the contacts of a folder, and keeps the weights that were best on the contacts for checking.

    The gel's fingerprint is stored with the weights; the indenters held out are not trained on. `progress` is
    called after each epoch with the number of those done and of all. `start` is another gel's network to
    begin with, which counts as the first epoch; None for random weights.

    Raises InputError: no contacts, damaged ones, or too few; no such device.
    """
    check_choice("device", device, ("auto", "cpu", "cuda"))
    check_device(device)
    if device == "auto":
        device = "cuda" if torch.cuda.is_available() else "cpu"
    train, check, _ = split(read_contacts(folder), heldout)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = _fit(train, check, seed, epochs, device, progress, start)
    deepest = max(float(p.depth_mm.max()) for p in train)
    share = max(float((p.depth_mm > 0).mean((1, 2)).max()) for p in train)
    return GelSurrogate(network.weights(), fingerprint, deepest, share, heldout)


def _fit(train, check, seed, epochs, device, progress, start=None) -> UNet:
    depth, wanted = _tensors(train, device)
    network = UNet()
    if start is not None:
        network.load_state_dict({k: torch.from_numpy(w) for k, w in start.weights.items()})
    network.to(device)
    average = copy.deepcopy(network)
    optimizer = torch.optim.Adam(network.parameters(), lr=RATE)
    generator = np.random.default_rng(seed)
    looked, steps = _tensors(check, device), 0
    best, best_loss, best_epoch = copy.deepcopy(average), np.inf, 0
    if start is not None:
        with torch.no_grad():
            best_loss = float(_loss(average, *looked))
    for epoch in range(epochs):
        order = generator.permutation(len(depth))
        for i in range(0, len(order), BATCH):
            pick = order[i : i + BATCH]
            axes = [axis for axis in (-2, -1) if generator.random() < 0.5]  # the gel is its own mirror image
            loss = _loss(network, depth[pick].flip(axes), wanted[pick].flip(axes))
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            steps += 1
            decay = min(AVERAGE, (1 + steps) / (10 + steps))
            with torch.no_grad():
                for a, w in zip(average.parameters(), network.parameters(), strict=True):
                    a.lerp_(w, 1 - decay)
        with torch.no_grad():
            now = float(_loss(average, *looked))
        if now < best_loss:
            best, best_loss, best_epoch = copy.deepcopy(average), now, epoch
        progress(epoch + 1, epochs)
        if epoch - best_epoch >= PATIENCE:
            break
    return best


def _tensors(contacts: list[Pairs], device: str) -> tuple[torch.Tensor, torch.Tensor]:
    depth = np.concatenate([p.depth_mm for p in contacts])
    moved = np.concatenate([p.displacement_mm for p in contacts])
    touched = depth.any((1, 2))
    return tuple(torch.from_numpy(a[touched])[:, None].to(device) for a in (depth, moved))


def _loss(network: UNet, depth: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
    """Mean square over the contact region, and over what lies around it with the same weight."""
    both = network(torch.cat([depth, torch.zeros_like(depth[:1])]))
    error = (depth + both[:-1] - both[-1:] - wanted) ** 2
    inside = (depth > 0).float()
    return (error * inside).sum() / inside.sum() + (error * (1 - inside)).sum() / (1 - inside).sum()


METHODS = ("network", "probe", "surface")
MEASURES = ("mae_mm", "around_mm", "image_rmse_levels", "area_error_px")


def evaluate_gel(surrogate: GelSurrogate, contacts: Sequence[Pairs], twin: Twin) -> dict:
    """Compares displacement, tactile image and contact area of unseen contacts at their full depth.

    Returns `rows`: one for each indenter, then one, `unseen`, over indenters that were never trained on; each
    with `indenter`, `contacts`, `depth_mm` (mean of the deepest points) and for each of `METHODS` the means
    over contacts of

    - `mae_mm`: mean absolute error of the displacement where the probe grid touches;
    - `around_mm`: the same over the rest of the window;
    - `image_rmse_levels`: of the tactile images, over all pixels and channels;
    - `area_error_px`: absolute error of the number of pixels in contact.

    Raises InputError: in no contact anything touches.
    """
    gel = replace(GelModel.from_twin(twin), depth_scale=1.0)  # the network's input is the object's own depth
    seen_by = {
        "network": TactileSensor(gel, surrogate.displacement),
        "probe": TactileSensor(gel, lambda depth: depth),
        "surface": TactileSensor(gel),
    }
    found: dict[str, list] = {}
    for pairs in contacts:
        depth, moved = pairs.depth_mm[-1], pairs.displacement_mm[-1]
        if depth.any():
            truth = TactileSensor(gel, lambda _, moved=moved: moved)
            errors = [_errors(sensor, truth, depth) for sensor in seen_by.values()]
            found.setdefault(pairs.indenter, []).append((float(depth.max()), np.array(errors)))
    if not found:
        raise InputError("In none of the contacts anything touches the gel's window; collect others.")
    rows = [_row(name, found[name]) for name in INDENTERS if name in found]
    unseen = [contact for name in surrogate.heldout for contact in found.get(name, [])]
    return {"rows": rows + ([_row("unseen", unseen)] if unseen else [])}


def _errors(sensor: TactileSensor, truth: TactileSensor, depth: np.ndarray) -> list[float]:
    error = np.abs(sensor.displacement(depth) - truth.displacement(depth))
    images = sensor.image(depth), truth.image(depth)
    rmse = np.sqrt(np.mean((images[0].astype(float) - images[1]) ** 2))
    pixels = [truth.contact(image).pixels for image in images]
    inside = depth > 0
    return [error[inside].mean(), error[~inside].mean(), rmse, abs(pixels[0] - pixels[1])]


def _row(name: str, contacts: list) -> dict:
    means = np.mean([errors for _, errors in contacts], 0)
    depth_mm = float(np.mean([depth for depth, _ in contacts]))
    each = (dict(zip(MEASURES, values, strict=True)) for values in means.tolist())
    row = {"indenter": name, "contacts": len(contacts), "depth_mm": depth_mm}
    return row | dict(zip(METHODS, each, strict=True))
