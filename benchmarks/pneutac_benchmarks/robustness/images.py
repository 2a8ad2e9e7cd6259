"""Damaged and malicious image files, read as a recording's images are."""

import contextlib
import io
import multiprocessing
import random
import struct
import time
import zlib
from pathlib import Path

import numpy as np
from PIL import Image

from pneutac_benchmarks.robustness.outcome import Outcome, judge
from pneutac_sim.errors import InputError
from pneutac_sim.files import FORMATS, read_image

MOST_S, MOST_MB = 1.0, 500.0
SIZES = (0, 1, 255, 256, 65535, 2**31 - 1, 2**32 - 1)


def whole_images(seed: int = 0) -> list[bytes]:
    """A small image in every format that is read, some in several kinds."""
    rng = np.random.default_rng(seed)
    rgb = Image.fromarray(rng.integers(0, 256, (24, 32, 3)).astype(np.uint8))
    kinds = [(rgb, f, {}) for f in FORMATS]
    kinds += [(rgb.convert(mode), "PNG", {}) for mode in ("L", "1", "P", "RGBA", "I;16")]
    kinds += [(rgb, "TIFF", {"compression": c}) for c in ("tiff_lzw", "tiff_adobe_deflate")]
    kinds += [(rgb.convert("CMYK"), "JPEG", {}), (rgb, "JPEG", {"progressive": True})]
    files = []
    for image, kind, options in kinds:
        buffer = io.BytesIO()
        image.save(buffer, kind, **options)
        files.append(buffer.getvalue())
    return files


def mutated(data: bytes, rng: random.Random) -> bytes:
    """The same bytes with a few changes: flips, extreme sizes, cuts and doublings."""
    data = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        near = rng.random() < 0.7  # headers are where the sizes stand
        at = rng.randrange(min(len(data), 64) if near else len(data))
        kind = rng.randrange(6)
        if kind == 0:
            data[at] = rng.randrange(256)
        elif kind == 1:
            data[at : at + 4] = struct.pack(rng.choice("<>") + "I", rng.choice(SIZES))
        elif kind == 2:
            del data[at : at + rng.randint(1, 16)]
        elif kind == 3:
            data[at:at] = data[at : at + rng.randint(1, 64)]
        elif kind == 4:
            data = data[: rng.randrange(1, len(data) + 1)]
        else:
            data[at:at] = rng.randbytes(rng.randint(1, 8))
        data = data or bytearray(b"\0")
    return _with_checksums(bytes(data)) if rng.random() < 0.5 else bytes(data)


def _with_checksums(data: bytes) -> bytes:
    """A PNG whose chunks' checksums are right again, so that its reader goes on."""
    if not data.startswith(b"\x89PNG\r\n\x1a\n"):
        return data
    out, at = data[:8], 8
    while at + 12 <= len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        body = data[at + 4 : at + 8 + length]
        out += data[at : at + 4] + body + struct.pack(">I", zlib.crc32(body))
        at += 12 + length
    return out


def bomb(width: int, height: int) -> bytes:
    """A small PNG that stands for a huge black picture."""
    row = zlib.compressobj(9)
    body = b"".join(row.compress(bytes(1 + 3 * width)) for _ in range(height)) + row.flush()
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", body), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(c)) + t + c + struct.pack(">I", zlib.crc32(t + c)) for t, c in chunks
    )


def damage_images(number: int, seed: int = 0) -> Outcome:
    """Mutated images: each is read or refused in a sentence.

    Args:
        number: how many.
        seed: of the damage.
    """
    rng, files = random.Random(seed), whole_images()
    return judge(
        "images: mutated PNG, JPEG, BMP, TIFF",
        number,
        lambda i: read_image(mutated(files[i % len(files)], rng), "image.png", plain=rng.random() < 0.5),
    )


def read_bombs() -> Outcome:
    """Small files that stand for huge pictures, in a process of its own: time and memory are bounded."""
    files = [bomb(*size) for size in ((13_000, 13_000), (6_000, 4_166), (65_000, 380))] + [scans(2_000)]
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        times, mb = pool.apply(_cost, (files,))
    broken = [f"{i}: {s:.1f} s" for i, s in enumerate(times) if s > MOST_S]
    broken += [f"{mb:.0f} MB"] if mb > MOST_MB else []
    return Outcome(
        "images: files of at most 0.5 MB that state up to 169 million pixels, or 2,000 scans",
        len(files),
        tuple(broken),
        f"the worst takes {max(times):.2f} s of processor time and {mb:.0f} MB",
    )


def _cost(files: list[bytes]) -> tuple[list[float], float]:
    """Processor time (s) of reading each file, and how much this process' memory grew at most (MB)."""
    Path("/proc/self/clear_refs").write_text("5")  # the most is counted from now on
    before, times = _memory_mb("VmRSS"), []
    for data in files:
        seconds = _seconds(data)
        times.append(
            min(seconds, _seconds(data)) if seconds > MOST_S else seconds
        )  # a busy machine is slow once
    return times, _memory_mb("VmHWM") - before


def _seconds(data: bytes) -> float:
    started = time.process_time()
    with contextlib.suppress(InputError):
        read_image(data, "image")
    return time.process_time() - started


def _memory_mb(field: str) -> float:
    """This process' `VmRSS` (now) or `VmHWM` (most since the last reset) on Linux."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(field)) / 1024


def scans(number: int) -> bytes:
    """A progressive JPEG whose last scan is there many times."""
    buffer = io.BytesIO()
    Image.new("RGB", (4096, 4096)).save(buffer, "JPEG", progressive=True)
    data = buffer.getvalue()
    last = data[data.rindex(b"\xff\xda") : -2]
    return data[:-2] + number * last + data[-2:]
