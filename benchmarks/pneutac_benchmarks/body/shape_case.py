"""One body of `pneutac benchmark body --part=shape`: photographs, markers, material points at rest."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pneutac_datasets.generate.photographs import Disturbances, write_photographs
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.registry import in_order
from pneutac_sim.features import CHAMBERS
from pneutac_sim.finger import BodyData, Pipeline, fit
from pneutac_sim.mpm import devices
from pneutac_sim.mpm.solve import solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads
from pneutac_sim.twin import Twin

TRAIN_KPA = (0.0, 3.0, 6.0, 9.0, 12.0, 15.0)
HELDOUT_KPA = (1.0, 4.0, 7.0, 10.0, 13.0)  # neither photographs nor markers of these are fitted
# Of an arm, whose chambers are fitted one at a time: between levels, and two chambers at once.
ARM_HELDOUT_KPA = (
    *(
        (4.0, 0.0, 0.0),
        (0.0, 4.0, 0.0),
        (0.0, 0.0, 4.0),
        (10.0, 0.0, 0.0),
        (0.0, 10.0, 0.0),
        (0.0, 0.0, 10.0),
    ),
    *((7.0, 13.0, 0.0), (0.0, 7.0, 13.0), (13.0, 0.0, 7.0)),
)
ORDER_KPA = (0, 9, 3, 15, 6, 12, 1, 14, 7, 4, 13, 10, 2, 11, 5, 8)  # far apart, so that what comes late shows
DOWN = {"gravity_x": 1.0, "gravity_y": 0.0, "gravity_z": 0.0}


@dataclass(frozen=True)
class Hidden:
    """What a twin without effects does not know of a finger.

    Attributes:
        disturbances: of the session.
        add: the effect that describes it; empty where none does, and markers alone are fitted.
        after_s: when each pressure is photographed.
        turned_deg: by which the base is turned about y for a second photograph of each pressure, and gravity
            told.
    """

    disturbances: Disturbances = field(default_factory=Disturbances)
    add: str = ""
    after_s: tuple[float, ...] = ()
    turned_deg: float = 0.0


HIDDEN = {
    "stiffening": Hidden(Disturbances(effects={"stiffening": {"linear_1_per_kpa": 0.04}}), "stiffening"),
    "creep": Hidden(
        Disturbances(effects={"creep": {"weight_4s": 0.06, "weight_40s": 0.08}}), "creep", (2.0, 60.0)
    ),
    "gravity, base turned by 30 degrees": Hidden(
        Disturbances(effects={"gravity": {"body_mass_g": 50.0, "tip_mass_g": 20.0}}), "gravity", (), 30.0
    ),
    "base tilted by 3 degrees": Hidden(Disturbances(tilt_deg=3.0), "base_tilt"),
    "camera moved by 2 degrees and 3 mm": Hidden(Disturbances(camera_deg=2.0, camera_mm=3.0)),
    "masks ragged by 2 px": Hidden(Disturbances(mask_px=2.0)),
}


@dataclass(frozen=True)
class BodyCase:
    """One hidden body.

    Attributes:
        device: `finger` or `arm`.
        seed: of everything about it.
        hidden: key of `HIDDEN`, or empty where truth is of the model's form.
        evaluations: of the objective.
        particles: of the twin.
    """

    device: str
    seed: int
    hidden: str
    evaluations: int
    particles: int

    @property
    def recording(self) -> str:
        """Name of its recording's folder."""
        return "_".join([self.device, str(self.seed), *self.hidden.replace(",", "").split()])

    @property
    def key(self) -> str:
        """File name of its result."""
        return f"{self.recording}_{self.evaluations}_{self.particles}"


def take_photographs(case: BodyCase, folder: Path) -> Recording:
    """The case's recording inside `folder`; one that is complete there is not taken again."""
    path = folder / case.recording
    if (folder / "truth" / f"{case.recording}.json").is_file():  # what is written last
        return Recording.load(path)
    hidden = HIDDEN.get(case.hidden, Hidden())
    if case.device == "arm":
        single = np.eye(CHAMBERS["arm"])
        pressures = np.array(
            [[0.0] * 3, *(p * c for c in single for p in TRAIN_KPA[1:]), *map(list, ARM_HELDOUT_KPA)]
        )
        return write_photographs(path, case.seed, "arm", pressures)
    pressures, conditions = np.array(ORDER_KPA if hidden.after_s else sorted(ORDER_KPA), float), {}
    if hidden.turned_deg:
        turn = np.radians(hidden.turned_deg)
        turned = DOWN | {"gravity_x": np.cos(turn), "gravity_z": -np.sin(turn)}
        conditions = {k: np.repeat([DOWN[k], turned[k]], len(pressures)) for k in DOWN}
        pressures = np.tile(pressures, 2)
    return write_photographs(
        path,
        case.seed,
        pressures_kpa=pressures,
        disturbances=hidden.disturbances,
        after_s=hidden.after_s,
        conditions=conditions,
    )


def photographed(recording: Recording) -> Recording:
    """The part that is calibrated by images: photographs of the base as it was first."""
    kept = np.ones(len(recording), bool)
    for name in DOWN:
        if recording.has(name):
            kept &= recording.column(name) == recording.column(name)[0]
    return recording.keep(kept)


def heldout(recording: Recording) -> np.ndarray:
    """(n,) bool: samples at pressures that nothing is fitted to."""
    pressure = np.stack([recording.column(c) for c in recording.pressure_columns], 1).astype(float)
    levels = np.array(HELDOUT_KPA)[:, None] if pressure.shape[1] == 1 else np.array(ARM_HELDOUT_KPA)
    return (np.abs(pressure[:, None] - levels).max(-1) < 1e-6).any(1)


def first_twin(recording: Recording) -> Twin:
    """Where a calibration starts: the paper's finger, or an arm as `pneutac new` makes it."""
    twin = Twin.builtin() if recording.device == "finger" else Twin(recording.device)
    twin.length_mm = recording.length_mm
    twin.spine_joint_positions_mm = recording.spine_joint_positions_mm
    if recording.device == "arm":
        pipeline = Pipeline.of(twin)
        twin = pipeline.update(twin, pipeline.theta(twin, max(TRAIN_KPA)))
    return twin


def add_effect(twin: Twin, recording: Recording, name: str) -> Twin:
    """The twin with an effect (empty: without one), fitted to the markers that may be seen.

    Gain and rest pressure go with it. How the bend is spread over the joints stays as photographs told: the
    tip alone hardly tells it, and a fit of everything would lose it.
    """
    bench = BodyData.of(recording, twin, source="command", start="held")
    new = [name] if name else []
    only = ["gain_rad_per_kpa", "rest_pressure_kpa", *new]
    return fit(twin, bench, [*twin.effects, *new], ~heldout(recording), only).twin


def at_rest(
    twin: Twin, recording: Recording, rows: np.ndarray, particles: int, device: str
) -> tuple[np.ndarray, np.ndarray]:
    """Joint angles (n, H), rad, and tips (n, 3), mm, of material points at these samples (mask).

    Effects of the observation then act on the tips.
    """
    q_cmd = devices.sampled_targets(twin, recording.samples)[rows]
    solver = devices.BODIES[twin.device](twin, batch=len(q_cmd), particles=particles, device=device)
    q = solve_equilibrium(solver, Loads(q_cmd=q_cmd)).q
    markers = np.zeros((len(q), 5))
    markers[:, :3] = 1e3 * devices.spine_points(solver, q)[:, -1]
    for effect in in_order(list(twin.effects)):
        if effect.stage == "observation":
            values = {k: v.value for k, v in twin.effects[effect.name].items()}
            # the length is the only column that any asks for
            column = np.full((len(q), len(effect.columns)), twin.length_mm)
            markers = effect.apply(markers, np.ones(len(q)), values, column)
    return q, markers[:, :3]
