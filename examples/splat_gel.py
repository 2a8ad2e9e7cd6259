"""The gel as Gaussian splats: 18,880 particles, each with one Gaussian, move with a press and are drawn."""

from pathlib import Path

import numpy as np
from PIL import Image

from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.sensor import TactileSensor
from pneutac_sim.splat.gel import SplatSensor

sensor = TactileSensor()  # the generated DIGIT; in the image plane
splats = SplatSensor(sensor.model)  # the same gel, as Gaussians

depth_mm = sensor.probe(*Press("sphere", 4.0, x_mm=1.0, y_mm=-2.0, depth_mm=1.0).shapes())
plane, drawn = sensor.image(depth_mm), splats.image(sensor.displacement(depth_mm))
rmse = np.sqrt(np.mean((plane.astype(float) - drawn) ** 2))
print(f"image plane and splats differ by {rmse:.2f} of 255 levels (RMSE)")
Path("outputs/splat_gel").mkdir(parents=True, exist_ok=True)
Image.fromarray(np.hstack([plane, drawn])).save("outputs/splat_gel/gel.png")
