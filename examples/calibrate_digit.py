"""A touch sensor from two images: fit one rest image and one press, predict other presses."""

import numpy as np
from PIL import Image

from lerobot_pneutac import calibrate, compare
from lerobot_pneutac.verbs.new import new_twin
from pneutac_datasets.generate.gel import write_hidden_gel
from pneutac_sim.gel.indenter import Press
from pneutac_sim.gel.sensor import TactileSensor

# Generated photographs; with a sensor of yours: Recording.load("your/folder").
recording = write_hidden_gel("outputs/calibrate_digit/presses", ["shadow"], seed=1, images=6)

result = calibrate(new_twin("gel", recording), recording)
comparison = compare(result.twin, recording)
print(f"on photographs that were not fitted: {comparison.heldout:.2f} {comparison.unit}")

# What the calibrated sensor would see of an edge.
sensor = TactileSensor(result.twin)
depth_mm = sensor.probe(*Press("edge", 6.0, x_mm=0.0, y_mm=2.0, depth_mm=0.8, yaw_rad=0.4).shapes())
image = sensor.image(depth_mm)
print(sensor.contact(image), "largest depth", np.round(depth_mm.max(), 2), "mm")
Image.fromarray(image).save("outputs/calibrate_digit/edge.png")
