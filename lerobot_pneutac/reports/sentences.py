"""What was found, in words that a newcomer understands."""

import numpy as np

from lerobot_pneutac.diagnosis.experiment import Separation, separations
from lerobot_pneutac.diagnosis.pneumatics import sensor_noise
from lerobot_pneutac.diagnosis.result import BodyFindings
from lerobot_pneutac.study.pair import LONGER
from pneutac_sim.effects.registry import get_effect

REPEAT = "Run the same program twice, an hour apart: what comes back is the device, what does not is the lab."


def lead(d: BodyFindings) -> str:
    """The one sentence (or two) at the top."""
    device, unit = d.recording.device, d.noise.unit
    e = d.evidence
    if d.verdict == "adequate":
        return (
            f"Nothing is missing that this recording could show: the {device}'s error of {d.after_error:.3g} "
            f"{unit} is the noise of the measurement ({d.noise.value:.3g} {unit})."
        )
    if d.verdict == "ambiguous":
        if not e.moves:
            return (
                "This recording cannot tell: the commanded pressure never moves, so nothing about bending "
                "can be learnt from it."
            )
        if e.poor:
            return (
                f"This recording is too short to tell anything: {e.samples} samples to fit and {e.units} "
                "pieces of time to test on."
            )
        return (
            f"This recording cannot tell what is missing: {_names(e.near_miss)} would help, but the fall of "
            "the error may be chance."
        )
    if d.verdict == "unknown_effect":
        tried = (
            f" The best that the library offers, {_names(d.selected)}, removes {_percent(d)} of it."
            if d.selected
            else " No effect in the library makes it smaller."
        )
        return (
            f"Something that no known effect describes moves your {device}: an error of "
            f"{d.after_error:.3g} {unit} stays where the noise is {d.noise.value:.3g} {unit}." + tried
        )
    first = get_effect(d.selected[0])
    values = {k: v.value for k, v in d.twin.effects[first.name].items()}
    text = (
        first.describe(values, device)
        + f" Adding {_names(d.selected)} removes {_percent(d)} of the avoidable error."
    )
    rivals = sorted({r.rival for r in d.rivals if r.effect == first.name})
    if rivals:
        text += f" As far as this recording can tell it may be {' or '.join(rivals)} instead."
    if d.verdict == "insufficient_form":
        text += (
            f" Its form is not the whole truth: {d.after_error:.3g} {unit} stay where the noise is "
            f"{d.noise.value:.3g} {unit}."
        )
    return text


def caveats(d: BodyFindings) -> list[str]:
    """What the reader must know beside the verdict."""
    said = []
    if d.measured_pressure and d.pressure_error:
        before, after, noise = d.pressure_error
        said.append(
            f"The measured pressure tells air from body: the command misses it by {before:.3g} kPa, the "
            f"modelled air by {after:.3g} kPa, and its noise is {noise:.2g} kPa."
        )
    elif not d.measured_pressure:
        said.append(_no_pressure(d))
    if d.evidence.at_bound:
        said.append(f"At a bound, so the form is not right there: {', '.join(d.evidence.at_bound)}.")
    if not d.parts.has_test:
        said.append(
            "The recording is too short for a part of its own for the report; the errors are optimistic."
        )
    return said


def _no_pressure(d: BodyFindings) -> str:
    """Why the measured pressure tells nothing, and what follows."""
    logged = [c.replace("cmd_", "") for c in d.recording.pressure_columns]
    hidden = "so a slow valve and a creeping body hide each other: a lag may be creep in part."
    if not all(map(d.recording.has, logged)):
        return f"The pressure was not measured, {hidden} Log {', '.join(logged)} to tell them apart."
    if d.evidence.moves:
        return f"The measured pressure hardly moves while the command does, so it was left aside, {hidden}"
    moved = max(np.ptp(d.recording.column(c)) for c in logged)
    if moved > max(1e-3, 10 * sensor_noise(d.recording, logged)):
        return (
            "The measured pressure moves although the commanded one never does, so the model had nothing to "
            "follow: check that pressure_cmd_kpa is what was asked for."
        )
    return "The measured pressure does not move either."


def how_tested(d: BodyFindings) -> str:
    """On what the candidates were tried, and why some kind is not among them."""
    if not d.measured_pressure:
        said = "Without a usable measured pressure, effects of air and body are tried on the pose alike."
        return said if d.tested else f"{said} {_NONE_TRIED.format('effect', 'pose')}"
    said = (
        "As the pressure was measured, effects of the air are tried on it, and all others on the pose, "
        "driven by the measured pressure."
    )
    on_pressure = [t.tested_by == "measured pressure" for t in d.tested]
    if not any(on_pressure):
        said += " " + _NONE_TRIED.format("effect of the air", "measured pressure")
    if all(on_pressure):
        said += " " + _NONE_TRIED.format("other effect", "pose")
    return said


_NONE_TRIED = "No {} was tried: the twin as it is leaves nothing of the {} that would be worth one."


def next_experiment(d: BodyFindings) -> tuple[str, Separation | None]:
    """What to record next, and the predictions behind it where two models compete."""
    if d.evidence.poor:
        return LONGER, None
    if d.rivals:
        r = d.rivals[0]
        best = separations(d.recording, r.winner.twin, r.fit.twin, d.noise.value, (r.effect, r.rival))
        if best:
            return f"To tell {r.effect} from {r.rival}: {best[0].advice}", best[0]
    if d.verdict == "unknown_effect":
        return REPEAT, None
    hints = d.selected or d.evidence.near_miss
    if d.verdict in ("ambiguous", "insufficient_form") and hints:
        return f"To see {hints[0]} alone: {get_effect(hints[0]).experiment}", None
    if d.verdict == "missing_effect":
        return f"To confirm {hints[0]}: {get_effect(hints[0]).experiment}", None
    return "Nothing needs to be recorded; go to higher pressure to find where the twin ends.", None


def _percent(d: BodyFindings) -> str:
    return percent(*d.removed)


def percent(share: float, interval: tuple[float, float]) -> str:
    """`87 % [81 to 92]`; the interval is left out where it rounds to the number itself."""
    value, lo, hi = (round(100 * x) for x in (share, *interval))
    return f"{value} %" if lo == value == hi else f"{value} % [{lo} to {hi}]"


def _names(names: list[str]) -> str:
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]
