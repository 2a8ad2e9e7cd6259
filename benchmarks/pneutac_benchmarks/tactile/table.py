"""Means and standard errors of the tactile benchmark, its tables, and where other methods come out ahead."""

from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from lerobot_pneutac.reports.page import write_result
from pneutac_benchmarks.tables import markdown, mean_sem, shown
from pneutac_benchmarks.tactile.methods import METHODS

# score -> heading, decimals
SCORES = {
    "rmse": ("RMSE", 2),
    "psnr": ("PSNR, dB", 2),
    "ncc": ("NCC", 3),
    "contact_rmse": ("contact RMSE", 2),
    "contact_dncc": ("contact dNCC", 3),
}
ACROSS = {
    "rest": "rest image alone",
    "moved": "the other's fit",
    "drift": "and half the drift",
    "own": "its own fit",
}


def by_role(images: list[dict]) -> dict[str, dict[str, list]]:
    """Role to score to mean and standard error over its images."""
    roles = dict.fromkeys(i["role"] for i in images)
    return {r: {k: mean_sem([i[k] for i in images if i["role"] == r]) for k in SCORES} for r in roles}


def ahead(rows: dict[str, dict]) -> list[dict]:
    """Where a method not ours has a lower error than this model, with the paired standard error.

    Args:
        rows: method key to row of one set.

    Returns:
        One entry a method, role and score: by how many levels it is ahead.
    """
    out = []
    for key, row in rows.items() if "model" in rows else ():
        if METHODS[key].ours or METHODS[key].name.startswith(METHODS["model"].name):
            continue
        pairs = list(zip(rows["model"]["images"], row["images"], strict=True))
        for role in dict.fromkeys(i["role"] for i in row["images"]):
            for score in ("rmse", "contact_rmse"):
                by, sem = mean_sem([a[score] - b[score] for a, b in pairs if b["role"] == role])
                if by > 0:
                    out.append({"method": METHODS[key].name, "role": role, "score": score, "by": [by, sem]})
    return out


def summary(measured: dict[str, dict[str, dict]], across: list[dict]) -> dict:
    """Content of `result.json` from set -> method key -> row, and the rows across sets."""
    sets = {}
    for name, rows in measured.items():
        images = next(iter(rows.values()))["images"]
        roles = [i["role"] for i in images]
        sets[name] = {
            "images": {r: roles.count(r) for r in dict.fromkeys(roles)},
            "methods": {METHODS[k].name: by_role(row["images"]) for k, row in rows.items()},
            "times": {METHODS[k].name: {t: row[t] for t in ("fit_s", "image_ms")} for k, row in rows.items()},
            "ahead_of_ours": ahead(rows),
        }
    moved = [
        {"from": r["from"], "to": r["to"]}
        | {
            how: {k: mean_sem([i[k] for i in r[how]]) for k in ("rmse", "contact_rmse", "contact_dncc")}
            for how in ACROSS
        }
        for r in across
    ]
    return {"unit": "levels", "sets": sets, "across": moved}


def set_table(content: dict) -> list[list[str]]:
    """Cells of one set's table, heading first: method, role and images, scores, times."""
    out = [["images", "method", *(h for h, _ in SCORES.values()), "fit, s", "ms an image"]]
    for role, n in content["images"].items():
        for method, roles in content["methods"].items():
            t = content["times"][method]
            cells = [shown(roles[role][k], d) for k, (_, d) in SCORES.items()]
            out.append([f"{role} ({n})", method, *cells, f"{t['fit_s']:.1f}", f"{t['image_ms']:.1f}"])
    return out


def across_table(across: list[dict]) -> list[list[str]]:
    """Cells of the table across sets, heading first; RMSE / contact RMSE."""
    out = [["fitted to", "scored on", *ACROSS.values()]]
    for r in across:
        cells = [f"{shown(r[h]['rmse'], 1)} / {shown(r[h]['contact_rmse'], 1)}" for h in ACROSS]
        out.append([r["from"], r["to"], *cells])
    return out


def sentences(content: dict) -> list[str]:
    """Where ours is not the best, in words."""
    return [
        f"{a['method']} is ahead of this model on '{a['role']}' by {shown(a['by'], 2)} levels of "
        f"{SCORES[a['score']][0]} (paired)."
        for a in content["ahead_of_ours"]
    ]


def write_tables(measured: dict, across: list[dict], out: Path, console: Console) -> dict:
    """Prints the tables, writes `table.md` and `result.json`.

    Args:
        measured: set -> method key -> row of `benchmark_tactile.measure`.
        across: rows of `benchmark_tactile.measure_across`.
        out: folder.
        console: where the tables go.

    Returns:
        The content of `result.json`.
    """
    result, lines = summary(measured, across), []
    ours = {m.name for m in METHODS.values() if m.ours}
    for name, content in result["sets"].items():
        cells = set_table(content)
        _print(f"{name}: mean ± standard error, 8-bit levels", cells, ours, console)
        lines += [f"## {name}", "", *_markdown(cells, ours), ""]
        found = sentences(content)
        lines += [f"- {s}" for s in found] + [""] * bool(found)
        for s in found:
            console.print(s, highlight=False)
    if result["across"]:
        cells = across_table(result["across"])
        _print("This model across sets: RMSE / contact RMSE", cells, set(), console)
        lines += ["## Across sets", "", *_markdown(cells, set()), ""]
    write_result(out, result)
    (out / "table.md").write_text("\n".join(lines))
    console.print(f"table: {out / 'table.md'}", highlight=False, soft_wrap=True)
    return result


def _print(title: str, cells: list[list[str]], bold: set[str], console: Console) -> None:
    """The first column's entries become headings of their own, which saves width."""
    table, last = Table(title=title, box=box.SIMPLE, pad_edge=False, collapse_padding=True), None
    table.add_column(cells[0][1], no_wrap=True)
    for head in cells[0][2:]:
        table.add_column(head, justify="right")
    for first, name, *rest in cells[1:]:
        if first != last:
            table.add_section()
            table.add_row(f"[dim]{cells[0][0]}: {first}[/]")
            last = first
        table.add_row(name, *rest, style="bold" if name in bold else None)
    console.print(table)


def _markdown(cells: list[list[str]], bold: set[str]) -> list[str]:
    rows = [[r[0], *(f"**{c}**" for c in r[1:])] if r[1] in bold else r for r in cells[1:]]
    return markdown(cells[0], rows)
