"""Fits a finger's modulus and its chamber's stiffness to loaded poses.

What loads the tip must be known: `payload_g` with the direction of gravity, or a measured `force_x_n`,
`force_y_n`, `force_z_n`. The finger's own weight under another direction of gravity identifies weight over
stiffness alone; it is fitted along and not taken for either.
"""

from dataclasses import dataclass, replace
from importlib.util import find_spec

import numpy as np

from lerobot_pneutac.study.base import with_unit
from lerobot_pneutac.verbs.measured_range import measured_range
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.gravity import STANDARD_GRAVITY
from pneutac_sim.errors import InputError
from pneutac_sim.finger import BodyData, fit
from pneutac_sim.finger.fit import PipelineFit
from pneutac_sim.finger.soft_body import SoftBody
from pneutac_sim.finger.stages import BODY_SHARE, FORCES
from pneutac_sim.surrogate.programs import bending_range
from pneutac_sim.twin import PAPER_FINGER, Twin, Value

WHOLE, MODULUS = "joint_stiffness_nm_per_rad", "youngs_modulus_mpa"
GRAVITY = ("gravity_x", "gravity_y", "gravity_z")
LEAST_FORCE_N = 0.02  # by which loads must differ
TURNED = 0.1  # change of a component of gravity from which on the finger's own weight counts
WIDEST = 1.5  # upper over lower end of an interval, beyond which a number is not identified

PARTICLES = 4000  # of the soft body, about


@dataclass(frozen=True)
class Compliance:
    """What loaded poses determine.

    Attributes:
        twin: with what was found.
        parameters: name to `value`, `ci95`, `unit` and `note`, of the stiffness and the modulus.
        remark: one sentence for the report.
        evaluations: simulations made.
    """

    twin: Twin
    parameters: dict[str, dict]
    remark: str
    evaluations: int


def fit_compliance(twin: Twin, recording: Recording, train: np.ndarray, seed: int = 0) -> Compliance:
    """Fits the joints' whole stiffness and the soft body's modulus where known loads bend the finger.

    Args:
        twin: of a finger or an arm; of an arm, which bends in two planes, nothing is fitted.
        recording: of the same device.
        train: (n,) samples to fit.
        seed: of the starting points.
    """
    if twin.device != "finger":
        return _held(twin, "An arm's modulus and stiffness are not fitted to loaded poses; they stay fixed.")
    force = known_forces(recording)
    if force is None or np.ptp(force[train], axis=0)[[0, 2]].max() < LEAST_FORCE_N:
        return _held(twin, f"{NO_LOAD}, so {_NEITHER}; {advice(twin)}.")
    samples = recording.samples.assign(**dict(zip(FORCES, force.T, strict=True)))
    known = replace(recording, samples=samples)
    start = twin.copy()
    start.pressure_range_kpa = measured_range(recording) or twin.pressure_range_kpa
    start.effects.pop("payload", None)  # its weight is a force now
    effects = list(start.effects)
    turned = all(map(recording.has, GRAVITY)) and np.ptp(samples[list(GRAVITY)].to_numpy()[train], 0).max()
    if turned > TURNED and "gravity" not in effects:
        effects.append("gravity")
    if not (find_spec("taichi") or find_spec("quadrants")):
        return _held(twin, f"The soft body's torque needs Taichi, which is not installed, so {_NEITHER}.")
    from pneutac_sim.mpm.soft_body import measure  # the other bench verbs run without Taichi
    from pneutac_sim.mpm.solve import MpmDiverged

    try:
        body = measure(start, bending_range(start), PARTICLES)
    except (InputError, MpmDiverged) as e:
        return _held(twin, f"No soft body can be put round this spine ({e}), so {_NEITHER}.")
    data = BodyData.of(known, start)
    both = fit(start, data, effects, train, seed=seed, body=body)
    return _found(twin, both, body)


def known_forces(recording: Recording) -> np.ndarray | None:
    """(n, 3) N at the tip in the base frame, measured or of what hangs there; None where neither is known."""
    force = np.zeros((len(recording.samples), 3))
    measured = all(map(recording.has, FORCES))
    if measured:
        force += recording.samples[list(FORCES)].to_numpy(float)
    hung = recording.has("payload_g") and all(map(recording.has, GRAVITY))
    if hung:
        down = recording.samples[list(GRAVITY)].to_numpy(float)
        force += 1e-3 * STANDARD_GRAVITY * recording.column("payload_g")[:, None] * down
    return force if measured or hung else None


def advice(twin: Twin) -> str:
    """What to hang on the finger: what moves its tip by a tenth of its length, as far as is known."""
    levers = 1e-3 * (twin.length_mm - np.asarray(twin.spine_joint_positions_mm))
    K = twin.parameters.get(WHOLE, Value(PAPER_FINGER[WHOLE])).value
    grams = 1e3 * 0.1e-3 * twin.length_mm * K / (levers @ levers) / STANDARD_GRAVITY
    return (
        f"hang about {float(f'{grams:.1g}'):g} g on the tip in some trials, with the base level and with it "
        "upright, and write payload_g and gravity_x, gravity_y, gravity_z, or push with a force gauge and "
        "write force_x_n, force_y_n, force_z_n"
    )


NO_LOAD = "No known load bends the finger"
_NEITHER = "neither the joints' stiffness nor the modulus is identified and both stay fixed"


def _held(twin: Twin, remark: str) -> Compliance:
    return Compliance(twin, {}, remark, 0)


def _found(twin: Twin, found: PipelineFit, body: SoftBody) -> Compliance:
    """The twin with the fitted values."""
    if WHOLE not in found.ci95 or WHOLE in found.at_bound:
        return _held(twin, f"The loads bend the finger too little, so {_NEITHER}; {advice(twin)}.")
    new, whole = twin.copy(), found.twin.parameters[WHOLE]
    if whole.ci95[1] > WIDEST * whole.ci95[0]:
        shown = "{:.2g} to {:.2g} N m/rad a joint".format(*whole.ci95)
        return _held(
            twin, f"The loads leave the stiffness anywhere from {shown}, so {_NEITHER}; {advice(twin)}."
        )
    new.parameters[WHOLE] = whole
    rows = {WHOLE: with_unit(whole, "N m/rad") | {"note": ""}}
    remark = "Joint stiffness: {:.2g} to {:.2g} N m/rad.".format(*whole.ci95)
    # a body of the modulus E alone would be as stiff as joints of E times this
    alone = body.alone(1e-3 * (twin.length_mm - np.asarray(twin.spine_joint_positions_mm)))
    share = found.twin.parameters[BODY_SHARE]
    low, high = (whole.value * s / alone for s in share.ci95 or (0.0, 1.0))
    if BODY_SHARE not in found.at_bound and high < WIDEST * low:
        new.parameters[MODULUS] = Value(whole.value * share.value / alone, (low, high))
        rows[MODULUS] = with_unit(new.parameters[MODULUS], "MPa") | {"note": ""}
        remark += f" Young's modulus: {low:.3g} to {high:.3g} MPa; the rest is the chamber's."
        return Compliance(new, rows, remark, found.evaluations)
    value = twin.parameters.get(MODULUS, Value(PAPER_FINGER[MODULUS])).value
    range_mpa = f"{max(low, 0.0):.2g} to {high:.2g} MPa"
    rows[MODULUS] = with_unit(Value(value), "MPa") | {"note": f"fixed: not identifiable ({range_mpa})"}
    remark += (
        f" Young's modulus cannot be identified from these data ({range_mpa}); record the angles of the "
        "joints too (q_1_rad ...)."
    )
    if value * alone >= whole.value:
        new.parameters[MODULUS] = Value(0.5 * (low + min(high, 0.9 * whole.value / alone)))
        remark += f" It is set to {new.parameters[MODULUS].value:.2g} MPa."
        rows[MODULUS]["value"] = new.parameters[MODULUS].value
    return Compliance(new, rows, remark, found.evaluations)
