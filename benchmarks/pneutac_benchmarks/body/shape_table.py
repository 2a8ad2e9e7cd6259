"""The tables of `pneutac benchmark body --part=shape`: means over bodies with their standard errors."""

from pathlib import Path

import numpy as np
from rich.console import Console

from lerobot_pneutac.reports.page import write_result
from pneutac_benchmarks.tables import markdown, mean_sem, shown, terminal

OWN = "in the model's form"


def summary(bodies: list[dict]) -> dict[str, list[dict]]:
    """Rows of the three tables.

    Args:
        bodies: what `benchmark_shape.solve` returned.

    Returns:
        `shape`: a device of the model's form a row; `parameters`: of those, a parameter a row, the errors'
        magnitudes; `effects`: a hidden effect a row.
    """
    out: dict[str, list[dict]] = {"shape": [], "parameters": [], "effects": []}
    for device in dict.fromkeys(b["device"] for b in bodies if not b["hidden"]):
        mine = [b for b in bodies if b["device"] == device and not b["hidden"]]
        good = [b for b in mine if "refused" not in b]
        row = {"what": f"{device} {OWN}", "bodies": len(mine), "refused": len(mine) - len(good)}
        row |= errors(good, "before")
        row["worst_mm"] = max((max(b["before"]["tip_mm"]) for b in good), default=None)
        for name in ("iou", "rmse"):
            row[name] = mean_sem(b["heldout"][name] for b in good)
        row["seconds"] = float(np.median([b["seconds"] for b in good])) if good else None
        out["shape"].append(row)
        for name in good[0]["parameters"] if good else ():
            out["parameters"].append({"device": device} | parameter_row(name, good))
    for hidden in dict.fromkeys(b["hidden"] for b in bodies if b["hidden"]):
        mine = [b for b in bodies if b["hidden"] == hidden]
        good = [b for b in mine if "refused" not in b]
        row = {"what": hidden, "bodies": len(mine), "refused": len(mine) - len(good)}
        row["added"] = good[0].get("effect", {}).get("name", "") if good else ""
        out["effects"].append(row | {"before": errors(good, "before"), "after": errors(good, "after")})
    return out


def errors(bodies: list[dict], when: str) -> dict:
    """Tip in mm and in percent of the length, joints in degrees: mean and standard error over bodies."""
    tips = [float(np.mean(b[when]["tip_mm"])) for b in bodies]
    return {
        "tip_mm": mean_sem(tips),
        "tip_percent": mean_sem(100 * t / b["length_mm"] for t, b in zip(tips, bodies, strict=True)),
        "joints_deg": mean_sem(b[when]["joints_deg"] for b in bodies),
    }


def parameter_row(name: str, bodies: list[dict]) -> dict:
    """One parameter: mean error and magnitude of the error, how often identified and covered."""
    p = [b["parameters"][name] for b in bodies]
    off = [x["value"] - x["truth"] for x in p]
    share = [100 * d / abs(x["truth"]) if x["truth"] else None for d, x in zip(off, p, strict=True)]
    return {
        "parameter": name,
        "unit": p[0]["unit"],
        "error": mean_sem(off),
        "error_percent": mean_sem(share),
        "magnitude_percent": mean_sem(abs(s) if s is not None else None for s in share),
        "identified": sum(x["identified"] for x in p),
        "covered": sum(x["covered"] for x in p),
        "bodies": len(p),
    }


def write_tables(bodies: list[dict], out: Path, console: Console) -> dict:
    """Prints the tables, writes `tables.md` and `result.json`, and returns the content of the latter."""
    rows = summary(bodies)
    refused = [f"{b['device']} {b['seed']} {b['hidden']}: {b['refused']}" for b in bodies if "refused" in b]
    tables = [
        (
            "Calibrated from photographs, judged at pressures never seen; mean ± SEM over bodies",
            ("body", "bodies", "tip, mm", "tip, % of length", "worst, mm", "joints, deg", "IoU", "RMSE", "s"),
            [
                (r["what"], _count(r), shown(r["tip_mm"]), shown(r["tip_percent"]), _one(r["worst_mm"]),
                 shown(r["joints_deg"]), shown(r["iou"], 4), shown(r["rmse"], 1), _one(r["seconds"], 0))
                for r in rows["shape"]
            ],
        ),
        (
            "Parameters against truth",
            ("device", "parameter", "error", "error, %", "magnitude, %", "identified", "95 % covers"),
            [
                (r["device"], f"{r['parameter']} ({r['unit']})" if r["unit"] else r["parameter"],
                 shown(r["error"], 4, "+"), shown(r["error_percent"], 1, "+"),
                 shown(r["magnitude_percent"], 1), f"{r['identified']}/{r['bodies']}",
                 f"{r['covered']}/{r['bodies']}")
                for r in rows["parameters"]
            ],
        ),
        (
            "Effects hidden in the body: calibrated by images without, then added from markers",
            ("hidden", "bodies", "added", "before, mm", "before, %", "after, mm", "after, %",
             "joints before, deg", "joints after, deg"),
            [
                (r["what"], _count(r), r["added"] or "markers alone",
                 *(shown(r[k][u]) for k in ("before", "after") for u in ("tip_mm", "tip_percent")),
                 *(shown(r[k]["joints_deg"]) for k in ("before", "after")))
                for r in rows["effects"]
            ],
        ),
    ]  # fmt: skip
    lines = []
    for title, heads, cells in tables:
        if not cells:
            continue
        lines += [f"{title}:", "", *markdown(heads, cells), ""]
        console.print(terminal(title, heads, cells))
    for sentence in refused:
        console.print(f"[yellow]refused:[/] {sentence}", highlight=False)
        lines.append(f"- refused: {sentence}")
    (out / "tables.md").write_text("\n".join(lines).rstrip() + "\n")
    result = {"bodies": bodies, **rows}
    write_result(out, result)
    console.print(f"tables: {out / 'tables.md'}", highlight=False)
    return result


def _count(row: dict) -> str:
    return f"{row['bodies']} ({row['refused']} refused)" if row["refused"] else str(row["bodies"])


def _one(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
