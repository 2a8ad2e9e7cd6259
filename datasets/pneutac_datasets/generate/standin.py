"""The stand-in on the bench, finger and gel: what one measures of a real finger before making its twin."""

from pathlib import Path

import numpy as np
import pandas as pd
from PIL import Image

from pneutac_datasets.generate.hidden.programs import ProgramTrial, session
from pneutac_datasets.generate.presses import ball_press, press_row, write_session
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.features import MAX_PRESSURE_KPA
from pneutac_sim.finger.inputs import Inputs
from pneutac_sim.finger.pipeline import Pipeline
from pneutac_sim.gel.photograph import press_depth
from pneutac_sim.world.standin import GAUGE_NOISE_KPA, standin_gel, standin_twin
from pneutac_sim.world.standin_touch import CameraNoise, standin_sensor

FINE_HZ = 100.0  # the finger is simulated between the logged samples too
MARKER_NOISE_MM = 0.3
PRESSES = 16


def write_finger(folder: str | Path, seed: int = 0, minutes: float = 6.0, hz: float = 20.0) -> Recording:
    """Writes a session with the stand-in's finger: stairs, triangles, loops, holds, steps, and two repeats.

    The pressure is logged by the gauge of the robot, so that air and body can be told apart.

    Args:
        folder: where the recording goes.
        seed: decides the programs' random levels and the noise.
        minutes: length of the session.
        hz: samples a second.

    Raises:
        InputError: `minutes` or `hz` is out of its range.
    """
    if not 1 <= minutes <= 60 or not 5 <= hz <= 50:
        raise InputError(f"minutes={minutes}, hz={hz}: minutes must be 1 to 60 and hz 5 to 50.")
    rng = np.random.default_rng([seed, 3])
    hanging = (1.0, 0.0, 0.0)
    trials = [ProgramTrial(t.label, t.command) for t in session(MAX_PRESSURE_KPA, 60 * minutes, hz, rng)[:3]]
    twin, every = standin_twin(), round(FINE_HZ / hz)
    table = []
    for number, trial in enumerate(trials):
        n = len(trial.command)
        t = np.arange(n) / hz
        fine = np.arange((n - 1) * every + 1) / (hz * every)
        samples = {
            "trial": np.full(len(fine), number),
            "time_s": fine,
            "pressure_cmd_kpa": np.interp(fine, t, trial.command),
        }
        model = Pipeline.of(twin)
        run = model.run(Inputs.from_samples(samples), model.theta(twin))
        tip = run.markers[::every, :3] + MARKER_NOISE_MM * rng.standard_normal((n, 3))
        gauge = run.pressure_kpa[::every, 0] + GAUGE_NOISE_KPA * rng.standard_normal(n)
        columns = {"trial": number, "program": trial.label, "time_s": np.round(t, 4)}
        columns |= {"pressure_cmd_kpa": trial.command, "pressure_kpa": gauge}
        columns |= {f"tip_{a}_mm": tip[:, i] for i, a in enumerate("xyz")}
        columns |= {f"gravity_{a}": hanging[i] for i, a in enumerate("xyz")}
        table.append(pd.DataFrame(columns))
    meta = {
        "device": "finger",
        "length_mm": twin.length_mm,
        "spine_joint_positions_mm": twin.spine_joint_positions_mm,
        "samples": "samples.csv",
        "notes": "Generated: the stand-in for reality.",
    }
    Recording(Path(folder), meta, pd.concat(table, ignore_index=True), "finger").write(folder)
    return Recording.load(folder)


def write_gel(folder: str | Path, seed: int = 0) -> Recording:
    """Writes a rest image and `PRESSES` presses by balls into the stand-in's gel, the first to calibrate by.

    Args:
        folder: where the recording goes.
        seed: decides places, depths, noise and drift of the light.
    """
    folder, rng = Path(folder), np.random.default_rng([seed, 4])
    gel = standin_gel()
    sensor, camera = standin_sensor(gel), CameraNoise(gel.rest_image.shape)
    camera.begin(rng)
    (folder / "images").mkdir(parents=True, exist_ok=True)
    Image.fromarray(gel.rest_image).save(folder / "rest.png")  # the mean of many frames
    rows = []
    for i in range(PRESSES):
        press, name = ball_press(i, rng), f"images/ball_{i}.png"
        Image.fromarray(camera.photograph(sensor.image(press_depth(press, gel)))).save(folder / name)
        rows.append(press_row(i, name, press))
    return write_session(folder, rows, gel.px_per_mm, "Generated: the stand-in for reality.")
