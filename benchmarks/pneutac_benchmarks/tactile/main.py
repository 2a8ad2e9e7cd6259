"""`pneutac benchmark tactile`: fits renderers to one pair of images and scores them on held-out ones."""

import os
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from pneutac_benchmarks.tactile.methods import METHODS, makes_for, own_gel
from pneutac_benchmarks.tactile.picture import picture_grid
from pneutac_benchmarks.tactile.sets import TactileSet, find_sets, thumbnail
from pneutac_benchmarks.tactile.table import write_tables
from pneutac_sim.errors import InputError, check_choice
from pneutac_sim.files import read_made, write_json
from pneutac_sim.gel.pair import score

SECONDS_ACROSS = 5.0  # of a pair of sets, for the progress bar


@dataclass
class BenchmarkTactileConfig:
    """Options of `pneutac benchmark tactile`.

    Attributes:
        data: folder of recordings; where left out, the folder `tactile` of $PNEUTAC_DATA.
        sets: names of folders in it, joined by commas; where left out, all recordings of gels.
        methods: keys of `METHODS`, joined by commas; where left out, all.
        out: folder of the tables; rows in it that were measured on the same images are not repeated.
    """

    data: Path | None = None
    sets: str | None = None
    methods: str | None = None
    out: Path = Path("outputs/benchmark_tactile")

    def __post_init__(self):
        if self.data is None:
            if not os.environ.get("PNEUTAC_DATA"):
                raise InputError("data is not given; give the folder of recorded gels, or set PNEUTAC_DATA.")
            self.data = Path(os.environ["PNEUTAC_DATA"]) / "tactile"
        if not self.data.is_dir():
            raise InputError(f"data={self.data} is no folder; give one with a recording in each subfolder.")
        for name in self.method_keys:
            check_choice("methods", name, METHODS)

    @property
    def method_keys(self) -> list[str]:
        """Methods to compare, in the table's order."""
        given = dict.fromkeys(METHODS if self.methods is None else self.methods.split(","))
        return sorted(given, key=lambda k: list(METHODS).index(k) if k in METHODS else -1)


def benchmark_tactile(cfg: BenchmarkTactileConfig) -> None:
    """Measures what is not there yet, then prints and writes tables and pictures."""
    sets, console = find_sets(cfg.data, cfg.sets), Console()
    rows = [(s, k) for s in sets for k in cfg.method_keys if s.name in (METHODS[k].sets or [s.name])]
    pairs = [(a, b) for a in sets for b in sets if a is not b] if "model" in cfg.method_keys else []
    jobs = [(_file(cfg.out, s.name, k), s.key, METHODS[k].seconds, measure, (s, k)) for s, k in rows]
    jobs += [
        (_across_file(cfg.out, a, b), a.key + b.key, SECONDS_ACROSS, measure_across, (a, b)) for a, b in pairs
    ]
    todo = [j for j in jobs if not _done(j[0], j[1])]
    console.print(
        f"{len(sets)} sets, {len(jobs)} rows, {len(todo)} to do; Ctrl-C stops, the same command goes on",
        highlight=False,
    )
    look = TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()
    with Progress(*look, console=console, transient=True) as bar:
        task = bar.add_task("", total=sum(j[2] for j in todo))
        for file, key, seconds, work, what in todo:
            bar.update(task, description=f"{file.parent.name}, {file.stem}")
            row, thumbs = work(*what)
            _write(file, row | {"key": key}, thumbs)
            bar.advance(task, seconds)
    measured = {s.name: {} for s in sets}
    for s, k in rows:
        measured[s.name][k] = read_made(_file(cfg.out, s.name, k))
    across = [read_made(_across_file(cfg.out, a, b)) for a, b in pairs]
    write_tables(measured, across, cfg.out, console)
    for s in sets:
        thumbs = {
            k: np.load(_file(cfg.out, s.name, k).with_suffix(".npz"))["images"] for k in measured[s.name]
        }
        picture = picture_grid(s, measured[s.name], thumbs)
        picture.save(cfg.out / f"tactile_{s.name}.png", optimize=True)
        console.print(f"picture: {cfg.out / f'tactile_{s.name}.png'}", highlight=False, soft_wrap=True)


def measure(chosen: TactileSet, key: str) -> tuple[dict, np.ndarray]:
    """Fits one method to one set and scores each held-out image.

    Returns:
        Scores and times, and small pictures (n, h, w, 3) uint8.

    Raises:
        InputError: the calibration pair is not what it is said to be.
    """
    method = METHODS[key]
    began = time.process_time()
    try:
        predict = method.fit(chosen.name, chosen.data)
    except InputError as e:
        raise InputError(f"{chosen.name}, '{chosen.data.presses[0].name}': {e}") from e
    fit_s = time.process_time() - began
    predict(chosen.data.presses[0])  # compiles
    began = time.process_time()
    images = [predict(s) for s in chosen.heldout]
    image_ms = 1e3 * (time.process_time() - began) / len(images)
    row = {"fit_s": fit_s, "image_ms": image_ms, "images": _scores(chosen, images)}
    return row, np.stack([thumbnail(i) for i in images])


def measure_across(source: TactileSet, target: TactileSet) -> tuple[dict, None]:
    """Fits this model to one set and scores it on another, of which it gets the rest image or the pair.

    The two DIGITs' constants of the make are those found on the source alone.
    """
    from lerobot_pneutac.study.gel import seen_by
    from pneutac_sim.gel.photograph import Predictor

    data, pair = target.data, target.data.presses[0]
    moved = seen_by(own_gel(source.data, makes=makes_for(source.name, target.name)), data)
    own = own_gel(data, makes=makes_for(source.name, target.name))
    row = {"from": source.name, "to": target.name, "rest": _scores(target, [s.rest for s in target.heldout])}
    for name, gel, drift in (("moved", moved, []), ("drift", moved, [pair]), ("own", own, [pair])):
        predictor = Predictor(gel, drift)
        row[name] = _scores(target, [predictor.image(s.press, s.rest, s.clock) for s in target.heldout])
    return row, None


def _scores(chosen: TactileSet, images: list[np.ndarray]) -> list[dict]:
    """One entry a held-out image; the PSNR of equal images, which is infinite, is cut off."""
    out = []
    for s, image in zip(chosen.heldout, images, strict=True):
        values = asdict(score(image, s.image, s.rest, s.x_px, s.y_px, s.radius_px))
        out.append(
            {"image": s.name, "role": s.role or "others"} | values | {"psnr": min(values["psnr"], 99.0)}
        )
    return out


def _file(out: Path, name: str, key: str) -> Path:
    return out / "rows" / name / f"{key}.json"


def _across_file(out: Path, source: TactileSet, target: TactileSet) -> Path:
    return out / "across" / f"{source.name}__{target.name}.json"


def _done(file: Path, key: str) -> bool:
    return file.is_file() and read_made(file).get("key") == key


def _write(file: Path, row: dict, thumbs: np.ndarray | None) -> None:
    """The row last, so that a stopped run leaves no half of one."""
    file.parent.mkdir(parents=True, exist_ok=True)
    if thumbs is not None:
        np.savez_compressed(file.with_suffix(".npz"), images=thumbs)
    write_json(file, row)
