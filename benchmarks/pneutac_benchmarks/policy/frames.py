"""Demonstrations of the benchmark in memory: what `pneutac_bc` and augmentation see of their frames.

Tactile images are means over 80 x 60 cells, rounded to 8 bits, as in `pneutac_datasets.demonstrations.pool`.
"""

from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import torch
from torch.nn import functional as F

from lerobot_robot_pneutac.policy.configuration_pneutac_bc import ahead, frames_ahead
from lerobot_robot_pneutac.policy.modeling_pneutac_bc import Scaling
from lerobot_robot_pneutac.policy.tactile_encoder import MAX_EPISODES, pool
from pneutac_datasets.demonstrations.augment.reference import Reference
from pneutac_datasets.demonstrations.episodes import Episode
from pneutac_sim.features import CONTROL_HZ, Places
from pneutac_sim.files import whole
from pneutac_sim.gel.contact import without_specks
from pneutac_sim.gel.sensor import TactileSensor

POOLED = 64  # images pooled together


@dataclass
class Frames:
    """N frames of several demonstrations, one after the other.

    Attributes:
        state: float32 (N, 20).
        action: float32 (N, 4).
        images: uint8 (N, 80, 60, 3).
        episode: (N,) number of the demonstration, ascending from 0.
        centre_mm: (N, 2) middle of the imprint, see `Reference`; NaN where none is needed.
        shape: (3,) channels, rows and columns of the whole image.
    """

    state: np.ndarray
    action: np.ndarray
    images: np.ndarray
    episode: np.ndarray
    centre_mm: np.ndarray
    shape: np.ndarray

    @classmethod
    def of(cls, episodes: list[Episode], sensor: TactileSensor | None = None) -> "Frames":
        """Of demonstrations; with a twin's sensor also the middles of their imprints."""
        lengths = [len(e) for e in episodes]
        centres = [
            np.full((len(e), 2), np.nan)
            if sensor is None
            else sensor.imprint_centres_mm(e.images, without_specks(e.state[:, e.places.area].astype(float)))
            for e in episodes
        ]
        rows, columns, channels = episodes[0].images.shape[1:]
        return cls(
            np.concatenate([e.state for e in episodes]).astype(np.float32),
            np.concatenate([e.action for e in episodes]).astype(np.float32),
            np.concatenate([_pooled(e.images) for e in episodes]),
            np.repeat(np.arange(len(episodes)), lengths),
            np.concatenate(centres),
            np.array([channels, rows, columns]),
        )

    @classmethod
    def joined(cls, parts: list["Frames"]) -> "Frames":
        """Several as one; demonstrations are numbered on."""
        before = np.cumsum([0, *[p.episodes for p in parts[:-1]]])
        episode = np.concatenate([p.episode + n for p, n in zip(parts, before, strict=True)])
        arrays = {
            f.name: np.concatenate([getattr(p, f.name) for p in parts])
            for f in fields(cls)
            if f.name not in ("episode", "shape")
        }
        return cls(**arrays, episode=episode, shape=parts[0].shape)

    def first_episodes(self, n: int) -> "Frames":
        """Its first `n` demonstrations."""
        end = int(np.searchsorted(self.episode, n))
        return Frames(**{f.name: getattr(self, f.name)[:end] for f in fields(self)} | {"shape": self.shape})

    def answered_early(self, delay: int) -> "Frames":
        """The same with labels ahead by a delay in frames, as `pneutac_bc` learns from."""
        area = self.state[:, Places.of(self.action.shape[1] - 3).area]
        moved = ahead(self.action, area, self.episode, frames_ahead(delay, CONTROL_HZ))
        return replace(self, action=moved)

    def __len__(self) -> int:
        return len(self.episode)

    @property
    def episodes(self) -> int:
        return int(self.episode[-1]) + 1

    @property
    def first(self) -> np.ndarray:
        """(N,) whether a demonstration starts there."""
        return np.diff(self.episode, prepend=-1) > 0

    @property
    def previous(self) -> np.ndarray:
        """(N, 4) the action of the frame before; at a demonstration's start its own."""
        return np.where(self.first[:, None], self.action, np.roll(self.action, 1, axis=0))

    @property
    def rest(self) -> torch.Tensor:
        """The rest image (3, H, W) in [0, 1], by the rule of `tactile_encoder.rest_image_of`."""
        chosen = np.unique(np.linspace(0, self.episodes - 1, min(self.episodes, MAX_EPISODES)).round())
        first = self.images[self.first][chosen.astype(int)]
        rest = torch.from_numpy(first).permute(0, 3, 1, 2).float().div(255).quantile(0.5, dim=0)
        return F.interpolate(rest[None], tuple(map(int, self.shape[1:])))[0]

    @property
    def scaling(self) -> Scaling:
        """How a policy scales state and action of these data."""
        return Scaling.of(
            {
                name: {"min": values.min(0), "max": values.max(0)}
                for name, values in (("observation.state", self.state), ("action", self.action))
            }
        )

    def references(self, base_m: np.ndarray) -> list[Reference]:
        """For augmentation, in the station's frame."""
        places, found = Places.of(self.action.shape[1] - 3), []
        for k in range(self.episodes):
            rows = self.episode == k
            state, action = self.state[rows].astype(float), self.action[rows].astype(float)
            area = without_specks(state[:, places.area])
            found.append(Reference(k, state[:, places.ee] + base_m, area, action, "", self.centre_mm[rows]))
        return found

    def save(self, path: str | Path) -> None:
        """Writes an .npz file, which appears whole or not at all."""
        with whole(Path(path)) as part, part.open("wb") as file:
            np.savez(file, **vars(self))

    @classmethod
    def load(cls, path: str | Path) -> "Frames":
        """Reads what `save` wrote."""
        with np.load(path, allow_pickle=False) as file:
            return cls(**{name: file[name] for name in file.files})


def _pooled(images: np.ndarray) -> np.ndarray:
    parts = [
        pool(torch.from_numpy(images[k : k + POOLED]).permute(0, 3, 1, 2).float()).round().byte()
        for k in range(0, len(images), POOLED)
    ]
    return torch.cat(parts).permute(0, 2, 3, 1).contiguous().numpy()
