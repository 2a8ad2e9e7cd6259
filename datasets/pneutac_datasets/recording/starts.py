"""How each trial began, if `recording.json` states it: memory (creep, hysteresis) depends on it."""

from dataclasses import dataclass
from pathlib import Path

from pneutac_datasets.recording.wording import listed, shown
from pneutac_sim.errors import InputError

STARTS = ("rested", "continues", "unknown")
EXAMPLE = '{"3": {"start": "continues", "pause_s": 12}}'


@dataclass(frozen=True)
class TrialStart:
    """In what state the device was when a trial began.

    Attributes:
        start: `rested`: lay without pressure until its memory had faded; `continues`: goes on from the trial
            before it in the table; `unknown`.
        pause_s: time without pressure since the last row of the trial before, s; None where it is not known.
    """

    start: str = "unknown"
    pause_s: float | None = None


def check_starts(meta: dict, file: Path) -> None:
    """Raises InputError where field `trials` of `recording.json` is not as documented."""
    stated = meta.get("trials")
    if stated is None:
        return
    if not isinstance(stated, dict):
        raise InputError(
            f"{file}: field 'trials' is {shown(stated)}; name trials by number, as in {EXAMPLE}."
        )
    for number, how in stated.items():
        where = f"{file}: field 'trials' of trial {shown(number)}"
        if not isinstance(how, dict) or "start" not in how or set(how) - {"start", "pause_s"}:
            raise InputError(f"{where} is {shown(how)}; give 'start' and perhaps 'pause_s', as in {EXAMPLE}.")
        start, pause = how["start"], how.get("pause_s")
        if start not in STARTS:
            raise InputError(f"{where}: 'start' is {shown(start)}; it must be one of {', '.join(STARTS)}.")
        if pause is None:
            continue
        if isinstance(pause, bool) or not isinstance(pause, int | float) or not 0 <= pause < 1e12:
            raise InputError(f"{where}: 'pause_s' is {shown(pause)}; give seconds, 0 or more.")
        if start == "rested":
            raise InputError(
                f"{where}: 'pause_s' is {pause:g} though its start is 'rested', however long that took; "
                "leave it out, or write 'continues' where the rest was too short to forget the trial before."
            )


def check_numbers(meta: dict, trials: list[int], file: Path) -> None:
    """Raises InputError where field `trials` does not fit the trials (in order) of the table."""
    stated = meta.get("trials") or {}
    names = [str(t) for t in trials]
    for number in stated:
        if number not in names:
            raise InputError(
                f"{file}: field 'trials' names trial {shown(number)}, which is not in the table; its trials "
                f"are {listed(trials)}."
            )
    if stated.get(names[0], {}).get("start") == "continues":
        raise InputError(
            f"{file}: field 'trials' lets trial {names[0]} continue, but it is the first of the table; write "
            "'rested' or 'unknown'."
        )


def starts(meta: dict, trials: list[int]) -> dict[int, TrialStart]:
    """How each of these trials began; `unknown` where it is not stated."""
    stated = meta.get("trials") or {}
    return {t: TrialStart(**stated.get(str(t), {})) for t in trials}


def meta_of_kept(meta: dict, before: list[int], kept: list[int]) -> dict:
    """The fields for a table of fewer trials; one that continued a trial which is gone starts unknown."""
    if "trials" not in meta:
        return meta
    previous = dict(zip(before[1:], before, strict=False))
    now = dict(zip(kept[1:], kept, strict=False))
    stated = {}
    for trial in kept:
        how = meta["trials"].get(str(trial))
        if how is not None:
            torn = how["start"] == "continues" and now.get(trial) != previous.get(trial)
            stated[str(trial)] = {"start": "unknown"} if torn else how
    return meta | {"trials": stated}
