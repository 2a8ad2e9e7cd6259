"""Whether the two answers of a diagnosis are true: how much is explained, and which mechanism it is.

python -m pneutac_benchmarks.diagnosis.answers FOLDER ...          # scores of `pneutac benchmark diagnosis`
python -m pneutac_benchmarks.diagnosis.answers --fit FOLDER ...    # new numbers of `diagnosis.verdict`

A recording ends explained where another day's error is at most `ENDS` times the noise. Where the answer
holds on condition of how commands are logged (`explained_where`), that day was logged so. A cause is right
where one of its terms is among the names that `rules.COUNTS` lists for the device, written before any result.
`BETWEEN` was listed after seed 300 had been seen, on which limits and weights of the answers were chosen.
"""

import argparse
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from scipy.optimize import minimize
from scipy.stats import binomtest

from lerobot_pneutac.diagnosis import thresholds as T
from pneutac_benchmarks.diagnosis.rules import COUNTS, COUNTS_AS_NEAR, counts
from pneutac_benchmarks.tables import terminal
from pneutac_sim.effects.laws import family

ENDS = 1.3
EDGES = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
RIDGE, RIDGE_FAMILY = 1.0, 0.2  # of the weights, on features of unit variance, and of each family's own
BETWEEN = (  # what changes between the days, so that a diagnosis of one cannot predict the other
    "marker_slip", "mount_knock", "mount_turned", "camera_warm_up", "slip_and_swelling", "stand_shakes",
    "tracker_freezes", "gauge_drifting",
)  # fmt: skip


def causes(answers: Sequence[dict]) -> list[dict]:
    """Each cause that was found, with `right` and the probability that was reported."""
    out = []
    for a in answers:
        accepted = [n for t in a["truth"] for n in COUNTS[t]]
        for c in a["causes"]:
            right = any(counts(t, accepted) for t in c["terms"])
            out.append(c | {"right": right, "probability": c["ranked"][c["cause"]], "effects": a["effects"]})
    return out


def judged(answer: dict) -> float:
    """Error over noise of another day, logged as the answer asks for."""
    return answer["ratio_logged"] if answer.get("explained_where") else answer["ratio"]


def show(answers: Sequence[dict], console: Console) -> None:
    """Prints both answers' tables; `answers` of the sets of truths."""
    rows, steady = [], [a for a in answers if a["effects"] not in BETWEEN]
    for name, chosen, ratio in (
        ("all", answers, judged),
        ("nothing changes between the days", steady, judged),
        ("the same, conditions not regarded", steady, lambda a: a["ratio"]),
        ("the same, as day 1 was recorded", steady, lambda a: a.get("ratio_recorded", a["ratio"])),
    ):
        ends = [a for a in chosen if ratio(a) <= ENDS]
        called = [a for a in chosen if a["explained"] == "fully"]
        recall = sum(a["explained"] == "fully" for a in ends)
        precision = sum(ratio(a) <= COUNTS_AS_NEAR for a in called)
        rows.append((name, *_share(recall, len(ends)), *_share(precision, len(called))))
    heads = (
        "recordings", f"other day within {ENDS}: called fully explained", "95 %",
        f"called fully explained: other day within {COUNTS_AS_NEAR}", "95 %",
    )  # fmt: skip
    console.print(terminal("Explained", heads, rows))
    every = causes(answers)
    if not every:
        return
    reported, right = (np.array([c[k] for c in every], float) for k in ("probability", "right"))
    rows = []
    for low, high in zip(EDGES[:-1], EDGES[1:], strict=True):
        i = (reported >= low) & ((reported < high) | (high == 1.0))
        if i.any():
            rows.append(
                (
                    f"{low:.1f} to {high:.1f}",
                    f"{reported[i].mean():.2f}",
                    *_share(int(right[i].sum()), i.sum()),
                )
            )
    console.print(terminal("Mechanism", ("probability reported", "mean", "right", "95 %"), rows))
    base, brier = right.mean(), ((reported - right) ** 2).mean()
    console.print(
        f"{len(every)} causes; Brier score {brier:.3f}; of the base rate {base:.2f} alone "
        f"{base * (1 - base):.3f}"
    )


def _share(k: int, n: int) -> tuple[str, str]:
    if not n:
        return "0 of 0", "-"
    interval = binomtest(k, n).proportion_ci(method="wilson")
    return f"{k} of {n}", f"{interval.low:.0%} to {interval.high:.0%}"


def fitted(every: Sequence[dict]) -> tuple[np.ndarray, dict[str, float]]:
    """Weights (k,) of a logistic regression with a ridge on causes' features, and what each family adds."""
    X, right = np.array([c["features"] for c in every]), np.array([c["right"] for c in every], float)
    families = sorted({c["cause"] for c in every})
    own = np.array([[c["cause"] == f for f in families] for c in every], float)
    mean, spread = X[:, 1:].mean(axis=0), X[:, 1:].std(axis=0) + 1e-9
    Z = np.column_stack([np.ones(len(X)), (X[:, 1:] - mean) / spread, own])
    ridge = np.repeat([0.0, RIDGE, RIDGE_FAMILY], [1, len(mean), len(families)])

    def loss(b: np.ndarray) -> float:
        z = Z @ b
        return float((np.logaddexp(0, z) - right * z).sum() + (ridge * b**2).sum())

    b = minimize(loss, np.zeros(Z.shape[1])).x
    slopes, of_family = b[1 : 1 + len(mean)] / spread, b[1 + len(mean) :]
    return np.r_[b[0] - slopes @ mean, slopes], dict(zip(families, map(float, of_family), strict=True))


def predicted(every: Sequence[dict], weights: np.ndarray, of_family: dict[str, float]) -> np.ndarray:
    """(n,) probabilities that causes are right."""
    z = np.array([np.dot(c["features"], weights) + of_family.get(c["cause"], 0.0) for c in every])
    return 1 / (1 + np.exp(-z))


def stood_for(answers: Sequence[dict]) -> dict[str, dict[str, float]]:
    """Of a family's wrong causes, the shares that were in truth another family that was not found besides.

    Shares are shrunk by two causes of no family; those that were seen once are left out.
    """
    seen, wrong = {}, Counter()
    for a in answers:
        every = causes([a])
        named = [t for c in every for t in c["terms"]]
        missed = [COUNTS[t] for t in a["truth"] if not any(counts(n, COUNTS[t]) for n in named)]
        for c in every:
            if not c["right"]:
                wrong[c["cause"]] += 1
                seen.setdefault(c["cause"], Counter()).update({family(m[0]) for m in missed if m})
    shares = {
        f: {g: n / (wrong[f] + 2) for g, n in count.most_common() if n > 1} for f, count in seen.items()
    }
    return {f: s for f, s in shares.items() if s}


def show_fit(answers: Sequence[dict], console: Console) -> None:
    """Prints new numbers of `diagnosis.verdict`, and how those fitted to other seeds do on each seed."""
    for seed in sorted({a["seed"] for a in answers}):
        of_it, others = (
            causes([a for a in answers if (a["seed"] == seed) == here]) for here in (True, False)
        )
        if of_it and others:
            p, right = predicted(of_it, *fitted(others)), np.array([c["right"] for c in of_it], float)
            sure = p > T.CERTAIN
            base = right.mean() * (1 - right.mean())
            console.print(
                f"seed {seed} by the others: Brier score {((p - right) ** 2).mean():.3f}, of the base rate "
                f"{base:.3f}; certain {sure.sum()}, right {right[sure].sum():.0f}"
            )
    weights, of_family = fitted(causes(answers))
    console.print(f"WEIGHTS = {tuple(np.round(weights, 2).tolist())}")
    console.print(f"FAMILY = { {f: round(b, 2) for f, b in of_family.items()} }")
    shares = {f: {g: round(n, 2) for g, n in s.items()} for f, s in stood_for(answers).items()}
    console.print(f"STOOD_FOR = {shares}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folders", nargs="+", type=Path, help="of pneutac benchmark diagnosis")
    parser.add_argument("--fit", action="store_true", help="fit new weights")
    args, console = parser.parse_args(), Console()
    answers = [json.loads(f.read_text()) for d in args.folders for f in sorted((d / "cases").glob("*.json"))]
    show(answers, console)
    if args.fit:
        show_fit(answers, console)


if __name__ == "__main__":
    main()
