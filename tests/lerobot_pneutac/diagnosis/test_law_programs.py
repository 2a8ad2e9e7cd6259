"""The program that is proposed for a law: its own, and one in which the law shows."""

import json

import numpy as np
import pandas as pd
import pytest

from lerobot_pneutac.diagnosis.design import predict, separations
from lerobot_pneutac.diagnosis.law_programs import law_program
from lerobot_pneutac.verbs.measure import read_program
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.effects.laws import TABLE, law, starts
from pneutac_sim.finger import BodyData, fit
from pneutac_sim.twin import Twin, Value

NOISE_MM = 0.4
TOP_KPA = 60.0
NEIGHBOURS = [  # pairs that one loop can hardly tell apart
    ("lag(p)", "power_law_memory(p)"),
    ("lag(p)", "lag(p^2)"),
    ("play(p)", "lag(p)"),
    ("tanh(dp/dt)", "play(p)"),
    ("mode(p)", "lag(p)"),
    ("p fading_max(p)", "p below_max(p)"),
    ("p lag(|dp/dt|)", "p lag(p |dp/dt|)"),
    ("power(p)", "hinge(p)"),
]


def bench(kpa: np.ndarray) -> Recording:
    t = np.arange(len(kpa)) / 10
    samples = pd.DataFrame({"trial": 0, "time_s": t, "pressure_cmd_kpa": kpa, "temperature_c": 23.0})
    samples[["tip_x_mm", "tip_z_mm"]] = 0.0
    meta = {"device": "finger", "length_mm": 110.0, "samples": "samples.csv"}
    return Recording("bench", meta, samples, "finger")


LOOPS = bench(TOP_KPA * 0.5 * (1 - np.cos(np.arange(600) / 10 * 2 * np.pi / 20)))


def with_law(name: str, weight: float = 0.15) -> Twin:
    twin = Twin.builtin()
    shape = [p for p in law(name).parameters if p.name not in ("weight", "scale_kpa")]
    values = {"weight": weight, "scale_kpa": TOP_KPA}
    values |= {
        p.name: s * TOP_KPA**p.range_power
        for p, s in zip(shape, starts(name)[len(starts(name)) // 2], strict=True)
    }
    twin.effects = {name: {k: Value(v) for k, v in values.items()}}
    return twin


def constants(twin: Twin, name: str) -> dict[str, float]:
    return {k: v.value for k, v in twin.effects[name].items()}


def planned(name: str, twin: Twin) -> Recording:
    program = law_program(LOOPS, name, constants(twin, name))
    return Recording("planned", LOOPS.meta, program.samples, "finger")


def seen(twin: Twin, recording: Recording) -> np.ndarray:
    return predict(twin, BodyData.of(recording, twin, source="command"))[0]


@pytest.mark.parametrize("name", [n for n in TABLE if not law(n).several])
def test_each_law_shows_in_its_own_program(name):
    twin = with_law(name, 1.0 if name == "round(p)" else 0.15)  # a converter rounds all of its command
    recording = planned(name, twin)
    left = seen(twin, recording) - seen(Twin.builtin(), recording)
    assert np.linalg.norm(left, axis=1).max() > 2 * NOISE_MM
    assert recording.samples["pressure_cmd_kpa"].max() <= 1.5 * TOP_KPA
    assert recording.samples["time_s"].max() <= 1200


@pytest.mark.parametrize(("one", "other"), NEIGHBOURS)
def test_neighbours_have_other_programs_and_each_tells_them_apart(one, other):
    """The other law is first fitted to loops of the one, as a diagnosis would."""
    twin = with_law(one)
    own, rival = (law_program(LOOPS, n, constants(with_law(n), n)) for n in (one, other))
    assert own.advice != rival.advice
    p, q = (x.samples["pressure_cmd_kpa"].to_numpy() for x in (own, rival))
    same = len(p) == len(q) and np.allclose(p, q)
    assert same == (TABLE[one].memory == TABLE[other].memory)  # else by what one looks at
    loops = bench(LOOPS.samples["pressure_cmd_kpa"].to_numpy())
    loops.samples[["tip_x_mm", "tip_z_mm"]] = seen(twin, loops)
    start = with_law(other, 0.01)
    fitted = fit(
        start, BodyData.of(loops, start, source="command"), only=[other, "gain_rad_per_kpa"], starts=2
    ).twin
    recording = planned(one, twin)
    left = seen(twin, recording) - seen(fitted, recording)
    assert np.linalg.norm(left, axis=1).max() > NOISE_MM


def test_the_constants_set_the_program():
    quick, slow = (law_program(LOOPS, "lag(p)", {"weight": 0.1, "time_s": t}) for t in (2.0, 20.0))
    assert "hold 6 s" in quick.advice and "hold 60 s" in slow.advice
    assert len(slow.samples) > 0.5 * len(quick.samples)
    p = slow.samples["pressure_cmd_kpa"].to_numpy()
    assert (p == 30.0).mean() == pytest.approx(0.25, abs=0.02) and p.max() == 60.0
    assert (
        law_program(LOOPS, "creep", {}) is None and law_program(LOOPS, "tracker_lag", {"time_s": 1.0}) is None
    )


@pytest.mark.parametrize("rate", [0.5, 12.0, 300.0])
def test_three_paces_are_three_at_any_rate(rate):
    program = law_program(LOOPS, "tanh(dp/dt)", {"weight": 0.1, "rate_kpa_per_s": rate, "time_s": 0.05})
    speed = np.abs(np.diff(program.samples["pressure_cmd_kpa"].to_numpy())) * 10
    assert all(
        (np.abs(speed - fast * speed.max()) < 0.05 * speed.max()).sum() > 20 for fast in (1, 1 / 3, 1 / 9)
    )


def test_the_warm_half_repeats_the_cold_one():
    twin = with_law("lag(p) dT")
    s = planned("lag(p) dT", twin).samples
    half = len(s) // 2
    assert np.array_equal(s["pressure_cmd_kpa"][:half], s["pressure_cmd_kpa"][half:])
    assert set(s["temperature_c"][:half]) == {23.0} and set(s["temperature_c"][half:]) == {31.0}


def test_a_laws_program_is_on_the_menu_and_can_be_driven(tmp_path):
    a, b = with_law("mode(p)"), with_law("lag(p)")
    names = [s.name for s in separations(LOOPS, a, b, NOISE_MM, ("mode(p)", "lag(p)"))]
    assert "for mode(p)" in names and "for lag(p)" not in names
    folder = LOOPS.write(tmp_path / "r")
    advice = law_program(LOOPS, "mode(p)", constants(a, "mode(p)")).advice
    told = {k: {"value": v} for k, v in constants(a, "mode(p)").items()}
    result = {"next_experiment": f"To confirm it: {advice}", "parameters": {"mode(p)": told}}
    (tmp_path / "result.json").write_text(json.dumps(result))
    (trial,) = read_program(str(tmp_path / "result.json"), 60.0, 100.0, folder)
    assert trial.program == "for mode(p)" and trial.pressure_kpa.max() == pytest.approx(60.0)
