"""The one reader of image files that people bring: bounded in bytes, pixels, time and memory."""

import io
import struct
import warnings
import zlib
from pathlib import Path

import numpy as np
from PIL import Image, ImageFile

from pneutac_datasets.recording.wording import cut
from pneutac_sim.errors import InputError
from pneutac_sim.files import refuse_pointer

# Others take memory before their size is known (WebP), or run programs (EPS).
FORMATS = ("PNG", "JPEG", "BMP", "TIFF")
MOST_BYTES = 80 * 2**20
MOST_PIXELS = 25_000_000  # 6000 x 4000: decoding takes under 400 MB and half a second
MOST_SCANS = 60  # of a JPEG; a progressive one has about 10, and each costs a pass over all pixels
# What PIL's decoders of these formats raise on damaged files.
DAMAGED = (OSError, SyntaxError, ValueError, TypeError, KeyError, IndexError, EOFError, OverflowError)
DAMAGED = (*DAMAGED, struct.error, zlib.error, Image.DecompressionBombError, MemoryError)


def read_image(source: str | Path | bytes, name: str = "", plain: bool = False) -> np.ndarray:
    """RGB uint8 (H, W, 3) of an image file or its content: first its size from the header, then its pixels.

    `name` is what the message calls it, if empty the file; a `plain` one must be RGB with 8 bits a channel.
    Raises InputError where it is too large, damaged, of another format than `FORMATS`, or not plain.
    """
    name = name or str(source)
    size = len(source) if isinstance(source, bytes) else Path(source).stat().st_size
    if size > MOST_BYTES:
        raise InputError(f"{name} has {size / 2**20:.0f} MB, above the limit of {MOST_BYTES // 2**20} MB.")
    if not isinstance(source, bytes):
        refuse_pointer(Path(source))
    data = source if isinstance(source, bytes) else Path(source).read_bytes()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about damaged fields that nothing here reads
            with Image.open(io.BytesIO(data), formats=FORMATS) as image:
                _check(image, name, plain)
                if image.format == "JPEG" and data.count(b"\xff\xda") > MOST_SCANS:
                    raise InputError(f"{name} has more than {MOST_SCANS} scans; save it again.")
                return np.array(image.convert("RGB"))
    except InputError:
        raise
    except DAMAGED as e:
        reason = cut(" ".join(f"{e}".split()) or type(e).__name__, 200).rstrip(".")
        if "BytesIO" in reason:  # PIL names the buffer that it was given
            reason = "it is none of these"
        raise InputError(f"{name} cannot be read as an image ({', '.join(FORMATS)}): {reason}.") from e


def _check(image: ImageFile.ImageFile, name: str, plain: bool) -> None:
    width, height = image.size
    if width * height > MOST_PIXELS:
        raise InputError(
            f"{name} states {width} x {height} pixels, above the limit of {MOST_PIXELS / 1e6:.0f} million;"
            " make it smaller."
        )
    if not plain:
        return
    words = {"L": "grey", "1": "black and white", "P": "a palette", "I": "grey with 32 bits"}
    what = words.get(image.mode)
    if "A" in image.mode:
        what = "with an alpha channel, so not opaque"
    if "16" in image.mode or any("16" in str(tile[3]) for tile in image.tile):
        what = "of 16 bits a channel"
    if what or image.mode not in ("RGB", "YCbCr"):
        raise InputError(f"{name} is {what or image.mode}; convert it to plain RGB with 8 bits a channel.")
