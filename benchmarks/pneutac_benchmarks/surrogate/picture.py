"""One contact: the gel's face by material points, by the network and by the probe grid alone."""

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from pneutac_sim.surrogate.gel_collect import Pairs

ENLARGED, GAP_PX, LABEL_PX = 4, 8, 40
ERROR_MM = 0.3  # at which the colours of an error end


def picture(contact: Pairs, by_network: np.ndarray) -> Image.Image:
    """Displacements above, errors below.

    Args:
        contact: of the full simulation.
        by_network: (80, 59) mm at its full depth.
    """
    full, probe = contact.displacement_mm[-1], contact.depth_mm[-1]
    top = max(float(full.max()), float(probe.max()))
    panels = [
        [
            (f"full MPM, {contact.indenter}", full / top),
            ("network", by_network / top),
            ("probe grid", probe / top),
        ],
        [
            (f"0 to {top:.2f} mm above", None),
            (f"|error|, to {ERROR_MM} mm", np.abs(by_network - full) / ERROR_MM),
            (f"|error|, to {ERROR_MM} mm", np.abs(probe - full) / ERROR_MM),
        ],
    ]
    height, width = (ENLARGED * n for n in full.shape)
    out = Image.new("RGB", (3 * (width + GAP_PX), 2 * (height + LABEL_PX)), "white")
    draw, font = ImageDraw.Draw(out), ImageFont.load_default(14)
    for i, line in enumerate(panels):
        for k, (label, share) in enumerate(line):
            x, y = k * (width + GAP_PX), i * (height + LABEL_PX)
            draw.text((x + 4, y + LABEL_PX // 2), label, fill="#1b2430", font=font, anchor="lm")
            if share is not None:
                levels = np.uint8(255 * np.clip(share, 0, 1)).repeat(ENLARGED, 0).repeat(ENLARGED, 1)
                colours = cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS)[..., ::-1]
                out.paste(Image.fromarray(np.ascontiguousarray(colours)), (x, y + LABEL_PX))
    return out
