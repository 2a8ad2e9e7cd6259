"""The table of other methods on the same two days."""

from pathlib import Path

import numpy as np
from rich.console import Console

from lerobot_pneutac.reports.page import write_result
from pneutac_benchmarks.diagnosis.rules import COUNTS_AS_NEAR, COUNTS_AS_REMOVED
from pneutac_benchmarks.tables import markdown, terminal

HEADS = (
    "method",
    "90 % removed",
    "near the floor",
    "removed, median",
    "error over floor, median",
    "median s",
)


def summary(answers: list[dict]) -> list[dict]:
    """One row a method; truths without anything to remove are left out."""
    kept = [a for a in answers if any(m.get("removed") is not None for m in a["methods"].values())]
    rows = []
    for name in dict.fromkeys(n for a in kept for n in a["methods"]):
        found = [a["methods"][name] for a in kept if "skipped" not in a["methods"].get(name, {"skipped": ""})]
        if not found:
            rows.append({"method": name, "recordings": 0})
            continue
        share = [m["removed"] for m in found]
        ratio = [m["ratio"] for m in found]
        rows.append(
            {
                "method": name, "recordings": len(found),
                "removed": sum(s >= COUNTS_AS_REMOVED for s in share),
                "near": sum(r <= COUNTS_AS_NEAR for r in ratio),
                "removed_median": float(np.median(share)), "after_median": float(np.median(ratio)),
                "seconds": float(np.median([m["seconds"] for m in found])),
            }
        )  # fmt: skip
    return rows


def write_table(answers: list[dict], out: Path, console: Console) -> None:
    """Prints the table; writes `result.json` and `table.md` into `out`."""
    rows, cells = summary(answers), []
    for r in rows:
        if not r["recordings"]:
            cells.append((r["method"], "not installed", "", "", "", ""))
            continue
        n = r["recordings"]
        counted = f"{r['removed']} of {n}", f"{r['near']} of {n}", f"{r['removed_median']:.0%}"
        cells.append((r["method"], *counted, f"{r['after_median']:.2f}", f"{r['seconds']:.1f}"))
    console.print(terminal("other methods", HEADS, cells))
    out.mkdir(parents=True, exist_ok=True)
    (out / "table.md").write_text("\n".join(markdown(HEADS, cells)) + "\n")
    write_result(out, {"methods": rows, "cases": answers})
