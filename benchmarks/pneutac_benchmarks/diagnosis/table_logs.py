"""The tables of ordinary logs: what was named where nothing is hidden, and found where something is."""

from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from lerobot_pneutac.reports.page import write_result
from pneutac_benchmarks.tables import markdown, terminal

WITHIN = 0.2  # of the true noise
LONG_S, QUICK_HZ = 2.0, 10
HEADS = (
    "logs", "count", "something named", "crashed", "unknown_effect", "floor unknown",
    "floor within 20 %, holds of 2 s or repeats", "median s",
)  # fmt: skip
EFFECT_HEADS = ("effect", "count", "found", "named otherwise", "not determinable", "missed", "crashed")


def write_table(answers: list[dict], out: Path, console: Console) -> None:
    """Prints both tables; writes `result.json` and `table.md` into `out`."""
    plain = [a for a in answers if a["kind"] == "plain"]
    effect = [a for a in answers if a["kind"] == "effect"]
    rows = [_plain("all plain", plain)]
    for name, of in LEVELS.items():
        for level in sorted({of(a) for a in plain}):
            rows.append(_plain(f"{name} {level}", [a for a in plain if of(a) == level]))
    found = []
    for judged, heading in ((True, "10 Hz or more, holds of 2 s or more"), (False, "slower or shorter")):
        group = [a for a in effect if _easy(a) == judged]
        for name in dict.fromkeys(a["effects"] for a in group):
            found.append(_effect(f"{name}, {heading}", [a for a in group if a["effects"] == name]))
        found.append(_effect(f"all, {heading}", group))
    console.print(terminal("plain logs", HEADS, rows))
    console.print(terminal("logs with an effect of five times the noise", EFFECT_HEADS, found))
    out.mkdir(parents=True, exist_ok=True)
    lines = [*markdown(HEADS, rows), "", *markdown(EFFECT_HEADS, found)]
    (out / "table.md").write_text("\n".join(lines) + "\n")
    write_result(out, {"cases": answers})


LEVELS: dict[str, Callable[[dict], float | str]] = {
    "Hz": lambda a: a["log"]["hz"],
    "hold, s": lambda a: a["log"]["hold_s"],
    "program": lambda a: a["log"]["program"],
    "trials": lambda a: a["log"]["trials"],
    **{
        k: (lambda a, k=k: "yes" if a["log"][k] else "no")
        for k in ("repeats", "gauge", "sent", "stated", "tips", "jitter")
    },
}


def _easy(a: dict) -> bool:
    return a["log"]["hz"] >= QUICK_HZ and a["log"]["hold_s"] >= LONG_S


def _plain(name: str, group: list[dict]) -> tuple[str, ...]:
    done = [a for a in group if "crash" not in a]
    judged = [a for a in done if a["log"]["hold_s"] >= LONG_S or a["log"]["repeats"]]
    close = [a for a in judged if a["floor"] is not None and abs(a["floor"] / a["noise"] - 1) <= WITHIN]
    seconds = sorted(a["seconds"] for a in done) or [0.0]
    return (
        name, str(len(group)), str(sum(bool(a["selected"]) for a in done)), str(len(group) - len(done)),
        str(sum(a["verdict"] == "unknown_effect" for a in done)), str(sum(a["floor"] is None for a in done)),
        f"{len(close)} of {len(judged)}", f"{seconds[len(seconds) // 2]:.0f}",
    )  # fmt: skip


def _effect(name: str, group: list[dict]) -> tuple[str, ...]:
    done = [a for a in group if "crash" not in a]
    found = [a for a in done if a["right"]]
    other = [a for a in done if a["selected"] and not a["right"]]
    open_ = [a for a in done if not a["selected"] and a["verdict"] != "adequate"]
    missed = [a for a in done if not a["selected"] and a["verdict"] == "adequate"]
    counts = (group, found, other, open_, missed)
    return (name, *(str(len(x)) for x in counts), str(len(group) - len(done)))
