"""`pneutac compare`: how far a twin is from a recording, and where it fails."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from lerobot_pneutac.cli.options import parse_options
from lerobot_pneutac.reports.compare_sentence import sentence
from lerobot_pneutac.reports.page import write_result
from lerobot_pneutac.study.pair import other_unit, require, same_device
from pneutac_datasets.recording.axes import Axis, axes, is_still, motion
from pneutac_datasets.recording.checks import check
from pneutac_datasets.recording.mounts import on_one_mount
from pneutac_datasets.recording.noise import NoiseFloor, noise_floor
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.finger import BodyData, simulate
from pneutac_sim.finger.quantities import root_mean, squared_distance
from pneutac_sim.twin import Twin

PASSAGE_S = 2.0
PASSAGES = 5
FIDELITIES = ("pipeline", "mpm")
APART_S = 10.0  # between the starts of two: the next-worst place says more than the same one again


@dataclass
class CompareConfig:
    """Options of `pneutac compare`.

    Attributes:
        twin: the twin's folder.
        recording: a bench recording of the same device.
        out: folder for `result.json` and `report.html`; nothing is written without it.
        fidelity: `pipeline` (the twin's kinematics, every sample) or `mpm` (of a finger or an arm: the full
            body of material points, at samples spread over the recording).
        samples: by mpm: at most so many, 200 where left out.
        seed: decides which blocks of time are held out, where the twin was not fitted on this recording, and
            which samples are simulated by mpm.
    """

    twin: Path | None = None
    recording: Path | None = None
    out: Path | None = None
    fidelity: str = "pipeline"
    samples: int | None = None
    seed: int = 0

    def __post_init__(self):
        require(self, "twin", "recording")
        if self.fidelity not in FIDELITIES:
            raise InputError(f"--fidelity={self.fidelity} is unknown; choose {' or '.join(FIDELITIES)}.")
        if self.samples is not None and (self.samples < 2 or self.fidelity != "mpm"):
            raise InputError(f"--samples={self.samples} must be 2 or more, together with --fidelity=mpm.")
        if self.out is not None and self.out.exists() and not self.out.is_dir():
            raise InputError(f"--out={self.out} is a file; give a folder.")


@dataclass
class Comparison:
    """A twin against a recording, sample by sample.

    Attributes:
        recording: without the rows that the data check left out.
        said: what the data check found, one sentence each.
        columns: (D,) compared columns; the first `counted` make the error.
        counted: see `columns`.
        measured: (n, D).
        model: (n, D).
        unit: of the error.
        train: (n,) mask; the other samples are held out.
        noise: floor of the error.
        axes: ways to sort the samples.
        rate: (n,) of the commanded pressure, kPa/s.
        still: (n,) whether it stands.
        pressure: (n,) squared error of the measured pressure, kPa^2, or None where none was measured.
        simulated: by what, in words.
        fidelity: `pipeline` or `mpm`.
        out_of_range: share of the recording's samples outside what the twin's action network was trained
            with; None where it has none.
    """

    recording: Recording
    said: list[str]
    columns: tuple[str, ...]
    counted: int
    measured: np.ndarray
    model: np.ndarray
    unit: str
    train: np.ndarray
    noise: NoiseFloor
    axes: list[Axis]
    rate: np.ndarray
    still: np.ndarray
    pressure: np.ndarray | None
    simulated: str = "by the pipeline, at every sample"
    fidelity: str = "pipeline"
    out_of_range: float | None = None

    @property
    def squared(self) -> np.ndarray:
        """(n,) squared Euclidean distance."""
        return squared_distance((self.measured - self.model)[:, : self.counted])


def main(argv: list[str]) -> None:
    """Runs the verb."""
    config = parse_options(CompareConfig, argv)
    twin = Twin.load(config.twin)
    recording = Recording.load(config.recording)
    if not (recording.device == "gel" and twin.gel):
        same_device(twin, recording, config.twin, "compare")
    if recording.device == "gel":
        if config.fidelity != "pipeline":
            raise InputError(
                "--fidelity=mpm is of a finger or an arm, but the recording is of a gel; omit it."
            )
        from lerobot_pneutac.verbs.compare_gel import compare_gel

        compare_gel(twin, recording, config.out, Console())
        return
    recording.warnings += other_unit(twin, recording)
    c = compare(twin, recording, config.seed, config.fidelity, config.samples, Console())
    result = summarize(c, twin)
    _show(c, result)
    if config.out is not None:
        from lerobot_pneutac.reports.compare import write_report

        write_result(config.out, result)
        Console().print(f"report: {write_report(c, result, config.out)}")


def compare(
    twin: Twin,
    recording: Recording,
    seed: int = 0,
    fidelity: str = "pipeline",
    samples: int | None = None,
    console: Console | None = None,
) -> Comparison:
    """Checks the recording, runs the twin from the commanded pressure and sorts the errors.

    Args:
        twin: of the same device.
        recording: of a finger or an arm.
        seed: of the split, where the twin's history does not tell another one for this recording.
        fidelity: `pipeline` or `mpm`.
        samples: see `CompareConfig`.
        console: where the progress of material points is shown; None for nowhere.
    """
    clean, said = check(recording)
    train = train_mask(twin, clean, seed)
    clean, moved = on_one_mount(clean, twin, train, refit=False)
    said += moved
    prediction = simulate(twin, BodyData.of(clean, twin, source="command"))
    said += [f"Effect '{name}' could not act: {why}." for name, why in prediction.left_out.items()]
    bench = prediction.data
    outside, told = _out_of_range(twin, bench)
    said += [told] if told else []
    rate = motion(clean)[0]
    whole = Comparison(
        recording=clean,
        said=said,
        columns=bench.columns,
        counted=bench.counted,
        measured=bench.measured,
        model=prediction.model,
        unit=bench.unit,
        train=train,
        noise=noise_floor(clean),
        axes=axes(clean),
        rate=rate,
        still=is_still(clean, rate),
        pressure=_pressure_error(clean, twin),
        out_of_range=outside,
    )
    if fidelity == "pipeline":
        return whole
    from lerobot_pneutac.verbs.compare_mpm import SAMPLES, by_mpm

    return by_mpm(whole, twin, bench, samples or SAMPLES, seed, console)


def _out_of_range(twin: Twin, bench: BodyData) -> tuple[float | None, str | None]:
    if not twin.networks:
        return None, None
    from lerobot_pneutac.verbs.compare_networks import out_of_range

    return out_of_range(twin, bench)


def train_mask(twin: Twin, recording: Recording, seed: int = 0) -> np.ndarray:
    """Samples (n,) that the twin may have been fitted to.

    The last version fitted on this very recording tells the `seed` of its split; other recordings are split
    with `seed`.
    """
    here = Path(recording.folder).resolve()
    for entry in reversed(twin.history):
        if entry.get("seed") is not None and Path(entry.get("recording") or "").resolve() == here:
            return recording.split(int(entry["seed"]))[0]
    return recording.split(seed)[0]


def summarize(c: Comparison, twin: Twin) -> dict:
    """The comparison as `result.json` has it; numbers without a sample behind them are null."""
    squared = c.squared
    pressure = None
    if c.pressure is not None:
        pressure = {
            "unit": "kPa",
            "error": {"train": _rms(c.pressure[c.train]), "heldout": _rms(c.pressure[~c.train])},
            "means": "measured pressure against what the twin makes of the command",
        }
    return {
        "fidelity": c.fidelity,
        "simulated": c.simulated,
        "unit": c.unit,
        "sentence": sentence(c),
        "error": {"all": _rms(squared), "train": _rms(squared[c.train]), "heldout": _rms(squared[~c.train])},
        "noise_floor": c.noise.value,
        "noise": {"session": c.noise.session, "how": c.noise.how, "by_column": c.noise.by_column},
        "columns": {
            name: _rms(c.measured[:, i] - c.model[:, i], squares=False) for i, name in enumerate(c.columns)
        },
        "pressure": pressure,
        "out_of_range": c.out_of_range,
        "by": {a.name: by_axis(a, squared, c.train) for a in c.axes},
        "worst": worst(c),
        "history": [
            {k: e.get(k) for k in ("version", "change", "train", "heldout", "unit")} for e in twin.history
        ],
        "samples": len(squared),
        "checks": c.said,
    }


def _pressure_error(recording: Recording, twin: Twin) -> np.ndarray | None:
    """(n,) squared distance of the pneumatics from the measured pressure, from the command."""
    measured = [n.replace("cmd_", "") for n in recording.pressure_columns]
    if not all(map(recording.has, measured)):
        return None
    return squared_distance(simulate(twin, BodyData.of(recording, twin, target="pressure")).residual)


def by_axis(axis: Axis, squared: np.ndarray, train: np.ndarray) -> list[dict]:
    """One row a bin: error, held-out error, number of samples and share of all squared error."""
    total = max(float(squared.sum()), 1e-300)
    rows = []
    for i, label in enumerate(axis.labels):
        at = axis.bin == i
        row = {"value": label}
        if axis.value is not None:
            row |= {"from": float(axis.value[at].min()), "to": float(axis.value[at].max())}
        row |= {
            "error": _rms(squared[at]),
            "heldout": _rms(squared[at & ~train]),
            "n": int(at.sum()),
            "share": float(squared[at].sum() / total),
        }
        rows.append(row)
    return rows


def worst(c: Comparison) -> list[dict]:
    """The worst passages of about `PASSAGE_S`, at least two samples each, some time apart."""
    passages = []
    squared = c.squared
    for trial, rows in c.recording.trials().items():
        t, e = c.recording.column("time_s")[rows], squared[rows]
        begin, sums = np.arange(len(t)), np.r_[0.0, np.cumsum(e)]
        end = np.maximum(np.searchsorted(t, t + PASSAGE_S, side="right"), np.minimum(begin + 2, len(t)))
        mean = (sums[end] - sums[:-1]) / (end - begin)
        free = t <= max(t[0], t[-1] - PASSAGE_S)  # a passage is whole, or the whole of a short trial
        for a in np.argsort(-mean, kind="stable"):
            if len([p for p in passages if p["trial"] == trial]) == PASSAGES:
                break
            if free[a]:
                free[np.abs(t - t[a]) < APART_S] = False
                passage = {"trial": trial, "from_s": float(t[a]), "to_s": float(t[end[a] - 1])}
                passage["error"] = float(np.sqrt(mean[a]))
                if c.recording.has("program"):
                    passage["program"] = str(c.recording.column("program")[rows][a])
                passages.append(passage)
    return sorted(passages, key=lambda p: -p["error"])[:PASSAGES]


def _rms(x: np.ndarray, squares: bool = True) -> float | None:
    """Root of the mean of squares (n,), or of the squares of (n,); None where there is none."""
    if len(x) == 0:
        return None
    return root_mean(x if squares else x**2)


def _show(c: Comparison, result: dict) -> None:
    console = Console()
    console.print(f"[bold]{result['sentence']}[/bold]")
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))

    def number(x):
        return "-" if x is None else f"{x:.3g} {c.unit}"

    if c.fidelity != "pipeline":
        table.add_row("simulated", c.simulated)
    table.add_row("held-out error", number(result["error"]["heldout"]))
    table.add_row("train error", number(result["error"]["train"]))
    table.add_row("noise floor", f"{number(c.noise.value)} ({c.noise.how})")
    if result["pressure"]:
        e = result["pressure"]["error"]["heldout"]
        table.add_row("pressure, held out", "-" if e is None else f"{e:.3g} kPa")
    for p in result["worst"][:3]:
        where = f"trial {p['trial']}, {p['from_s']:.1f} to {p['to_s']:.1f} s"
        table.add_row("worst passage", f"{number(p['error'])} in {where} {p.get('program', '')}")
    if c.out_of_range is not None:
        table.add_row("out of the network's range", f"{100 * c.out_of_range:.2g}% of samples")
    for entry in result["history"]:
        told = "-" if entry["heldout"] is None else f"{entry['heldout']:.3g} {entry['unit'] or ''}"
        table.add_row(f"version {entry['version']}", f"{entry['change']}: held out {told}")
    console.print(table)
    for said in c.said:
        console.print(f"[yellow]- {said}[/yellow]")
