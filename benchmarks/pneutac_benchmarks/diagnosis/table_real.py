"""The table of real recordings."""

from pathlib import Path

import numpy as np
from rich.console import Console

from lerobot_pneutac.reports.page import write_result
from pneutac_benchmarks.tables import markdown, terminal
from pneutac_sim.effects.laws import family


def write_table(answers: list[dict], out: Path, console: Console) -> None:
    """Prints the table; writes `result.json` and `table.md` into `out`."""
    boxes = list(dict.fromkeys(m for a in answers for m in a["methods"]))
    heads = ("recording", "judged on", "found", "verdict", "before", "after", *boxes)
    by: dict[tuple[str, str], list[dict]] = {}
    for a in answers:
        by.setdefault((a["effects"], a["kind"]), []).append(a)
    cells = []
    for (name, kind), members in by.items():
        found = "; ".join(dict.fromkeys(" + ".join(map(family, a["selected"])) or "nothing" for a in members))
        verdicts = ", ".join(dict.fromkeys(a["verdict"] for a in members))
        unit = members[0]["unit"]
        errors = [f"{_shown([a[k] for a in members])} {unit}" for k in ("before", "after")]
        others = [_shown([a["methods"][b] for a in members]) for b in boxes]
        judged = f"test blocks, {len(members)} splits" if kind == "blocks" else "the last 40 %"
        cells.append((name, judged, found, verdicts, *errors, *others))
    console.print(terminal("real recordings", heads, cells))
    out.mkdir(parents=True, exist_ok=True)
    (out / "table.md").write_text("\n".join(markdown(heads, cells)) + "\n")
    write_result(out, {"cases": answers})


def _shown(values: list[float | None]) -> str:
    """Median, and the span where there are several; `-` where a method is not installed."""
    known = [v for v in values if v is not None]
    if not known:
        return "-"
    span = f" ({min(known):.3g}-{max(known):.3g})" if len(known) > 1 else ""
    return f"{np.median(known):.3g}{span}"
