"""Speed of the tactile pipeline on one thread: python benchmarks/touch_speed.py.

Prints medians in milliseconds beside the goal for each stage.
"""

import os

os.environ.setdefault("NUMBA_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import time
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from pneutac_sim.gel import layout
from pneutac_sim.gel.fit import fit_presses
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.pair import PressPhotograph
from pneutac_sim.gel.photograph import press_depth
from pneutac_sim.gel.probe import BOX, CAPSULE, SPHERE, probe_grid
from pneutac_sim.gel.sensor import TactileSensor


def median_ms(call, repeats: int = 300) -> float:
    call()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


def main() -> None:
    sensor = TactileSensor()
    tilt = Rotation.from_euler("xyz", [0.1, 0.2, 0.3]).as_matrix()
    shapes = {
        "one sphere": ([SPHERE], [[0.003, 0, 0]], [[0, 0, 0.0024]]),
        "one box": ([BOX], [[0.004, 0.003, 0.003]], [[0, 0, 0.0024]]),
        "one capsule": ([CAPSULE], [[0.002, 0.004, 0]], [[0, 0, 0.0044]]),
        "box, capsule, sphere": (
            [BOX, CAPSULE, SPHERE],
            [[0.004, 0.003, 0.003], [0.002, 0.004, 0], [0.003, 0, 0]],
            [[0, 0.004, 0.0024], [0, 0, 0.0044], [0, -0.004, 0.0024]],
        ),
    }
    table = Table(title="Tactile pipeline, one thread")
    for name in ("stage", "median ms", "goal ms"):
        table.add_column(name, justify="left" if name == "stage" else "right")
    for name, (kinds, sizes, positions) in shapes.items():
        arrays = [np.array(kinds), np.array(sizes), np.array(positions), np.array([tilt] * len(kinds))]
        table.add_row(f"probe grid, {name}", f"{median_ms(lambda a=arrays: probe_grid(*a)):.3f}", "0.040")
    depth = probe_grid(*arrays)
    table.add_row("gel surface", f"{median_ms(lambda: sensor.displacement(depth)):.3f}", "")
    table.add_row("image, surface included", f"{median_ms(lambda: sensor.image(depth)):.3f}", "2")
    image = sensor.image(depth)
    table.add_row("contact area of an image", f"{median_ms(lambda: sensor.contact(image)):.3f}", "")
    prior = layout.DIGIT.prior_field(sensor.rest_image, layout.Orientation())
    prior = prior.times(float(np.linalg.norm(sensor.model.light)) / 2)
    fielded = TactileSensor(replace(sensor.model, prior_residual=prior))
    table.add_row(
        "image with a prior residual field", f"{median_ms(lambda: fielded.image(depth)):.3f}", "0.8"
    )
    area = median_ms(lambda: sensor.contact_from_depth(depth))
    table.add_row("contact area without the image", f"{area:.3f}", "")
    nothing = np.zeros_like(depth)
    table.add_row("image without contact", f"{median_ms(lambda: sensor.image(nothing)):.3f}", "")
    gel, press = GelModel.builtin(), Press("sphere", 3.0, 0.5, 0.5, 0.9)
    photograph = sensor.image(press_depth(press, gel))
    fit = median_ms(lambda: fit_presses([PressPhotograph(press, photograph, gel.rest_image)], 20.0), 5)
    table.add_row("calibration from one pair", f"{fit:.0f}", "")
    Console().print(table)


if __name__ == "__main__":
    main()
