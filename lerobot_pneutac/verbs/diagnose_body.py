"""Which physical effect a body lacks, as a result."""

import math
import time
from dataclasses import dataclass

import numpy as np

from lerobot_pneutac.diagnosis.result import BodyFindings, Tested
from lerobot_pneutac.reports.page import Report
from lerobot_pneutac.reports.sentences import caveats, lead, next_experiment, percent
from lerobot_pneutac.verbs.diagnosis import Diagnosis

LITTLE_ALONE = 0.03  # share of the avoidable error: an effect that alone removes less looks like nothing


@dataclass(frozen=True, eq=False)
class BodyDiagnosis(Diagnosis):
    """What a body lacks.

    Attributes:
        found: everything that was found.
    """

    found: BodyFindings

    verdict = property(lambda self: self.found.verdict)
    selected = property(lambda self: self.found.selected)
    twin = property(lambda self: self.found.twin)
    findings = property(lambda self: self.found.findings)

    @property
    def title(self) -> str:
        """Heading of the table."""
        return f"held-out error, {self.found.noise.unit} (noise {self.found.noise.value:.3g})"

    @property
    def sentence(self) -> str:
        """What was found."""
        return lead(self.found)

    @property
    def next_experiment(self) -> str:
        """What to record next."""
        return next_experiment(self.found)[0]

    def rows(self) -> list[dict]:
        """The chosen effects and some others."""
        d = self.found
        heads = ("effect", "error alone", "avoidable error removed", "parameters", "")
        rows = [("(as it is)", f"{d.before_error:.3g}", "", "", "")]
        chosen = [t for t in d.tested if t.name in d.selected]
        rest = [t for t in d.tested if t.name not in d.selected][: max(2, 6 - len(chosen))]
        for t in chosen + rest:
            values = ", ".join(f"{k} {v['value']:.3g}" for k, v in list(t.parameters.items())[:3])
            rows.append((t.name, f"{t.heldout:.3g}", percent(t.reduction, t.ci95), values, how_found(d, t)))
        if d.selected:
            rows.append(("(all found)", f"{d.after_error:.3g}", "", "", ""))
        return [dict(zip(heads, row, strict=True)) for row in rows]

    def remarks(self) -> list[str]:
        """What was not tested, caveats, the next experiment, the verdict."""
        d = self.found
        return [
            *(f"  {u.name}: {u.reason}" for u in d.untested),
            *caveats(d),
            f"[bold]Next experiment:[/] {self.next_experiment}",
            f"verdict: {d.verdict}   ({d.seconds:.0f} s)",
        ]

    def to_dict(self) -> dict:
        """The content of `result.json`."""
        return result(self.found, self.next_experiment)

    def page(self) -> Report:
        """The sentence, then the evidence as pictures."""
        from lerobot_pneutac.reports.diagnosis import diagnosis_page

        return diagnosis_page(self.found, *next_experiment(self.found))


def how_found(d: BodyFindings, t: Tested) -> str:
    """What the table's last column says; some effects show only once others are there."""
    if t.name not in d.selected:
        return ""
    return "found" if t.reduction > LITTLE_ALONE or len(d.selected) == 1 else "found, with the others"


def result(d: BodyFindings, advice: str) -> dict:
    """The contract of `result.json`."""
    train = d.parts.train

    def errors(residual: np.ndarray) -> dict:
        squared = (residual**2).sum(1)
        return {"train": math.sqrt(squared[train].mean()), "heldout": math.sqrt(d.judge.value(squared))}

    share, interval = d.removed
    return {
        "verdict": d.verdict,
        "sentence": lead(d),
        "unit": d.noise.unit,
        "noise_floor": d.noise.value,
        "noise_floor_how": d.noise.how,
        "baseline": errors(d.before),
        "selected": d.selected,
        "after": errors(d.after),
        "reduction": share,
        "reduction_ci95": list(interval),
        "parameters": {
            name: {k: {"value": v.value, "ci95": v.ci95} for k, v in d.twin.effects[name].items()}
            for name in d.selected
        },
        "ladder": [{"change": label, **errors(r)} for label, r in d.ladder],
        "effects": [
            {
                "name": t.name, "heldout": t.heldout, "reduction": t.reduction,
                "reduction_ci95": list(t.ci95), "parameters": t.parameters, "tested_by": t.tested_by,
            }
            for t in d.tested
        ]
        + [
            {
                "name": u.name, "heldout": None, "reduction": None, "reduction_ci95": None, "parameters": {},
                "tested_by": u.reason,
            }
            for u in d.untested
        ],
        "indistinguishable": [[r.effect, r.rival] for r in d.rivals],
        "correlated": [{"effects": [a, b], "correlation": c} for a, b, c in d.correlated],
        "profile": [
            {
                "parameter": p.name, "value": p.value, "unit": p.unit, "interval95": list(p.interval),
                "bounded_below": p.below, "bounded_above": p.above, "remark": p.remark,
                "points": [{"value": v, "chi2": c} for v, c in p.points],
            }
            for p in d.profiles
        ],
        "at_bound": d.evidence.at_bound,
        "error_over_noise": {k: getattr(d.evidence, k) for k in ("before", "after", "limit")},
        "measured_pressure": d.measured_pressure,
        "findings": d.findings,
        "notes": caveats(d),
        "fingerprints": [
            {"effect": f.effect, "share": f.share, "chance": f.chance, "p_value": f.p_value} for f in d.prints
        ],
        "next_experiment": advice,
        "seconds": d.seconds,
        "time": time.strftime("%Y-%m-%d %H:%M"),
    }  # fmt: skip
