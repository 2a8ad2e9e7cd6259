"""`pneutac add` for a gel: switches an optics effect on, re-fits the light, keeps it if the error falls."""

import numpy as np
from rich.console import Console
from rich.table import Table

from lerobot_pneutac.reports.page import Report, write_result
from lerobot_pneutac.reports.sentences import percent
from lerobot_pneutac.study.gel import Bench, at_bound
from lerobot_pneutac.verbs.diagnose_gel import load_gel, own_effects
from lerobot_pneutac.verbs.fit_gel import for_twin
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.optics import OPTICS
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin


def run(twin: Twin, recording: Recording, cfg, console: Console) -> None:
    """The verb, for a gel.

    Raises:
        InputError: the effect is no optics effect or on already, or the held-out error does not surely fall.
    """
    from lerobot_pneutac.verbs.diagnose import progress

    if cfg.effect not in OPTICS:
        raise InputError(f"'{cfg.effect}' does not act on a gel's images; give one of {', '.join(OPTICS)}.")
    own = own_effects(twin)
    if cfg.effect in own:
        raise InputError(
            f"The twin has the effect '{cfg.effect}' already (it has {', '.join(own)}); "
            "`pneutac calibrate` re-fits it."
        )
    gel, data = load_gel(twin, recording)
    bench = Bench(gel, data, cfg.seed)
    noise = bench.noise()
    with progress(console) as (tell, done):
        tell(f"fitting with and without {cfg.effect}", 2)
        before = bench.trial(own)
        done()
        after = bench.trial([*own, cfg.effect], before.fit.gel)
        done()
    held = ~bench.train

    def errors(trial) -> dict:
        lo, hi = np.sqrt(np.quantile(bench.judge.mse(trial.squares), [0.025, 0.975]))
        return {
            "train": float(np.sqrt(trial.squares[bench.train].mean())),
            "heldout": float(np.sqrt(bench.judge.value(trial.squares))),
            "heldout_ci95": [float(lo), float(hi)],
            "heldout_contact": float(np.sqrt(trial.contact[held].mean())),
        }

    old, new = errors(before), errors(after)
    table = Table(title=f"error, levels (noise {noise:.3g})")
    for head in ("", "train", "held-out", "95 % interval", "contact"):
        table.add_column(head)
    for name, e in (("before", old), (f"with {cfg.effect}", new)):
        lo, hi = e["heldout_ci95"]
        cells = [
            f"{e['train']:.4g}",
            f"{e['heldout']:.4g}",
            f"{lo:.4g} to {hi:.4g}",
            f"{e['heldout_contact']:.4g}",
        ]
        table.add_row(name, *cells)
    console.print(table)
    fall = bench.judge.drop(before.squares, after.squares)
    if fall[1] <= 0:
        raise InputError(
            f"Nothing was written: with {cfg.effect} the held-out error goes from {old['heldout']:.4g} to "
            f"{new['heldout']:.4g} levels, which is no sure fall; `pneutac diagnose` tells what is missing."
        )
    share, interval = bench.judge.reduction(before.squares, after.squares, noise)
    fitted = after.fit.gel
    sentence = OPTICS[cfg.effect].describe(fitted.effects[cfg.effect], "gel")
    console.print(sentence, highlight=False)
    console.print(f"{cfg.effect} removes {percent(share, interval)} of the avoidable error", highlight=False)
    for_twin(fitted, twin).into_twin(twin)
    twin.save_version(
        cfg.twin,
        f"added {cfg.effect}",
        str(cfg.recording),
        {"train": new["train"], "heldout": new["heldout"], "unit": "levels", "seed": cfg.seed},
    )
    units = {p.name: p.unit for p in OPTICS[cfg.effect].parameters}
    values = fitted.effects[cfg.effect]
    result = {
        "effect": cfg.effect,
        "unit": "levels",
        "noise_floor": noise,
        "before": old,
        "after": new,
        "reduction": share,
        "reduction_ci95": list(interval),
        "parameters": {k: {"value": v, "ci95": None, "unit": units[k]} for k, v in values.items()},
        "at_bound": at_bound(fitted, [cfg.effect]),
        "checks": data.warnings,
        "twin": str(cfg.twin),
        "version": len(twin.history) - 1,
    }
    console.print(f"wrote version {result['version']} of {cfg.twin}", highlight=False)
    if cfg.out is not None:
        write_result(cfg.out, result)
        page = Report(f"Added {cfg.effect}")
        page.lead(
            f"{sentence} With {cfg.effect} the held-out error fell from {old['heldout']:.3g} to "
            f"{new['heldout']:.3g} levels."
        )
        page.table([{"": n, **e} for n, e in (("before", old), ("after", new))], "Levels of 8 bits.")
        page.table([{"parameter": k, **v} for k, v in result["parameters"].items()])
        console.print(f"report: {page.write(cfg.out)}", highlight=False)
