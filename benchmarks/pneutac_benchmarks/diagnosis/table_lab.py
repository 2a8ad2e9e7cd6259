"""The table of set `lab`: what the loop reaches on another day, and what it refuses."""

from pathlib import Path

from rich.console import Console

from lerobot_pneutac.reports.page import write_result
from pneutac_benchmarks.diagnosis.rules import COUNTS, counts
from pneutac_benchmarks.tables import markdown, terminal
from pneutac_sim.effects.laws import family

NEAR = 1.2  # times the noise on another day
HEADS = (
    "missing effect", "fingers", "other day, times the noise: before, after (median)", "within 1.2", "named",
    "same causes on both days", "absent effects refused",
)  # fmt: skip


def write_table(answers: list[dict], out: Path, console: Console) -> None:
    """Prints the table; writes `result.json` and `table.md` into `out`."""
    loops = [a for a in answers if a["kind"] == "loop"]
    other = {(a["effects"], a["seed"]): a for a in answers if a["kind"] == "friday"}
    names = list(dict.fromkeys(a["effects"] for a in loops))
    rows = [_row(n, [a for a in loops if a["effects"] == n], other) for n in names]
    rows.append(_row("all", loops, other))
    console.print(terminal("lab fingers", HEADS, rows))
    (out / "table.md").write_text("\n".join(markdown(HEADS, rows)) + "\n")
    write_result(out, {"cases": answers})


def _row(name: str, loops: list[dict], other: dict) -> tuple[str, ...]:
    tried = [t for a in loops for t in a["tried"].values()]
    ratio = [sorted(a[k] / a["floor"] for a in loops)[len(loops) // 2] for k in ("before", "after")]
    n = len(loops)
    same = [_causes(a) == _causes(other[a["effects"], a["seed"]]) for a in loops]
    return (
        name, str(n), f"{ratio[0]:.2f}, {ratio[1]:.2f}",
        f"{sum(a['after'] <= NEAR * a['floor'] for a in loops)} of {n}",
        f"{sum(any(counts(s, COUNTS[a['effects']]) for s in a['selected']) for a in loops)} of {n}",
        f"{sum(same)} of {n}", f"{sum(not t['accepted'] for t in tried)} of {len(tried)}",
    )  # fmt: skip


def _causes(answer: dict) -> set[str]:
    """What a day names: known causes and families of effects."""
    return {*answer["known"], *map(family, answer["selected"])}
