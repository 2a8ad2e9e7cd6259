"""How often a finding is right, by what a diagnosis knows of itself: weights of `diagnosis.belief`, a check.

    pneutac benchmark experiments --seed=131 --budget_min=6 --out=out
    python benchmarks/belief.py out            # the weights in use, on devices that they never saw
    python benchmarks/belief.py --fit out ...  # new weights, checked on devices that are left out in turn

Every diagnosis on the way counts that found something, of each device alike, and devices with a form in the
grammar as much as those without one.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from rich.console import Console
from scipy.optimize import minimize

from lerobot_pneutac.diagnosis.verdict import WEIGHTS, features
from pneutac_benchmarks.diagnosis.rules import BASE, COUNTS, counts
from pneutac_benchmarks.experiments import LAWS
from pneutac_benchmarks.tables import terminal

EDGES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0)


def read(folders: list[Path]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Features (4, n), whether right, weight and device (n,) of all diagnoses that found something."""
    rows, devices, names = [], [], []
    for file in sorted(f for folder in folders for f in (folder / "cases").glob("*.json")):
        case = json.loads(file.read_text())
        allowed = [n for n in COUNTS[case["effect"]] if n != BASE]
        for s in case["steps"]:
            if s["selected"] and "probability" in s:
                suffices = s["verdict"] == "missing_effect"
                right = counts(s["selected"][0], allowed)
                rows.append((s["error"] / s["noise"], s["probability"], suffices, right))
                devices.append(f"{file.parent.parent} {case['effect']}")
                names.append(case["effect"])
    error, share, suffices, right = (np.array([r[i] for r in rows], float) for i in range(4))
    device, form = np.array(devices), np.isin(names, LAWS)
    weight = np.array([1 / (device == d).sum() for d in device])
    for kind in (form, ~form):
        weight[kind] /= weight[kind].sum()
    return features(error, share, suffices), right, weight, device


def fitted(X: np.ndarray, right: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(4,) weights of the logistic regression, slightly damped."""

    def loss(b: np.ndarray) -> float:
        z = b @ X
        return float(weight @ (np.logaddexp(0, z) - right * z) + 1e-4 * weight.sum() * (b[1:] ** 2).sum())

    return minimize(loss, np.zeros(len(X))).x


def table(told: np.ndarray, right: np.ndarray, weight: np.ndarray, console: Console) -> None:
    """Prints what was told beside how often it was so."""

    def mean(x: np.ndarray, i: np.ndarray) -> float:
        return float(np.average(x[i], weights=weight[i]))

    rows, every = [], np.ones(len(told), bool)
    for low, high in zip(EDGES[:-1], EDGES[1:], strict=True):
        i = (told >= low) & (told < high)
        if i.any():
            rows.append(
                [f"{low:.1f} to {high:.1f}", str(i.sum()), f"{mean(told, i):.2f}", f"{mean(right, i):.2f}"]
            )
    console.print(terminal("How often it was right", ["told", "diagnoses", "in the mean", "right"], rows))
    ours, constant = mean((told - right) ** 2, every), mean((mean(right, every) - right) ** 2, every)
    console.print(f"Brier score {ours:.3f}; of the mean alone {constant:.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folders", nargs="+", type=Path, help="of pneutac benchmark experiments")
    parser.add_argument("--fit", action="store_true", help="fit new weights")
    args, console = parser.parse_args(), Console()
    X, right, weight, device = read(args.folders)
    told = 1 / (1 + np.exp(-np.array(WEIGHTS) @ X))
    if args.fit:
        console.print(f"weights {np.round(fitted(X, right, weight), 2).tolist()}")
        for d in set(device):
            out = device == d
            told[out] = 1 / (1 + np.exp(-fitted(X[:, ~out], right[~out], weight[~out]) @ X[:, out]))
    table(told, right, weight, console)


if __name__ == "__main__":
    main()
