"""Scores truths by the rules, prints the tables, draws the confusion matrix and the ladder of errors."""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from PIL import Image
from rich.console import Console
from scipy.stats import binomtest

from lerobot_pneutac.reports.page import write_result
from pneutac_benchmarks.diagnosis import pictures
from pneutac_benchmarks.diagnosis.answers import show
from pneutac_benchmarks.diagnosis.rules import (
    COUNTS_AS_NEAR,
    COUNTS_AS_REMOVED,
    NAMED,
    names_right,
    names_too_much,
)
from pneutac_benchmarks.tables import markdown, terminal
from pneutac_sim.effects.laws import family

HEADS = (
    "device, kind", "recordings", "90 % removed", "near the floor", "right physics", "95 % interval",
    "named too much", "removed, median", "error over floor: before", "after, median", "median s",
)  # fmt: skip
EACH = ("truth", "device", "90 % removed", "near", "right physics", "removed", "before", "after", "answers")
SILENT = ("adequate", "unknown_effect", "ambiguous")


def score(a: dict) -> dict[str, bool]:
    """The counts of one answer.

    Returns:
        `removed` (True also where there was nothing to remove and nothing was spoilt), `near`, `right` and
        `too_much`.
    """
    disturbance = [t for t in a["truth"] if t not in a["physics"]]
    extra = names_too_much(disturbance, a["physics"], a["selected"])
    near = a["ratio"] <= COUNTS_AS_NEAR
    right = names_right(a["physics"], a["verdict"], a["selected"], a["ratio"])
    if not a["physics"]:  # plain, or a disturbance alone: quiet but for the measurement
        right = not extra
    gone = near if a["removed"] is None else a["removed"] >= COUNTS_AS_REMOVED
    return {"removed": gone, "near": near, "right": right, "too_much": bool(extra)}


def answered(a: dict) -> str:
    """The headline's family, or the verdict where none is named."""
    return family(a["selected"][0]) if a["verdict"] in NAMED and a["selected"] else a["verdict"]


def groups(answers: Iterable[dict]) -> dict[str, list[dict]]:
    """Answers by device and kind; a disturbance without any physics is a kind of its own."""
    out: dict[str, list[dict]] = {}
    for a in answers:
        kind = "disturbance" if a["kind"] == "effect" and not a["physics"] else a["kind"]
        out.setdefault(f"{a['device']}, {kind}", []).append(a)
    return out


def summary(answers: list[dict]) -> list[dict]:
    """One row a group."""
    rows = []
    for name, members in groups(answers).items():
        scores = [score(a) for a in members]
        sums = {k: sum(s[k] for s in scores) for k in scores[0]}
        interval = binomtest(sums["right"], len(members)).proportion_ci(method="wilson")
        shares = [a["removed"] for a in members if a["removed"] is not None]
        rows.append(
            {
                "group": name, "recordings": len(members), **sums,
                "right_ci95": [float(interval.low), float(interval.high)],
                "removed_median": float(np.median(shares)) if shares else None,
                "before_median": float(np.median([_before(a) for a in members])),
                "after_median": float(np.median([a["ratio"] for a in members])),
                "seconds": float(np.median([a["seconds"] for a in members])),
            }
        )  # fmt: skip
    return rows


def _before(a: dict) -> float:
    return min(a["before"], a["constant"]) / a["floor"]


def write_table(answers: list[dict], out: Path, console: Console) -> None:
    """Prints the tables; writes `result.json`, `table.md`, `confusion.png` and `ladder.png` into `out`."""
    rows = summary(answers)
    cells = [
        (
            r["group"], f"{r['recordings']}", f"{r['removed']}", f"{r['near']}", f"{r['right']}",
            "{:.0%}-{:.0%}".format(*r["right_ci95"]), f"{r['too_much']}", _percent(r["removed_median"]),
            f"{r['before_median']:.1f}", f"{r['after_median']:.2f}", f"{r['seconds']:.0f}",
        )
        for r in rows
    ]  # fmt: skip
    console.print(terminal(f"diagnosis, {answers[0]['set']}", HEADS, cells))
    show(answers, console)
    lines = [*markdown(HEADS, cells), "", *markdown(EACH, each(answers))]
    out.mkdir(parents=True, exist_ok=True)
    (out / "table.md").write_text("\n".join(lines) + "\n")
    write_result(
        out, {"groups": rows, "cases": [a | score(a) | {"share_removed": a["removed"]} for a in answers]}
    )
    single = [a for a in answers if a["kind"] not in ("pair", "device")]
    if single:
        pairs = [(a["effects"], answered(a), score(a)["right"]) for a in single]
        Image.fromarray(pictures.confusion(pairs, SILENT)).save(out / "confusion.png", optimize=True)
    steps = [
        (f"{name}, {device}", _median(members, _before), _median(members, lambda a: a["ratio"]))
        for (name, device), members in _by_truth(answers).items()
    ]
    Image.fromarray(pictures.ladder(steps, COUNTS_AS_NEAR)).save(out / "ladder.png", optimize=True)
    console.print(f"tables: {out / 'table.md'}; pictures beside it", highlight=False)


def each(answers: list[dict]) -> list[tuple[str, ...]]:
    """One row a truth and device."""
    out = []
    for (name, device), members in _by_truth(answers).items():
        scores = [score(a) for a in members]
        counted = [f"{sum(s[k] for s in scores)} of {len(members)}" for k in ("removed", "near", "right")]
        shares = [a["removed"] for a in members if a["removed"] is not None]
        words = ", ".join(f"{k} {v}" for k, v in Counter(map(answered, members)).most_common())
        before, after = _median(members, _before), _median(members, lambda a: a["ratio"])
        gone = _percent(float(np.median(shares)) if shares else None)
        out.append((name, device, *counted, gone, f"{before:.1f}", f"{after:.2f}", words))
    return out


def _by_truth(answers: Iterable[dict]) -> dict[tuple[str, str], list[dict]]:
    out: dict[tuple[str, str], list[dict]] = {}
    for a in answers:
        out.setdefault((a["effects"], a["device"]), []).append(a)
    return out


def _median(members: list[dict], value) -> float:
    return float(np.median([value(a) for a in members]))


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{share:.0%}"
