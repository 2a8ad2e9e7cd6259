"""Tables, learning curves and the report of the policy benchmark."""

from importlib.metadata import version
from pathlib import Path

import numpy as np
from rich.console import Console

from lerobot_pneutac.reports.page import Report, write_result
from pneutac_benchmarks.policy.plan import COMPARED, CONDITIONS, Condition, conditions
from pneutac_benchmarks.tables import markdown, mean_sem, shown, terminal

PACKAGES = ("lerobot", "lerobot_robot_pneutac", "torch", "mujoco", "stable-baselines3")


def success(cfg, done: dict[str, dict], name: str) -> dict[str, dict | None]:
    """Success of a condition.

    Args:
        cfg: BenchmarkPolicyConfig.
        done: unit name to `unit.json`.
        name: of the condition.

    Returns:
        task, and `overall`, to `mean` and `sem` in percent and `seeds`, their number; None where there is no
        number. `overall` is over the seeds for which all tasks have one.
    """

    def of(task: str, seed: int) -> float | None:
        unit = done.get(f"{task}/{seed}/{name}_trials")
        return unit and unit["result"]["success_percent"]

    values = {task: [of(task, seed) for seed in cfg.seeds] for task in cfg.tasks}
    whole = [v for v in zip(*values.values(), strict=True) if None not in v]
    values["overall"] = [float(np.mean(v)) for v in whole]
    out = {}
    for task, found in values.items():
        found = [x for x in found if x is not None]
        mean, sem = mean_sem(found)
        out[task] = {"mean": mean, "sem": sem, "seeds": len(found)} if found else None
    return out


def rows(cfg, done: dict[str, dict], chosen: dict[str, Condition]) -> list[dict]:
    """A row a condition, as text."""
    out = []
    for name, condition in chosen.items():
        cells = success(cfg, done, name)
        row = {"condition": name, "trained on": condition.words}
        out.append(row | {task: _cell(cell, len(cfg.seeds)) for task, cell in cells.items()})
    return out


def write(cfg, done: dict[str, dict], failed: dict[str, str], wall_s: float, console: Console) -> Path:
    """Prints the tables; writes `result.json`, `table.md` and the report, whose path it returns."""
    chosen = conditions(cfg)
    parts = {
        "Success on the stand-in, %": {name: CONDITIONS[name] for name in cfg.conditions},
        "Before and after the twin was corrected, %": COMPARED if cfg.twin_before else {},
    }
    tables = {title: rows(cfg, done, part) for title, part in parts.items() if part}
    note = (
        f"Mean and standard error over {len(cfg.seeds)} seeds, {cfg.trials} trials each;"
        f" {cfg.demonstrations} demonstrations on the stand-in, {cfg.augmented} augmented,"
        f" {cfg.pretrain_updates} + {cfg.finetune_updates} updates of {cfg.batch} samples for each."
    )
    text = []
    for title, table in tables.items():
        heads, cells = list(table[0]), [row.values() for row in table]
        console.print(terminal(title, heads, cells, left=2))
        text += [f"{title}:", "", *markdown(heads, cells), ""]
    text += [note, *(f"- {name}: {why}" for name, why in failed.items())]
    (cfg.out / "table.md").write_text("\n".join(text) + "\n")
    found = {name: success(cfg, done, name) for name in chosen}
    write_result(
        cfg.out,
        {
            "versions": {name: version(name) for name in PACKAGES},
            "options": dict(vars(cfg)),
            "success": found,
            "failures": failed,
            "wall_s": wall_s,
            "units": done,
        },
    )
    report = Report("Policies on the stand-in")
    report.text(note)
    for title, table in tables.items():
        report.heading(title)
        report.table(table)
        report.figure(_bars(cfg, parts[title], found), title)
    if failed:
        report.heading("What could not be done")
        report.table([{"unit": name, "why": why} for name, why in failed.items()])
    report.heading("Learning curves")
    for task in cfg.tasks:
        report.figure(_curves(cfg, done, task, chosen), f"{task}: loss on the last data")
    report.heading("Seconds")
    report.table(_seconds(done))
    return report.write(cfg.out)


def _cell(cell: dict | None, seeds: int) -> str:
    if cell is None:
        return "-"
    text = shown((cell["mean"], cell["sem"]), 0)
    return text if cell["seeds"] == seeds else f"{text} ({cell['seeds']} of {seeds} seeds)"


def _bars(cfg, part: dict[str, Condition], found: dict[str, dict]):
    """Success with its standard error: a group a task, a bar a condition."""
    import plotly.graph_objects as go

    figure = go.Figure()
    groups = [*cfg.tasks, "overall"]
    for name, condition in part.items():
        cells = [found[name][group] for group in groups]
        figure.add_bar(
            x=groups,
            y=[cell and cell["mean"] for cell in cells],
            error_y={"array": [cell and cell["sem"] for cell in cells], "thickness": 1},
            name=condition.words,
        )
    figure.update_layout(yaxis_title="success on the stand-in, %", yaxis_range=[0, 100])
    return figure


def _curves(cfg, done: dict[str, dict], task: str, chosen: dict[str, Condition]):
    """Loss against all updates so far, on what is held out if anything is; a line a condition and seed."""
    import plotly.graph_objects as go
    from plotly.colors import qualitative

    figure = go.Figure()
    for colour, name in zip(qualitative.Dark24, chosen, strict=False):
        for seed in cfg.seeds:
            unit = done.get(f"{task}/{seed}/{name}_policy")
            if unit is None:
                continue
            curve = unit["result"]["training"]["curve"]
            before = cfg.pretrain_updates if "pretraining" in unit["result"] else 0
            figure.add_scatter(
                x=[before + row["update"] for row in curve],
                y=[row.get("held_out", row["loss"]) for row in curve],
                name=name,
                legendgroup=name,
                showlegend=seed == cfg.seeds[0],
                line={"color": colour},
            )
    figure.update_layout(xaxis_title="update", yaxis_title="loss, mm² + kPa²", yaxis_type="log")
    return figure


def _seconds(done: dict[str, dict]) -> list[dict]:
    """A row a kind of unit."""
    kinds: dict[str, list[float]] = {}
    for found in done.values():
        kinds.setdefault(found["unit"]["kind"], []).append(found["seconds"])
    return [
        {"unit": kind, "number": len(s), "seconds each": sum(s) / len(s), "seconds in all": sum(s)}
        for kind, s in kinds.items()
    ]
