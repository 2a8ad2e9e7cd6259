"""Times a batch of 64 tactile images on a GPU, by device events: needs CUDA.

Beside it the least time in which the GPU could write the images, bytes over its memory's bandwidth, and what
the same images take on one core of the CPU.
"""

import os

os.environ.setdefault("NUMBA_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import time
from dataclasses import replace

import numpy as np
import torch

from pneutac_benchmarks.speed.device_time import device_ms
from pneutac_sim.gel import layout
from pneutac_sim.gel.batch import TactileBatch
from pneutac_sim.gel.fit import fit_presses
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import PressPhotograph
from pneutac_sim.gel.photograph import press_depth
from pneutac_sim.gel.sensor import TactileSensor

BATCH, COPY_BYTES = 64, 1 << 30


def main() -> None:
    generated, press = GelModel.builtin(), Press("sphere", 3.0, 0.5, 0.5, 0.9)
    photograph = TactileSensor(generated).image(press_depth(press, generated))
    calibrated = fit_presses(
        [PressPhotograph(press, photograph, generated.rest_image)], generated.px_per_mm
    ).gel
    prior = layout.DIGIT.prior_field(generated.rest_image, layout.Orientation())
    assert prior is not None
    prior = prior.times(float(np.linalg.norm(calibrated.light)) / 2)
    gels = {
        "generated DIGIT": generated,
        "calibrated DIGIT, all optics effects": replace(calibrated, prior_residual=None),
        "the same with the prior residual field of its make": replace(calibrated, prior_residual=prior),
    }
    rng = np.random.default_rng(0)
    presses = [
        Press("sphere", rng.uniform(2, 5), *rng.uniform(0.1, 0.9, 2), rng.uniform(0.3, 1.5))
        for _ in range(BATCH)
    ]
    depth = np.stack([press_depth(p, generated) for p in presses])
    given = torch.tensor(depth, device="cuda")
    source, target = (torch.empty(COPY_BYTES, dtype=torch.uint8, device="cuda") for _ in range(2))
    bandwidth = 2 * COPY_BYTES / device_ms(lambda: target.copy_(source)) * 1e3
    print(f"{torch.cuda.get_device_name()}: copies {bandwidth / 1e12:.2f} TB/s")
    for name, gel in gels.items():
        batch, sensor = TactileBatch(gel, "cuda"), TactileSensor(gel)
        images = batch.image(given)
        took = device_ms(lambda batch=batch: batch.image(given))
        least = 1e3 * (images.nbytes + given.nbytes) / bandwidth
        begun = time.perf_counter()
        batch.image(depth).cpu()
        there_and_back = 1e3 * (time.perf_counter() - begun)
        sensor.image(depth[0])
        begun = time.perf_counter()
        expected = np.stack([sensor.image(d) for d in depth])
        cpu = 1e3 * (time.perf_counter() - begun)
        off = np.abs(images.cpu().numpy().astype(int) - expected)
        print(
            f"{name}: {took:.2f} ms a batch of {BATCH} (copied from and to the CPU {there_and_back:.1f}, "
            f"memory's limit {least:.3f}, one core {cpu:.0f}); at most {off.max()} level off, "
            f"{(off > 0).mean():.1e} of all values"
        )


if __name__ == "__main__":
    main()
