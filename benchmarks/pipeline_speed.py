"""How fast the finger pipeline simulates and fits ten minutes at 20 Hz.

Run `OMP_NUM_THREADS=1 python benchmarks/pipeline_speed.py`.

CPU seconds of one core, the least of several runs after compilation.
"""

import time

import numpy as np
import pandas as pd

from pneutac_sim.effects import body_effects, get_effect
from pneutac_sim.finger import BodyData, Inputs, Pipeline, PressurePipeline, fit
from pneutac_sim.twin import Twin, Value

N, HZ, TOP = 12_000, 20, 15.0


def program() -> dict[str, np.ndarray]:
    """Holds, triangles and stairs, in trials of a minute, with every condition column."""
    rng = np.random.default_rng(0)
    t, p, i = np.arange(N) / HZ, np.zeros(N), 0
    while i < N:
        s = np.arange(min(N - i, int(rng.uniform(5, 40) * HZ)))
        p[i : i + len(s)] = [
            np.full(len(s), rng.uniform(0, TOP)),
            rng.uniform(5, TOP) * np.abs((s / HZ / rng.uniform(4, 20)) % 1 * 2 - 1),
            np.floor(6 * s / len(s)) * rng.uniform(1, 2.5),
        ][rng.integers(3)]
        i += len(s)
    trial = (t // 60).astype(int)
    table = {"trial": trial, "time_s": t, "pressure_cmd_kpa": p, "segment2_cmd_1_kpa": np.roll(p, 50)}
    table |= {f"pressure_cmd_{c + 1}_kpa": np.roll(p, 900 * c) for c in range(3)}
    table |= {"gravity_x": np.zeros(N), "gravity_y": np.zeros(N), "gravity_z": np.where(trial % 3, -1.0, 1.0)}
    return table | {"temperature_c": 22.0 + 6 * (trial % 2), "payload_g": np.where(trial % 4, 0.0, 50.0)}


def best(f, times: int = 5) -> float:
    """Least CPU time of several calls, s; the first call, which compiles, is not counted."""
    f()
    spent = []
    for _ in range(times):
        began = time.process_time()
        f()
        spent.append(time.process_time() - began)
    return min(spent)


def main() -> None:
    """Prints the table."""
    table = program()
    print("| what | ms |\n|---|---|")
    for device in ("finger", "arm"):
        twin = Twin(device=device, parameters={"gain_rad_per_kpa": Value(0.011)})
        inputs = Inputs.from_samples(table, device)
        for label, effects in (
            ("no effect", []),
            ("creep", ["creep"]),
            ("all effects", list(body_effects())),
        ):
            model = Pipeline.of(twin, inputs, effects)
            theta = model.theta(twin, TOP)
            ms = 1e3 * best(lambda m=model, x=inputs, t=theta: m.run(x, t))
            print(f"| simulate {N} samples of the {device}, {label} | {ms:.1f} |")

    truth = Twin.builtin()
    truth.effects["creep"] = get_effect("creep").start(TOP)
    inputs = Inputs.from_samples(table)
    model = Pipeline.of(truth, inputs)
    run = model.run(inputs, model.theta(truth))
    noise = 0.2 * np.random.default_rng(0).normal(size=(N, 2))
    table["tip_x_mm"], table["tip_z_mm"] = (model.outputs(run, ["tip_x_mm", "tip_z_mm"]) + noise).T
    recording = type("Recording", (), {"samples": pd.DataFrame(table), "device": "finger"})
    bench = BodyData.of(recording, truth)
    train = np.arange(N) // 300 % 3 > 0
    warm = fit(Twin(), bench, [], train).twin
    for label, twin, effects, starts in (
        ("static, from nothing", Twin(), [], 4),
        ("static + creep, from nothing", Twin(), ["creep"], 4),
        ("static + creep, from a calibrated twin", warm, ["creep"], 2),
        ("static + valve_lag + hysteresis, from a calibrated twin", warm, ["valve_lag", "hysteresis"], 2),
        ("static + gravity + payload, from a calibrated twin", warm, ["gravity", "payload"], 2),
    ):
        ms = 1e3 * best(lambda t=twin, e=effects, s=starts: fit(t, bench, e, train, starts=s), 3)
        print(f"| fit {N} samples, {label} | {ms:.0f} |")

    online = PressurePipeline(truth)
    ms = 1e3 * best(lambda: [online.step(p, 1 / 15) for p in table["pressure_cmd_kpa"][:1000]]) / 1000
    print(f"| one control step, creep | {ms:.3f} |")


if __name__ == "__main__":
    main()
