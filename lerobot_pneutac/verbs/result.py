"""What the results of all verbs share: `result.json`, a report, a look in a notebook."""

import math
import shlex
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from lerobot_pneutac.cli.terminal import unmarked
from lerobot_pneutac.diagnosis.thresholds import NOISE
from lerobot_pneutac.reports.page import Report, plain, save_table, span, write_result
from pneutac_datasets.recording.pressures import usable
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.files import together, write_image
from pneutac_sim.finger.quantities import root_mean
from pneutac_sim.twin import Twin


class Result:
    """Base of the frozen dataclasses that the verbs return.

    A subclass declares what is in `result.json` (`keys`, and `content` for what is computed), a sentence, the
    rows of one short table and remarks; from these come the file, the console, a notebook and the page.
    """

    heading: ClassVar[str] = ""  # of table and report; `{0.name}` in it is an attribute of the result
    caption: ClassVar[str] = ""  # of the table on the page
    findings: tuple[str, ...] = ()  # what the checks of the recording found, one sentence each
    # of `result.json`; a pair is a key and the attribute that holds its value, with dots
    keys: ClassVar[tuple[str | tuple[str, str], ...]] = ()

    @property
    def title(self) -> str:
        return self.heading.format(self)

    @property
    def findings_shown(self) -> tuple[str, ...]:
        """What is printed before the sentence: the findings, where no remark has them."""
        return self.findings

    def subject(self) -> tuple[Twin | None, str | Path]:
        """The twin that it is about, and the recording's folder; None and empty where there is none."""
        recording = getattr(self, "recording", None) or ""
        return getattr(self, "twin", None), getattr(recording, "folder", recording)

    @property
    def next_command(self) -> str:
        """What to run next; empty where nothing follows."""
        return ""

    def next_after(self, out: Path | None) -> str:
        """What to do next, a command or a sentence, once the report lies in folder `out`, if it does."""
        return self.next_command

    def next_step(self, out: Path | None, command: str) -> str:
        """The same after a command, whose task and station of demonstrations the next one takes over."""
        following = self.next_after(out)
        given = [a for a in shlex.split(command) if a.startswith(("--task=", "--station="))]
        if given and "--recording=" in command and following.startswith("pneutac"):
            return f"{following} {shlex.join(given)}"
        return following

    @property
    def sentence(self) -> str:
        """What a reader should take away; empty where the table says it all."""
        return ""

    def rows(self) -> list[dict]:
        """The short table; each row has the same keys."""
        return []

    def remarks(self) -> list[str]:
        """What a reader should know besides the table, one sentence each."""
        return []

    def to_dict(self) -> dict:
        """The content of `result.json`: dicts, lists, texts, numbers and None."""
        return {str(k): plain(v) for k, v in self.content().items()}

    def content(self) -> dict:
        """The same, which may hold arrays, tuples, paths and dataclasses."""
        pairs = ((k, k) if isinstance(k, str) else k for k in self.keys)
        return {key: attrgetter(attribute)(self) for key, attribute in pairs}

    def page(self) -> Report:
        """The sentence, the table and the remarks; others go on from here or begin with `lead_page`."""
        page = self.lead_page()
        page.table(self.rows(), self.caption)
        for remark in self.remarks():
            page.text(unmarked(remark).plain)
        return page

    def lead_page(self) -> Report:
        page = Report(self.title)
        if self.sentence:
            page.lead(self.sentence)
        return page

    def pictures(self) -> dict[str, np.ndarray]:
        """Pictures next to the report, file name to uint8 (H, W, 3)."""
        return {}

    def tables(self) -> dict[str, list[dict] | dict]:
        """Tables next to the report, file name to rows or columns."""
        return {}

    written: ClassVar[tuple[str, ...]] = ()  # names of what `write_more` may write

    def write_more(self, folder: Path) -> None:
        """Writes what else belongs to the report."""

    def report(self, out: str | Path, command: str = "") -> Path:
        """Writes `result.json`, `report.html` and pictures into folder `out`; returns the page's path.

        They appear together: a stop leaves the report that was there before.

        Args:
            out: folder, made where there is none.
            command: that does it again, stored, and shown at the end of the page.
        """
        with together(Path(out), self.written) as folder:
            self.write_more(folder)
            write_result(folder, self.to_dict() | ({"command": command} if command else {}))
            for name, picture in self.pictures().items():
                write_image(folder / name, picture)
            for name, table in self.tables().items():
                save_table(folder / name, table)
            page = self.page()
            page.about = about(*self.subject())
            page.next_step(self.next_step(Path(out), command))
            if command:
                page.heading("Do it again")
                page.code(command)
            page.write(folder)
        return Path(out) / "report.html"

    def __repr__(self) -> str:
        """Kind and sentence; the numbers are in `to_dict`."""
        return f"<{type(self).__name__}: {self.sentence or self.title}>"

    def _repr_html_(self) -> str:
        return Result.page(self).fragment()


def about(twin: Twin | None, recording: str | Path = "") -> str:
    """Which twin in which version, and which recording, by its folder's name; empty where there is none."""
    parts = []
    if twin is not None:
        last = twin.history[-1] if twin.history else None
        version = f", version {last['version']} ({last['change']})" if last else ""
        where = f" `{twin.folder}`" if twin.folder else ""
        parts.append(f"Twin: {twin.device}{where}{version}.")
    if recording:
        parts.append(f"Recording: `{Path(recording).name}`.")
    return " ".join(parts)


def command_on(verb: str, twin: Twin, recording: str | Path, *options: str) -> str:
    """A verb's command for a twin and a recording, to copy."""
    folders = [f"--twin={twin.folder or 'TWIN'}", f"--recording={recording}"]
    return shlex.join(["pneutac", verb, *folders, *options])


def drive_command(out: Path | None) -> str:
    """The command that drives the program of a report in folder `out`; empty where there is none."""
    measure = ["pneutac", "measure", f"--program={out}/program.csv", f"--out={out}/recording"]
    return "" if out is None else shlex.join(measure)


def history_of(twin: Twin, *more: str) -> list[dict]:
    """The versions of a twin with the errors that each recorded, and `more` of its entries."""
    names = ("version", "change", "train", "heldout", "unit", *more)
    return [{k: e.get(k) for k in names} for e in twin.history]


ANOTHER_DAY = "ANOTHER_DAY"  # the recording to take next, in a command to copy


class Comparison(Result):
    """A twin against a recording."""

    twin: Twin  # that was compared
    unit: str  # of the errors
    noise_floor: float | None  # error that the measurement's own noise makes; None where it is unknown

    @property
    @abstractmethod
    def error(self) -> dict[str, float | None]:
        """Root mean square error by part, `train` and `heldout` among them; None where a part is empty."""

    @property
    @abstractmethod
    def by(self) -> dict[str, list[dict]]:
        """Under which conditions it fails: axis to one row a bin."""

    @property
    @abstractmethod
    def worst(self) -> list[dict]:
        """Where it fails most."""

    @property
    def history(self) -> list[dict]:
        return history_of(self.twin)

    @property
    def next_command(self) -> str:
        """To learn why it fails, on a recording that the twin was fitted to; to test it where noise is left.

        A recording that it was never fitted to tests it, and would no longer once it is diagnosed.
        """
        error = self.train if self.heldout is None else self.heldout
        fitted = [Path(e["recording"]) for e in self.twin.history if e.get("recording")]
        here = Path(self.subject()[1])
        tested = bool(fitted) and here.resolve() not in [p.resolve() for p in fitted]
        if self.noise_floor and error is not None and error <= NOISE * self.noise_floor:
            return "" if tested else command_on("compare", self.twin, ANOTHER_DAY)
        return command_on("diagnose", self.twin, fitted[-1] if tested else here)

    @property
    def heldout(self) -> float | None:
        return self.error["heldout"]

    @property
    def train(self) -> float | None:
        return self.error["train"]


def rms_of(squared: np.ndarray) -> float | None:
    """Root of the mean of squares (n,); None where there is none."""
    return root_mean(squared) if len(squared) else None


WORSE = 1.02  # times the error of before: closer counts as equal


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Calibration(Result):
    """A calibrated twin; subclasses hold what is particular to markers, photographs and gels."""

    twin: Twin  # the next version, not yet written
    parameters: dict[str, dict]  # name to `value`, `unit` and, of a body, `ci95` and `note`
    # `train` and `heldout` root mean square error in `unit`; None where there is no such part
    error: dict[str, float | None]
    unit: str  # of the error
    evaluations: int  # of the model
    seconds: float = 0.0  # wall time
    recording: str = ""  # what it was fitted to
    change: str  # what the twin's history says of this version
    seed: int | None = None  # decided which part was held out; None where roles did
    findings: tuple[str, ...] = ()  # of the checks, one sentence each
    saved_to: Path | None = None  # the twin's folder once it was saved

    keys = ("parameters", "error", "unit", "evaluations", "seconds", "recording")

    @property
    def reference(self) -> tuple[str, float | None]:
        """What a fit must not be worse than on test samples, and its error; None without one."""
        return "", None

    @property
    def worse(self) -> str:
        """Why the fit is not stored; empty where it is as good as its reference or better."""
        what, before = self.reference
        heldout = self.error["heldout"]
        if before is None or heldout is None or heldout <= WORSE * before:
            return ""
        both = f"the fit misses by {heldout:.3g} {self.unit}, and {what} by {before:.3g}"
        check = "if the recording is to blame, `pneutac check` lists its faults"
        return f"Nothing was stored: on test samples {both}; {check}."

    def save(self, folder: str | Path, report: Callable[[Result], object] = lambda _: None) -> Self:
        """Writes the twin as the next version of `folder`; returns the result that knows its place.

        `report` is called with that result before the version counts; where it raises, none is made.

        Raises:
            InputError: the fit is `worse` than what was there before.
        """
        if self.worse:
            raise InputError(self.worse)
        twin = self.twin.copy()
        saved = replace(self, twin=twin, saved_to=Path(folder))
        errors = {**self.error, "unit": self.unit} | ({} if self.seed is None else {"seed": self.seed})
        errors |= self._noted()
        twin.save_version(folder, self.change, self.recording, errors, lambda: report(saved))
        return saved

    def _noted(self) -> dict:
        """What the history stores of this version besides its errors."""
        return {}

    @property
    def version(self) -> int | None:
        return self.twin.history[-1]["version"] if self.saved_to else None

    @property
    def next_command(self) -> str:
        return "" if self.worse else command_on("compare", self.twin, self.recording)

    def rows(self) -> list[dict]:
        out = []
        for name, p in self.parameters.items():
            interval = "" if str(p["note"]).startswith("not identifiable") else span(p["ci95"])
            row = {"parameter": name, "value": p["value"], "95 % interval": interval}
            out.append(row | {"unit": p["unit"], "note": p["note"]})
        return out

    def content(self) -> dict:
        where = {"twin": self.saved_to, "version": self.version} if self.saved_to else {}
        return super().content() | where

    def _now(self) -> str:
        return f"; stored as version {self.version} of {self.saved_to}" if self.saved_to else ""


def measured_range(recording: Recording) -> tuple[float, float] | None:
    """Lowest and highest commanded pressure in kPa, 0 (vented) among them; None where nothing is driven.

    It ends where the supply does.
    """
    pressures = usable(recording)[0].commands
    if not pressures.size or not pressures.any():
        return None
    return 0.0 - _outwards(-min(pressures.min(), 0.0)), _outwards(max(pressures.max(), 0.0))


def range_sentence(pressure_range_kpa: tuple[float, float]) -> str:
    goes = "The recording goes from {:g} to {:g} kPa".format(*pressure_range_kpa)
    return f"{goes}; robots and environments drive the twin no farther unless `pressure_range_kpa` is given."


def _outwards(value: float) -> float:
    """The next number of two digits: valves and programs hardly ever stop at a round number."""
    if value == 0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / unit - 1e-6) * unit:.6g}")
