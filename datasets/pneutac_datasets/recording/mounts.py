"""Sessions that were mounted differently: a twin has one base, so such trials are moved onto the first one.

Where, under equal conditions, the same pressure brings the device elsewhere from one trial on, the device was
perhaps turned and shifted between trials, which says nothing about its physics; perhaps it remembers (creep,
softening), which does. So data are moved only where one rigid motion of a session significantly removes most
of the error, over whole trials, and where the history of the pressure cannot explain it as well. Every verb
that weighs a twin against a recording looks at it through `on_one_mount`.
"""

import numpy as np

from pneutac_datasets.recording.motion import Motion
from pneutac_datasets.recording.mount_cases import Bench, Case, pressure
from pneutac_datasets.recording.noise import headline
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.finger import quantities
from pneutac_sim.twin import Twin

FAR = 0.05  # of the device's length: the least distance that is looked into
TURNED_DEG = 45.0
SWEEP = 0.3  # of the whole pressure range that a trial must cover to fit its rest and direction
CONDITIONS = {"gravity_x": 0.1, "gravity_y": 0.1, "gravity_z": 0.1, "temperature_c": 2.0, "payload_g": 0.1}


def on_one_mount(recording: Recording, twin: Twin, train: np.ndarray) -> tuple[Recording, list[str]]:
    """The recording moved onto one mount, and a sentence for each session that was mounted differently.

    Args:
        recording: cleaned; one of a single mount is returned as it is.
        twin: of the device.
        train: (n,) mask of training samples; others are moved, but nothing is judged or fitted by them.
    """
    return align_mounts(recording, twin.length_mm, train)


def align_mounts(
    recording: Recording, length_mm: float, train: np.ndarray | None = None
) -> tuple[Recording, list[str]]:
    """Moves trials with a significantly different mount onto the mount of the first one.

    Of tip coordinates the motion turns and shifts; angles, curvatures and a single coordinate are shifted.

    Args:
        recording: of a finger or an arm.
        length_mm: of the device.
        train: (n,) mask of samples to judge and fit by; None means all.

    Returns:
        The recording and a sentence for each session that was moved.
    """
    columns, unit = headline(recording)
    train = np.ones(len(recording), bool) if train is None else train
    sweeps = _sweeps(recording, columns, train)
    far = FAR * length_mm / quantities.weight(unit, "mm", length_mm)
    order = list(sweeps)
    apart = [t for t in order if _apart(sweeps[order[0]], sweeps[t], far)]
    if not apart:
        return recording, []
    bench = Bench(recording, columns, train)
    alike = order[: order.index(apart[0])]  # later ones may be of any mount
    begun = _begun(recording)
    others = [t for t in bench.trials if t not in alike and _same(begun, alike[0], t)]
    moved: dict[int, Motion] = {}
    sentences = []
    for session in _runs(sweeps, order, apart, far):
        case = Case(bench, alike, [t for t in session if t not in moved])
        if case.sure():
            rough, motion = case.motions()
            way = _against(sweeps[order[0]], sweeps[session[0]])
            free = [t for t in others if t not in moved]
            free = [t for t in free if t not in sweeps or _against(sweeps[order[0]], sweeps[t]) == way]
            joined = [t for t in free if Case(bench, alike, [t]).halves(rough)]
            moved |= dict.fromkeys(joined, motion)
            sentences += [_sentence(case, motion, alike, joined, unit)] if joined else []
    return (_moved(recording, columns, moved), sentences) if moved else (recording, [])


def _moved(recording: Recording, columns: list[str], motions: dict[int, Motion]) -> Recording:
    samples, trials = recording.samples.copy(), recording.trials()
    for trial, motion in motions.items():
        rows = samples.index[trials[trial]]
        samples.loc[rows, columns] = motion(samples.loc[rows, columns].to_numpy(float))
    return Recording(recording.folder, recording.meta, samples, recording.device, recording.warnings)


def _sweeps(recording: Recording, columns: list[str], train: np.ndarray) -> dict[int, np.ndarray]:
    """Trial to what a straight line in the pressures makes of it (1 + chambers, k): at rest, and per kPa.

    Of trials that cover enough of the pressures and have the conditions of the first such trial.
    """
    p = pressure(recording)
    lowest, reach = p.min(0), np.ptp(p, axis=0).max()
    y = recording.samples[columns].to_numpy(float)
    found: dict[int, np.ndarray] = {}
    begun = _begun(recording)
    for trial, at in recording.trials().items() if columns else ():
        rows = np.arange(at.start, at.stop)[train[at]]
        if len(rows) < 2 or not np.ptp(p[rows], axis=0).max() > SWEEP * reach > 0:
            continue
        if _same(begun, next(iter(found), trial), trial):
            design = np.c_[np.ones(len(rows)), p[rows] - lowest]
            found[trial] = np.linalg.lstsq(design, y[rows], rcond=None)[0]
    return found


def _begun(recording: Recording) -> dict[int, np.ndarray]:
    """Trial to the conditions under which it began, in units of what still counts as equal."""
    names = [c for c in CONDITIONS if recording.has(c)]
    tolerances = np.array([CONDITIONS[c] for c in names])
    trials = recording.trials()
    rows = recording.samples[names].iloc[[at.start for at in trials.values()]].to_numpy(float)
    return dict(zip(trials, rows / tolerances, strict=True))


def _same(begun: dict[int, np.ndarray], a: int, b: int) -> bool:
    return bool((np.abs(begun[a] - begun[b]) <= 1 + 1e-12).all())


def _apart(a: np.ndarray, b: np.ndarray, far: float) -> bool:
    """Whether two trials lie far from each other at rest, or bend in other directions."""
    if np.linalg.norm(a[0] - b[0]) >= far:
        return True
    if a.shape[1] != 3:
        return False
    (ay, az), (by, bz) = a[1:, 1:].T, b[1:, 1:].T  # the straight finger lies along x
    if min((ay**2 + az**2).sum() / (a[1:] ** 2).sum(), (by**2 + bz**2).sum() / (b[1:] ** 2).sum()) < 0.25:
        return False
    roll = np.arctan2((ay * bz - az * by).sum(), (ay * by + az * bz).sum())
    return bool(abs(np.degrees(roll)) >= TURNED_DEG)


def _against(a: np.ndarray, b: np.ndarray) -> bool:
    return bool((a[1:] * b[1:]).sum() < 0)


def _runs(sweeps: dict[int, np.ndarray], order: list[int], apart: list[int], far: float) -> list[list[int]]:
    """Trials that differ from the first one, in runs whose trials are similar."""
    runs: list[list[int]] = []
    for before, trial in zip([None, *order], order, strict=False):
        if trial in apart:
            if before not in apart or _apart(sweeps[runs[-1][0]], sweeps[trial], far):
                runs.append([])
            runs[-1].append(trial)
    return runs


def _sentence(case: Case, motion: Motion, alike: list[int], moved: list[int], unit: str) -> str:
    turns = len(motion.shift) > 1 and unit == "mm"
    how = f"turned by {motion.angle_deg:.0f} degrees and shifted" if turns else "shifted"
    far, (before, after) = case.reach(motion), case.error
    return (
        f"The device was mounted differently in {_trials(moved)}: at equal pressures it is {far:.3g} {unit} "
        f"away from {_trials(alike)}, early and late in a trial, and no memory effect explains that. "
        f"Data of {_trials(moved)} are {how} onto the first mount. On rows that were not used to fit the "
        f"motion this reduces the distance from {before:.3g} to {after:.3g} {unit}."
    )


def _trials(numbers: list[int]) -> str:
    """`trial 3`, `trials 3 to 5 and 8`."""
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) != 1) + 1)
    items = [x for r in runs for x in ([f"{r[0]} to {r[-1]}"] if len(r) > 2 else map(str, r))]
    *first, last = items
    return f"trial{'s' * (len(numbers) > 1)} {', '.join(first)}{' and ' * bool(first)}{last}"
