"""Tables, learning curves and the report of the policy benchmark."""

from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from rich.console import Console
from scipy.stats import binomtest

from lerobot_pneutac.reports.page import Report, write_result
from pneutac_benchmarks.policy.plan import COMPARED, CONDITIONS, Condition, conditions
from pneutac_benchmarks.tables import markdown, mean_sem, terminal

PACKAGES = ("lerobot", "lerobot_robot_pneutac", "torch", "mujoco", "stable-baselines3")
RESAMPLED = 4000
BASE = "real"

Trials = dict[int, dict[int, dict]]  # seed to start to trial


def trials_of(cfg, done: dict[str, dict], name: str, task: str) -> Trials:
    """All trials of a condition in a task that are there."""
    found: Trials = {}
    for seed in cfg.seeds:
        at = f"{task}/{seed}/{name}_trials_"
        for unit, what in done.items():
            if unit.startswith(at):
                found.setdefault(seed, {}).update({t["start"]: t for t in what["result"]["trials"]})
    return found


def _rate(trials: Trials) -> dict | None:
    """Mean success of the sets in percent, with Wilson's 95 % interval for as many trials."""
    if not trials:
        return None
    sets = [100 * float(np.mean([t["success"] for t in starts.values()])) for starts in trials.values()]
    n, mean = sum(map(len, trials.values())), float(np.mean(sets))
    low, high = binomtest(round(mean / 100 * n), n).proportion_ci(method="wilson")
    found = {"mean": mean, "low": 100 * low, "high": 100 * high, "sem": mean_sem(sets)[1]}
    return found | {"trials": n, "seeds": len(trials)}


def success(cfg, done: dict[str, dict], name: str) -> dict[str, dict | None]:
    """Success of a condition.

    Args:
        cfg: BenchmarkPolicyConfig.
        done: unit name to `unit.json`.
        name: of the condition.

    Returns:
        task to `mean`, `low` and `high` in percent, the numbers of `trials` and `seeds`, and `sem` over the
        seeds; None where there is no number. `overall` is the mean of the tasks, with `trials` of all.
    """
    out = {task: _rate(trials_of(cfg, done, name, task)) for task in cfg.tasks}
    cells = list(out.values())
    out["overall"] = None
    if cells and all(cells):
        mean, n = float(np.mean([c["mean"] for c in cells])), sum(c["trials"] for c in cells)
        out["overall"] = {"mean": mean, "trials": n, "seeds": min(c["seeds"] for c in cells)}
    return out


def difference(cfg, done: dict[str, dict], name: str, base: str) -> dict[str, dict] | None:
    """Success of a condition less that of another, over the starts that both were tried from, in points.

    The 95 % interval resamples sets of demonstrations and, in each, starts.

    Returns:
        task, and `overall`, the mean of the tasks, to `mean`, `low`, `high` and `pairs`; None where a task
        has no pair.
    """
    rng, drawn, out = np.random.default_rng(0), [], {}
    for task in cfg.tasks:
        a, b = (trials_of(cfg, done, which, task) for which in (name, base))
        sets = []
        for seed in sorted(a.keys() & b.keys()):
            common = sorted(a[seed].keys() & b[seed].keys())
            points = [float(a[seed][s]["success"]) - float(b[seed][s]["success"]) for s in common]
            sets += [100 * np.array(points)] if points else []
        if not sets:
            return None
        means = np.array([_again(sets, rng) for _ in range(RESAMPLED)])
        drawn.append(means)
        out[task] = _interval(float(np.mean([x.mean() for x in sets])), means) | {
            "pairs": sum(map(len, sets))
        }
    every = _interval(float(np.mean([out[t]["mean"] for t in cfg.tasks])), np.mean(drawn, 0))
    return out | {"overall": every | {"pairs": sum(out[t]["pairs"] for t in cfg.tasks)}}


def _again(sets: list[np.ndarray], rng: np.random.Generator) -> float:
    chosen = rng.integers(len(sets), size=len(sets))
    return float(np.mean([rng.choice(sets[k], len(sets[k])).mean() for k in chosen]))


def _interval(mean: float, drawn: np.ndarray) -> dict[str, float]:
    low, high = np.percentile(drawn, [2.5, 97.5])
    return {"mean": mean, "low": float(low), "high": float(high)}


def worth(found: dict[str, dict], name: str, demonstrations: int) -> float | None:
    """Real demonstrations with which a policy does as well in the mean of the tasks as a condition's.

    Between the numbers that were measured it goes by their logarithms; None beyond them.
    """
    curve = [
        (c.real * demonstrations, cells["overall"]["mean"])
        for n, cells in found.items()
        if (c := CONDITIONS.get(n)) and not c.made and not c.memory and cells["overall"]
    ]
    mean = found[name]["overall"] and found[name]["overall"]["mean"]
    numbers, means = np.array(sorted(curve)).T if len(curve) > 1 else (np.empty(0), np.empty(0))
    means = np.maximum.accumulate(means)
    if mean is None or not len(means) or not means[0] <= mean <= means[-1]:
        return None
    return float(np.exp(np.interp(mean, means, np.log(numbers))))


def rows(cfg, done: dict[str, dict], chosen: dict[str, Condition], base: str = BASE) -> list[dict]:
    """A row a condition, as text."""
    found = {name: success(cfg, done, name) for name in conditions(cfg)}
    out = []
    for name, condition in chosen.items():
        row = {"condition": name, "trained on": condition.words}
        row |= {task: _cell(found[name][task]) for task in cfg.tasks}
        overall = found[name]["overall"]
        row["mean"] = f"{overall['mean']:.1f}" if overall else "-"
        less = difference(cfg, done, name, base) if name != base else None
        row[f"minus {base}, by task"] = "; ".join(_points(less[t]) for t in cfg.tasks) if less else "-"
        row[f"minus {base}, mean"] = _points(less["overall"], 1) if less else "-"
        number = worth(found, name, cfg.demonstrations)
        row["worth so many real ones"] = "-" if number is None else f"{number:.0f}"
        out.append(row)
    return out


def reasons(cfg, done: dict[str, dict], chosen: dict[str, Condition]) -> list[dict]:
    """A row a condition, task and reason for which trials failed, as text."""
    out = []
    for name in chosen:
        for task in cfg.tasks:
            trials = [t for s in trials_of(cfg, done, name, task).values() for t in s.values()]
            why = [t["reason"] for t in trials if not t["success"]]
            counts = {reason: why.count(reason) for reason in sorted(set(why))}
            text = "; ".join(f"{n} {reason}" for reason, n in counts.items()) or "none"
            if trials:
                out.append(
                    {"condition": name, "task": task, "failed": f"{len(why)} of {len(trials)}", "why": text}
                )
    return out


def curve(cfg, done: dict[str, dict]) -> list[dict]:
    """Success against the number of real demonstrations, as text."""
    real = [n for n in cfg.conditions if not CONDITIONS[n].made and not CONDITIONS[n].memory]
    names = sorted(real, key=lambda n: CONDITIONS[n].real)
    out = []
    for name in names:
        cells = success(cfg, done, name)
        row = {"real demonstrations": f"{max(CONDITIONS[name].real * cfg.demonstrations, 1):.0f}"}
        row |= {task: _cell(cells[task]) for task in cfg.tasks}
        out.append(row | {"mean": f"{cells['overall']['mean']:.1f}" if cells["overall"] else "-"})
    return out if len(out) > 1 else []


def write(cfg, done: dict[str, dict], failed: dict[str, str], wall_s: float, console: Console) -> Path:
    """Prints the tables; writes `result.json`, `table.md` and the report, whose path it returns."""
    chosen = conditions(cfg)
    asked = {name: CONDITIONS[name] for name in cfg.conditions}
    compared = COMPARED if cfg.twin_before else {}
    tables = {
        "Success on the stand-in, %": rows(cfg, done, asked) if asked else [],
        "Before and after the twin was corrected, %": rows(cfg, done, compared) if compared else [],
        "Success and the number of real demonstrations, %": curve(cfg, done),
        "Why trials failed": reasons(cfg, done, chosen),
    }
    tables = {title: table for title, table in tables.items() if table}
    people = ", ".join("{} {:g} at width {:g}".format(task, *cfg.of_task(task)) for task in cfg.tasks)
    note = (
        f"{len(cfg.seeds)} sets of {cfg.demonstrations} demonstrations (person: {people}), {cfg.trials}"
        f" trials each, from the same starts for all conditions of a set; in brackets Wilson's 95 % interval"
        " and the number of trials; differences with 95 % intervals by resampling sets and starts;"
        f" {cfg.augmented} made, {cfg.pretrain_updates + cfg.finetune_updates} updates of {cfg.batch}."
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
            "versions": {name: _version(name) for name in PACKAGES},
            "options": dict(vars(cfg)),
            "success": found,
            "differences": {name: difference(cfg, done, name, BASE) for name in chosen if name != BASE},
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
        if title.startswith(("Success on", "Before")):
            report.figure(_bars(cfg, asked if title.startswith("Success") else compared, found), title)
    if failed:
        report.heading("What could not be done")
        report.table([{"unit": name, "why": why} for name, why in failed.items()])
    films = [(name, each) for name, unit in done.items() for each in unit["result"].get("films", ())]
    if films:
        report.heading("Failed trials")
    for name, each in films:
        text = f"{name.removesuffix('_films')}, start {each['start']}: {each['reason']}"
        report.videos([each["file"]], text, 320)
    report.heading("Learning curves")
    for task in cfg.tasks:
        report.figure(_curves(cfg, done, task, chosen), f"{task}: loss on the last data")
    report.heading("Seconds")
    report.table(seconds(done))
    return report.write(cfg.out)


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _cell(cell: dict | None) -> str:
    if cell is None:
        return "-"
    return f"{cell['mean']:.0f} ({cell['low']:.0f}-{cell['high']:.0f}, {cell['trials']})"


def _points(cell: dict, digits: int = 0) -> str:
    return f"{cell['mean']:+.{digits}f} ({cell['low']:+.{digits}f} to {cell['high']:+.{digits}f})"


def _bars(cfg, part: dict[str, Condition], found: dict[str, dict]):
    """Success with its interval: a group a task, a bar a condition."""
    import plotly.graph_objects as go

    figure = go.Figure()
    groups = [*cfg.tasks, "overall"]
    for name, condition in part.items():
        cells = [found[name][group] or {} for group in groups]
        up = [c.get("high", c.get("mean", 0.0)) - c.get("mean", 0.0) for c in cells]
        down = [c.get("mean", 0.0) - c.get("low", c.get("mean", 0.0)) for c in cells]
        figure.add_bar(
            x=groups,
            y=[cell.get("mean") for cell in cells],
            error_y={"array": up, "arrayminus": down, "symmetric": False, "thickness": 1},
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
            loss = unit["result"]["training"]["curve"]
            before = cfg.pretrain_updates if "pretraining" in unit["result"] else 0
            figure.add_scatter(
                x=[before + row["update"] for row in loss],
                y=[row.get("held_out", row["loss"]) for row in loss],
                name=name,
                legendgroup=name,
                showlegend=seed == cfg.seeds[0],
                line={"color": colour},
            )
    figure.update_layout(xaxis_title="update", yaxis_title="loss, mm² + kPa²", yaxis_type="log")
    return figure


def seconds(done: dict[str, dict]) -> list[dict]:
    """A row a kind of unit."""
    kinds: dict[str, list[float]] = {}
    for found in done.values():
        options = found["unit"].get("options", {})
        kind = found["unit"]["kind"]
        kinds.setdefault(f"{kind} {options['method']}" if "method" in options else kind, []).append(
            found["seconds"]
        )
    return [
        {"unit": kind, "number": len(s), "seconds each": sum(s) / len(s), "seconds in all": sum(s)}
        for kind, s in kinds.items()
    ]
