"""What a tactile image shows beyond the sensor at rest, as a short vector.

The background of the tactile image, taken from the demonstrations themselves.
"""

from typing import TYPE_CHECKING

import numpy as np
import torch
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from torch import Tensor, nn
from torch.nn import functional as F

from lerobot_robot_pneutac.policy.configuration_pneutac_bc import POOLED_SHAPE, TACTILE, whole_shape
from pneutac_sim.errors import InputError
from pneutac_sim.features import IMAGE_SHAPE

if TYPE_CHECKING:
    from pneutac_sim.gel.sensor import TactileSensor

EMBEDDING = 64
DIFFERENCE_SCALE = 32 / 255  # a firm touch changes the image by some 32 of 255 levels
DARK = 8 / 255  # a pixel darker than this shows nothing of the light
DRIFT = 0.5, 2.0  # of brightness; beyond these a camera is covered, which must not look like no touch


def grid(rows: int, columns: int) -> tuple[int, int]:
    """Rows and columns of the means of an image of that size."""
    across, along = sorted(POOLED_SHAPE[:2])
    return (along, across) if rows >= columns else (across, along)


def pool(image: Tensor) -> Tensor:
    """Means of images (B, 3, H, W) over the cells of `grid`, 4 x 4 pixels of a DIGIT's."""
    (h, w), small = image.shape[2:], grid(*image.shape[2:])
    if h % small[0] == 0 and w % small[1] == 0:
        return F.avg_pool2d(image, (h // small[0], w // small[1]))
    return F.adaptive_avg_pool2d(image, small)


def layers(channels: int) -> nn.Sequential:
    """Three strided convolutions from |image - rest| (B, channels, 80, 60) to the embedding (B, 64)."""
    relu = nn.ReLU(inplace=True)  # saves a CPU a sixth of a step
    return nn.Sequential(
        nn.Conv2d(channels, 16, 5, stride=2, padding=2),
        relu,
        nn.Conv2d(16, 32, 3, stride=2, padding=1),
        relu,
        nn.Conv2d(32, 32, 3, stride=2, padding=1),
        relu,
        nn.AvgPool2d(2),  # ten demonstrations have too few touches for more weights
        nn.Flatten(),
        nn.Linear(32 * 5 * 4, EMBEDDING),
    )


class TactileEncoder(nn.Module):
    """|image - rest| at 80 x 60, through three strided convolutions to a 64-D embedding; lying at 60 x 80.

    Pixels are averaged before the sign is dropped: a camera's noise then averages out, where the mean of its
    absolute value would look like a light touch everywhere. Each channel of the rest image is brought to the
    image's brightness first, since light and exposure drift by more than a light touch changes.

    Attributes:
        rest_image: (3, H, W) in [0, 1]; NaN until it is known.
    """

    def __init__(self, shape: tuple[int, int, int] = (IMAGE_SHAPE[2], *IMAGE_SHAPE[:2])):
        """An encoder of images of a shape (3, H, W)."""
        super().__init__()
        c, h, w = shape
        self._small = grid(h, w)
        self.register_buffer("rest_image", torch.full((c, h, w), torch.nan))
        self.layers = layers(c)

    def forward(self, difference: Tensor) -> Tensor:
        """Embedding (B, 64) of what `difference` gives."""
        return self.layers(difference.abs())

    def difference(self, image: Tensor) -> Tensor:
        """Image less rest (B, 3, 80, 60), lying ones (B, 3, 60, 80), of size 1 in a firm touch.

        Args:
            image: (B, 3, H, W) in [0, 1], or (B, 3, 80, 60) where its pixels are means already.

        The brightness is the median ratio to the rest image: a touch covers less than half of the image.
        Raises InputError: the images have another shape, or there is no rest image.
        """
        pooled = tuple(image.shape[1:]) == (POOLED_SHAPE[2], *self._small)
        if not pooled and image.shape[1:] != self.rest_image.shape:
            raise InputError(
                f"The tactile image has the shape {tuple(image.shape[1:])}; pneutac_bc needs"
                f" {tuple(self.rest_image.shape)}."
            )
        if self.rest_image[0, 0, 0].isnan():
            raise InputError(
                "The policy has no rest image: train it on a dataset with tactile images or load its weights."
            )
        seen = image if pooled else pool(image)
        rest = pool(self.rest_image[None])
        # Every fourth pixel gives the same median; of all of them it is a quarter of a training step.
        ratio = seen[..., ::2, ::2] / rest[..., ::2, ::2].clamp_min(DARK)
        gain = ratio.flatten(2).median(2).values.clamp(*DRIFT)[..., None, None]
        return (seen - gain * rest) / DIFFERENCE_SCALE


MAX_EPISODES = 16

# Correlation of rest images, see `likeness`. Photographs of two DIGITs, the generated DIGIT and the
# stand-in's have 0.80 to 0.99 with each other, any of them with one mirrored, turned or with channels swapped
# at most 0.71, and with a GelSight at most 0.34.
SAME_SENSOR = 0.78
_CELL = 10  # px; finer structure than this differs between gels of one make
_FLAT = 1 / 255  # an image that varies by less shows nothing to compare
MOST_ELSEWHERE = 0.05  # share of the pixels that differ from the twin's image at rest; more is noted


def rest_image_of(meta) -> torch.Tensor:
    """(3, H, W) float32 in [0, 1]: the median over the first frames of up to 16 episodes, spread evenly.

    A demonstration starts out of contact; the median forgives some that do not. Raises InputError: an image
    cannot be read.
    """
    total = meta.total_episodes
    chosen = np.unique(np.linspace(0, total - 1, min(total, MAX_EPISODES)).round().astype(int))
    rest = torch.stack(_first_images(meta, chosen.tolist())).float().quantile(0.5, dim=0)
    whole = whole_shape(meta.features[TACTILE])[1:]
    # Each mean stands for its pixels, and pools to itself.
    return rest if tuple(rest.shape[1:]) == whole else F.interpolate(rest[None], whole)[0]


def _first_images(meta, episodes: list[int]) -> list[Tensor]:
    dataset = LeRobotDataset(meta.repo_id, root=meta.root, episodes=episodes, revision=meta.revision)
    first = [int(meta.episodes[e]["dataset_from_index"]) for e in episodes]
    row = dataset.absolute_to_relative_idx
    try:
        return [dataset[row[i]][TACTILE] for i in first]
    except (OSError, ValueError, RuntimeError) as error:  # what PIL and PyAV raise
        raise InputError(
            f"Dataset '{meta.repo_id}': no rest image, for the first '{TACTILE}' of an episode cannot be read"
            f" ({type(error).__name__}: {error}); delete that episode or record it again."
        ) from error


def likeness(a: Tensor, b: Tensor) -> float | None:
    """Whether two rest images (3, H, W) in [0, 1] show the same arrangement of lights, at any brightness.

    Returns:
        Their correlation, over cells of 10 x 10 pixels and all channels, each channel without its mean; None
        where one of them is evenly coloured.
    """
    a, b = (F.avg_pool2d(image.float(), _CELL) for image in (a, b))
    a, b = (image - image.mean((1, 2), keepdim=True) for image in (a, b))
    if min(a.std(), b.std()) < _FLAT:
        return None
    return float((a * b).sum() / (a.square().sum() * b.square().sum()).sqrt())


def other_sensor(meta: LeRobotDatasetMetadata, sensor: "TactileSensor") -> str:
    """A sentence where the twin's gel does not look at rest like that of the demonstrations; else empty.

    A policy has one image at rest: what differs from it looks like a touch. Raises InputError where they are
    of another kind of sensor, or turned.
    """
    from pneutac_sim.gel.contact import contact_area, quieted  # Numba, which robots do not need

    rest = rest_image_of(meta)
    like = likeness(rest, torch.from_numpy(sensor.rest_image.copy()).permute(2, 0, 1) / 255)
    image = (255 * rest).round().byte().permute(1, 2, 0).contiguous().numpy()
    if like is not None and like < SAME_SENSOR:
        how = f"correlation {like:.2f} with its image at rest, {SAME_SENSOR:g} needed"
        what = f"the first images of '{TACTILE}' are not of the twin's kind of sensor, or turned ({how})"
        raise InputError(f"{meta.root}: {what}; give --twin of the sensor that recorded them.")
    share = contact_area(quieted(image), quieted(sensor.rest_image), sensor.model.threshold_levels).area
    if share <= MOST_ELSEWHERE:
        return ""
    pixels = f"before a touch {100 * share:.0f} % of the pixels of '{TACTILE}' differ from the twin's image"
    why = "at rest, so that a policy trained on both takes one of the two for touched"
    remedy = "calibrate the twin's gel (pneutac calibrate), or give --twin of that sensor"
    return f"{meta.root}: {pixels} {why}; {remedy}."


def check_same_sensor(known: Tensor, found: Tensor, repo_id: str) -> None:
    """Raises InputError where a dataset's rest image cannot be of the kind of sensor that a policy knows.

    The policy's own, `known`, is NaN where it has none.
    """
    if known.isnan().any():
        return
    found = found.to(known.device)
    like = likeness(known, found)
    if like is None or like >= SAME_SENSOR:
        return
    views = {
        "mirrored left to right": found.flip(2),
        "mirrored top to bottom": found.flip(1),
        "turned upside down": found.flip(1, 2),
        "BGR instead of RGB": found.flip(0),
    }
    how = max(views, key=lambda k: likeness(known, views[k]))
    seems = (
        f"it seems {how}" if likeness(known, views[how]) >= SAME_SENSOR else "it seems another kind of sensor"
    )
    raise InputError(
        f"Dataset '{repo_id}': its tactile rest image is not of the sensor that --policy.path was trained on"
        f" (correlation {like:.2f}, at least {SAME_SENSOR:g} needed); {seems}: record with the camera as in"
        " the first training, or train again with --policy.type=pneutac_bc."
    )
