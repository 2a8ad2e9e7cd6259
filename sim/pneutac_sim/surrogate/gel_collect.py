"""Pairs of probe grid and MPM displacement for the perception network, collected contact by contact.

Each indenter is driven in slowly, step by step, since friction makes the gel remember its way. Every step is
an equilibrium and so a pair of its own. A folder holds `collection.json`, and for each contact either
`contact_NNNN.npz` or, where the material points found no equilibrium, `contact_NNNN.diverged`.
"""

import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pneutac_sim.errors import InputError
from pneutac_sim.executor import ExecutorOptions, run_pieces
from pneutac_sim.files import claim, whole, write_text
from pneutac_sim.gel.indenter import INDENTERS, Press
from pneutac_sim.gel.model import GelModel
from pneutac_sim.gel.probe import COLS, ROWS, probe_grid
from pneutac_sim.mpm import devices
from pneutac_sim.mpm.devices import press_loads
from pneutac_sim.mpm.solve import MpmDiverged, halved_once, solve_equilibrium
from pneutac_sim.mpm.total_lagrangian import Loads
from pneutac_sim.surrogate.finger import gel_fingerprint
from pneutac_sim.twin import Twin

# Contacts of the gel: an indenter, anywhere and tilted, for both the probe grid and MPM.
#
# A contact is a `Press` turned about its tip. Both descriptions of it are made here: the shapes of the probe
# grid, of which the environment's objects are made, and the loads of the material points.

SIZE_MM = {
    "sphere": (1.5, 5.0),
    "cylinder": (1.0, 4.0),
    "cube": (2.0, 7.0),
    "edge": (3.0, 9.0),
    "cone": (2.5, 5.0),
}
DEPTH_MM = (1.1, 2.0)
SHALLOW_MM, SHALLOW_SHARE = (0.1, 0.8), 0.15  # the mean of all depths is 1.4 mm
TILT_RAD, TILT_SHARE = np.radians(12), 0.5
RIM_SHARE = 0.25  # of contacts whose centre lies within 1 mm of the window's rim, on either side


@dataclass(frozen=True)
class Contact:
    """One indenter pressed into the gel."""

    press: Press  # indenter, size, place, depth of its deepest point, and yaw
    tilt_rad: float = 0.0  # turn of the indenter about its tip
    tilt_towards_rad: float = 0.0  # direction of the axis of that turn, from x towards y

    @property
    def _tilt(self) -> Rotation:
        a = self.tilt_towards_rad
        return Rotation.from_rotvec(self.tilt_rad * np.array([np.cos(a), np.sin(a), 0.0]))

    @cached_property
    def _raised_m(self) -> float:
        """How far a tilted indenter is drawn back, for its deepest point to lie as deep as before."""
        if self.tilt_rad == 0:
            return 0.0
        flat = replace(self.press, x_mm=0.0, y_mm=0.0)
        shapes = self._turned(flat.shapes(), flat)
        deepest = probe_grid(*shapes, window_mm=(24.0, 24.0), thickness_mm=50.0, shape=(240, 240)).max()
        return 1e-3 * max(float(deepest) - flat.depth_mm, 0.0)

    def _turned(self, shapes, press: Press):
        kinds, sizes, positions, rotations = shapes
        tip = 1e-3 * np.array([press.x_mm, press.y_mm, -press.depth_mm])
        turn = self._tilt
        positions = [tip + turn.apply(np.asarray(p) - tip) for p in positions]
        return kinds, sizes, positions, [turn.as_matrix() @ r for r in rotations]

    def shapes(self) -> tuple:
        """`kinds, sizes, positions, rotations` for `probe_grid`, in metres."""
        kinds, sizes, positions, rotations = self._turned(self.press.shapes(), self.press)
        return kinds, sizes, [p + [0, 0, self._raised_m] for p in positions], rotations

    def loads(self) -> Loads:
        """The same indenter for the material points."""
        loads, turn = press_loads(self.press), self._tilt.as_matrix()
        at = loads.position_m + [0, 0, self._raised_m]
        return replace(loads, position_m=at, rotation=turn @ loads.rotation)

    def at(self, depth_mm: float) -> "Contact":
        return replace(self, press=replace(self.press, depth_mm=depth_mm))


def random_contact(seed: int, number: int, window_mm: tuple[float, float]) -> Contact:
    """Contact `number` of the series `seed`, the same whatever others there are; the indenters take turns."""
    rng = np.random.default_rng([seed, number])
    indenter = INDENTERS[number % len(INDENTERS)]
    shallow, rim, tilted = rng.random(3) < (SHALLOW_SHARE, RIM_SHARE, TILT_SHARE)
    place = rng.uniform(-0.4, 0.4, 2) * window_mm
    if rim:
        side = rng.integers(2)
        place[side] = rng.choice([-1, 1]) * (window_mm[side] / 2 + rng.uniform(-1, 1))
    press = Press(
        indenter,
        float(rng.uniform(*SIZE_MM[indenter])),
        *(float(v) for v in place),
        float(rng.uniform(*(SHALLOW_MM if shallow else DEPTH_MM))),
        float(rng.uniform(-np.pi, np.pi)),
    )
    tilt, towards = rng.uniform(0, TILT_RAD), rng.uniform(-np.pi, np.pi)
    return Contact(press, float(tilt) if tilted else 0.0, float(towards))


FORMAT = "pneutac-gel-contacts/1"
STEP_MM = 0.35  # finer ones change the displacement by 2 um


@dataclass(frozen=True)
class Pairs:
    """One contact, K equilibria on the way to its full depth."""

    indenter: str  # its name
    depth_mm: np.ndarray  # (K, 80, 59) probe grids, float32
    displacement_mm: np.ndarray  # (K, 80, 59) of the material points' face, float32


@dataclass(frozen=True)
class Collected:
    """What a call of `collect_gel` found or made."""

    contacts: int  # pressed to their full depth
    diverged: int  # contacts without an equilibrium, which are left out


def collect_gel(
    twin: Twin,
    folder: str | Path,
    contacts: int = 100,
    seed: int = 0,
    device: str = "auto",
    progress: Callable[[int, int], None] = lambda done, total: None,
    executor: ExecutorOptions | None = None,
) -> Collected:
    """Presses indenters into the gel of a twin; contacts that the folder holds already are reused.

    `seed` decides their shapes, sizes, depths and places. `progress` is called after each contact with the
    number of those done and of all. An `executor` collects contacts each on one core; None takes all cores,
    or the GPU, of this process.

    Raises InputError where the number makes no sense, or the folder holds contacts of another gel or seed.
    """
    if contacts < 1:
        raise InputError(f"contacts is {contacts}; give a number of contacts above zero.")
    folder, model = Path(folder), GelModel.from_twin(twin)
    label = {"format": FORMAT, "fingerprint": gel_fingerprint(twin), "seed": seed}
    claim(folder / "collection.json", label, fingerprint="gel")
    files, solver = [folder / f"contact_{n:04d}.npz" for n in range(contacts)], None
    if executor is not None:
        collect, report = partial(_collect, twin, files, seed, device), lambda _, *done: progress(*done)
        run_pieces(collect, files, folder / "logs", executor, report, "contacts", _collected)
    for number, file in enumerate(files):
        if not _collected(file):
            solver = solver or devices.gel(twin, device=device)
            _press_and_store(solver, model, file, seed, number)
        progress(number + 1, contacts)
    done = sum(file.exists() for file in files)
    return Collected(done, contacts - done)


def _collected(file: Path) -> bool:
    return file.exists() or file.with_suffix(".diverged").exists()


def _press_and_store(solver, model: GelModel, file: Path, seed: int, number: int) -> None:
    contact = random_contact(seed, number, model.window_mm)
    try:
        _store(file, contact, press(solver, contact, model))
    except MpmDiverged as e:
        write_text(file.with_suffix(".diverged"), f"{contact.press}: {e.finding}.\n")


def _collect(twin: Twin, files: list[Path], seed: int, device: str, number: int) -> None:
    solver = devices.gel(twin, device=device)
    _press_and_store(solver, GelModel.from_twin(twin), files[number], seed, number)


def press(solver, contact: Contact, model: GelModel) -> Pairs:
    """Drives an indenter in by steps of at most `STEP_MM`, to a contact's full depth.

    Raises MpmDiverged where no equilibrium was found.
    """
    return halved_once(solver, lambda: _press(solver, contact, model))


def _press(solver, contact: Contact, model: GelModel) -> Pairs:
    full, probe, mpm = contact.press.depth_mm, [], []
    count = int(np.ceil(full / STEP_MM))
    for k in range(count):
        part = contact.at(full * (k + 1) / count)
        solve_equilibrium(solver, part.loads(), warm=k > 0)
        probe.append(probe_grid(*part.shapes(), window_mm=model.window_mm, thickness_mm=model.thickness_mm))
        mpm.append(devices.surface_displacement(solver, model.window_mm)[0].astype(np.float32))
    return Pairs(contact.press.indenter, np.stack(probe), np.stack(mpm))


def read_contacts(folder: str | Path) -> list[Pairs]:
    """All contacts of a folder, in order.

    Raises InputError where the folder is not of `collect_gel`, or a file in it is damaged.
    """
    folder = Path(folder)
    if not (folder / "collection.json").is_file():
        raise InputError(
            f"There are no gel contacts in '{folder}' (no collection.json); collect them with "
            "`pneutac surrogate`."
        )
    return [_read(file) for file in sorted(folder.glob("contact_*.npz"))]


def _store(file: Path, contact: Contact, pairs: Pairs) -> None:
    p = contact.press
    with whole(file) as part, part.open("wb") as f:
        what = {"indenter": np.array(pairs.indenter), "size_mm": p.size_mm, "yaw_rad": p.yaw_rad}
        what |= {"place_mm": [p.x_mm, p.y_mm], "tilt_rad": [contact.tilt_rad, contact.tilt_towards_rad]}
        np.savez_compressed(f, **what, depth_mm=pairs.depth_mm, displacement_mm=pairs.displacement_mm)


def _read(file: Path) -> Pairs:
    try:
        with np.load(file, allow_pickle=False) as f:
            pairs = Pairs(str(f["indenter"]), f["depth_mm"], f["displacement_mm"])
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zipfile.zlib.error):
        pairs = None
    if pairs is None or not _sound(pairs):
        raise InputError(
            f"'{file}' is damaged; delete it and run `pneutac surrogate` again, which collects it again."
        )
    return pairs


def _sound(pairs: Pairs) -> bool:
    grids = (pairs.depth_mm, pairs.displacement_mm)
    return (
        pairs.indenter in INDENTERS
        and grids[0].shape == grids[1].shape == (len(grids[0]), ROWS, COLS)
        and len(grids[0]) > 0
        and all(g.dtype == np.float32 and np.isfinite(g).all() for g in grids)
    )
