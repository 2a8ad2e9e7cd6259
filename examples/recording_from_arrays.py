"""A bench recording out of arrays that you have: write it, read it back with its checks, calibrate a twin."""

from pathlib import Path

import numpy as np
import pandas as pd

from lerobot_pneutac import Recording, calibrate
from lerobot_pneutac.verbs.new import new_twin

# What a rig might have logged: pressure in kPa, bend of the tip in rad, at 10 Hz in six trials of 20 s.
rng = np.random.default_rng(0)
trials, time_s = np.repeat(range(6), 200), np.tile(np.arange(200) / 10, 6)
pressure_kpa = np.repeat(rng.uniform(0, 15, 60), 20)  # steps of 2 s
bend_rad = 0.045 * (pressure_kpa + 3) + rng.normal(0, 0.01, 1200)

samples = pd.DataFrame(
    {
        "trial": trials,
        "time_s": time_s,
        "pressure_cmd_kpa": pressure_kpa,
        "bend_angle_rad": bend_rad,
    }
)
meta = {"device": "finger", "length_mm": 90.0, "noise": {"bend_angle_rad": 0.01}}
folder = Recording(Path("outputs/mine"), meta, samples, "finger").write("outputs/mine")

recording = Recording.load(folder)  # units, clocks and columns are checked here
print(*recording.warnings, sep="\n")
result = calibrate(new_twin(recording=recording), recording)
for name in ("gain_rad_per_kpa", "rest_pressure_kpa"):
    print(name, round(result.twin.parameter(name), 4))
