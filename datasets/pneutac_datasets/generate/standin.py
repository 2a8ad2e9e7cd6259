"""The stand-in on the bench, finger and gel: what one measures of a real finger before making its twin."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd

from lerobot_robot_pneutac.standin.world import (
    GAUGE_NOISE_KPA,
    LENGTH_MM,
    TIP_MM,
    WINDOW_MM,
    CameraNoise,
    RodBody,
    clamped,
    new_gel,
)
from pneutac_datasets.generate.finger import ProgramTrial, session
from pneutac_datasets.generate.gel import ball_press, write_presses
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError, check_between
from pneutac_sim.features import MAX_PRESSURE_KPA
from pneutac_sim.gel.indenter import Press
from pneutac_truths.light import SPHERE, reach_below

MARKER_NOISE_MM = 0.3
SETTLE_S, TURNED_S = 1.0, 4.0  # a finger that has been turned or loaded swings longer
HANGING = {"gravity_x": 1.0, "gravity_y": 0.0, "gravity_z": 0.0}  # in the base's frame
PRESSES = 16
HZ = 20.0  # samples a second of a session
SCALE_SHARE, SCALE_NOISE_N = 0.01, 0.003  # errors of the scale under the gel


def write_finger(folder: str | Path, seed: int = 0, minutes: float = 6.0) -> Recording:
    """Writes a session with the stand-in's finger: stairs, triangles, loops, holds, steps, and two repeats.

    Each trial begins rested. The pressure is logged by the gauge of the robot, so that air and body can be
    told apart. The seed decides the programs' random levels and the noise. Raises InputError where `minutes`
    is out of its range.
    """
    check_between(1, 60, minutes=minutes)
    rng = np.random.default_rng([seed, 3])
    trials = [ProgramTrial(t.label, t.command) for t in session(MAX_PRESSURE_KPA, 60 * minutes, HZ, rng)[:3]]
    return _write(folder, trials, HZ, rng)


def _write(
    folder: str | Path,
    trials: list[ProgramTrial],
    hz: float,
    rng: np.random.Generator,
    conditions: Mapping[str, float] = HANGING,
) -> Recording:
    conditions, table = HANGING | conditions, []
    for number, trial in enumerate(trials):
        n = len(trial.command)
        tip, pressure = _measured(trial.command, hz, conditions)
        tip = tip + MARKER_NOISE_MM * rng.standard_normal((n, 3))
        gauge = pressure + GAUGE_NOISE_KPA * rng.standard_normal(n)
        columns = {"trial": number, "program": trial.label, "time_s": np.round(np.arange(n) / hz, 4)}
        columns |= {"pressure_cmd_kpa": trial.command, "pressure_kpa": gauge}
        columns |= {f"tip_{a}_mm": tip[:, i] for i, a in enumerate("xyz")}
        table.append(pd.DataFrame(columns | conditions))
    length = LENGTH_MM + TIP_MM
    meta = {"device": "finger", "length_mm": length, "samples": "samples.csv"}
    meta |= {"spine_joint_positions_mm": [length * (k + 0.5) / 4 for k in range(4)]}
    meta |= {"trials": {str(k): {"start": "rested"} for k in range(len(trials))}}
    meta |= {"notes": "Generated: the stand-in for reality."}
    Recording(Path(folder), meta, pd.concat(table, ignore_index=True), "finger").write(folder)
    return Recording.load(folder)


def write_program(folder: str | Path, program: str | Path, seed: int = 0) -> Recording:
    """Writes what the stand-in's finger, long without pressure, did under a program of commands.

    The program is a CSV with `time_s`, when a command is sent, and `pressure_cmd_kpa`, as `pneutac control`
    and `pneutac design` write it; the finger hears it at the next sample, which come at the pace of most
    rows. By `gravity_x`, `gravity_y`, `gravity_z` the base is turned, `payload_g` hangs at the tip. Raises
    InputError where the program cannot be read, or goes beyond the finger's pressures.
    """
    try:
        table = pd.read_csv(program)
        time_s, command = (table[c].to_numpy(float) for c in ("time_s", "pressure_cmd_kpa"))
    except (KeyError, ValueError, OSError) as e:
        raise InputError(f"{program} must be a table with time_s and pressure_cmd_kpa: {e}.") from e
    if not np.isfinite([time_s, command]).all() or command.min() < 0 or command.max() > MAX_PRESSURE_KPA:
        raise InputError(f"{program}: pressure_cmd_kpa must be finite and in 0 to {MAX_PRESSURE_KPA:g}.")
    dt = np.diff(time_s)
    if len(dt) == 0 or not (dt > 0).all() or (usual := float(np.median(dt))) > 0.2:
        raise InputError(f"{program}: time_s must rise, most times by the same and by at most 0.2 s.")
    grid = time_s[0] + np.arange(round((time_s[-1] - time_s[0]) / usual) + 1) * usual
    command = command[np.searchsorted(time_s, grid + 0.01 * usual, side="right") - 1]
    conditions = {c: float(table[c].iloc[0]) for c in (*HANGING, "payload_g") if c in table}
    return write_trials(folder, [("program", command)], 1 / usual, seed, conditions)


def write_trials(
    folder: str | Path,
    trials: Sequence[tuple[str, np.ndarray]],
    hz: float,
    seed: int,
    conditions: Mapping[str, float] = HANGING,
) -> Recording:
    """Writes what the stand-in's finger did, long without pressure before each of several trials.

    A trial is a name and commands (n,), kPa; the conditions are the direction of gravity in the base's frame
    and `payload_g`. Raises InputError where a command lies beyond the finger's pressures.
    """
    for name, command in trials:
        if command.min() < 0 or command.max() > MAX_PRESSURE_KPA:
            raise InputError(f"'{name}' leaves 0 to {MAX_PRESSURE_KPA:g} kPa, the range of the stand-in.")
    made = [ProgramTrial(name, command) for name, command in trials]
    known = {c: v for c, v in conditions.items() if c in (*HANGING, "payload_g")}
    return _write(folder, made, hz, np.random.default_rng([seed, 5]), known)


def _measured(
    command_kpa: np.ndarray, hz: float, conditions: Mapping[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Marker (n, 3) in mm in the base's frame and pressure (n,) in kPa of the rested finger in its clamp."""
    model = clamped()
    model.opt.timestep = 1 / (hz * np.ceil(1 / (hz * model.opt.timestep)))
    data = mujoco.MjData(model)
    finger, base, tip = RodBody(model, data), data.body("finger"), data.site("tip")
    mujoco.mj_kinematics(model, data)
    pull = base.xmat.reshape(3, 3) @ np.array([conditions[g] for g in HANGING])
    model.opt.gravity[:] = np.linalg.norm(model.opt.gravity) * pull
    weight = 1e-3 * conditions.get("payload_g", 0.0) * model.opt.gravity
    last = model.site("tip").bodyid[0]

    def hang(share: float) -> None:
        """The weight pulls at the marker, wherever that is."""
        data.xfrc_applied[last] = np.r_[weight, np.cross(tip.xpos - data.xipos[last], weight)]

    each = (hang,) if weight.any() else ()  # at every substep, of which a session has a hundred thousand
    turned = {g: conditions[g] for g in HANGING} != HANGING or weight.any()
    settle_s = TURNED_S if turned else SETTLE_S
    finger.advance(0.0, round(settle_s * hz) / hz, *each)
    places, pressure = np.empty((len(command_kpa), 3)), np.empty(len(command_kpa))
    for i in range(len(command_kpa)):
        mujoco.mj_kinematics(model, data)
        places[i] = 1e3 * base.xmat.reshape(3, 3).T @ (tip.xpos - base.xpos)
        pressure[i] = finger.rod.pressure_kpa
        finger.advance(float(command_kpa[i]), 1 / hz, *each)
    return places, pressure


def write_gel(folder: str | Path, seed: int = 0) -> Recording:
    """Writes a rest image and `PRESSES` presses by balls into the stand-in's gel, the first to calibrate by.

    A depth is from the first touch on, the force that of a scale under the gel; the seed decides places,
    depths, noise and drift of the light.
    """
    rng = np.random.default_rng([seed, 4])
    gel, scale = new_gel(), np.random.default_rng([seed, 6])
    camera = CameraNoise(gel.rest_image.shape)
    camera.begin(rng)

    def presses() -> Iterator[tuple[Press, np.ndarray, dict]]:
        for i in range(PRESSES):
            press = ball_press(i, rng)
            ball = [SPHERE], [[press.size_mm, 0.0, 0.0]]
            at = np.array([press.x_mm, press.y_mm, press.size_mm])
            first = (reach_below(*ball, at, np.eye(3), gel.xs_mm, gel.ys_mm) + gel.rest_mm).max()  # below 0
            at[2] -= press.depth_mm - first
            displacement, force = gel.press(*ball, at, np.eye(3))
            image = camera.photograph(gel.image(displacement))
            read_n = scale.normal(force, np.hypot(SCALE_SHARE * force, SCALE_NOISE_N))
            yield press, image, {"force_n": read_n}

    px_per_mm = gel.rest_image.shape[1] / WINDOW_MM[0]  # its rest image is the mean of many frames
    return write_presses(folder, gel.rest_image, presses(), px_per_mm, "Generated: the stand-in for reality.")
