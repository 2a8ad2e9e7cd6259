"""What a tactile image shows beyond the sensor at rest, as a short vector."""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from lerobot_robot_pneutac.policy.configuration_pneutac_bc import POOLED_SHAPE
from pneutac_sim.errors import InputError
from pneutac_sim.features import IMAGE_SHAPE

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
        self.layers = nn.Sequential(
            nn.Conv2d(c, 16, 5, stride=2, padding=2),
            nn.ReLU(),
            nn.Conv2d(16, 32, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.Conv2d(32, 32, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.AvgPool2d(2),  # ten demonstrations have too few touches for more weights
            nn.Flatten(),
            nn.Linear(32 * 5 * 4, EMBEDDING),
        )

    def forward(self, difference: Tensor) -> Tensor:
        """Embedding (B, 64) of what `difference` gives."""
        return self.layers(difference.abs())

    def difference(self, image: Tensor) -> Tensor:
        """Image less rest (B, 3, 80, 60), lying ones (B, 3, 60, 80), of size 1 in a firm touch.

        Args:
            image: (B, 3, H, W) in [0, 1], or (B, 3, 80, 60) where its pixels are means already.

        The brightness is the median ratio to the rest image: a touch covers less than half of the image.

        Raises:
            InputError: the images have another shape, or there is no rest image.
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
