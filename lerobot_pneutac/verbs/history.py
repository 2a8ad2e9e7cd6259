"""A twin with its history: as one page to send to somebody, its versions, and the way back to one of them."""

from dataclasses import dataclass
from pathlib import Path

from lerobot_pneutac.cli.terminal import Terminal
from lerobot_pneutac.diagnosis import thresholds as T
from lerobot_pneutac.diagnosis.result import CURVE_LIKE
from lerobot_pneutac.diagnosis.verdict import called
from lerobot_pneutac.reports.page import Report, span
from lerobot_pneutac.verbs.result import Result, history_of
from pneutac_datasets.recording.wording import joined
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class TwinReport(Result):
    """What a twin is and how it became so."""

    twin: Twin

    keys = (("device", "twin.device"), "sentence", "history")

    @property
    def history(self) -> list[dict]:
        return history_of(self.twin, "recording")

    @property
    def title(self) -> str:
        return f"Twin of a {self.twin.device}" + (f": {self.twin.folder.name}" if self.twin.folder else "")

    def subject(self) -> tuple[Twin, str]:
        return self.twin, (self.twin.history[-1].get("recording") or "") if self.twin.history else ""

    @property
    def sentence(self) -> str:
        twin = self.twin
        effects = joined([called(e, twin) for e in twin.effects]) if twin.effects else "no effects"
        tested = [e for e in twin.history if e.get("heldout") is not None]
        long = "" if twin.device == "gel" else f", {twin.length_mm:g} mm long"
        version = f", in version {len(twin.history) - 1}" if twin.history else ""
        text = f"A twin of a {twin.device}{long}, with {effects}{version}"
        if not tested:
            return f"{text}; it was never tested on data that it had not seen."
        last = tested[-1]
        error = f"{last['heldout']:.3g} {last.get('unit') or ''}".strip()
        return f"{text}; its test error was {error} when it was last fitted."

    def rows(self) -> list[dict]:
        shown = {"train": "training error", "heldout": "test error"}
        return [{shown.get(k, k): v for k, v in e.items()} for e in self.history]

    def described(self) -> list[str]:
        """A sentence on each effect, and one on what the recording left open of it."""
        device, out = self.twin.device, []
        for name, values in self.twin.effects.items():
            text = get_effect(name).describe({k: v.value for k, v in values.items()}, device)
            specs, open_ = {p.name: p for p in get_effect(name).parameters}, []
            for p, known in values.items():  # or its 95 % interval ends where the fit allowed no more
                if known.ci95 is None or p not in specs:
                    continue
                _, lower, upper = specs[p].limits(max(map(abs, self.twin.pressure_range_kpa)))
                near, (low, high) = T.AT_BOUND * (upper - lower), known.ci95
                if known.value in (low, high) or low <= lower + near or high >= upper - near:
                    open_.append(p)
            if open_:
                text += (
                    f" The recording does not determine {joined(open_)}, at the limit of the allowed range,"
                    " so it may compensate for something that the twin lacks."
                )
            elif name in CURVE_LIKE:
                text += " This is fitted, not measured: it may compensate for a curve that the twin lacks."
            out.append(text)
        return out

    def parameters(self) -> list[dict]:
        return [
            {"of": of, "parameter": name, "value": v.value, "95 % interval": span(v.ci95)}
            for of, values in ({"body": self.twin.parameters} | self.twin.effects).items()
            for name, v in values.items()
        ]

    def content(self) -> dict:
        return super().content() | {"effects": list(self.twin.effects), "parameters": self.parameters()}

    def page(self) -> Report:
        from lerobot_pneutac.reports.compare import history_figure  # plotly

        page, twin = self.lead_page(), self.twin
        if twin.history:
            page.heading("How it became so")
            for unit in dict.fromkeys(e["unit"] for e in self.history if e["unit"]):
                entries = [e for e in self.history if e["unit"] == unit]
                if len(entries) > 1:
                    page.figure(history_figure(entries, unit), "Errors as each version recorded them.", 340)
            page.table(self.rows())
        if twin.effects:
            page.heading("What its effects do")
            page.text("\n\n".join(self.described()))
        page.heading("Its numbers")
        page.table(self.parameters(), "Units are in the names; where no interval stands, none was fitted.")
        if "rest_image" in twin.arrays:
            page.heading("Its touch sensor without contact")
            page.image(twin.arrays["rest_image"], width=240)
        return page


def report(twin: Twin) -> TwinReport:
    """The twin with its history; nothing is changed."""
    return TwinReport(twin=twin)


def restore(folder: str | Path, version: int) -> Twin:
    """Writes an earlier version of a twin as its newest one, so that nothing is lost; returns it."""
    newest = Twin.load(folder, calibrated=False)  # going back mends one without its gain
    numbers = [e["version"] for e in newest.history]
    if version not in numbers:
        there = f"it has {', '.join(map(str, numbers))}" if numbers else "it was never fitted"
        raise InputError(f"{folder} has no version {version}; {there}.")
    if version == numbers[-1]:
        raise InputError(f"Version {version} is the newest of {folder}; give an earlier one to go back to.")
    entry, twin = newest.history[version], Twin.load(folder, version)
    twin.history = newest.history
    rest = {k: v for k, v in entry.items() if k not in ("version", "change", "recording")}
    change = f"back to version {version}: {entry['change']}"
    twin.save_version(folder, change, entry.get("recording", ""), rest)
    return twin


@dataclass
class HistoryConfig:
    """Options of `pneutac history`."""

    twin: Path  # folder of the twin
    restore: int | None = None  # version to go back to; it is written as the newest, so that nothing is lost


def command(cfg: HistoryConfig, terminal: Terminal) -> None:
    if cfg.restore is None:
        twin = Twin.load(cfg.twin, calibrated=False)
    else:
        twin = restore(cfg.twin, cfg.restore)
    terminal.show(report(twin))
    if cfg.restore is not None:
        number = twin.history[-1]["version"]
        terminal.say(f"Stored version {number} of {cfg.twin}, equal to version {cfg.restore}.")
