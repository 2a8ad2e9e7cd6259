"""Rows of the table of the networks."""

from pneutac_benchmarks.tables import markdown, mean_sem


def row(what: str, unit: str, values, without=None, goal=None, paper=None, note: str = "") -> dict:
    """A row of the table from values of independent cases (n,): their mean and its standard error.

    Args:
        what: is measured.
        unit: of it.
        values: one a case.
        without: mean of the same without the network.
        goal: what it should be.
        paper: what the paper has.
        note: more.
    """
    mean, sem = mean_sem(values)
    return {
        "what": what, "unit": unit, "mean": mean, "sem": sem, "cases": len(values),
        "without": without, "goal": goal, "paper": paper, "note": note,
    }  # fmt: skip


def table(rows: list[dict]) -> str:
    """Rows as markdown."""
    lines = []
    for r in rows:
        spread = "" if r["sem"] is None else f" ± {_short(r['sem'])}"
        cells = [
            _short(r[k]) if isinstance(r[k], float) else r[k] or "" for k in ("without", "goal", "paper")
        ]
        lines.append((r["what"], f"{_short(r['mean'])}{spread} {r['unit']}", *cells, r["note"]))
    return "\n".join(markdown(("what", "measured", "without network", "goal", "paper", ""), lines)) + "\n"


def _short(x: float) -> str:
    return f"{x:,.0f}" if abs(x) >= 100 else f"{x:.3g}"
