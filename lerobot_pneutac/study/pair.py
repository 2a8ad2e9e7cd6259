"""A twin and the recording it is weighed against: whether they fit together, and whether there is enough."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from lerobot_pneutac.diagnosis import thresholds as T
from pneutac_datasets.demonstrations.reading import (
    Demonstrations,
    is_dataset,
    is_demonstrations,
    load_demonstrations,
)
from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.units import unit_faults
from pneutac_datasets.recording.wording import an, joined, plural
from pneutac_sim.errors import InputError, option
from pneutac_sim.features import CHAMBERS
from pneutac_sim.finger import BodyData, Pipeline
from pneutac_sim.mpm.solid import parameter
from pneutac_sim.twin import Twin, no_twin

# kappa w E / p of a bent body of width w: about 1.5 for a solid bar with a hole in it (A h w / I), 8 for the
# paper's finger, 2 to 14 for rods of 15 to 90 kPa. What is softer than the twin's modulus has more.
USUAL = 6.0
UNITS = (("psi", 6.895), ("bar", 100.0), ("mbar", 0.1), ("Pa", 0.001))  # kPa in one


def pressure_unit_doubts(twin: Twin) -> list[str]:
    """One sentence where the gain of a calibrated twin suits another unit of pressure better, else none.

    The bend per pressure, as kappa w E / p, has no unit and hardly depends on the size of a finger.
    """
    modulus = parameter(twin, "youngs_modulus_mpa")
    joints = len(twin.spine_joint_positions_mm)
    bend = abs(twin.parameter("gain_rad_per_kpa")) * joints  # rad/kPa
    ratio = bend * parameter(twin, "width_mm") / twin.length_mm * 1000 * modulus
    if not ratio > T.PSI_RATIO:
        return []
    return [
        f"The {twin.device} bends by {bend:.2g} rad a kPa, {ratio / USUAL:.0f} times what fingers of"
        f" {modulus:.2g} MPa do: {_asked(ratio / USUAL)};"
        " else it is softer, and rows with payload_g show how much."
    ]


def unlike_the_twin(twin: Twin, recording: Recording) -> list[str]:
    """A note where a calibrated twin would roll up at a recording's pressures, or bends far otherwise."""
    gain = twin.parameters.get("gain_rad_per_kpa")
    if gain is None or gain.ci95 is None:
        return []
    top = {c: float(np.abs(recording.column(c)).max()) for c in recording.pressure_columns}
    name = max(top, key=top.__getitem__)
    turn = abs(gain.value) * top[name]  # rad a joint
    if turn > 2 * math.pi:
        return [
            f"Column '{name}' reaches {top[name]:.4g}, which would turn each joint of the calibrated twin "
            "more than once around; if it is not in kPa, convert it (pascal: divide by 1000)."
        ]
    times = _bend(recording, twin.length_mm) / max(turn * len(twin.spine_joint_positions_mm), 1e-9)
    if 1 / T.PSI_TIMES <= times <= T.PSI_TIMES or not times:
        return []
    far = f"{times:.0f} times as far" if times > 1 else f"only {times:.1g} times as far"
    return [
        f"At up to {top[name]:.3g} kPa in '{name}' the {twin.device} bends {far} as the"
        f" calibrated twin: {_asked(times)}; else calibrate the twin to it."
    ]


def _bend(recording: Recording, length_mm: float) -> float:
    """Range of the measured bend, rad: of its angle, or by the tip, which moves half the length a rad."""
    if recording.has("bend_angle_rad"):
        return float(np.ptp(recording.column("bend_angle_rad")))
    tips = [np.ptp(recording.column(c)) for c in recording.observations if c.startswith("tip_")]
    return float(np.linalg.norm(tips)) / (length_mm / 2)


def _asked(times: float) -> str:
    """Which unit pressures that act so many times as strongly as kPa may be in."""
    unit, kpa = min(UNITS, key=lambda u: abs(math.log(times / u[1])))
    return f"are the pressures in {unit}? Then multiply the pressure columns by {kpa:g}"


def recorded_min(recording: Recording) -> float:
    """Minutes of a recording, without the pauses between its trials."""
    time_s = recording.samples.groupby("trial")["time_s"]
    return float((time_s.max() - time_s.min()).sum()) / 60


def longer(recording: Recording) -> str:
    """What to record where a recording has too few rows."""
    minutes = recorded_min(recording)
    if minutes >= T.ENOUGH_MIN:
        rate = len(recording) / (60 * minutes)
        return f"Record faster: {minutes:.0f} minutes are enough, at 10 rows a second and not at {rate:.2g}."
    has = f"{minutes:.2g} minutes" if minutes >= 1 else f"{60 * minutes:.2g} s"
    what = "steps, slow and fast ramps and long holds, in several trials"
    return f"Record ten minutes with {what} (this recording has {has})."


def load_pair(
    twin_path: Path, recording_path: Path, verb: str, task: str = "", station: Path | None = None
) -> tuple[Twin, Recording | Demonstrations]:
    """The twin and a recording from their folders; raises InputError where they are of different devices.

    Demonstrations may lie on the Hub, and are of a task and the station of a file; see `load_demonstrations`.
    """
    if not is_dataset(recording_path):
        no_demonstrations(recording_path, task, station)
        return load_bench_pair(twin_path, recording_path, verb)
    twin = Twin.load(twin_path)
    recording = load_demonstrations(recording_path, task, twin, station=station)
    same_device(twin, recording, twin_path, verb)
    return twin, recording


def no_demonstrations(recording_path: Path | str, task: str, station: Path | None) -> None:
    """Raises InputError where options of demonstrations are given with a bench recording."""
    for name, value in (("task", task), ("station", station)):
        if value:
            raise InputError(
                f"{name} is for demonstrations, but {recording_path} is a bench recording; omit it."
            )


def load_bench_pair(twin_path: Path, recording_path: Path, verb: str) -> tuple[Twin, Recording]:
    """The same of a bench recording alone; raises InputError where demonstrations are given too."""
    if is_demonstrations(recording_path):
        raise InputError(f"{recording_path} holds demonstrations; {verb} a bench recording of the device.")
    recording = Recording.load(recording_path)
    if not twin_path.exists():
        raise InputError(no_twin(twin_path, recording=recording_path))
    twin = Twin.load(twin_path)
    same_device(twin, recording, twin_path, verb)
    return twin, recording


def same_device(twin: Twin, recording: Recording | Demonstrations, twin_name: str | Path, verb: str) -> None:
    """Raises InputError where the two are of different devices; a gel may be that of a finger."""
    if recording.device != twin.device and not (recording.device == "gel" and twin.gel):
        raise InputError(
            f"{recording.folder} is of {an(recording.device)} and {twin_name} of {an(twin.device)}; "
            f"{verb} a twin with a recording of its own device."
        )


def same_chambers(twin: Twin, driven: int) -> None:
    """Raises InputError where a bench drives another number of chambers than the twin's device has."""
    needed = CHAMBERS.get(twin.device, 0)
    if needed != driven:
        has = plural(needed, "chamber") if needed else "no chambers"
        raise InputError(
            f"The twin is of {an(twin.device)}, which has {has}, and the bench drives {driven}; give a bench"
            " and a twin of one device."
        )


def same_body[R: Recording | Demonstrations](twin: Twin, recording: R, verb: str) -> R:
    """The recording with the twin's length where it states none, and with a note where one is due.

    Raises InputError where the two do not fit together.
    """
    same_device(twin, recording, "the twin", verb)
    if isinstance(recording, Demonstrations) or recording.device == "gel":
        return recording
    length_mm = None if recording.meta.get("length_proposed") else recording.length_mm
    if length_mm is None:  # of the twin's finger the tip tells its unit, and the checks its frame
        meta = {k: v for k, v in recording.meta.items() if k != "length_proposed"}
        recording = replace(recording, meta=meta | {"length_mm": twin.length_mm})
        for fault in unit_faults(recording.samples, recording.meta, Path(recording.folder)):
            raise InputError(fault)
    elif not same_length(length_mm, twin):
        raise InputError(
            f"{recording.folder}/recording.json: length_mm is {recording.length_mm:g}, the twin's is "
            f"{twin.length_mm:g}; make the twin with "
            f"`pneutac new --twin=DIR {option('recording', recording.folder)}`."
        )
    return replace(recording, warnings=recording.warnings + unlike_the_twin(twin, recording))


def same_length(length_mm: float, twin: Twin) -> bool:
    """Whether a length measured from base to tip marker is the twin's, within 2 %."""
    return abs(length_mm - twin.length_mm) <= 0.02 * twin.length_mm


def fit_parts(
    twin: Twin, recording: Recording, seed: int = 0
) -> tuple[Recording, list[str], np.ndarray, np.ndarray]:
    """A recording of a finger or an arm as a fit may use it, and how its samples are shared.

    Returns:
        The checked recording, one sentence a finding, and masks (n,) of training and held-out samples.

    Raises:
        InputError: no column says what the device did, pressure or device never moves, or rows are too few.
    """
    folder = recording.folder
    if not recording.poses:
        raise InputError(
            f"{folder}: no column tip_x_mm, bend_angle_rad, curvature_x_1_per_m or q_1_rad has what the "
            "device did; add one of them."
        )
    device_moves(recording)
    checked, findings = check(recording)
    train, heldout = checked.split(seed)
    enough_rows(twin, checked, list(twin.effects), train)
    command = checked.samples[checked.pressure_columns].to_numpy(float)[train]
    if np.ptp(command, axis=0).max() < T.STANDS_KPA:
        raise InputError(
            f"{folder}: column '{checked.pressure_columns[0]}' is {command[0, 0]:g} kPa in every row that "
            "would be fitted, so the bend per pressure cannot be fitted; record steps or ramps."
        )
    return checked, findings, train, heldout


def device_moves(recording: Recording) -> None:
    """Raises InputError where every measured number of the device is the same in all rows."""
    poses = recording.poses
    if poses and len(recording) > 1 and not np.ptp(recording.samples[poses].to_numpy(float), axis=0).any():
        never = f"never change{'s' * (len(poses) == 1)}"
        named = f"{recording.folder}: {joined(map(repr, poses))}"
        raise InputError(f"{named} {never}; check that the tracker ran.")


LEAST_SAMPLES = 10  # of fewer the 95 % interval of a root mean square exceeds 0.7 to 1.8 times its value


def enough_to_compare(recording: Recording, checked: Recording) -> None:
    """Raises InputError where too few samples are left of a recording to say how large an error is."""
    if len(checked) < LEAST_SAMPLES:
        device_moves(recording)  # rows in which the tracker stands are none, and that is what to say then
        raise InputError(
            f"{recording.folder} has {plural(len(checked), 'usable sample')}, and a comparison takes at "
            f"least {LEAST_SAMPLES}; record a longer trial."
        )


def enough_rows(twin: Twin, recording: Recording, effects: list[str], train: np.ndarray) -> None:
    """Raises InputError where training samples (n,) are too few to fit a twin with these effects at all."""
    bench = BodyData.of(recording, twin, source="command")
    pipeline = Pipeline.of(twin, bench.inputs, effects)
    count = sum(
        not spec.fixed and name.rpartition(".")[0] not in pipeline.left_out
        for name, spec in zip(pipeline.names, pipeline.specs, strict=True)
    )
    if train.sum() * len(bench.columns) <= count:
        least = math.ceil((count + 1) / len(bench.columns) / max(train.mean(), 0.5))
        samples = recording.meta.get("samples")  # none of a table that is not converted yet
        where = recording.folder / samples if samples else "The table"
        more = longer(recording)
        raise InputError(
            f"{where} has {plural(len(recording), 'row')}, and"
            f" fitting the {count} parameters takes at least {least} (hundreds to distinguish effects);"
            f" {more[0].lower()}{more[1:]}"
        )
