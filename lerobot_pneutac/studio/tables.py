"""Tables of the studio."""

from lerobot_pneutac.reports.page import cell


def table(rows: list[dict]) -> str:
    """Rows of one kind as Markdown; empty where there are none."""
    if not rows:
        return ""
    head = "| " + " | ".join(map(str, rows[0])) + " |\n|" + "---|" * len(rows[0])
    return "\n".join([head, *("| " + " | ".join(cell(v) for v in row.values()) + " |" for row in rows)])
