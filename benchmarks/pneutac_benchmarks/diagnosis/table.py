"""Scores the set `hidden`, prints its table and draws the confusion matrix."""

import math
from collections import Counter
from pathlib import Path

import numpy as np
from PIL import Image
from rich.console import Console

from lerobot_pneutac.reports.page import write_result
from pneutac_benchmarks.diagnosis import pictures
from pneutac_benchmarks.diagnosis.rules import NAMED, counts
from pneutac_benchmarks.tables import markdown, terminal
from pneutac_sim.effects.laws import family

HEADS = (
    "recordings", "right", "95 % interval", "error before, mm", "after, mm", "noise, mm",
    "avoidable error removed", "with an extra effect", "median s",
)  # fmt: skip
HIDDEN_HEADS = ("hidden", "strength", "right", "answers", "error before, mm", "after, mm", "removed")


def right(a: dict) -> bool:
    """Whether an answer counts as right.

    effect: the headline names an accepted effect. pair: both are among the effects found. none: nothing is
    found and nothing suspected. unknown: the verdict is `unknown_effect`.
    """
    if a["kind"] == "effect":
        return a["verdict"] in NAMED and counts(a["selected"][0], a["truth"]["accepts"][0])
    if a["kind"] == "pair":
        return a["verdict"] in NAMED and all(
            any(counts(s, x) for s in a["selected"]) for x in a["truth"]["accepts"]
        )
    return a["verdict"] == ("adequate" if a["kind"] == "none" else "unknown_effect")


def answered(a: dict) -> str:
    """The headline's family, or the verdict where none is named."""
    return family(a["selected"][0]) if a["verdict"] in NAMED else a["verdict"]


def extra(a: dict) -> list[str]:
    """Effects found that were not hidden."""
    accepted = [n for x in a["truth"]["accepts"] for n in x]
    return [e for e in a["selected"] if not counts(e, accepted)] if a["verdict"] in NAMED else []


def groups(answers: list[dict]) -> dict[str, list[dict]]:
    """Answers by kind and strength."""
    out: dict[str, list[dict]] = {}
    for a in answers:
        name = f"one effect, strength {a['strength']:g}" if a["kind"] == "effect" else a["kind"]
        out.setdefault(name, []).append(a)
    return out


def summary(answers: list[dict]) -> list[dict]:
    """One row a group: how many were right, with Wilson's 95 % interval, and the errors."""
    rows = []
    for name, members in groups(answers).items():
        n, k = len(members), sum(map(right, members))
        lo, hi = wilson(k, n)
        rows.append(
            {
                "group": name, "recordings": n, "right": k, "share": k / n, "ci95": [lo, hi],
                "before": float(np.mean([a["before"] for a in members])),
                "after": float(np.mean([a["after"] for a in members])),
                "noise": float(np.mean([a["noise_floor"] for a in members])),
                "removed": float(np.mean([a["reduction"] for a in members])),
                "with_extra": sum(bool(extra(a)) for a in members),
                "seconds": float(np.median([a["seconds"] for a in members])),
            }
        )  # fmt: skip
    return rows


def wilson(k: int, n: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share."""
    p, z = k / n, 1.96
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    return max(0.0, middle - half), min(1.0, middle + half)


def write_table(answers: list[dict], out: Path, console: Console) -> None:
    """Prints the table; writes `result.json`, `table.md` and `confusion.png` into `out`."""
    rows = summary(answers)
    cells = [
        (
            r["group"], f"{r['right']} of {r['recordings']}", f"{r['ci95'][0]:.0%}-{r['ci95'][1]:.0%}",
            f"{r['before']:.2f}", f"{r['after']:.2f}", f"{r['noise']:.2f}", f"{r['removed']:.0%}",
            f"{r['with_extra']}", f"{r['seconds']:.0f}",
        )
        for r in rows
    ]  # fmt: skip
    heads = ("", "right", "95 %", "error before", "after", "noise", "removed", "extra", "s")
    console.print(terminal("blind diagnosis", heads, cells))
    by_effect: dict[tuple[str, float], list[dict]] = {}
    for a in answers:
        by_effect.setdefault((a["effects"].replace(",", " + "), a["strength"]), []).append(a)
    hidden = []
    for (name, strength), members in by_effect.items():
        words = ", ".join(f"{k} {v}" for k, v in Counter(map(answered, members)).most_common())
        before, after, removed = (np.mean([a[k] for a in members]) for k in ("before", "after", "reduction"))
        count = f"{sum(map(right, members))} of {len(members)}"
        errors = f"{before:.2f}", f"{after:.2f}", f"{removed:.0%}"
        hidden.append((name, f"{strength:g}", count, words, *errors))
    lines = [*markdown(HEADS, cells), "", *markdown(HIDDEN_HEADS, hidden)]
    wrong = [a for a in answers if not right(a)]
    write_result(out, {"groups": rows, "wrong": wrong})
    (out / "table.md").write_text("\n".join(lines) + "\n")
    Image.fromarray(confusion(answers)).save(out / "confusion.png", optimize=True)
    console.print(f"table: {out / 'table.md'}, picture: {out / 'confusion.png'}", highlight=False)


def confusion(answers: list[dict]) -> np.ndarray:
    """Hidden against headline, see `pictures.confusion`; pairs are left out."""
    shown = [(a["effects"], answered(a), right(a)) for a in answers if a["kind"] != "pair"]
    return pictures.confusion(shown, ("adequate", "unknown_effect", "ambiguous"))
