"""Finds a body in a photograph."""

import cv2
import numpy as np

from pneutac_sim.errors import InputError

SHADOW = 0.5  # how much of a mere change of brightness counts: shadows on the backdrop are that
NOISE = 10  # median deviations of unchanged pixels that a change must exceed
SURE = 2  # a change this many times over the threshold is certainly the body's
ALIKE = 0.12  # distance of shares of red, green and blue up to which a pixel is of a given colour
ITERATIONS = 4  # of GrabCut
LEAST = 1e-3  # of the picture that a body fills


def segment(image: np.ndarray, background: np.ndarray | None = None, colour=None) -> np.ndarray:
    """Mask of the body: what differs from the empty scene, or looks like a colour; refined by GrabCut.

    Args:
        image: RGB uint8 (H, W, 3).
        background: the same scene without the body, RGB uint8 (H, W, 3); the safer way.
        colour: RGB (3,) or several (k, 3), 0 to 255, of a body of few colours that its surroundings do not
            have; brightness does not count.

    Returns:
        bool (H, W): the largest connected piece, without holes.

    Raises:
        InputError: neither or both of `background` and `colour`, shapes that differ, or nothing found.
    """
    _picture("image", image)
    if (background is None) == (colour is None):
        raise InputError("Give segment either the background without the body, or the body's colour.")
    if background is not None:
        _picture("background", background)
        if background.shape != image.shape:
            raise InputError(
                f"The background is of shape {background.shape}, the image of {image.shape}; take both with "
                "the same camera."
            )
        difference = _lab(image) - _lab(background)
        difference[..., 0] *= SHADOW
        away = cv2.GaussianBlur(np.linalg.norm(difference, axis=-1), (0, 0), 1.0)
        quiet = float(np.median(away))  # most of the picture has not changed
        likely, threshold = away, quiet + NOISE * max(float(np.median(np.abs(away - quiet))), 0.3)
    else:
        colours = np.asarray(colour, float)
        if colours.size == 0 or colours.shape[-1] != 3 or not ((colours >= 0) & (colours <= 255)).all():
            raise InputError(f"colour is {colour}; give RGB from 0 to 255, one or several.")
        chroma, known = _chroma(cv2.GaussianBlur(image, (0, 0), 1.0)), _chroma(colours.reshape(-1, 3))
        away = np.min([np.linalg.norm(chroma - k, axis=-1) for k in known], axis=0)
        likely, threshold = -away, -ALIKE
    mask = _largest(likely > threshold)
    seeds = np.where(mask, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    edge = max(3, round(0.01 * image.shape[0]))  # px, within which GrabCut may move the outline
    seeds[cv2.dilate(mask.astype(np.uint8), _disc(edge)) == 0] = cv2.GC_BGD
    inner = cv2.erode(mask.astype(np.uint8), _disc(edge if background is None else 2)) > 0
    seeds[inner & (likely > (SURE * threshold if background is not None else threshold))] = cv2.GC_FGD
    if (seeds == cv2.GC_BGD).any():
        models = np.zeros((2, 1, 65))
        cv2.setRNGSeed(0)
        cv2.grabCut(
            cv2.cvtColor(image, cv2.COLOR_RGB2BGR), seeds, None, models[0], models[1], ITERATIONS,
            cv2.GC_INIT_WITH_MASK,
        )  # fmt: skip
        mask = _largest(np.isin(seeds, (cv2.GC_FGD, cv2.GC_PR_FGD)))
    return mask


def _largest(mask: np.ndarray) -> np.ndarray:
    """The largest connected piece of a mask without isolated pixels and gaps, with its holes filled."""
    clean = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, _disc(1))
    clean = cv2.morphologyEx(clean, cv2.MORPH_CLOSE, _disc(1))
    outlines, _ = cv2.findContours(clean, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    out = np.zeros_like(clean)
    if outlines:
        cv2.drawContours(out, [max(outlines, key=cv2.contourArea)], -1, 1, cv2.FILLED)
    if out.mean() < LEAST:
        raise InputError(
            "No body was found in the photograph; it looks as its background does, so use another backdrop "
            "or give a mask."
        )
    return out > 0


def _disc(radius: int) -> np.ndarray:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))


def _lab(image: np.ndarray) -> np.ndarray:
    """CIE L*a*b*, float32 (H, W, 3), L from 0 to 100."""
    return cv2.cvtColor(image.astype(np.float32) / 255, cv2.COLOR_RGB2LAB)


def _chroma(rgb: np.ndarray) -> np.ndarray:
    """Shares of red, green and blue, free of brightness except in the dark, where noise would rule."""
    return rgb / (rgb.sum(-1, keepdims=True, dtype=float) + 20)


def _picture(name: str, image) -> None:
    if not (
        isinstance(image, np.ndarray) and image.dtype == np.uint8 and image.ndim == 3 and image.shape[2] == 3
    ):
        raise InputError(f"The {name} must be RGB uint8 of shape (height, width, 3).")
